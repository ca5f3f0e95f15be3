"""Readers of the files that a mission's path may stand in, by suffix: entry points of ``smolbot.path_readers``."""

from __future__ import annotations

from pathlib import Path

from smolbot.core.arrays import FloatArray
from smolbot.paths.curve import read_csv


class CsvReader:
    """Points x and y in mm, a row each; see `smolbot.paths.curve.read_csv`."""

    has_shapes = False

    @staticmethod
    def read(path: Path, element: str | None, width_mm: float | None, height_mm: float | None) -> FloatArray:
        """Points, shape (n, 2), in mm."""
        return read_csv(path)


class SvgReader:
    """One shape of a drawing; see `smolbot.paths.drawing.svg.read_svg`."""

    has_shapes = True

    @staticmethod
    def read(path: Path, element: str | None, width_mm: float | None, height_mm: float | None) -> FloatArray:
        """Points, shape (n, 2), in mm, centred on the origin."""
        from smolbot.paths.drawing.svg import read_svg

        return read_svg(path, element, width_mm, height_mm)
