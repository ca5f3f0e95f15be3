"""True trajectory of a simulated robot, read from a run's record."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from smolbot.config.load import AnyMission
from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError
from smolbot.runs.recording.reader import read_run

SAME_TIME = 1e-9
"""Difference, in s, below which two poses have one time."""


@dataclass(frozen=True, eq=False)
class Trail:
    """True poses in order of time.

    Attributes
    ----------
    times : ndarray, shape (n,), in s
        On the run's clock.
    positions : ndarray, shape (n, 3), in m
        The cantilever's rotation centre, world frame.
    orientations : ndarray, shape (n, 4)
        Unit quaternions, scalar first, of the same sign from row to row.
    """

    times: FloatArray
    positions: FloatArray
    orientations: FloatArray

    def __post_init__(self) -> None:
        turned = self.orientations.copy()
        for i in range(1, len(turned)):  # q and -q are the same rotation
            if turned[i] @ turned[i - 1] < 0:
                turned[i] *= -1.0
        object.__setattr__(self, "orientations", turned)

    def interpolate(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Interpolate linearly between rows; before and after, the robot is at rest.

        Parameters
        ----------
        times : ndarray, shape (n,), in s

        Returns
        -------
        positions : ndarray, shape (n, 3), in m
            World frame.
        orientations : ndarray, shape (n, 4)
        """
        places = np.column_stack([np.interp(times, self.times, column) for column in self.positions.T])
        turned = np.column_stack([np.interp(times, self.times, column) for column in self.orientations.T])
        return places, turned / np.linalg.norm(turned, axis=1, keepdims=True)


def read_trail(run: str | Path) -> tuple[Trail, AnyMission]:
    """Read the true poses of a recorded run: one in each listening window and one at each shot's end.

    Parameters
    ----------
    run : str or Path
        Folder of the run.

    Returns
    -------
    trail : Trail
    mission : Mission or Observation

    Raises
    ------
    InputError, MissingFileError
        If there is no record, or it holds no truth, as on a bench.
    """
    record = read_run(run)
    known = [p for m in record.moments for p in (m.truth, m.truth_at_end) if p is not None]
    if len(known) < 2:
        raise InputError(f"{record.path}: has no true poses; only a run in the simulated tank can be filmed.")
    times = np.array([pose.time for pose in known])
    order = np.argsort(times, kind="stable")
    kept = order[np.concatenate([[True], np.diff(times[order]) > SAME_TIME])]
    trail = Trail(
        times[kept], np.array([known[i].position for i in kept]), np.array([known[i].orientation for i in kept])
    )
    return trail, record.mission()
