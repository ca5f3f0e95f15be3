"""A pause of a run: requested from any thread, applied by the loop once a cycle."""

from __future__ import annotations


class Pause:
    """Switch that holds the robot: while it is on, the loop listens but does not move the robot.

    Attributes
    ----------
    held : bool
        True while the pause is on.

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
        """Only listen, from the next cycle on."""
        self.held = True

    def resume(self) -> None:
        """Steer again, from the next cycle on."""
        self.held = False
