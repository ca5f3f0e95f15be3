"""The known track of a positioning stage: a row per recording, with position and orientation of the device.

A .csv file with named columns; other columns and lines that begin with ``#`` are ignored:

- ``x_mm, y_mm, z_mm``: the cantilever's rotation centre, in the rig's world frame.
- ``along_x, along_y, along_z`` and ``swing_x, swing_y, swing_z``: world directions of the cantilever (body z) and
  of
  its swing (body x), of any length. Or ``qw, qx, qy, qz``, as ``smolbot localize`` writes orientations.
- ``file``, optional: file of this row's samples, relative to the track. Rows with the same file take its shots in
  order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from smolbot.config.document import write_lines
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.rotations import quaternion_from_axes
from smolbot.core.text_table import Row, read_table
from smolbot.errors import InputError, MissingFileError

POSITION_COLUMNS = ("x_mm", "y_mm", "z_mm")
QUATERNION_COLUMNS = ("qw", "qx", "qy", "qz")
ALONG_COLUMNS, SWING_COLUMNS = ("along_x", "along_y", "along_z"), ("swing_x", "swing_y", "swing_z")

UNKNOWN_COVARIANCE = np.full((6, 6), math.nan)
"""Covariance of a pose that a stage tells: none is claimed."""


@dataclass(frozen=True, eq=False)
class KnownTrack:
    """Content of a track file.

    Attributes
    ----------
    path : Path
    poses : tuple of Pose
        One for each row; their covariance is nan.
    files : tuple of Path or None
        File of each row's samples; None where the row names none.
    """

    path: Path
    poses: tuple[Pose, ...]
    files: tuple[Path | None, ...]


def read_known_track(path: str | Path) -> KnownTrack:
    """Read a track.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    KnownTrack

    Raises
    ------
    InputError
        With ``file:line: column`` for a missing column or a value that is no number.
    MissingFileError
        If there is no such file.
    """
    path = Path(path)
    if not path.is_file():
        raise MissingFileError(f"{path}: no such file.", name=str(path))
    table = read_table(path, named=True)
    if not table.rows:
        raise InputError(
            f"{path}: holds no track; a line of column names ({_format_needed_columns()}) "
            "and a row per recording are needed."
        )
    turned = _has_direction_columns(path, table.names)
    poses = [
        Pose(0.0, 1e-3 * row.parse_finite(POSITION_COLUMNS), _parse_orientation(row, turned), UNKNOWN_COVARIANCE)
        for row in table.rows
    ]
    files = [row["file"] if "file" in table.names else "" for row in table.rows]
    return KnownTrack(path, tuple(poses), tuple(path.parent / file if file else None for file in files))


def write_known_track(path: str | Path, poses: Sequence[Pose], files: Sequence[str]) -> None:
    """Write a track that `read_known_track` reads back.

    Parameters
    ----------
    path : str or Path
    poses : sequence of Pose
        One for each row.
    files : sequence of str
        File of each row's samples.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    lines = [",".join([*POSITION_COLUMNS, *ALONG_COLUMNS, *SWING_COLUMNS, "file"])]
    for pose, file in zip(poses, files, strict=True):
        values = [*(1e3 * pose.position), *pose.body_axis("z"), *pose.body_axis("x")]
        lines.append(",".join([*(f"{v:.9g}" for v in values), file]))
    write_lines(path, lines)


def plan_track(low: FloatArray, high: FloatArray, count: int) -> list[Pose]:
    """Plan poses that fill a box evenly, for a stage with a rotary axis and three holders.

    Headings are spread over the full circle. The three holders follow each other: cantilever level with level
    swing, cantilever level with vertical swing, cantilever upright.

    Parameters
    ----------
    low, high : ndarray, shape (3,), in m
        Corners of the box, in the world frame.
    count : int

    Returns
    -------
    list of Pose

    Examples
    --------
    >>> track = plan_track(np.array([-0.02, -0.02, 0.05]), np.array([0.02, 0.02, 0.08]), 3)
    >>> print(np.round(1e3 * track[0].position, 1), np.round(track[2].body_axis("z"), 1))
    [ -7.2 -13.2  51.5] [0. 0. 1.]
    """
    ratio = 1.2207440846057596  # root of r^4 = r + 1: steps of its powers fill a cube most evenly
    up = np.array([0.0, 0.0, 1.0])
    track = []
    for i in range(count):
        place = low + (high - low) * ((0.5 + (i + 1) * ratio ** -np.arange(1.0, 4.0)) % 1.0)
        heading = 2.399963 * i  # golden angle
        ahead, aside = (np.array([math.cos(a), math.sin(a), 0.0]) for a in (heading, heading + 0.5 * math.pi))
        along, swing = ((ahead, aside), (ahead, up), (up, ahead))[i % 3]
        track.append(Pose(0.0, place, quaternion_from_axes(along, swing, "zx"), UNKNOWN_COVARIANCE))
    return track


def _format_needed_columns() -> str:
    directions = ", ".join((*ALONG_COLUMNS, *SWING_COLUMNS))
    return f"{', '.join(POSITION_COLUMNS)}, and {directions} or {', '.join(QUATERNION_COLUMNS)}"


def _has_direction_columns(path: Path, names: Sequence[str]) -> bool:
    """Return whether the orientation is given by two directions instead of a quaternion; raise if by neither."""
    directions = all(name in names for name in (*ALONG_COLUMNS, *SWING_COLUMNS))
    missing = [name for name in POSITION_COLUMNS if name not in names]
    if missing or not (directions or all(name in names for name in QUATERNION_COLUMNS)):
        what = f"column {', '.join(missing)} is missing" if missing else "no orientation"
        raise InputError(f"{path}: {what}; a track needs {_format_needed_columns()}. Got {', '.join(names)[:200]}.")
    return directions


def _parse_orientation(row: Row, directions: bool) -> FloatArray:
    if not directions:
        quaternion = row.parse_finite(QUATERNION_COLUMNS)
        length = float(np.linalg.norm(quaternion))
        if not 0.99 < length < 1.01:
            raise row.make_error(f"{', '.join(QUATERNION_COLUMNS)} must be of unit length; got {length:.4g}.")
        return quaternion / length
    along, swing = row.parse_finite(ALONG_COLUMNS), row.parse_finite(SWING_COLUMNS)
    sine = float(np.linalg.norm(np.cross(along, swing)))
    if not sine > 0.5 * float(np.linalg.norm(along)) * float(np.linalg.norm(swing)):
        raise row.make_error(f"along and swing must be two directions at right angles; got {along} and {swing}.")
    return quaternion_from_axes(along, swing, "zx")
