"""A route of a flexible tip: a smooth curve in space, with a frame that follows it without rolling."""

from __future__ import annotations

import numpy as np

from smolbot.core.arrays import FloatArray

SPACING = 1e-4  # m: between two points of the fine curve; a bend of 9 mm radius turns by 0.6 degrees between them
FEWEST = 8  # steps of the fine curve
STEEP = 0.9  # vertical part of a direction from which x, not up, defines the first side


class SplineRoute:
    """A cubic spline through points, parametrised by arc length.

    The frame's z axis is the curve's direction. Its x axis follows without rolling about z (double reflection,
    Wang et al. 2008), starting from the upward direction.

    Parameters
    ----------
    points : ndarray, shape (n, 3), in m
        World frame. At least two, no two in a row the same.
    direction : ndarray, shape (3,)
        Of the curve at its start.

    Attributes
    ----------
    length : float, in m
    """

    def __init__(self, points: FloatArray, direction: FloatArray) -> None:
        from scipy.interpolate import CubicSpline

        chords = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        start = direction / np.linalg.norm(direction)
        spline = CubicSpline(chords, points, bc_type=((1, start), (2, np.zeros(3))))
        fine = np.linspace(0.0, chords[-1], max(int(np.ceil(chords[-1] / SPACING)), FEWEST) + 1)
        places = spline(fine)
        self._arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
        self._places = places
        tangents = spline(fine, 1)
        self._tangents = tangents / np.linalg.norm(tangents, axis=1)[:, None]
        self._sides = _transport_side_vectors(places, self._tangents)
        self.length = float(self._arc[-1])

    def interpolate_positions(self, arc: FloatArray) -> FloatArray:
        """Return positions on the curve; before the start it continues straight.

        Parameters
        ----------
        arc : ndarray, shape (n,), in m
            Arc lengths.

        Returns
        -------
        ndarray, shape (n, 3), in m
            World frame.
        """
        inside = _interpolate_columns(arc, self._arc, self._places)
        return inside + np.minimum(arc, 0.0)[:, None] * self._tangents[0]

    def interpolate_rotations(self, arc: FloatArray) -> FloatArray:
        """Return the rotations of the frame that follows the curve.

        Parameters
        ----------
        arc : ndarray, shape (n,), in m
            Arc lengths.

        Returns
        -------
        ndarray, shape (n, 3, 3)
            From the tip's body frame to the world frame.
        """
        z = _interpolate_columns(arc, self._arc, self._tangents)
        z /= np.linalg.norm(z, axis=1)[:, None]
        x = _interpolate_columns(arc, self._arc, self._sides)
        x -= np.sum(x * z, axis=1)[:, None] * z
        x /= np.linalg.norm(x, axis=1)[:, None]
        return np.stack([x, np.cross(z, x), z], axis=2)

    @property
    def bends(self) -> tuple[FloatArray, FloatArray]:
        """Arc lengths (n,) in m, and the curvature (n,) in 1/m at each."""
        turn = np.arccos(np.clip(np.sum(self._tangents[1:] * self._tangents[:-1], axis=1), -1.0, 1.0))
        steps = np.diff(self._arc)
        return 0.5 * (self._arc[1:] + self._arc[:-1]), turn / steps


def _interpolate_columns(arc: FloatArray, known: FloatArray, values: FloatArray) -> FloatArray:
    return np.stack([np.interp(arc, known, column) for column in values.T], axis=1)


def _transport_side_vectors(places: FloatArray, tangents: FloatArray) -> FloatArray:
    """Return side vectors (n, 3) that follow the tangents without rolling about them."""
    up = np.array([0.0, 0.0, 1.0])
    if abs(tangents[0, 2]) > STEEP:
        up = np.array([1.0, 0.0, 0.0])
    sides = np.empty_like(tangents)
    sides[0] = up - (up @ tangents[0]) * tangents[0]
    sides[0] /= np.linalg.norm(sides[0])
    for i in range(len(tangents) - 1):
        # rotation-minimising frame by double reflection: in the plane between the points, then between the tangents
        first = places[i + 1] - places[i]
        c = first @ first
        side = sides[i] - 2.0 / c * (first @ sides[i]) * first
        along = tangents[i] - 2.0 / c * (first @ tangents[i]) * first
        second = tangents[i + 1] - along
        d = second @ second
        sides[i + 1] = side - (2.0 / d * (second @ side) * second if d > 0.0 else 0.0)
    return sides
