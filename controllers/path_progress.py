"""Progress of a robot along its path: legs between corners, and an arc length that never jumps between strands."""

from __future__ import annotations

import math

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.motion.kernels import find_nearest
from smolbot.paths.curve import Curve

SEARCH_BACK, SEARCH_AHEAD = 2e-3, 4e-3
"""Widest search, in m of arc length, behind and ahead of the last place: strands of a letter cross."""

STRETCH = 2.0
"""Largest progress per distance moved, beside the handover: on the inside of a bend a place on the path runs ahead."""


class PathProgress:
    """A path cut into legs at its corners, and the robot's progress along it.

    A leg is left when its end is within `handover`, or has been passed. Progress counts by arc length, in order: from
    one position to the next it changes by no more than `STRETCH` times the distance between them, and the handover.
    So where the path crosses or touches itself, no piece of it is skipped, and its end counts only after the rest.

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
        self._before: tuple[float, float] | None = None

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
        moved = 0.0 if self._before is None else math.hypot(x - self._before[0], y - self._before[1])
        self._before = x, y
        if self.leg < 0:
            if self._compute_distance(x, y, 0) > handover:
                return
            self.leg = 0
        most = STRETCH * moved + handover
        back, farthest = min(most, SEARCH_BACK), self.arc_length + min(most, SEARCH_AHEAD)
        while not self.done:
            first, last = self.stops[self.leg], self.stops[self.leg + 1]
            ahead = farthest - self.arc_length
            near = find_nearest(self.points, self.arc, first, last, self.arc_length, x, y, back, ahead)
            self.arc_length = min(near[0], farthest)
            self.progress = max(self.progress, self.arc_length)
            end = float(self.arc[last])
            left = end - self.arc_length
            close = self._compute_distance(x, y, last) <= handover and left <= 2 * handover and end <= farthest
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
