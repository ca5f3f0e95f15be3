"""Errors of this package; each also derives from the built-in error that it resembles."""

from __future__ import annotations

import re

_PLACE = re.compile(r"(?P<file>[^:\n]+(?::[^:\n]+)*?\.\w+)(?::(?P<line>\d+))?: ")


class TableError(ValueError):
    """A field table that cannot be read, built or used; for a file the message has one line for each fault.

    Examples
    --------
    >>> error = TableError("coils.txt:1204: Bz of coil 3 is not a number.")
    >>> error.file, error.line
    ('coils.txt', 1204)
    """

    @property
    def file(self) -> str:
        """File of the first fault; empty if it concerns no file."""
        found = _PLACE.match(str(self))
        return found["file"] if found else ""

    @property
    def line(self) -> int | None:
        """Line of the first fault; None if it concerns no line."""
        found = _PLACE.match(str(self))
        return int(found["line"]) if found and found["line"] else None


class OutsideTableError(ValueError):
    """A point outside the volume that a field table covers; the message names the point and the covered range.

    Parameters
    ----------
    message : str
    point, low, high : tuple of float, in m, or None
        The first such point, and the corners of the covered volume; attributes of the error too.
    """

    def __init__(
        self, message: str = "", /, *, point: tuple[float, ...] | None = None, low: tuple[float, ...] | None = None,
        high: tuple[float, ...] | None = None,
    ) -> None:  # fmt: skip
        super().__init__(message)
        self.point, self.low, self.high = point, low, high
