"""A pause of a run: asked for from any thread, heeded by the loop once a cycle."""

from __future__ import annotations


class Pause:
    """While it holds, the loop goes on to listen and moves nothing.

    Examples
    --------
    >>> pause = Pause()
    >>> pause.hold()
    >>> pause.held
    True
    """

    def __init__(self) -> None:
        self.held = False

    def hold(self) -> None:
        """From the next cycle on, only listen."""
        self.held = True

    def resume(self) -> None:
        """From the next cycle on, steer again."""
        self.held = False
