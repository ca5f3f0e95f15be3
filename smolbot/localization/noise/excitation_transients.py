"""Ring-down of the excitation coils, learned so that listening may start before it is over."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.sensing import Recording
from smolbot.errors import InputError

SEPARABLE_AFTER = 12.0
"""Time constants after which a learned ring-down can be separated from a signal."""

NEGLIGIBLE_AFTER = 20.0
"""Time constants after which a ring-down is negligible in every sensor."""

MIN_RELATIVE_DIFFERENCE = 0.03
"""Relative difference below which two time constants count as one."""

_TIME_CONSTANT_RANGE = (1e-4, 2e-2)
"""Time constants, in s, between which one is searched."""

_GRID_POINTS, _SEARCH_STEPS = 60, 40
"""Time constants that are tried first, and steps of the golden section search between two of them."""

_MIN_GAIN = 0.5
"""Misfit at the best time constant, as a share of the worst: above it the probes hold no decay."""

_BLOCK = 2e-4
"""Length, in s, of the blocks to which a probe is averaged."""

_MAINS = 50.0
"""Frequency, in Hz, of the mains that is fitted with a decay."""


def learn_time_constant(probes: Sequence[Recording], frequency: float) -> float:
    """Learn the time constant of the decay after a drive, common to all channels.

    Each channel has its own size of one common exponential, a constant, and oscillations at the
    device's resonance and at the mains, which are fitted as well; only the exponential's time constant
    is non-linear.

    Parameters
    ----------
    probes : sequence of Recording
        Made right after a drive off resonance; saturated channels are left out.
    frequency : float, in Hz
        The device's resonance.

    Returns
    -------
    float, in s

    Raises
    ------
    InputError
        If no channel holds a decay.
    """
    if not probes:
        raise InputError("A ring-down is learned from at least one probe; got none.")

    def misfit(tau: float) -> float:
        return sum(_compute_squared_residual(probe, tau, frequency) for probe in probes)

    grid = np.geomspace(*_TIME_CONSTANT_RANGE, _GRID_POINTS)
    values = [misfit(t) for t in grid]
    best = int(np.argmin(values))
    if not 0 < best < len(grid) - 1 or values[best] > _MIN_GAIN * max(values):
        raise InputError("The probes show no decay of the excitation coils; no ring-down was learned.")
    low, high = np.log(grid[best - 1]), np.log(grid[best + 1])
    golden = 0.5 * (np.sqrt(5.0) - 1.0)
    for _ in range(_SEARCH_STEPS):
        a, b = high - golden * (high - low), low + golden * (high - low)
        if misfit(float(np.exp(a))) < misfit(float(np.exp(b))):
            high = b
        else:
            low = a
    return float(np.exp(0.5 * (low + high)))


def fit_decay_sizes(probe: Recording, tau: float, frequency: float) -> FloatArray:
    """Fit the size of a decay at the first sample of a recording.

    Parameters
    ----------
    probe : Recording
    tau : float, in s
        Time constant.
    frequency : float, in Hz
        Of a device that oscillates at the same time; see `learn_time_constant`.

    Returns
    -------
    ndarray, shape (n_sensors,), in T
    """
    time, blocks = _average_blocks(probe)
    sizes: FloatArray = np.linalg.lstsq(_make_design_matrix(time, tau, frequency), blocks.T, rcond=None)[0][1]
    return sizes


def _compute_squared_residual(probe: Recording, tau: float, frequency: float) -> float:
    """Compute the squared residual of all usable channels for one time constant."""
    time, blocks = _average_blocks(probe)
    design = _make_design_matrix(time, tau, frequency)
    usable = blocks[~probe.saturated]
    solution = np.linalg.lstsq(design, usable.T, rcond=None)[0]
    return float(np.sum((usable.T - design @ solution) ** 2))


def _average_blocks(probe: Recording) -> tuple[FloatArray, FloatArray]:
    """Compute times (n,) in s from the first sample, and means (n_sensors, n) over blocks of 0.2 ms."""
    step = max(int(_BLOCK * probe.sample_rate), 1)
    count = probe.field.shape[1] // step
    blocks = probe.field[:, : count * step].reshape(len(probe.field), count, step).mean(axis=2)
    return (np.arange(count) + 0.5) * step / probe.sample_rate, blocks


def _make_design_matrix(time: FloatArray, tau: float, frequency: float) -> FloatArray:
    """Make the columns of constant, decay, and the oscillations of device and mains, shape (n, 6)."""
    turns = 2.0 * np.pi * np.outer(time, [frequency, _MAINS])
    return np.column_stack([np.ones(len(time)), np.exp(-time / tau), np.cos(turns), np.sin(turns)])


def make_decay_columns(time: FloatArray, constants: tuple[float, ...]) -> FloatArray:
    """Make the columns of decays for a linear fit.

    Time constants that differ by less than `MIN_RELATIVE_DIFFERENCE` count as one: their difference cannot be
    measured, and two free decays would absorb part of the signal.

    Parameters
    ----------
    time : ndarray, shape (n,), in s
        After the end of the drive.
    constants : tuple of float, in s
        Time constants.

    Returns
    -------
    ndarray, shape (n, n_different)
        Each column begins at one.
    """
    different: list[float] = []
    for tau in sorted(constants):
        if not different or tau > (1.0 + MIN_RELATIVE_DIFFERENCE) * different[-1]:
            different.append(tau)
    return np.array([np.exp(-(time - time[0]) / tau) for tau in different]).reshape(-1, len(time)).T
