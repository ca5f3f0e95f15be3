"""A robot's position and heading at any time, interpolated linearly between poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.shots import Rotate
from smolbot.runs.trace import Moment


@dataclass(frozen=True)
class InterpolatedTrack:
    """Positions and headings over time.

    Attributes
    ----------
    times : ndarray, shape (n,), in s
    positions : ndarray, shape (n, 3), in m
        In the world frame.
    headings : ndarray, shape (n, 2)
        Horizontal part of a body direction, in the world frame.
    """

    times: FloatArray
    positions: FloatArray
    headings: FloatArray

    @classmethod
    def from_poses(cls, poses: list[Pose], body_axis: FloatArray) -> InterpolatedTrack:
        """Build a track from poses.

        Parameters
        ----------
        poses : list of Pose
        body_axis : ndarray, shape (3,)
            Body direction whose horizontal part is the heading.

        Returns
        -------
        InterpolatedTrack
        """
        ordered = sorted(poses, key=lambda pose: pose.time)
        ahead = np.array([(p.rotation @ body_axis)[:2] for p in ordered]).reshape(-1, 2)
        places = np.array([p.position for p in ordered]).reshape(-1, 3)
        return cls(np.array([p.time for p in ordered]), places, ahead)

    def with_positions(self, times: FloatArray, places: FloatArray) -> InterpolatedTrack:
        """Add positions to the track, with headings interpolated between the known ones.

        Parameters
        ----------
        times : ndarray, shape (n,), in s
        places : ndarray, shape (n, 3), in m
            In the world frame.

        Returns
        -------
        InterpolatedTrack
        """
        if not len(times) or not len(self.times):
            return self
        headings = np.column_stack([np.interp(times, self.times, column) for column in self.headings.T])
        order = np.argsort(np.concatenate([self.times, times]), kind="stable")
        return InterpolatedTrack(
            np.concatenate([self.times, times])[order],
            np.vstack([self.positions, places])[order],
            np.vstack([self.headings, headings])[order],
        )

    def interpolate(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Interpolate position and heading linearly.

        Parameters
        ----------
        time : float, in s

        Returns
        -------
        place : ndarray, shape (3,), in m
            In the world frame; nan without any pose.
        heading : ndarray, shape (2,)
            nan without any pose.
        """
        if not len(self.times):
            return np.full(3, np.nan), np.full(2, np.nan)
        values = np.column_stack([self.positions, self.headings])
        found = np.array([np.interp(time, self.times, column) for column in values.T])
        return found[:3], found[3:]


def collect_true_way(moments: list[Moment]) -> tuple[FloatArray, FloatArray]:
    """Collect the true positions during magnet rotation, spread evenly in time.

    The record has positions without times, and only those at which the robot moved.

    Parameters
    ----------
    moments : list of Moment

    Returns
    -------
    times : ndarray, shape (n,), in s
    places : ndarray, shape (n, 3), in m
        In the world frame.
    """
    times, places = [np.zeros(0)], [np.zeros((0, 3))]
    for moment in moments:
        shot = moment.cycle.shot
        turns = [(at, at + w.duration) for at, w in shot.timed() if isinstance(w, Rotate)]
        if turns and len(moment.way):
            times.append(shot.start + np.linspace(turns[0][0], turns[-1][1], len(moment.way)))
            places.append(moment.way)
    return np.concatenate(times), np.vstack(places)
