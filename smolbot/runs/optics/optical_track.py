"""The track of a robot in a video, and the file that stores it.

``track.csv`` has a row for each frame that shows the robot, SI, columns by name::

    frame      number of the frame, from 0
    time_s     on the run's clock where the video is aligned with a run, else from the first frame
    x_m, y_m   the cantilever's rotation centre, in the rig's world frame, as every pose of smolbot
    z_m        its assumed height
    heading_rad  azimuth of the robot's axis (body z), counterclockwise from +x, unwrapped
    sigma_m    standard deviation of the position from the outline fit
    share      fraction of the outline that was detected

Frames that hide the robot have no row.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from smolbot.core.arrays import BoolArray, FloatArray, IntArray
from smolbot.core.text_table import Row, read_table, write_table
from smolbot.errors import InputError, MissingFileError, report_write_errors

COLUMNS = ("frame", "time_s", "x_m", "y_m", "z_m", "heading_rad", "sigma_m", "share")
NEEDED = COLUMNS[:6]
MAX_GAP = 0.15  # s: between two frames further apart nothing is known


@dataclass(frozen=True, eq=False)
class OpticalTrack:
    """A track, frame by frame, of the frames that show the robot.

    Attributes
    ----------
    frames : ndarray of int, shape (n,)
    times : ndarray, shape (n,), in s
        From the first frame, or on a run's clock once `shift`.
    positions : ndarray, shape (n, 3), in m
        Rotation centre, world frame.
    headings : ndarray, shape (n,), in rad
        Azimuth of body z, unwrapped.
    sigmas : ndarray, shape (n,), in m
        Standard deviation of each position.
    shares : ndarray, shape (n,)
        Fraction of the outline that was detected.
    total : int
        Number of frames of the video.
    head_unsure : int
        Number of frames in which head and tail could not be distinguished.
    view_sigma : float, in m
        Standard deviation of an error common to all positions, from the uncertainty of the camera.
    """

    frames: IntArray
    times: FloatArray
    positions: FloatArray
    headings: FloatArray
    sigmas: FloatArray
    shares: FloatArray
    total: int
    head_unsure: int = 0
    view_sigma: float = math.nan

    @property
    def hidden(self) -> int:
        """Number of frames that do not show the robot."""
        return self.total - len(self.frames)

    def shift(self, offset: float) -> OpticalTrack:
        """Return the same track with an offset added to its times.

        Parameters
        ----------
        offset : float, in s

        Returns
        -------
        OpticalTrack
        """
        return replace(self, times=self.times + offset)

    def interpolate(self, times: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Interpolate the track linearly between frames.

        Parameters
        ----------
        times : ndarray, shape (n,), in s

        Returns
        -------
        positions : ndarray, shape (n, 3), in m
            In the world frame.
        headings : ndarray, shape (n,), in rad
        known : ndarray of bool, shape (n,)
            False outside the track, and between two frames too far apart.
        """
        times = np.asarray(times, dtype=np.float64)
        places = np.column_stack([np.interp(times, self.times, column) for column in self.positions.T])
        headings = np.interp(times, self.times, self.headings)
        after = np.clip(np.searchsorted(self.times, times), 1, len(self.times) - 1)
        inside = (times >= self.times[0]) & (times <= self.times[-1])
        known = inside & (self.times[after] - self.times[after - 1] <= max(MAX_GAP, 1.5 * self._step))
        return places, headings, known

    def compute_max_still_share(self, reach: float) -> float:
        """Compute the largest fraction of the video's frames in which the robot was near one position.

        Parameters
        ----------
        reach : float, in m
            Radius about that position.

        Returns
        -------
        float
        """
        places = self.positions[:, :2]
        near = [np.count_nonzero(np.sum((places - place) ** 2, axis=1) < reach**2) for place in places[::5]]
        return max(near) / self.total

    @property
    def _step(self) -> float:
        return float(np.median(np.diff(self.times))) if len(self.times) > 1 else 0.0


def write_optical_track(path: Path, track: OpticalTrack) -> None:
    """Write ``track.csv``; see the module for its columns.

    Parameters
    ----------
    path : Path
    track : OpticalTrack

    Raises
    ------
    InputError
        If it cannot be written.
    """
    table = zip(track.frames, track.times, *track.positions.T, track.headings, track.sigmas, track.shares, strict=True)
    with report_write_errors(path):
        write_table(path, COLUMNS, ([int(number), *(f"{v:.9g}" for v in values)] for number, *values in table))


def read_optical_track(path: str | Path) -> OpticalTrack:
    """Read a ``track.csv``, ours or another program's; sigma_m and share may be missing.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    OpticalTrack

    Raises
    ------
    MissingFileError
        If there is no such file.
    InputError
        With ``file:line: column`` for a missing column or a value that is no number.
    """
    path = Path(path)
    if not path.is_file():
        raise MissingFileError(f"{path}: no such file.", name=str(path))
    found = read_table(path, named=True)
    missing = [name for name in NEEDED if name not in found.names]
    if missing:
        raise InputError(f"{path}: column {', '.join(missing)} is missing; an optical track has {', '.join(NEEDED)}.")
    rows = [
        [*row.parse_finite(NEEDED), *(_read_optional(row, name) for name in COLUMNS[len(NEEDED) :])]
        for row in found.rows
    ]
    if len(rows) < 2:
        raise InputError(f"{path}: holds {len(rows)} rows; a track has two or more.")
    table = np.array(rows)
    if not np.all(np.diff(table[:, 1]) > 0):
        raise InputError(f"{path}: time_s must rise from row to row.")
    frames = table[:, 0].astype(np.int64)
    return OpticalTrack(
        frames, table[:, 1], table[:, 2:5], table[:, 5], table[:, 6], table[:, 7], int(frames[-1] - frames[0]) + 1
    )


def _read_optional(row: Row, name: str) -> float:
    return row.parse_number(row[name], name) if name in row.names and row[name] else math.nan
