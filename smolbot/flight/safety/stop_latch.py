"""The stop latch of a run: once tripped, it stays tripped."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

Ending = Literal["stopped", "failed"]


class Latch:
    """Latch that forbids to play anything more, with the reason. Once tripped, it stays tripped.

    It takes no lock: it is safe to use from any thread and from signal handlers.

    Attributes
    ----------
    over : bool
        True once the run has ended.

    Examples
    --------
    >>> latch = Latch()
    >>> latch.trip("stopped by the operator (key)", "stopped")
    True
    >>> latch.trip("coil '+x' is too hot"), latch.reason, latch.ending
    (False, 'stopped by the operator (key)', 'stopped')
    """

    def __init__(self) -> None:
        self._first: dict[str, tuple[str, Ending]] = {}
        self._halts: list[Callable[[], None]] = []
        self.over = False

    @property
    def tripped(self) -> bool:
        """True once it was tripped."""
        return bool(self._first)

    @property
    def reason(self) -> str:
        """Why it was tripped; empty if it was not."""
        return self._first["first"][0] if self._first else ""

    @property
    def ending(self) -> Ending:
        """Status of a run that it ended: ``stopped`` by a person, ``failed`` by a fault."""
        return self._first["first"][1] if self._first else "failed"

    def trip(self, reason: str, ending: Ending = "failed", *, halt: bool = True) -> bool:
        """Trip the latch and call the halt functions that are bound to it. The first reason is kept.

        Parameters
        ----------
        reason : str
        ending : {"failed", "stopped"}
            Status of the run: ended by a fault, or by a person.
        halt : bool
            Whether to call the halt functions. Signal handlers pass False: they may have interrupted one of them.

        Returns
        -------
        bool
            True if this call was the first.
        """
        mine = (reason, ending)
        first = self._first.setdefault("first", mine) is mine
        if halt:
            for stop in self._halts:
                stop()
        return first

    def bind(self, halt: Callable[[], None]) -> None:
        """Have a function called when the latch trips; at once if it has tripped already.

        Parameters
        ----------
        halt : callable
            Takes no arguments.
        """
        self._halts.append(halt)
        if self.tripped:
            halt()

    def end(self) -> None:
        """Mark the run as over: nothing more is played, and no signal interrupts."""
        self.over = True
