"""Frequency and damping of the free oscillation, measured without a pose.

`measure_ring_down` needs no pose and no amplitude: each channel has its own size and phase at f and at 2f,
only f and the damping are common.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.sensing import DampingModel, Device, Recording, SensorArray
from smolbot.localization.device.least_squares import minimize
from smolbot.localization.device.thinning import BLOCK_NOISE, Hum, ThinnedRecording, thin_recording

_FIRST_TWO = ((1, 1), (2, 2), (2, 0))
"""Power and harmonic of the waves in a fit: fundamental, second harmonic, shift of the mean."""

N_WAVES = 5
"""Real waves of a channel: two for each harmonic, one for the mean."""

FREQUENCY_RANGE = np.array([0.4, 2.0])
"""Range of the frequency in a fit, as factors on the nominal value."""

LOG_DAMPING_RANGE = (-7.0, 7.0)
"""Range of the damping's logarithm (1/s) in a fit."""

MIN_DAMPING, DAMPING_FACTORS = 0.2, np.array([0.4, 0.7, 1.0, 1.5, 2.5])
"""Smallest nominal damping, in 1/s, and the factors on it from which a search starts."""

SEARCH_SHARE = 0.5
"""Largest half width of the search, as a share of the nominal frequency."""

FIT_STEPS = np.array([1e-4, 1e-4])
"""Steps of the difference quotients for frequency (Hz) and the damping's logarithm."""

GRID_SHARE, MIN_GRID = 0.25, 0.1
"""Spacing of the searched frequencies, in units of 1 / duration, and at least, in Hz."""

TINY, TINY_VARIANCE = 1e-30, 1e-300
"""Norm of a wave, and variance, that keep a quotient finite."""


@dataclass(frozen=True)
class RingDownFit:
    """Frequency and damping of one recording, for any pose.

    Attributes
    ----------
    frequency, frequency_std : float, in Hz
    damping, damping_std : float, in 1/s
    damping_model : {"linear", "exponential"}
    strength : float, in T
        Root of the sum of squares over channels of the oscillation's amplitude at the end of the drive.
    signal_to_noise : float
        Root of explained over expected sum of squares; below about 10 no oscillation can be measured.
    """

    frequency: float
    frequency_std: float
    damping: float
    damping_std: float
    damping_model: DampingModel
    strength: float
    signal_to_noise: float


def measure_ring_down(
    recording: Recording,
    sensors: SensorArray,
    device: Device,
    *,
    hum: Hum | None = None,
    search: float = 10.0,
    damping_model: DampingModel | None = None,
) -> RingDownFit:
    """Measure frequency and damping of the free oscillation from all channels, without a pose.

    Least squares with the channels' sizes and phases at f (D) and at 0 and 2f (D²) projected out.

    Parameters
    ----------
    recording : Recording
    sensors : SensorArray
    device : Device
        Start: its assumed frequency and damping.
    hum : Hum, optional
        Mains lines in the room.
    search : float, in Hz
        Largest distance of the grid from the assumed frequency.
    damping_model : {"linear", "exponential"}, optional
        Envelope to fit; the device's own if not given.

    Returns
    -------
    RingDownFit
        Standard deviations are those of the fit; repeated measurements scatter more where noise is not white.

    Raises
    ------
    InputError
        As for `thin_recording`.
    """
    model = damping_model or device.damping_model
    base = replace(device, damping_model=model)
    thinned = thin_recording(recording, sensors, device.frequency, hum)

    def make_device(values: FloatArray) -> Device:
        frequency = np.clip(values[0], *(FREQUENCY_RANGE * device.frequency))
        return replace(base, frequency=float(frequency), damping=float(np.exp(np.clip(values[1], *LOG_DAMPING_RANGE))))

    def residual(values: FloatArray) -> FloatArray:
        basis = _compute_harmonic_basis(thinned, make_device(values))
        return np.ravel(thinned.data - (thinned.data @ basis) @ basis.T) / BLOCK_NOISE

    span = min(search, SEARCH_SHARE * device.frequency)
    rates = np.log(max(device.damping, MIN_DAMPING) * DAMPING_FACTORS)
    grid = [
        np.array([f, rate])
        for rate in rates
        for f in device.frequency
        + np.linspace(-span, span, 2 * int(span / _choose_grid_step(thinned, np.exp(rate))) + 1)
    ]
    bases = (_compute_harmonic_basis(thinned, make_device(values)) for values in grid)
    best = grid[int(np.argmax([float(np.sum((thinned.data @ basis) ** 2)) for basis in bases]))]
    values, covariance, cost = minimize(residual, best, FIT_STEPS)
    found = make_device(values)
    channels, blocks = thinned.data.shape
    excess = cost / max(channels * (blocks - N_WAVES) - 2, 1)  # relative to the expected noise
    spread = np.sqrt(np.diag(covariance) * excess)
    basis = _compute_harmonic_basis(thinned, found)
    explained = float(np.sum((thinned.data @ basis) ** 2))
    wave = thinned.compute_waves(found, [(1, 1)])[0]
    columns = thinned.whiten(np.stack([wave.real, wave.imag]))
    sizes = np.linalg.lstsq(columns.T, basis @ (thinned.data @ basis).T, rcond=None)[0]
    return RingDownFit(
        found.frequency,
        float(spread[0]),
        found.damping,
        float(found.damping * spread[1]),
        model,
        float(np.sqrt(np.sum(sizes**2))),
        float(np.sqrt(explained / max(N_WAVES * channels * excess, TINY_VARIANCE)) / BLOCK_NOISE),
    )


def _choose_grid_step(thinned: ThinnedRecording, damping: float) -> float:
    """Choose the step, in Hz, of a frequency grid that misses no peak."""
    duration = min(float(thinned.time[-1] - thinned.time[0]), 2.0 / damping)
    return max(GRID_SHARE / duration, MIN_GRID)


def _compute_harmonic_basis(thinned: ThinnedRecording, device: Device) -> FloatArray:
    """Compute a whitened orthonormal basis (n_blocks, 5) of the oscillation at f, 2f and 0, with any phase."""
    first, second, mean = thinned.compute_waves(device, _FIRST_TWO)
    rows = thinned.whiten(np.stack([first.real, first.imag, second.real, second.imag, mean.real]))
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    basis, _ = np.linalg.qr((rows / np.maximum(size, TINY)).T)
    return basis
