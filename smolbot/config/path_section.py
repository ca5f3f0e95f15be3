"""The ``[path]`` section of a mission file, and the curve that it describes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import PurePath
from typing import TYPE_CHECKING

import numpy as np
from pydantic import field_validator, model_validator

from smolbot.config.alternatives import PATHS
from smolbot.config.document import Document, Fault, FileModel
from smolbot.config.plugins import list_plugins, load_plugin
from smolbot.config.units import NotNegative, Point, Positive
from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError, report_plugin_errors
from smolbot.paths.corners import round_corners
from smolbot.paths.curve import Curve
from smolbot.paths.glyphs import find_glyph_fault, make_glyph_outline
from smolbot.paths.outline import Outline
from smolbot.paths.speed_profile import compute_speed_profile

if TYPE_CHECKING:
    from smolbot.config.plugin_protocols import PathReader


class PathSection(FileModel):
    """The path in the horizontal plane, in mm: a glyph with its size, a list of points, or an SVG or CSV file.

    Attributes
    ----------
    width_mm, height_mm : float
        Size of a glyph, or of an SVG. With one of the two an SVG keeps its aspect ratio, with neither its own size.
    element : str
        Id of the SVG shape to use.
    center_mm : tuple of float
        World position of the middle of a glyph or an SVG, or of the origin of points and of a CSV.
    corner_radius_mm : float
        Radius of rounded corners; 0 keeps corners sharp.
    speed_mm_s : float
        Requested speed along the path, recording time included; without it the law goes as fast as it can.
    lateral_mm_s2, acceleration_mm_s2 : float
        Limits that reduce the speed in bends: of v² times curvature, and of the change of speed along the path.
    """

    glyph: str | None = None
    width_mm: Positive | None = None
    height_mm: Positive | None = None
    points_mm: list[Point] | None = None
    file: str | None = None
    element: str | None = None
    center_mm: Point = (0.0, 0.0)
    corner_radius_mm: NotNegative = 0.0
    speed_mm_s: Positive | None = None
    lateral_mm_s2: Positive | None = None
    acceleration_mm_s2: Positive | None = None

    @field_validator("glyph")
    @classmethod
    def _check_glyph(cls, name: str | None) -> str | None:
        fault = find_glyph_fault(name) if name is not None else None
        if fault:
            raise ValueError(fault)
        return name

    @field_validator("points_mm")
    @classmethod
    def _check_point_count(cls, points: list[Point] | None) -> list[Point] | None:
        if points is not None and len(points) < 2:
            raise ValueError("points_mm needs at least two points.")
        return points

    @field_validator("file")
    @classmethod
    def _readable(cls, file: str | None) -> str | None:
        known = list_plugins("path_readers")
        if file is not None and _suffix(file) not in known:
            raise ValueError(f"no reader of '.{_suffix(file)}' is installed; files may be: {', '.join(known)}.")
        return file

    @model_validator(mode="after")
    def _check_one_kind(self) -> PathSection:
        given = [name for name in PATHS if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"give one of glyph, points_mm or file; got {', '.join(given) or 'none'}.")
        if self.glyph is not None and (self.width_mm is None or self.height_mm is None):
            raise ValueError("a glyph needs width_mm and height_mm.")
        has_shapes = self.reader is not None and self.reader.has_shapes
        if self.glyph is None and not has_shapes and (self.width_mm is not None or self.height_mm is not None):
            raise ValueError(
                "width_mm and height_mm belong to a glyph or an SVG; points and a CSV have their size in mm."
            )
        if self.element is not None and not has_shapes:
            raise ValueError("element names a shape of an SVG file; there is none.")
        if self.lateral_mm_s2 is not None and self.speed_mm_s is None:
            raise ValueError("lateral_mm_s2 slows a path's speed in bends; give speed_mm_s too.")
        if self.acceleration_mm_s2 is not None and self.lateral_mm_s2 is None:
            raise ValueError("acceleration_mm_s2 limits how a speed changes before bends; give lateral_mm_s2 too.")
        return self

    @property
    def reader(self) -> PathReader | None:
        """What reads the file; None where the path is in none."""
        return None if self.file is None else load_plugin("path_readers", _suffix(self.file))


def _suffix(file: str) -> str:
    return PurePath(file).suffix.lower().removeprefix(".")


def read_path(document: Document, section: PathSection, height: float) -> tuple[Curve, tuple[str, ...]]:
    """Make the curve that a ``[path]`` section describes.

    Parameters
    ----------
    document : Document
        The mission file.
    section : PathSection
    height : float, in m
        z of the curve in the world frame.

    Returns
    -------
    Curve
        In the world frame.
    tuple of str
        Remarks on how the curve was made.

    Raises
    ------
    ConfigError
        With the key at fault, and the place in the file that it names.
    """
    key = next(name for name in PATHS if getattr(section, name) is not None)
    try:
        outline = _read_outline(document, section)
        curve = Curve(_to_world(outline, section.center_mm, height))  # coincident points are reported as given
        remarks = outline.remarks
        if section.corner_radius_mm > 0.0:
            moved = round_corners(outline.points + np.array(section.center_mm), section.corner_radius_mm)
            curve, remarks = Curve(_to_world(moved, (0.0, 0.0), height)), (*remarks, *moved.remarks)
        if section.speed_mm_s is not None:
            limits = (None if v is None else v * 1e-3 for v in (section.lateral_mm_s2, section.acceleration_mm_s2))
            curve = replace(curve, speed=compute_speed_profile(curve.points, section.speed_mm_s * 1e-3, *limits))
        return curve, remarks
    except InputError as error:
        raise document.error([Fault(("path", key), str(error))]) from error


def _read_outline(document: Document, section: PathSection) -> Outline:
    if section.glyph is not None:
        assert section.width_mm is not None
        assert section.height_mm is not None
        return make_glyph_outline(section.glyph, section.width_mm, section.height_mm)
    reader = section.reader
    if section.file is None or reader is None:
        return Outline(np.array(section.points_mm))
    path = document.folder(("path", "file")) / section.file
    with report_plugin_errors("Path reader", reader, "read"):
        points = np.asarray(reader.read(path, section.element, section.width_mm, section.height_mm), dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2:
        raise InputError(f"{path}: points must have shape (n, 2) with n at least 2; its reader gave {points.shape}.")
    return Outline(points)


def _to_world(outline: Outline, center_mm: Point, height: float) -> FloatArray:
    """Return points (n, 3) in the world frame, in m."""
    flat = (outline.points + np.array(center_mm)) * 1e-3
    return np.column_stack([flat, np.full(len(flat), height)])
