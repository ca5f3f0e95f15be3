"""The latch of a run: shut once, by whoever has a reason, and shut it stays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

Ending = Literal["stopped", "failed"]


class Latch:
    """Says that nothing more may be played, and why. Safe from any thread and from signal handlers; takes no lock.

    Examples
    --------
    >>> latch = Latch()
    >>> latch.shut("stopped by the operator (key)", "stopped")
    True
    >>> latch.shut("coil '+x' is too hot"), latch.reason, latch.ending
    (False, 'stopped by the operator (key)', 'stopped')
    """

    def __init__(self) -> None:
        self._first: dict[str, tuple[str, Ending]] = {}
        self._halts: list[Callable[[], None]] = []
        self.over = False

    @property
    def is_shut(self) -> bool:
        return bool(self._first)

    @property
    def reason(self) -> str:
        """Why it was shut; empty while it is not."""
        return self._first["first"][0] if self._first else ""

    @property
    def ending(self) -> Ending:
        """How a run ends that it was shut on: by a person, or by a fault."""
        return self._first["first"][1] if self._first else "failed"

    def shut(self, reason: str, ending: Ending = "failed", *, halt: bool = True) -> bool:
        """Shut it, and halt what is bound to it; the first reason stays. True if this call was the first.

        `halt` is left out by signal handlers: they may have interrupted the very code that they would call.
        """
        mine = (reason, ending)
        first = self._first.setdefault("first", mine) is mine
        if halt:
            for stop in self._halts:
                stop()
        return first

    def bind(self, halt: Callable[[], None]) -> None:
        """Have `halt` called when the latch is shut; at once if it is."""
        self._halts.append(halt)
        if self.is_shut:
            halt()

    def end(self) -> None:
        """The run is over, for whatever reason: from here on nothing is played, and no signal interrupts."""
        self.over = True
