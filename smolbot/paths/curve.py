"""Paths as curves: polylines with arc length, distance and progress; reading them from CSV files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np

from smolbot.core.arrays import FloatArray, as_floats, freeze
from smolbot.core.text_table import read_table
from smolbot.errors import InputError
from smolbot.paths.corners import MIN_CORNER_ANGLE
from smolbot.paths.speed_profile import SpeedProfile

MIN_STEP = 1e-9
"""Distance, in m, below which two points of a path coincide."""

ROUNDING = 1e-9
"""Share of a step that is rounding, not one more step."""

TINY = 1e-30
"""Squared length, in m², of a segment without a horizontal part: keeps its quotient finite."""


@dataclass(frozen=True)
class Curve:
    """A curve through `points` (n, 3), in m, world frame, with straight pieces between them.

    Arc length `s` runs from 0 to `length`, in m. `speed` is the requested speed, listening included; without one a
    controller moves as fast as it can.

    Examples
    --------
    >>> import smolbot
    >>> path = smolbot.Curve([[0, 0, 0.06], [0.003, 0, 0.06], [0.003, 0.004, 0.06]])
    >>> path.length, path.at(0.005).tolist()
    (0.007, [0.003, 0.002, 0.06])
    """

    points: FloatArray
    speed: SpeedProfile | None = None

    def __post_init__(self) -> None:
        points = as_floats(self.points, (None, 3), "Curve points")
        if len(points) < 2:
            raise InputError(f"A path needs at least two points; got {len(points)}.")
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if np.any(steps < MIN_STEP):
            raise InputError(f"Path points {int(np.argmin(steps))} and {int(np.argmin(steps)) + 1} coincide.")
        object.__setattr__(self, "points", freeze(points))

    @cached_property
    def arc(self) -> FloatArray:
        """Arc length at each point, shape (n,), in m."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=1))])

    @property
    def length(self) -> float:
        """Length of the path, in m."""
        return float(self.arc[-1])

    def at(self, s: FloatArray | float) -> FloatArray:
        """Compute the points at given arc lengths.

        Parameters
        ----------
        s : ndarray, shape (...), or float, in m
            Clipped to the path.

        Returns
        -------
        ndarray, shape (..., 3), in m, world frame
        """
        clipped = np.clip(s, 0.0, self.length)
        return np.stack([np.interp(clipped, self.arc, self.points[:, k]) for k in range(3)], axis=-1)

    def tangent(self, s: FloatArray) -> FloatArray:
        """Compute the unit direction of travel at given arc lengths.

        Parameters
        ----------
        s : ndarray, shape (n,), in m

        Returns
        -------
        ndarray, shape (n, 3), world frame
        """
        index = np.clip(np.searchsorted(self.arc, s, side="right") - 1, 0, len(self.points) - 2)
        steps = np.diff(self.points, axis=0)[index]
        return steps / np.linalg.norm(steps, axis=1, keepdims=True)

    def sampled(self, spacing: float, corner: float = MIN_CORNER_ANGLE) -> FloatArray:
        """Sample arc lengths along the path that include the start, every corner and the end.

        Parameters
        ----------
        spacing : float, in m
            Largest distance between two samples.
        corner : float, in rad
            Turns beyond it are corners.

        Returns
        -------
        ndarray, shape (n,), in m
        """
        steps = np.diff(self.points, axis=0)
        steps = steps / np.linalg.norm(steps, axis=1, keepdims=True)
        turns = np.arccos(np.clip(np.sum(steps[1:] * steps[:-1], axis=1), -1.0, 1.0))
        stops = np.concatenate([[0.0], self.arc[1:-1][turns > corner], [self.length]])
        counts = [max(int(np.ceil((b - a) / spacing - ROUNDING)), 1) for a, b in pairwise(stops)]
        pieces = [np.linspace(a, b, n + 1)[1:] for (a, b), n in zip(pairwise(stops), counts, strict=True)]
        return np.concatenate([[0.0], *pieces])

    def project(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Project points onto the path: find the nearest place on it in the horizontal plane.

        Parameters
        ----------
        points : ndarray, shape (n, 3), in m, world frame

        Returns
        -------
        s : ndarray, shape (n,), in m
            Arc length of the nearest place.
        distance : ndarray, shape (n,), in m
            Horizontal distance to it (cross-track error).
        """
        points = as_floats(points, (None, 3), "points")
        start, step = self.points[:-1, :2], np.diff(self.points[:, :2], axis=0)
        squared = np.sum(step**2, axis=1)
        fraction = np.einsum("nsk,sk->ns", points[:, None, :2] - start, step) / np.maximum(squared, TINY)
        fraction = np.clip(fraction, 0.0, 1.0)
        nearest = start + fraction[..., None] * step
        distance = np.linalg.norm(points[:, None, :2] - nearest, axis=2)
        best = np.argmin(distance, axis=1)
        rows = np.arange(len(points))
        s = self.arc[best] + fraction[rows, best] * np.diff(self.arc)[best]
        return s, distance[rows, best]


def read_csv(path: Path) -> FloatArray:
    """Read a path from a CSV file with the columns x and y; a header line is allowed.

    Parameters
    ----------
    path : Path

    Returns
    -------
    ndarray, shape (n, 2), in mm

    Raises
    ------
    InputError
        With file and line of the first row that is not two finite numbers, or for fewer than two points.
    """
    rows: list[tuple[float, float]] = []
    for row in read_table(path).rows:
        try:
            x, y = (float(cell) for cell in row.cells)
        except ValueError:
            raise row.make_error(f"each row must be two numbers, x and y in mm; got {row.text!r}.") from None
        if not np.isfinite([x, y]).all():
            raise row.make_error(f"x and y must be finite; got {row.text!r}.")
        rows.append((x, y))
    if len(rows) < 2:
        raise InputError(f"{path}: a path needs at least two points; found {len(rows)}.")
    return np.array(rows)
