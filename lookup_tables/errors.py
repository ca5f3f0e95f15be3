"""Errors of this package; each also derives from the built-in it resembles."""

from __future__ import annotations


class TableError(ValueError):
    """A field table that cannot be read, built or used; for a file the message has one line for each fault."""


class OutsideTableError(ValueError):
    """A point outside the volume that a field table covers; the message names the point and the covered range."""
