"""What a run believed, as far as a camera can judge it: the one place that knows how a run is stored."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from smolbot.arrays import BoolArray, FloatArray
from smolbot.errors import InputError, MissingFileError
from smolbot.rotations import matrix_from_quaternion


@dataclass(frozen=True, eq=False)
class RunPoses:
    """Poses of a run in order of time; those that were trusted.

    Attributes
    ----------
    folder : Path
    times : ndarray, shape (n,), in s
    positions, tracked : ndarray, shape (n, 3), in m
        As located, and as the tracker had it then; rows of `tracked` are nan where there was none.
    axes : ndarray, shape (n, 3)
        World direction of body z, as located.
    following : ndarray of bool, shape (n,)
        Poses after the path's start was reached; all of them where nothing was steered.
    """

    folder: Path
    times: FloatArray
    positions: FloatArray
    tracked: FloatArray
    axes: FloatArray
    following: BoolArray

    @property
    def headings(self) -> FloatArray:
        """Azimuth of body z (n,), in rad."""
        return np.asarray(np.arctan2(self.axes[:, 1], self.axes[:, 0]))


def read_run_poses(folder: str | Path) -> RunPoses:
    """Poses of a run folder, from its ``cycles.csv``.

    Raises
    ------
    MissingFileError
        If there is no such run.
    InputError
        If it is no record of a run, or holds no trusted pose.
    """
    folder = Path(folder)
    path = folder / "cycles.csv"
    if not path.is_file():
        raise MissingFileError(f"{path}: no such file; --run names the folder of a run, as smolbot run leaves it.")
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = [row for row in csv.DictReader(file) if row["pose_time_s"] and row["trusted"] == "1"]
        times = np.array([float(r["pose_time_s"]) for r in rows])
        positions = np.array([[float(r[f"pose_{a}_m"]) for a in "xyz"] for r in rows])
        tracked = np.array([[float(r[f"tracked_{a}_m"] or "nan") for a in "xyz"] for r in rows])
        turns = [np.array([float(r[f"pose_q{a}"]) for a in "wxyz"]) for r in rows]
    except (KeyError, ValueError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is no record of a run ({type(error).__name__}: {error}).") from error
    if not rows:
        raise InputError(f"{path}: holds no trusted pose to compare with.")
    axes = np.array([matrix_from_quaternion(q / np.linalg.norm(q))[:, 2] for q in turns])
    phases = np.array([r.get("phase") == "follow" for r in rows])
    return RunPoses(folder, times, positions, tracked, axes, phases if phases.any() else np.ones(len(rows), dtype=bool))
