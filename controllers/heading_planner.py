"""Planning of a robot's heading along a path: headings that allow a strong pull along the path, with few turns.

The force on an aligned moment does not point along the field, so the best heading is not the path's own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from controllers.allocation import compute_forces_by_field
from controllers.force_allocator import DIRECTION_SLACK, MAX_FIELD_SLOPES
from smolbot.core.arrays import FloatArray
from smolbot.motion.controller import Setup

HEADING_COUNT = 72
"""Number of candidate headings."""

MIN_SPEED = 5e-5
"""Speed, in m/s, that is assumed where no currents pull along the path."""


@dataclass(frozen=True)
class HeadingPlanner:
    """Plans headings along curves for one robot and one set of coils.

    Attributes
    ----------
    setup : Setup
    low, high : ndarray, shape (n_coils,), in A
        Limits of the currents.
    head_first : bool
        Whether the robot may only be pulled at the head.
    least_field : float, in T
        Weaker fields turn the robot too slowly.
    turn_time : float, in s/rad
        Assumed duration of a turn.
    """

    setup: Setup
    low: FloatArray
    high: FloatArray
    head_first: bool
    least_field: float
    turn_time: float

    def plan_headings(
        self, points: FloatArray, ways: FloatArray, spacing: float, start: float | None = None
    ) -> FloatArray:
        """Plan the headings that bring the robot along a curve in the shortest time.

        The time is that of moving at the strongest pull that each heading allows, and of turning; the least sum
        over the whole curve is found by dynamic programming.

        Parameters
        ----------
        points : ndarray, shape (n, 3), in m, world frame
        ways : ndarray, shape (n, 2)
            Directions of travel, unit vectors.
        spacing : float, in m
            Between two points.
        start : float, in rad, optional
            Heading before the first point.

        Returns
        -------
        ndarray, shape (n,), in rad
            Continuous, without jumps by 2 pi.
        """
        angles = np.arange(HEADING_COUNT) * (2.0 * np.pi / HEADING_COUNT)
        inside = self.setup.table.contains(points)
        pull = np.zeros((len(points), HEADING_COUNT))
        if inside.any():
            field, gradient = self.setup.table.field_and_gradient(points[inside])
            b, g = (np.ascontiguousarray(np.swapaxes(a, 0, 1)) for a in (field, gradient))
            rules = (self.least_field, MAX_FIELD_SLOPES[0], DIRECTION_SLACK)
            along = np.ascontiguousarray(ways[inside])
            pull[inside] = compute_forces_by_field(b, g, self.low, self.high, along, angles, rules, self.head_first)
        robot = self.setup.robot
        going = spacing / np.maximum(robot.moment * pull / robot.drag, MIN_SPEED)
        apart = np.abs((angles[:, None] - angles[None, :] + np.pi) % (2.0 * np.pi) - np.pi)
        turning = self.turn_time * apart
        cost = going[0].copy()
        if start is not None:
            cost += self.turn_time * np.abs((angles - start + np.pi) % (2.0 * np.pi) - np.pi)
        best = _find_fastest(cost, going, turning)
        return np.asarray(np.unwrap(angles[best]), dtype=np.float64)


@njit(cache=True, error_model="numpy")
def _find_fastest(cost: FloatArray, going: FloatArray, turning: FloatArray) -> npt.NDArray[np.int64]:
    """Find the headings, as indices (n,), with the least time over the whole curve, by dynamic programming.

    Parameters
    ----------
    cost : ndarray, shape (m,), in s
        Of each heading at the first point; changed in place.
    going : ndarray, shape (n, m), in s
        To each point under each heading.
    turning : ndarray, shape (m, m), in s
        From one heading to another; symmetric.
    """
    n, m = going.shape
    came, total = np.zeros((n, m), np.int64), np.empty(m)
    for i in range(1, n):
        for new in range(m):
            least = np.inf
            for old in range(m):
                # it turns while it goes; both add up a little, or a turn would be free wherever it goes slowly
                turn = turning[new, old]
                time = cost[old] + max(turn, going[i, new]) + 0.2 * turn
                if time < least:
                    least, came[i, new] = time, old
            total[new] = least
        cost, total = total, cost
    best = np.zeros(n, np.int64)
    best[n - 1] = np.argmin(cost)
    for i in range(n - 1, 0, -1):
        best[i - 1] = came[i, best[i]]
    return best
