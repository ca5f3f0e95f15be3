"""Starting points for the fit without a prior.

For a fixed position the first harmonic is linear in the oscillating moment vector. A coarse grid of
positions with a linear solve in each (variable projection) finds likely positions of the magnet and the direction
in which its moment oscillates. The turn about that direction, and its sign, remain unknown; several are tried.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.localization import kernels
from smolbot.localization.basis import list_labels
from smolbot.localization.problem import Fit, Problem

TRIED_TURNS = 12
"""Orientations that are tried about the direction of the oscillation."""

FINAL_FITS = 10
"""Fits that are continued to convergence."""

FIRST_STEPS, FINAL_STEPS = 4, 60
"""Iterations of the fit from every start, and of the best ones."""

MIN_AMPLITUDE, MAX_AMPLITUDE = 0.1, 0.95
"""Range of the first amplitude, as shares of the largest: a fit must not start at its bound."""

SAME_POSITION, SAME_ROTATION = 1e-3, 1.0 + 2.0 * np.cos(np.radians(5.0))
"""Two fits are the same within this distance, in m, and above this trace of their relative rotation (5 degrees)."""

MIN_DISTANCE = 2.0
"""Distance of two starts, in grid spacings."""

GRID_ROUNDING = 1e-9
"""Length, in m, by which the end of a grid may be missed."""


@dataclass(frozen=True)
class SearchVolume:
    """Box in the world frame in which a cold start searches for the magnet, in m.

    Examples
    --------
    >>> import smolbot
    >>> smolbot.SearchVolume(low=(-0.02, -0.02, 0.05), high=(0.02, 0.02, 0.07), spacing=0.01).grid().shape
    (75, 3)
    """

    low: tuple[float, float, float] = (-0.05, -0.05, 0.03)
    high: tuple[float, float, float] = (0.05, 0.05, 0.12)
    spacing: float = 0.008

    def grid(self) -> FloatArray:
        """Make the grid points.

        Returns
        -------
        ndarray, shape (n, 3), in m, world frame
        """
        axes = [np.arange(a, b + GRID_ROUNDING, self.spacing) for a, b in zip(self.low, self.high, strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


@dataclass(frozen=True)
class Start:
    """A starting point of the fit.

    Attributes
    ----------
    magnet : ndarray, shape (3,), in m, world frame
        Position of the magnet.
    swing : ndarray, shape (3,), in A·m² per reference angle, world frame
        Oscillating part of its moment.
    phase : float, in rad
    """

    magnet: FloatArray
    swing: FloatArray
    phase: float


def find_likely_starts(problem: Problem, volume: SearchVolume, keep: int = 5) -> list[Start]:
    """Find the grid positions, at least two spacings apart, that explain most of the first harmonic.

    Parameters
    ----------
    problem : Problem
    volume : SearchVolume
    keep : int
        Largest number of starts.

    Returns
    -------
    list of Start
        The best first.
    """
    model = problem.model
    real, imaginary = (int(np.flatnonzero((list_labels() == (1, 1, part)).all(axis=1))[0]) for part in (0, 1))
    design = np.concatenate([model.matrix[:, real], -model.matrix[:, imaginary]], axis=1)
    grid = volume.grid()
    moments = np.zeros((len(grid), 6))
    gains = kernels.fit_grid_moments(
        design.T @ design, design.T @ problem.data, model.positions, model.axes, grid, moments
    )
    starts: list[Start] = []
    for index in np.argsort(-gains):
        if all(np.linalg.norm(grid[index] - s.magnet) > MIN_DISTANCE * volume.spacing for s in starts):
            phasor = moments[index, :3] + 1j * moments[index, 3:]
            # the oscillating moment is linear: the phase that makes its phasor real
            phase = 0.5 * float(np.angle(np.sum(phasor**2)))
            starts.append(Start(grid[index], np.real(phasor * np.exp(-1j * phase)), phase))
        if len(starts) == keep:
            break
    return starts


def find_best_fits(problem: Problem, volume: SearchVolume, keep: int = 5) -> list[Fit]:
    """Find distinct fits from the most promising starts.

    Parameters
    ----------
    problem : Problem
    volume : SearchVolume
    keep : int
        Number of grid positions to start from.

    Returns
    -------
    list of Fit
        The best first.
    """
    tries: list[Fit] = []
    top = problem.model.amplitude_max
    for start in find_likely_starts(problem, volume, keep):
        size = float(np.linalg.norm(start.swing)) / problem.model.device.moment
        amplitude = min(max(size, MIN_AMPLITUDE * top), MAX_AMPLITUDE * top)
        for rotation, phase in _list_orientations(problem, start.swing, start.phase):
            center = start.magnet - problem.model.device.l0 * rotation[:, 2]
            tries.append(problem.fit(center, rotation, phase, amplitude, iterations=FIRST_STEPS))
    tries.sort(key=lambda t: t.sse)
    finals = [
        problem.fit(t.position, t.rotation, t.phase, t.amplitude, iterations=FINAL_STEPS) for t in tries[:FINAL_FITS]
    ]
    finals.sort(key=lambda t: t.sse)
    distinct: list[Fit] = []
    for fit in finals:
        if all(not _is_same_fit(fit, other) for other in distinct):
            distinct.append(fit)
    return distinct


def _is_same_fit(a: Fit, b: Fit) -> bool:
    near = float(np.linalg.norm(a.position - b.position)) < SAME_POSITION
    return near and float(np.trace(a.rotation.T @ b.rotation)) > SAME_ROTATION


def _list_orientations(problem: Problem, swing: FloatArray, phase: float) -> list[tuple[FloatArray, float]]:
    """List rotation matrices whose moment swings along `swing`, turned about it, each with its phase."""
    body = np.array(problem.model.device.drive_direction_in_body)
    out: list[tuple[FloatArray, float]] = []
    signs = (1.0,) if problem.model.device.along_cantilever else (1.0, -1.0)
    for sign in signs:
        along = sign * swing / np.linalg.norm(swing)
        seed = np.eye(3)[int(np.argmin(np.abs(along)))]
        side = np.cross(along, seed)
        side /= np.linalg.norm(side)
        up = np.cross(along, side)
        body_side = np.array([0.0, 1.0, 0.0])
        body_up = np.cross(body, body_side)
        frame_body = np.stack([body, body_side, body_up], axis=1)
        for turn in 2.0 * np.pi * np.arange(TRIED_TURNS) / TRIED_TURNS:
            turned = np.cos(turn) * side + np.sin(turn) * up
            frame_world = np.stack([along, turned, np.cross(along, turned)], axis=1)
            out.append((frame_world @ frame_body.T, phase if sign > 0 else phase + np.pi))
    return out
