"""The poses of a run that a camera can check; the optics use no other part of a record."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from smolbot.config.load import AnyMission
from smolbot.core.arrays import BoolArray, FloatArray
from smolbot.errors import InputError
from smolbot.runs.recording.reader import read_run
from smolbot.runs.run import get_trusted_poses


@dataclass(frozen=True, eq=False)
class RunPoses:
    """The trusted poses of a run, in order of time.

    Attributes
    ----------
    folder : Path
    times : ndarray, shape (n,), in s
        On the run's clock.
    positions, tracked : ndarray, shape (n, 3), in m
        Located, and the tracker's at the same times, in the world frame; rows of `tracked` are nan without a
        tracked pose.
    axes : ndarray, shape (n, 3)
        World direction of body z, as located.
    following : ndarray of bool, shape (n,)
        Whether the path's start had been reached.
    mission : Mission or Observation, optional
        As it was flown, with rig and robot.
    """

    folder: Path
    times: FloatArray
    positions: FloatArray
    tracked: FloatArray
    axes: FloatArray
    following: BoolArray
    mission: AnyMission | None = None

    @property
    def headings(self) -> FloatArray:
        """Azimuth of body z (n,), in rad."""
        return np.asarray(np.arctan2(self.axes[:, 1], self.axes[:, 0]))


def read_run_poses(folder: str | Path) -> RunPoses:
    """Read the trusted poses of a recorded run.

    Parameters
    ----------
    folder : str or Path
        Run folder, or its record.

    Returns
    -------
    RunPoses

    Raises
    ------
    InputError, MissingFileError
        If there is no record of a run, or it holds no trusted pose.
    """
    record = read_run(folder)
    cycles = [m.cycle for m in record.moments if m.cycle.trusted is not None]
    if not cycles:
        raise InputError(f"{record.path}: holds no trusted pose to compare with.")
    poses = get_trusted_poses(cycles)
    begun = {m.cycle.shot.start for m in record.trace().following}
    nowhere = np.full(3, np.nan)
    mission = record.mission()
    return RunPoses(
        folder=record.folder,
        times=np.array([pose.time for pose in poses]),
        positions=np.array([pose.position for pose in poses]),
        tracked=np.array([nowhere if c.tracked is None else c.tracked.position for c in cycles]),
        axes=np.array([pose.body_axis("z") for pose in poses]),
        following=np.array([cycle.shot.start in begun for cycle in cycles]),
        mission=mission,
    )
