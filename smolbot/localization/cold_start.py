"""Starts for the fit from anywhere, without a prior.

For a fixed position the first harmonic is linear in the oscillating moment vector. A coarse grid of
positions with a linear solve in each (variable projection) finds where the magnet may be and which
way its moment swings; what is left is the turn about that swing, and its sign, which are tried.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smolbot.arrays import FloatArray
from smolbot.localization import kernels
from smolbot.localization.basis import REFERENCE_ANGLE
from smolbot.localization.problem import Fit, Problem

TURNS = 12
"""Orientations tried about the direction of swing."""


@dataclass(frozen=True)
class SearchVolume:
    """Box in the world frame in which a cold start looks for the magnet, in m."""

    low: tuple[float, float, float] = (-0.05, -0.05, 0.03)
    high: tuple[float, float, float] = (0.05, 0.05, 0.12)
    spacing: float = 0.008

    def grid(self) -> FloatArray:
        """Grid points, shape (n, 3)."""
        axes = [np.arange(a, b + 1e-9, self.spacing) for a, b in zip(self.low, self.high, strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def first_harmonic(problem: Problem) -> tuple[FloatArray, float]:
    """Signed size of the first harmonic in each difference, and the common phase.

    Returns
    -------
    amplitudes : ndarray, shape (n_differences,), in T per reference angle
    phase : float, in rad
    """
    columns = [problem.model.basis[1, 1].real, -problem.model.basis[1, 1].imag]
    columns += [problem.model.basis[2, 2].real, -problem.model.basis[2, 2].imag]
    design = np.stack(columns, axis=1)
    scale = np.linalg.norm(design, axis=0)
    solution = np.linalg.lstsq(design / scale, problem.data.T, rcond=None)[0] / scale[:, None]
    phasor = solution[0] + 1j * solution[1]
    phase = 0.5 * float(np.angle(np.sum(phasor**2)))
    return np.real(phasor * np.exp(-1j * phase)), phase


def best_start(problem: Problem, volume: SearchVolume, keep: int = 5) -> Fit:
    """Fit from the most promising starts; the one with the least error.

    Parameters
    ----------
    keep : int
        Grid positions, at least two spacings apart, that are followed up.
    """
    amplitudes, phase = first_harmonic(problem)
    grid = volume.grid()
    moments = np.zeros_like(grid)
    errors = kernels.grid_residuals(
        amplitudes, problem.model.sensors.positions, problem.model.sensors.axes, problem.model.mixing, grid, moments
    )
    places: list[int] = []
    for index in np.argsort(errors):
        if all(np.linalg.norm(grid[index] - grid[i]) > 2.0 * volume.spacing for i in places):
            places.append(int(index))
        if len(places) == keep:
            break
    tries: list[Fit] = []
    for place in places:
        for orientation, sign_phase in _orientations(problem, moments[place], phase):
            top = problem.model.amplitude_max
            size = float(np.linalg.norm(moments[place])) / problem.model.device.moment / REFERENCE_ANGLE
            amplitude = min(max(size, 0.1 * top), 0.95 * top)
            center = grid[place] - problem.model.device.l0 * orientation[:, 2]
            tries.append(problem.fit(center, orientation, sign_phase, amplitude, iterations=4))
    tries.sort(key=lambda t: t.sse)
    finals = [problem.fit(t.position, t.rotation, t.phase, t.amplitude, iterations=60) for t in tries[:8]]
    return min(finals, key=lambda t: t.sse)


def _orientations(problem: Problem, swing: FloatArray, phase: float) -> list[tuple[FloatArray, float]]:
    """Rotation matrices whose moment swings along `swing`, turned about it, and the phase that goes with each."""
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
        for turn in 2.0 * np.pi * np.arange(TURNS) / TURNS:
            turned = np.cos(turn) * side + np.sin(turn) * up
            frame_world = np.stack([along, turned, np.cross(along, turned)], axis=1)
            out.append((frame_world @ frame_body.T, phase if sign > 0 else phase + np.pi))
    return out
