"""Which way a robot should point along a path: where the field must point for a strong pull along it, with few turns.

The force on an aligned moment does not point along the field, so the heading that serves a path is not the path's own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.allocation import forces_by_field
from controllers.force_allocator import SLACK, SLOPES
from smolbot.arrays import FloatArray
from smolbot.control import Setup

DIRECTIONS = 72
"""Headings among which is chosen."""

SLOWEST = 5e-5
"""Speed, in m/s, that is assumed where no currents pull along the path."""


@dataclass(frozen=True)
class Compass:
    """Finds headings along curves for one robot and one set of coils.

    Attributes
    ----------
    setup : Setup
    low, high : ndarray, shape (n_coils,), in A
    head_first : bool
    least_field : float, in T
        Weaker fields turn the robot too slowly.
    turn_time : float, in s/rad
        What a turn costs.
    """

    setup: Setup
    low: FloatArray
    high: FloatArray
    head_first: bool
    least_field: float
    turn_time: float

    def headings(self, points: FloatArray, ways: FloatArray, spacing: float, start: float | None = None) -> FloatArray:
        """Headings (n,), in rad, that bring the robot along soonest; without jumps of a whole turn.

        The time is that of going at the strongest pull that each heading allows, and of turning; the least sum over
        the whole curve is found by dynamic programming.

        Parameters
        ----------
        points : ndarray, shape (n, 3), in m
        ways : ndarray, shape (n, 2)
            Directions of travel, unit vectors.
        spacing : float, in m
            Between two points.
        start : float, in rad, optional
            Heading before the first point.
        """
        angles = np.arange(DIRECTIONS) * (2.0 * np.pi / DIRECTIONS)
        inside = self.setup.table.contains(points)
        pull = np.zeros((len(points), DIRECTIONS))
        if inside.any():
            field, gradient = self.setup.table.field_and_gradient(points[inside])
            b, g = (np.ascontiguousarray(np.swapaxes(a, 0, 1)) for a in (field, gradient))
            rules = (self.least_field, SLOPES[0], SLACK)
            pull[inside] = forces_by_field(b, g, self.low, self.high, np.ascontiguousarray(ways[inside]), angles, rules)
        if self.head_first:
            ahead = np.arctan2(ways[:, 1], ways[:, 0])[:, None] - angles[None, :]
            pull[np.cos(ahead) < -1e-9] = 0.0
        robot = self.setup.robot
        going = spacing / np.maximum(robot.moment * pull / robot.drag, SLOWEST)
        apart = np.abs((angles[:, None] - angles[None, :] + np.pi) % (2.0 * np.pi) - np.pi)
        turning = self.turn_time * apart
        cost = going[0].copy()
        if start is not None:
            cost += self.turn_time * np.abs((angles - start + np.pi) % (2.0 * np.pi) - np.pi)
        came = np.zeros((len(points), DIRECTIONS), dtype=np.int64)
        for i in range(1, len(points)):
            # it turns while it goes; both add up a little, or a turn would be free wherever it goes slowly
            total = cost[None, :] + np.maximum(turning, going[i][:, None]) + 0.2 * turning
            came[i] = np.argmin(total, axis=1)
            cost = total[np.arange(DIRECTIONS), came[i]]
        best = np.zeros(len(points), dtype=np.int64)
        best[-1] = int(np.argmin(cost))
        for i in range(len(points) - 1, 0, -1):
            best[i - 1] = came[i, best[i]]
        return np.asarray(np.unwrap(angles[best]), dtype=np.float64)
