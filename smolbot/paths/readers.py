"""Readers of path files, by suffix: entry points of ``smolbot.path_readers``."""

from __future__ import annotations

from pathlib import Path

from smolbot.core.arrays import FloatArray
from smolbot.paths.curve import read_csv


class CsvReader:
    """Reader of points x and y in mm, one per row; see `smolbot.paths.curve.read_csv`."""

    has_shapes = False

    @staticmethod
    def read(path: Path, element: str | None, width_mm: float | None, height_mm: float | None) -> FloatArray:
        """Read the points of a path.

        Parameters
        ----------
        path : Path
        element : str or None
            Not used.
        width_mm, height_mm : float or None
            Not used.

        Returns
        -------
        ndarray, shape (n, 2), in mm
        """
        return read_csv(path)


class SvgReader:
    """Reader of one shape of a drawing; see `smolbot.paths.drawing.svg.read_svg`."""

    has_shapes = True

    @staticmethod
    def read(path: Path, element: str | None, width_mm: float | None, height_mm: float | None) -> FloatArray:
        """Read the points of one shape.

        Parameters
        ----------
        path : Path
        element : str or None
            Id of the shape; needed only if the drawing holds more than one.
        width_mm, height_mm : float or None
            Size to which the shape is scaled.

        Returns
        -------
        ndarray, shape (n, 2), in mm
            Centred on the origin.
        """
        from smolbot.paths.drawing.svg import read_svg

        return read_svg(path, element, width_mm, height_mm)
