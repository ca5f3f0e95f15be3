"""Progress of a robot along its path: legs between corners, and an arc length that never jumps between strands."""

from __future__ import annotations

import math

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.motion.kernels import find_nearest
from smolbot.paths.curve import Curve

SEARCH_BACK, SEARCH_AHEAD = 2e-3, 4e-3
"""Search range, in m of arc length, behind and ahead of the last position: strands of a letter cross."""


class PathProgress:
    """A path cut into legs at its corners, and the robot's progress along it.

    A leg is left when its end is within `handover`, or has been passed. On a closed path, the end counts as reached
    only from the leg's own side.

    Parameters
    ----------
    path : Curve
    corner : float, in rad
        Turns beyond it end a leg.

    Attributes
    ----------
    points : ndarray, shape (n, 2), in m
    arc : ndarray, shape (n,), in m
    stops : list of int
        Vertices at which legs end, the path's start and end included.
    leg : int
        Present leg; -1 on the way to the path's start; ``len(stops) - 1`` when all are done.
    arc_length : float, in m
        Of the place on the leg that is nearest to the robot.
    progress : float, in m
        The largest of these so far.
    """

    def __init__(self, path: Curve, corner: float = float(np.radians(25.0))) -> None:
        self.points = np.ascontiguousarray(path.points[:, :2])
        self.arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=1))])
        steps = np.diff(self.points, axis=0)
        self.tangents = steps / np.linalg.norm(steps, axis=1, keepdims=True)
        cosines = np.sum(self.tangents[1:] * self.tangents[:-1], axis=1)
        turns = np.flatnonzero(cosines < np.cos(corner)) + 1
        self.stops = [0, *(int(i) for i in turns), len(self.points) - 1]
        self.leg = -1
        self.arc_length = 0.0
        self.progress = 0.0

    @property
    def length(self) -> float:
        """Length of the path, in m."""
        return float(self.arc[-1])

    @property
    def done(self) -> bool:
        """True once the path's end was reached."""
        return self.leg >= len(self.stops) - 1

    @property
    def leg_end(self) -> float:
        """Arc length, in m, at which the present leg ends; 0 on the way to the start."""
        return float(self.arc[self.stops[min(self.leg + 1, len(self.stops) - 1)]])

    def locate(self, position: FloatArray, handover: float) -> None:
        """Locate the robot on the path, and go on to the next leg where one is done.

        Parameters
        ----------
        position : ndarray, shape (2,) or (3,), in m, world frame
        handover : float, in m
            Distance within which the end of a leg counts as reached.
        """
        x, y = float(position[0]), float(position[1])
        if self.leg < 0:
            if self._compute_distance(x, y, 0) > handover:
                return
            self.leg = 0
        while not self.done:
            first, last = self.stops[self.leg], self.stops[self.leg + 1]
            near = find_nearest(self.points, self.arc, first, last, self.arc_length, x, y, SEARCH_BACK, SEARCH_AHEAD)
            self.arc_length = near[0]
            self.progress = max(self.progress, self.arc_length)
            end = float(self.arc[last])
            left = end - self.arc_length
            close = self._compute_distance(x, y, last) <= handover and left <= max(
                2 * handover, 0.5 * (end - self.arc[first])
            )
            if not close and left > 1e-9:
                return
            self.leg += 1
            self.arc_length = self.progress = end

    def interpolate(self, s: float) -> FloatArray:
        """Compute the point of the path at an arc length.

        Parameters
        ----------
        s : float, in m

        Returns
        -------
        ndarray, shape (2,), in m, world frame
        """
        return np.array([np.interp(s, self.arc, self.points[:, 0]), np.interp(s, self.arc, self.points[:, 1])])

    def _compute_distance(self, x: float, y: float, vertex: int) -> float:
        """Compute the distance, in m, from a vertex."""
        return math.hypot(x - self.points[vertex, 0], y - self.points[vertex, 1])
