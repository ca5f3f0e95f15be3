"""Requested speed along a path as data: slower in bends, by a limit on the centripetal acceleration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from smolbot.core.arrays import FloatArray, as_floats, freeze
from smolbot.errors import InputError
from smolbot.paths.corners import compute_curvature, find_corners
from smolbot.paths.polylines import compute_arc_lengths

CORNER_RADIUS = 0.25e-3
"""Radius, in m, of the bend that replaces a kept corner: no robot follows a corner more closely."""

SPEED_SPACING = 0.1e-3
"""Spacing, in m, of the points at which the speed is computed."""

MAX_BEND_CHORD = 1e-3
"""Length, in m, above which a segment is straight; shorter ones may be chords of a bend."""

MIN_CURVATURE = 1e-12
"""Curvature, in 1/m, of a straight line: keeps the quotient finite."""


@dataclass(frozen=True)
class SpeedProfile:
    """Speed along a path; between the given arc lengths its square is linear, as at a constant acceleration.

    Attributes
    ----------
    arc : ndarray, shape (n,), in m
        Arc lengths, ascending.
    speed : ndarray, shape (n,), in m/s

    Examples
    --------
    >>> steady = SpeedProfile(np.array([0.0, 10e-3]), np.array([2e-3, 2e-3]))
    >>> print(steady.duration, round(steady.after(1e-3, 2.0), 6))
    5.0 0.005
    """

    arc: FloatArray
    speed: FloatArray

    def __post_init__(self) -> None:
        arc, speed = as_floats(self.arc, (None,), "arc"), as_floats(self.speed, (None,), "speed")
        if len(arc) != len(speed) or len(arc) < 2 or np.any(np.diff(arc) <= 0.0):
            raise InputError(
                f"A speed profile needs two or more rising arc lengths; got {len(arc)}, {len(speed)} speeds."
            )
        if np.any(speed <= 0.0):
            raise InputError(f"A speed must be greater than 0 m/s; got {speed.min():g}.")
        object.__setattr__(self, "arc", freeze(arc))
        object.__setattr__(self, "speed", freeze(speed))

    @cached_property
    def times(self) -> FloatArray:
        """Time (n,) in s at which each arc length is passed."""
        return np.concatenate([[0.0], np.cumsum(2.0 * np.diff(self.arc) / (self.speed[1:] + self.speed[:-1]))])

    @property
    def duration(self) -> float:
        """Time from the path's start to its end, in s."""
        return float(self.times[-1])

    def at(self, s: float) -> float:
        """Compute the speed at an arc length.

        Parameters
        ----------
        s : float, in m

        Returns
        -------
        float, in m/s
        """
        return float(np.sqrt(np.interp(s, self.arc, self.speed**2)))

    def after(self, s: float, time: float) -> float:
        """Compute the arc length that is reached some time after another one.

        Parameters
        ----------
        s : float, in m
            Arc length at the start.
        time : float, in s

        Returns
        -------
        float, in m
            At most the path's end.
        """
        return float(np.interp(np.interp(s, self.arc, self.times) + time, self.times, self.arc))


def compute_speed_profile(
    points: FloatArray, speed: float, lateral: float | None = None, acceleration: float | None = None
) -> SpeedProfile:
    """Compute the fastest speed profile within limits on speed, centripetal acceleration and change of speed.

    First v <= sqrt(lateral / curvature) everywhere; then a forward and a backward pass limit the change of v² to
    2 a ds, as in time-optimal path parameterization (Bobrow, Dubowsky and Gibson 1985). The speed is not zero at the
    ends of a path, since a robot in a viscous liquid has negligible inertia.

    Parameters
    ----------
    points : ndarray, shape (n, 3), in m
    speed : float, in m/s
        Requested speed on straight parts.
    lateral : float, in m/s², optional
        Largest centripetal acceleration, v² times curvature; a corner counts as a bend of `CORNER_RADIUS`.
    acceleration : float, in m/s², optional
        Largest change of the speed along the path; default: `lateral`.

    Returns
    -------
    SpeedProfile
        Constant speed without `lateral`.
    """
    arc = compute_arc_lengths(points)
    if lateral is None:
        return SpeedProfile(arc[[0, -1]], np.full(2, speed))
    bend = compute_curvature(points)
    bend[find_corners(points)] = 1.0 / CORNER_RADIUS
    at_vertex = np.minimum(speed**2, lateral / np.maximum(bend, MIN_CURVATURE))
    places, squares = [arc[:1]], [at_vertex[:1]]
    for (low, high), (before, after) in zip(pairwise(arc), pairwise(at_vertex), strict=True):
        count = max(int(np.ceil((high - low) / SPEED_SPACING)), 1)
        inner = np.linspace(low, high, count + 1)[1:]
        chord = high - low < MAX_BEND_CHORD
        places.append(inner)
        squares.append(np.append(np.full(count - 1, max(before, after) if chord else speed**2), after))
    s, square = np.concatenate(places), np.concatenate(squares)
    gain = 2.0 * (lateral if acceleration is None else acceleration) * np.diff(s)
    # forward: no faster than the acceleration allows after the point before; backward: able to brake for the next
    for i in range(1, len(s)):
        square[i] = min(square[i], square[i - 1] + gain[i - 1])
    for i in range(len(s) - 2, -1, -1):
        square[i] = min(square[i], square[i + 1] + gain[i])
    return SpeedProfile(s, np.sqrt(square))
