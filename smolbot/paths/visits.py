"""Which parts of a path a robot visited, in the path's order: a measure that does not depend on any control law."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from smolbot.core.arrays import BoolArray, FloatArray, as_floats
from smolbot.errors import InputError
from smolbot.paths.curve import Curve

CELLS_PER_TOLERANCE, MAX_CELLS = 8, 4000
"""Number of cells of the path per length of one tolerance, and of the whole path at most."""

PLACES_AT_ONCE = 64
"""Number of places of the trail whose distances are computed at once: few enough for the processor's cache."""

TRAIL_STEPS_PER_TOLERANCE = 4
"""Number of places of the trail per length of one tolerance: straight lines join the positions."""

LOOP_TURN = np.radians(270.0)
"""Turn, in rad and in one sense, that makes a loop: no corner and no bend back turns as far."""

REVERSAL = np.radians(150.0)
"""Turn between two cells, in rad, beyond which the path turns back on itself, in no sense."""

LOOP_SHARE = 0.8
"""Tolerance in a loop as a share of its radius: from its middle, no part of a loop counts as visited."""


@dataclass(frozen=True)
class Visits:
    """The parts of a path that a robot visited in order, and those that it left out.

    Attributes
    ----------
    share : float
        Visited length over the length of the path, 0 to 1.
    skipped : tuple of (float, float), in m
        Arc lengths at which each part that was not visited begins and ends.
    """

    share: float
    skipped: tuple[tuple[float, float], ...]

    def describe_longest_skip(self, path: Curve) -> str:
        """Describe the longest part that was not visited.

        Parameters
        ----------
        path : Curve

        Returns
        -------
        str
            Such as ``27.4 mm near (-6.1, 4.0) mm``; empty if all was visited.
        """
        if not self.skipped:
            return ""
        begin, end = max(self.skipped, key=lambda part: part[1] - part[0])
        x, y, _ = 1e3 * path.at(0.5 * (begin + end))
        return f"{1e3 * (end - begin):.1f} mm near ({x:.1f}, {y:.1f}) mm"


@dataclass(frozen=True)
class Cells:
    """A path cut into cells of equal length.

    Attributes
    ----------
    edges : ndarray, shape (n + 1,), in m
        Arc lengths at which cells begin and end.
    places : ndarray, shape (n, 2), in m, world frame
        Middle of each cell.
    reach : ndarray, shape (n,), in m
        Distance from its middle within which a cell counts as visited.
    """

    edges: FloatArray
    places: FloatArray
    reach: FloatArray

    @property
    def arc(self) -> FloatArray:
        """Arc length in the middle of each cell, shape (n,), in m."""
        return 0.5 * (self.edges[:-1] + self.edges[1:])

    def find_reach(self, arc: FloatArray) -> FloatArray:
        """Find the distance within which places at some arc lengths count as visited.

        Parameters
        ----------
        arc : ndarray, shape (m,), in m

        Returns
        -------
        ndarray, shape (m,), in m
        """
        return self.reach[np.clip(np.searchsorted(self.edges, arc, side="right") - 1, 0, len(self.reach) - 1)]


def divide_path(path: Curve, tolerance: float) -> Cells:
    """Divide a path into cells, each with the distance within which it counts as visited.

    That is the tolerance, but less in a loop that is smaller: see `compute_local_tolerance`.

    Parameters
    ----------
    path : Curve
    tolerance : float, in m

    Returns
    -------
    Cells

    Raises
    ------
    InputError
        If the tolerance is not greater than 0.
    """
    if not tolerance > 0.0:
        raise InputError(f"The tolerance of a visit must be greater than 0; got {tolerance!r} m.")
    count = int(np.clip(np.ceil(CELLS_PER_TOLERANCE * path.length / tolerance), 1, MAX_CELLS))
    edges = np.linspace(0.0, path.length, count + 1)
    places = path.at(0.5 * (edges[:-1] + edges[1:]))[:, :2]
    return Cells(edges, places, compute_local_tolerance(places, path.length / count, tolerance))


def find_visits(path: Curve, positions: FloatArray, tolerance: float) -> Visits:
    """Find the parts of a path that a robot visited in the path's order.

    The path is cut into short cells. A cell is visited where the trail, a polyline through the positions, comes within
    the cell's tolerance of its middle. Of all ways to assign cells to the trail without ever going back on either, the
    one with most visited cells counts. So a second turn of a circle has to be flown, and a lobe of a figure eight
    cannot be visited from its crossing.

    Parameters
    ----------
    path : Curve
    positions : ndarray, shape (n, 3), in m, world frame
        Of the robot, in the order of time. Rows that are not finite are left out.
    tolerance : float, in m

    Returns
    -------
    Visits

    Raises
    ------
    InputError
        If the tolerance is not greater than 0, or the positions have another shape.

    Examples
    --------
    >>> path = Curve([[0, 0, 0], [0.004, 0, 0], [0, 0, 0]])  # there and back; first flown there only
    >>> out = np.column_stack([np.linspace(0, 0.004, 9), np.zeros(9), np.zeros(9)])
    >>> find_visits(path, out, 1e-4).share, find_visits(path, np.vstack([out, out[::-1]]), 1e-4).share
    (0.525, 1.0)
    """
    cells = divide_path(path, tolerance)
    places = as_floats(positions, (None, 3), "positions", finite=False)[:, :2]
    trail = _join(places[np.isfinite(places).all(axis=1)], tolerance / TRAIL_STEPS_PER_TOLERANCE)
    visited = _assign(trail, cells.places, cells.reach)
    bounds = np.flatnonzero(np.diff(np.concatenate([[True], visited, [True]]).astype(np.int8)))
    skipped = tuple((float(cells.edges[a]), float(cells.edges[b])) for a, b in bounds.reshape(-1, 2))
    return Visits(float(visited.mean()), skipped)


def compute_local_tolerance(places: FloatArray, spacing: float, tolerance: float) -> FloatArray:
    """Compute the distance within which each place of a path counts as visited: smaller in small loops.

    A loop is where the path turns by `LOOP_TURN` in one sense. Its radius is its length over its turn.

    Parameters
    ----------
    places : ndarray, shape (n, 2), in m
        At even distances along the path.
    spacing : float, in m
        Between two places, along the path.
    tolerance : float, in m
        Outside of small loops.

    Returns
    -------
    ndarray, shape (n,), in m

    Examples
    --------
    >>> angle = np.linspace(0.0, 2.0 * np.pi, 33)
    >>> circle = 0.5e-3 * np.column_stack([np.cos(angle), np.sin(angle)])
    >>> print(compute_local_tolerance(circle, 0.5e-3 * np.pi / 16, 0.8e-3).max().round(6))
    0.000413
    """
    local = np.full(len(places), tolerance)
    steps = np.diff(places, axis=0)
    heading = np.arctan2(steps[:, 1], steps[:, 0])
    turns = (np.diff(heading) + np.pi) % (2.0 * np.pi) - np.pi
    turned = np.concatenate([[0.0, 0.0], np.cumsum(np.where(np.abs(turns) > REVERSAL, 0.0, turns)), [0.0]])
    turned[-1] = turned[-2]  # (n + 1,): turn before each place, and behind the last one
    longest = int(tolerance / LOOP_SHARE * LOOP_TURN / spacing) + 1
    for cells in range(1, min(longest, len(places)) + 1):
        turn = np.abs(turned[cells:] - turned[:-cells])
        for first in np.flatnonzero(turn >= LOOP_TURN):
            inside = slice(first, first + cells)
            local[inside] = np.minimum(local[inside], LOOP_SHARE * cells * spacing / turn[first])
    return local


def _join(positions: FloatArray, step: float) -> FloatArray:
    """Join positions (n, 2) by straight lines, and return places on them that are at most `step` apart."""
    pieces = [positions[:1]]
    for a, b in pairwise(positions):
        count = int(np.ceil(np.hypot(*(b - a)) / step))
        pieces.append(a + np.arange(1, count + 1)[:, None] / max(count, 1) * (b - a))
    return np.vstack(pieces)


def _assign(trail: FloatArray, cells: FloatArray, reach: FloatArray) -> BoolArray:
    """Return which cells (n, 2) are visited by a trail (m, 2), in the order of both, so that most of them are.

    Dynamic programming: ``most[j]`` is the largest number of visited cells among the first j, after each place of the
    trail. A place visits any run of cells within their `reach` (n,), after all that was visited before. ``most`` grows
    by 0 or 1 from cell to cell, so that one bit for each is kept for the way back.
    """
    most = np.zeros(len(cells) + 1, dtype=np.int32)
    rows = []
    for within in _find_changes(trail, cells, reach):
        rows.append(np.packbits(np.diff(most).astype(bool)))
        count = np.concatenate([[0], np.cumsum(within, dtype=np.int32)])
        most = np.maximum.accumulate(most - count) + count
    visited = np.zeros(len(cells), dtype=bool)
    j = len(cells)
    for row in reversed(rows):
        earlier = np.concatenate([[0], np.cumsum(np.unpackbits(row, count=len(cells)), dtype=np.int32)])
        while most[j] > earlier[j]:  # this place of the trail visited the cell before j, unless that one was skipped
            j -= 1
            visited[j] = most[j + 1] > most[j]
        most = earlier
    return visited


def _find_changes(trail: FloatArray, cells: FloatArray, reach: FloatArray) -> Iterator[BoolArray]:
    """Find which cells (n,) each place of the trail visits: the same cells once more, or none, change nothing."""
    before = np.zeros(len(cells), dtype=bool)
    square = reach**2
    for first in range(0, len(trail), PLACES_AT_ONCE):
        away = trail[first : first + PLACES_AT_ONCE, None, :] - cells
        inside = away[..., 0] ** 2 + away[..., 1] ** 2 <= square
        for within in inside[inside.any(axis=1)]:
            if not np.array_equal(within, before):
                yield within
                before = within
