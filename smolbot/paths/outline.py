"""The points of a path before it becomes a curve, with remarks for the user."""

from __future__ import annotations

from dataclasses import dataclass

from smolbot.core.arrays import FloatArray


@dataclass(frozen=True)
class Outline:
    """Points of a path, and remarks on how they were made.

    Attributes
    ----------
    points : ndarray, shape (n, 2) or (n, 3), in mm
    remarks : tuple of str
        A sentence each, without its full stop.
    """

    points: FloatArray
    remarks: tuple[str, ...] = ()
