"""The robot's true poses over time, and the witness that reports them."""

from __future__ import annotations

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.errors import InputError

FIRST_ROWS = 4096
"""Rows reserved at first; more are added by doubling."""

ROUNDING = 1e-9
"""Slack on a time, in s."""


class History:
    """The robot's true pose at the start of every physics step; grows as the tank runs."""

    def __init__(self) -> None:
        self._times = np.empty(FIRST_ROWS)
        self._poses = np.empty((FIRST_ROWS, 7))
        self._count = 0

    def append_rows(self, more: int) -> tuple[FloatArray, FloatArray]:
        """Append `more` empty rows and return views of them for the caller to fill.

        Parameters
        ----------
        more : int
            Number of rows.

        Returns
        -------
        times : ndarray, shape (more,), in s
        poses : ndarray, shape (more, 7)
            Rotation centre (m) and quaternion (scalar first), world frame.
        """
        need = self._count + more
        if need > len(self._times):
            size = max(need, 2 * len(self._times))
            self._times = np.concatenate([self._times[: self._count], np.empty(size - self._count)])
            self._poses = np.concatenate([self._poses[: self._count], np.empty((size - self._count, 7))])
        start = self._count
        self._count = need
        return self._times[start:need], self._poses[start:need]

    def drop_last(self, rows: int = 1) -> None:
        """Remove the last rows.

        Parameters
        ----------
        rows : int
            Number of rows.
        """
        self._count -= rows

    def forget_before(self, time: float) -> None:
        """Remove the rows before a time, except for the last of them.

        Parameters
        ----------
        time : float, in s
        """
        first = max(int(np.searchsorted(self._times[: self._count], time)) - 1, 0)
        left = self._count - first
        self._times[:left] = self._times[first : self._count].copy()
        self._poses[:left] = self._poses[first : self._count].copy()
        self._count = left

    def find_rows_since(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Return the rows from the last one before a time on.

        Parameters
        ----------
        time : float, in s

        Returns
        -------
        times : ndarray, shape (p,), in s
        poses : ndarray, shape (p, 7)
            Rotation centre (m) and quaternion (scalar first), world frame.
        """
        times = self._times[: self._count]
        first = max(int(np.searchsorted(times, time)) - 1, 0)
        return times[first:], self._poses[first : self._count]

    def interpolate_pose(self, time: float) -> FloatArray:
        """Return the pose at a time, interpolated linearly between physics steps.

        Parameters
        ----------
        time : float, in s

        Returns
        -------
        ndarray, shape (7,)
            Rotation centre (m) and unit quaternion (scalar first), world frame.

        Raises
        ------
        InputError
            If the time was not played yet, or was forgotten.
        """
        times = self._times[: self._count]
        if not self._count or not times[0] - ROUNDING <= time <= times[-1] + ROUNDING:
            span = f"{times[0]:.3f} to {times[-1]:.3f} s" if self._count else "nothing yet"
            raise InputError(f"The true pose is recorded for {span}; got {time:.3f} s.")
        i = min(max(int(np.searchsorted(times, time)) - 1, 0), self._count - 2) if self._count > 1 else 0
        if self._count == 1:
            return self._poses[0].copy()
        a = min(max((time - times[i]) / (times[i + 1] - times[i]), 0.0), 1.0)
        pose = np.array((1 - a) * self._poses[i] + a * self._poses[i + 1])
        if self._poses[i, 3:] @ self._poses[i + 1, 3:] < 0:  # q and -q are the same rotation
            pose[3:] = (1 - a) * self._poses[i, 3:] - a * self._poses[i + 1, 3:]
        pose[3:] /= np.linalg.norm(pose[3:])
        return pose


class TankWitness:
    """Reports the true poses of one tank. Held by recorder and report, never by the loop's estimators.

    Parameters
    ----------
    history : History
    """

    def __init__(self, history: History) -> None:
        self._history = history

    def truth(self, time: float) -> Pose:
        """Return the true pose at a time, with a covariance of zero.

        Parameters
        ----------
        time : float, in s
            On the tank's clock.

        Returns
        -------
        Pose

        Raises
        ------
        InputError
            If the time was not played.
        """
        pose = self._history.interpolate_pose(time)
        return Pose(time, pose[:3], pose[3:], np.zeros((6, 6)))
