"""What a path is made from: points, and what a user should know of how they came about."""

from __future__ import annotations

from dataclasses import dataclass

from smolbot.core.arrays import FloatArray


@dataclass(frozen=True)
class Outline:
    """Points (n, 2) or (n, 3) in mm, and remarks on them, each a sentence without its full stop."""

    points: FloatArray
    remarks: tuple[str, ...] = ()
