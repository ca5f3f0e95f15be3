"""Printed markers at known positions: the file that lists them, and their detection in a picture.

A TOML file, mm in the rig's world frame::

    [fiducials]
    dictionary = "4x4_50"        # of ArUco
    side_mm = 8.0                # of a marker's black square
    height_mm = 45.0             # z of the plane that they lie in
    place_tolerance_mm = 0.05    # print and ruler, one standard deviation

    [[fiducials.markers]]
    id = 0
    center_mm = [-33, 33]
    turn_deg = 0                 # of its upper edge, counterclockwise from above; 0: the top faces +y
    height_mm = 60.0             # where it differs from that of the others

    [camera]                     # optional; without it parallax is less certain
    height_mm = 380.0            # z of the lens

Markers in one plane determine that plane, but leave the camera's tilt uncertain by some tenths of a degree. Points
15 mm above them are then located with an error of 0.1 to 0.3 mm. Put some of the markers, or all, at the robot's
height.

Markers under a liquid appear higher than they lie: give ``surface - depth / n`` as their height (n: refractive
index).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, field_validator

from smolbot.config.document import Document, FileModel
from smolbot.config.units import NotNegative, Positive
from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError
from smolbot.runs.optics.view import View, find_view

MIN_MARKERS = 2  # markers: one alone does not determine the tilt of the camera
MAX_RESIDUAL = 0.5e-3  # m: markers with larger residuals are not where the file states
DICTIONARIES = [f"{n}x{n}_{m}" for n in (4, 5, 6, 7) for m in (50, 100, 250, 1000)] + ["apriltag_36h11"]


class MarkerSection(FileModel):
    """Position of one marker."""

    id: Annotated[int, Field(ge=0)]
    center_mm: tuple[float, float]
    turn_deg: float = 0.0
    height_mm: float | None = None


class FiducialsSection(FileModel):
    """All markers."""

    dictionary: str = "4x4_50"
    side_mm: Positive
    height_mm: float
    place_tolerance_mm: NotNegative = 0.05
    markers: Annotated[list[MarkerSection], Field(min_length=MIN_MARKERS)]

    @field_validator("dictionary")
    @classmethod
    def _check_dictionary(cls, value: str) -> str:
        if value.lower() not in DICTIONARIES:
            raise ValueError(f"no dictionary is named '{value}'; known: {', '.join(DICTIONARIES)}.")
        return value.lower()

    @field_validator("markers")
    @classmethod
    def _check_ids_unique(cls, value: list[MarkerSection]) -> list[MarkerSection]:
        ids = [m.id for m in value]
        twice = sorted({i for i in ids if ids.count(i) > 1})
        if twice:
            raise ValueError(f"each marker has an id of its own; {twice[0]} comes twice.")
        return value


class CameraSection(FileModel):
    """Known properties of the camera."""

    height_mm: float | None = None


class FiducialsFile(FileModel):
    """All sections of a file of markers."""

    fiducials: FiducialsSection
    camera: CameraSection = CameraSection()


@dataclass(frozen=True)
class MarkerView:
    """The camera view determined from markers.

    Attributes
    ----------
    view : View
    detected : tuple of int
        Ids of the detected markers.
    missing : tuple of int
        Ids of markers of the file that were not detected.
    """

    view: View
    detected: tuple[int, ...]
    missing: tuple[int, ...]


def read_fiducials(path: Path) -> FiducialsFile:
    """Read a file of markers.

    Parameters
    ----------
    path : Path

    Returns
    -------
    FiducialsFile

    Raises
    ------
    ConfigError, MissingFileError
        With ``file:line: key`` for each fault.
    """
    return Document.read(path).validated(FiducialsFile)


def compute_corners(section: FiducialsSection, marker: MarkerSection) -> FloatArray:
    """Compute the world positions of a marker's corners: upper left, upper right, lower right, lower left.

    Parameters
    ----------
    section : FiducialsSection
    marker : MarkerSection

    Returns
    -------
    ndarray, shape (4, 3), in m
        In the world frame.
    """
    half, turn = 0.5 * section.side_mm, np.radians(marker.turn_deg)
    own = half * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])
    c, s = np.cos(turn), np.sin(turn)
    flat = np.array(marker.center_mm) + own @ np.array([[c, s], [-s, c]])
    height = section.height_mm if marker.height_mm is None else marker.height_mm
    return np.asarray(1e-3 * np.column_stack([flat, np.full(4, height)]))


def find_view_by_markers(picture: Any, file: FiducialsFile, camera_height: float | None = None) -> MarkerView:
    """Find the markers of a file in a picture, and the camera from them.

    Parameters
    ----------
    picture : Image
    file : FiducialsFile
    camera_height : float, optional, in m
        Used instead of the file's own.

    Returns
    -------
    MarkerView

    Raises
    ------
    InputError
        If too few markers are detected, or they do not lie where the file states.
    """
    section = file.fiducials
    detected = _detect(picture, section.dictionary)
    markers = {m.id: m for m in section.markers}
    here = [i for i in markers if i in detected]
    missing = tuple(i for i in markers if i not in detected)
    if len(here) < MIN_MARKERS:
        others = sorted(set(detected) - set(markers))
        also = f", but {', '.join(map(str, others))} that the file does not name" if others else ""
        raise InputError(
            f"found {len(here)} of {len(markers)} markers (ArUco {section.dictionary}; wanted {_format_ids(markers)})"
            f"{also}. {MIN_MARKERS} or more are needed: "
            "are they in the picture, sharp, with a white border, and of that dictionary?"
        )
    pixels = np.vstack([detected[i] for i in here])
    points = np.vstack([compute_corners(section, markers[i]) for i in here])
    height = camera_height
    if height is None and file.camera.height_mm is not None:
        height = 1e-3 * file.camera.height_mm
    # the corners of a marker err together: so many count as one
    place = 2e-3 * section.place_tolerance_mm
    view = find_view(pixels, points, (picture.shape[1], picture.shape[0]), height, point_sigma=place)
    off = view.rms / view.compute_scale(points.mean(axis=0))
    if off > MAX_RESIDUAL:
        raise InputError(
            f"Markers {_format_ids(here)} do not lie where the file says: {view.rms:.1f} pixels or {1e3 * off:.2f} mm "
            "(rms) "
            "are left. Check ids, places, turn_deg and side_mm; and height_mm of the camera."
        )
    return MarkerView(view, tuple(here), missing)


def _detect(picture: Any, dictionary: str) -> dict[int, FloatArray]:
    """Detect the markers of a dictionary; return the corners (4, 2) in pixels of each by id."""
    import cv2

    words = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{dictionary.upper()}"))
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    corners, ids, _ = cv2.aruco.ArucoDetector(words, settings).detectMarkers(picture)
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    found: dict[int, FloatArray] = {}
    for number, quad in zip([] if ids is None else ids.ravel(), corners, strict=True):
        found[int(number)] = _refine_corners(grey, quad.reshape(4, 2).astype(np.float64))
    return found


def _refine_corners(grey: Any, quad: FloatArray) -> FloatArray:
    """Compute corners (4, 2) to subpixel accuracy as intersections of lines through a square's edges."""
    import cv2

    side = float(np.mean(np.linalg.norm(quad - np.roll(quad, 1, axis=0), axis=1)))
    reach = max(3.0, 0.07 * side)
    steps = np.arange(-reach, reach + 0.25, 0.5)
    for _ in range(2):
        middle = quad.mean(axis=0)
        lines = []
        for i in range(4):
            a, b = quad[i], quad[(i + 1) % 4]
            t = np.linspace(0.12, 0.88, 40)[:, None]
            along = a + t * (b - a)
            normal = np.array([b[1] - a[1], a[0] - b[0]]) / np.linalg.norm(b - a)
            normal *= np.sign((a - middle) @ normal)
            at = along[:, None] + steps[None, :, None] * normal
            profile = cv2.remap(
                grey, at[..., 0].astype(np.float32), at[..., 1].astype(np.float32), cv2.INTER_LINEAR
            ).astype(np.float64)  # fmt: skip
            rise = np.maximum(np.diff(profile, axis=1), 0.0)  # black within, white around
            rise[rise < 0.25 * rise.max(axis=1, keepdims=True)] = 0.0
            where = rise @ (0.5 * (steps[1:] + steps[:-1])) / np.maximum(rise.sum(axis=1), 1e-9)
            points = along + np.where(rise.sum(axis=1) > 0, where, 0.0)[:, None] * normal
            lines.append(_fit_line(points))
        quad = np.array([_intersect(lines[i - 1], lines[i]) for i in range(4)])
    return quad


def _fit_line(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit a line to most of the points; return its middle and direction."""
    kept = points
    for _ in range(3):
        middle = kept.mean(axis=0)
        direction = np.linalg.svd(kept - middle)[2][0]
        away = np.abs((points - middle) @ np.array([-direction[1], direction[0]]))
        kept = points[away <= max(2.5 * float(np.median(away)), 0.1)]
    return middle, direction


def _intersect(one: tuple[FloatArray, FloatArray], other: tuple[FloatArray, FloatArray]) -> FloatArray:
    steps = np.linalg.solve(np.column_stack([one[1], -other[1]]), other[0] - one[0])
    return np.asarray(one[0] + steps[0] * one[1])


def _format_ids(ids: Any) -> str:
    return ", ".join(str(i) for i in ids)
