"""Paths in files of the lab's own: a radius in mm and an angle in degrees in each line."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from smolbot import InputError
from smolbot.core import FloatArray


class PolarReader:
    """Reads .polar files."""

    has_shapes = False

    @staticmethod
    def read(path: Path, element: str | None, width_mm: float | None, height_mm: float | None) -> FloatArray:
        """Points (n, 2) in mm."""
        try:
            radius, angle = np.loadtxt(path, ndmin=2).T
        except (OSError, ValueError) as error:
            raise InputError(f"{path}: each line must be a radius and an angle: {error}.") from error
        return np.column_stack([radius * np.cos(np.radians(angle)), radius * np.sin(np.radians(angle))])
