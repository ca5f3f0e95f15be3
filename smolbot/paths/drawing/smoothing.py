"""Smooth curves from the coarse polygons of a plotter font, with its corners and straight lines kept."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from smolbot.core.arrays import BoolArray, FloatArray

SAMPLE_SPACING = 0.25
"""Spacing of samples, in units of the font's grid."""

SLACK = 0.35
"""Distance, in grid units, by which a curve may miss a point of its polygon: points are rounded to half a unit."""

EXACT_SLACK = 2e-3
"""The same distance for points through which it must pass, and for straight lines."""

MIN_STRAIGHT_LENGTH = 6.9
"""Length, in grid units, from which a line is straight; shorter ones may be chords of a bend."""

MIN_CORNER_ANGLE, MIN_CORNER_ANGLE_BETWEEN_LINES = np.radians(70.0), np.radians(20.0)
"""Turns, in rad, from which a point is a corner: anywhere, and between two straight lines."""

HELD_POINT_WEIGHT, STRAIGHT_LINE_WEIGHT = 1e10, 1e7
"""Weights of a point through which the curve must pass, and of one on a straight line; others weigh 1."""

STIFFNESS_RANGE, STIFFNESS_STEPS = (-4.0, 8.0), 16
"""Decadic logarithms between which the stiffness is searched, and bisections of that search."""


def smooth_stroke(stroke: FloatArray, fixed: BoolArray | None = None) -> list[FloatArray]:
    """Smooth a stroke of the font between its corners.

    Each piece is the curve with the least change of curvature (third differences) among those that pass the points
    of the polygon within `SLACK`. So it is as round as the grid allows, without waves along it.

    Parameters
    ----------
    stroke : ndarray, shape (n, 2)
        On the font's grid. A stroke that ends where it begins, without a corner there, is smooth there too.
    fixed : ndarray of bool, shape (n,), optional
        Points through which the curve must pass, such as those where other strokes meet it.

    Returns
    -------
    list of ndarray, each of shape (n, 2)
        One piece between each two corners; a piece of two points is a straight line.

    Examples
    --------
    >>> [len(piece) for piece in smooth_stroke(np.array([[0.0, 0.0], [0.0, 9.0], [8.0, 9.0]]))]
    [2, 2]
    """
    held = np.zeros(len(stroke), dtype=bool) if fixed is None else fixed.copy()
    turns = _find_corners(stroke)
    loop = len(stroke) > 4 and np.allclose(stroke[0], stroke[-1])
    if loop and not turns.any() and not _find_corners(np.vstack([stroke[-2:], stroke[1:2]])).any():
        return [_fit_loop(stroke, held)]
    cuts = [0, *(int(i) + 1 for i in np.flatnonzero(turns)), len(stroke) - 1]
    held[cuts] = True
    return [_fit_open(stroke[a : b + 1], held[a : b + 1]) for a, b in pairwise(cuts)]


def _find_corners(stroke: FloatArray) -> BoolArray:
    """Return which inner points are corners."""
    steps = np.diff(stroke, axis=0)
    angle, long = np.arctan2(steps[:, 1], steps[:, 0]), np.hypot(steps[:, 0], steps[:, 1]) > MIN_STRAIGHT_LENGTH
    turn = np.abs((np.diff(angle) + np.pi) % (2.0 * np.pi) - np.pi)
    return (turn > MIN_CORNER_ANGLE) | ((turn > MIN_CORNER_ANGLE_BETWEEN_LINES) & long[1:] & long[:-1])


def _fit_loop(stroke: FloatArray, held: BoolArray) -> FloatArray:
    """Fit a closed stroke: repeat it three times and keep the middle round, which is free of end effects."""
    rounds = np.vstack([stroke[:-1], stroke[:-1], stroke])
    curve = _fit_open(rounds, np.concatenate([held[:-1], held[:-1], held]))
    n = (len(curve) - 1) // 3
    curve = curve[n : 2 * n + 1].copy()
    curve[-1] = curve[0]
    return curve


def _fit_open(polygon: FloatArray, held: BoolArray) -> FloatArray:
    """Fit the smoothest curve within `SLACK` of the points, and exact at held points and straight lines."""
    from scipy.linalg import solveh_banded

    lengths = np.hypot(*np.diff(polygon, axis=0).T)
    arc = np.concatenate([[0.0], np.cumsum(lengths)])
    if len(polygon) == 2:
        return polygon.copy()
    count = 3 * max(round(arc[-1] / SAMPLE_SPACING / 3), 2)
    grid = np.linspace(0.0, arc[-1], count + 1)
    on_line = np.searchsorted(arc, grid, side="right").clip(1, len(lengths)) - 1
    at = np.concatenate([arc, grid[lengths[on_line] > MIN_STRAIGHT_LENGTH]])
    goal = np.column_stack([np.interp(at, arc, polygon[:, k]) for k in range(2)])
    weight = np.where(np.arange(len(at)) < len(arc), 1.0, STRAIGHT_LINE_WEIGHT)
    weight[: len(arc)][held] = HELD_POINT_WEIGHT
    index = np.minimum((at / arc[-1] * count).astype(int), count - 1)
    share = at / arc[-1] * count - index
    # normal equations as diagonals: of the points, and of the third differences that the stiffness weighs
    points = np.zeros((4, count + 1))
    np.add.at(points[0], index, weight * (1.0 - share) ** 2)
    np.add.at(points[0], index + 1, weight * share**2)
    np.add.at(points[1], index, weight * share * (1.0 - share))
    right = np.zeros((count + 1, 2))
    np.add.at(right, index, (weight * (1.0 - share))[:, None] * goal)
    np.add.at(right, index + 1, (weight * share)[:, None] * goal)
    third = np.diff(np.eye(count + 1), 3, axis=0)
    normal = third.T @ third
    bending = np.array([np.pad(np.diagonal(normal, -k), (0, k)) for k in range(4)])

    def curve(stiffness: float) -> FloatArray:
        return solveh_banded(points + stiffness * bending, right, lower=True)

    def keeps(found: FloatArray) -> bool:
        passed = found[index] + share[:, None] * (found[index + 1] - found[index]) - goal
        return bool(np.all(np.hypot(passed[:, 0], passed[:, 1]) < np.where(weight == 1.0, SLACK, EXACT_SLACK)))

    # the stiffest curve that still keeps to its points
    low, high = STIFFNESS_RANGE
    for _ in range(STIFFNESS_STEPS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if keeps(curve(10.0**middle)) else (low, middle)
    best = curve(10.0**low)
    best[0], best[-1] = polygon[0], polygon[-1]
    return best
