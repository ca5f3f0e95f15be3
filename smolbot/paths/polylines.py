"""Geometry of polylines (n, 2) or (n, 3): points along them, nearest points, crossings, even samples."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from smolbot.core.arrays import FloatArray

PARALLEL = 1e-12
"""Cross product of two segments below which they are parallel and do not cross."""

ROUNDING = 1e-9
"""Slack on an arc length, in the unit of the points."""


def compute_arc_lengths(points: FloatArray) -> FloatArray:
    """Compute the arc length at each point of a polyline.

    Parameters
    ----------
    points : ndarray, shape (n, d)

    Returns
    -------
    ndarray, shape (n,)
    """
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def interpolate_polyline(points: FloatArray, s: FloatArray | float) -> FloatArray:
    """Interpolate points of a polyline at given arc lengths.

    Parameters
    ----------
    points : ndarray, shape (n, d)
    s : ndarray, shape (...), or float

    Returns
    -------
    ndarray, shape (..., d)
    """
    arc = compute_arc_lengths(points)
    return np.stack([np.interp(s, arc, points[:, k]) for k in range(points.shape[1])], axis=-1)


def find_nearest_place(points: FloatArray, point: FloatArray) -> tuple[float, float]:
    """Find the place on a polyline that is nearest to a point.

    Parameters
    ----------
    points : ndarray, shape (n, d)
    point : ndarray, shape (d,)

    Returns
    -------
    arc_length : float
        Of the nearest place.
    distance : float
        From the point to it.
    """
    start, step = points[:-1], np.diff(points, axis=0)
    share = np.clip(np.sum((point - start) * step, axis=1) / np.sum(step**2, axis=1), 0.0, 1.0)
    away = np.linalg.norm(start + share[:, None] * step - point, axis=1)
    best = int(np.argmin(away))
    return float(compute_arc_lengths(points)[best] + share[best] * np.linalg.norm(step[best])), float(away[best])


def find_crossings(a: FloatArray, b: FloatArray) -> list[tuple[float, float]]:
    """Find every place where two plane polylines cross.

    Parameters
    ----------
    a, b : ndarray, shape (n, 2)

    Returns
    -------
    list of tuple of 2 floats
        Arc lengths of the crossing along `a` and along `b`.

    Examples
    --------
    >>> find_crossings(np.array([[0.0, 0.0], [4.0, 0.0]]), np.array([[1.0, -2.0], [1.0, 2.0]]))
    [(1.0, 2.0)]
    """
    da, db = np.diff(a, axis=0), np.diff(b, axis=0)
    apart = b[None, :-1] - a[:-1, None]
    cross = da[:, None, 0] * db[None, :, 1] - da[:, None, 1] * db[None, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (apart[..., 0] * db[None, :, 1] - apart[..., 1] * db[None, :, 0]) / cross
        u = (apart[..., 0] * da[:, None, 1] - apart[..., 1] * da[:, None, 0]) / cross
    meet = (np.abs(cross) > PARALLEL) & (t >= 0.0) & (t <= 1.0) & (u >= 0.0) & (u <= 1.0)
    along_a, along_b = compute_arc_lengths(a), compute_arc_lengths(b)
    return [
        (
            float(along_a[i] + t[i, j] * (along_a[i + 1] - along_a[i])),
            float(along_b[j] + u[i, j] * (along_b[j + 1] - along_b[j])),
        )
        for i, j in np.argwhere(meet)
    ]


def split_at(points: FloatArray, places: list[float]) -> list[FloatArray]:
    """Split a polyline at given arc lengths.

    Parameters
    ----------
    points : ndarray, shape (n, d)
    places : list of float
        Arc lengths inside the polyline, in ascending order.

    Returns
    -------
    list of ndarray, each of shape (m, d)
    """
    arc = compute_arc_lengths(points)
    bounds = [0.0, *places, float(arc[-1])]
    parts = []
    for low, high in pairwise(bounds):
        inner = points[(arc > low + ROUNDING) & (arc < high - ROUNDING)]
        parts.append(np.vstack([interpolate_polyline(points, low), inner, interpolate_polyline(points, high)]))
    return parts


def is_straight(points: FloatArray, slack: float = 1e-6) -> bool:
    """Return whether a polyline is a straight line.

    Parameters
    ----------
    points : ndarray, shape (n, d)
    slack : float
        Largest allowed deviation, as a share of its length.

    Returns
    -------
    bool
        False if it has no length or turns back.
    """
    way = points[-1] - points[0]
    length = float(np.linalg.norm(way))
    if length == 0.0:
        return False
    off = points - points[0]
    along = off @ way / length
    beside = np.linalg.norm(off - along[:, None] * way / length, axis=1)
    return bool(np.all(beside <= slack * length) and np.all(np.diff(along) >= 0.0))


def resample_evenly(points: FloatArray, max_turn: float, max_segments: int = 720) -> FloatArray:
    """Resample a smooth polyline at even distances.

    Parameters
    ----------
    points : ndarray, shape (n, d)
    max_turn : float, in rad
        Largest turn at any point.
    max_segments : int
        Largest number of segments; it wins over `max_turn`.

    Returns
    -------
    ndarray, shape (m, d)
        The two ends alone for a straight line.
    """
    from scipy.interpolate import CubicSpline

    if is_straight(points):
        return points[[0, -1]]
    arc = compute_arc_lengths(points)
    loop = "periodic" if np.array_equal(points[0], points[-1]) else "not-a-knot"
    spline = CubicSpline(arc, points, bc_type=loop)
    fine = np.linspace(0.0, arc[-1], 4 * len(points))
    first, second = spline(fine, 1), spline(fine, 2)
    speed = np.linalg.norm(first, axis=1)
    beside = second - np.sum(second * first, axis=1, keepdims=True) / speed[:, None] ** 2 * first
    tightest = float(np.max(np.linalg.norm(beside, axis=1) / speed**2))
    count = int(np.clip(np.ceil(arc[-1] * tightest / max_turn), 4, max_segments))
    smooth = compute_arc_lengths(spline(fine))
    return np.asarray(spline(np.interp(np.linspace(0.0, smooth[-1], count + 1), smooth, fine)))
