"""Mains and its harmonics, and the noise between them, of each sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.sensing import Recording
from smolbot.errors import InputError

BLOCK_RATE = 5000.0
"""Rate, in Hz, to which recordings are averaged down first."""

N_HARMONICS = 8
"""Number of mains harmonics that are removed, the fundamental included."""

MAINS_SPREAD = 0.01
"""Relative width of the search for the mains frequency; grids stay within it, a generator may not."""

SLOW_BAND = (0.7, 1.7)
"""Band, in Hz, over which noise at 1 Hz is measured."""

FLOOR_BAND = (0.16, 0.42)
"""Band of the noise floor, as shares of the sensors' bandwidth: above 1/f noise and below the corner."""

FLOOR_SEGMENT = 0.2
"""Length, in s, of the segments that are averaged for the noise floor."""

MIN_DURATION = 1.0
"""Shortest recording, in s, in which noise at 1 Hz can be measured."""


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """Background noise of each sensor; arrays of shape (n_sensors,).

    Attributes
    ----------
    offset : ndarray, in T
        Mean.
    rms : ndarray, in T
        Of the residual without mean, trend, mains and harmonics.
    slow : ndarray, in T/√Hz
        Noise density around 1 Hz.
    floor : ndarray, in T/√Hz
        Noise density above 1/f noise, corrected for the sensors' low pass.
    mains : ndarray, in T
        Peak at the mains frequency.
    harmonics : ndarray, shape (n_sensors, N_HARMONICS - 1), in T
        Peaks at its multiples, from twice on.
    mains_frequency : float, in Hz
    span : ndarray, in T
        Largest less smallest sample; 0 for a channel that is stuck.
    saturated : ndarray of bool
    """

    offset: FloatArray
    rms: FloatArray
    slow: FloatArray
    floor: FloatArray
    mains: FloatArray
    harmonics: FloatArray
    mains_frequency: float
    span: FloatArray
    saturated: np.ndarray


def measure_sensor_noise(recordings: Sequence[Recording], mains: float, bandwidth: float = np.inf) -> SensorNoise:
    """Measure mains, harmonics and noise in recordings without excitation.

    Parameters
    ----------
    recordings : sequence of Recording
        Of one sample rate and one set of sensors, each at least a second long.
    mains : float, in Hz
        Nominal mains frequency.
    bandwidth : float, in Hz
        Corner of the sensors' first-order low pass.

    Returns
    -------
    SensorNoise

    Raises
    ------
    InputError
        If there is no recording, or if one is too short.
    """
    if not recordings:
        raise InputError("measure_hum needs at least one quiet recording; got none.")
    shortest = min(r.duration for r in recordings)
    if shortest < MIN_DURATION - 1e-9:
        raise InputError(f"Quiet recordings must last at least {MIN_DURATION:g} s; got {shortest:.3f} s.")
    size = max(round(recordings[0].sample_rate / BLOCK_RATE), 1)
    rate = recordings[0].sample_rate / size
    pieces = [_average_blocks(np.asarray(r.field), size) for r in recordings]
    frequency = _find_mains_frequency(pieces, rate, mains)
    fits = [_fit_lines(piece, rate, frequency) for piece in pieces]
    noise = [residual for _, residual in fits]
    peaks = np.sqrt(np.mean([np.abs(phasors) ** 2 for phasors, _ in fits], axis=0)).T
    top = min(bandwidth, 0.2 * rate)
    slow, _ = _compute_noise_density(noise, rate, shortest, SLOW_BAND, np.mean)
    floor, grid = _compute_noise_density(noise, rate, FLOOR_SEGMENT, (FLOOR_BAND[0] * top, FLOOR_BAND[1] * top), None)
    gain = np.sqrt(np.mean(1.0 / (1.0 + (grid / bandwidth) ** 2))) if np.isfinite(bandwidth) else 1.0
    return SensorNoise(
        offset=np.mean([np.asarray(r.field).mean(axis=1) for r in recordings], axis=0),
        rms=np.sqrt(np.mean([np.mean(piece**2, axis=1) for piece in noise], axis=0)),
        slow=slow,
        floor=floor / gain,
        mains=peaks[:, 0],
        harmonics=peaks[:, 1:],
        mains_frequency=frequency,
        span=np.max([np.ptp(np.asarray(r.field), axis=1) for r in recordings], axis=0),
        saturated=np.any([r.saturated for r in recordings], axis=0),
    )


def _average_blocks(field: FloatArray, size: int) -> FloatArray:
    n = field.shape[1] // size
    return np.asarray(field[:, : n * size].reshape(len(field), n, size).mean(axis=2))


def _build_design_matrix(count: int, rate: float, frequency: float) -> FloatArray:
    """Build the design matrix; its columns are cosines and sines of every order, a constant and a trend."""
    time = np.arange(count) / rate
    orders = np.arange(1, N_HARMONICS + 1)
    angle = 2 * np.pi * frequency * np.outer(time, orders[orders * frequency < 0.45 * rate])
    slow = np.stack([np.ones(count), (time - time.mean()) / time[-1]], axis=1)
    return np.concatenate([np.cos(angle), np.sin(angle), slow], axis=1)


def _fit_lines(piece: FloatArray, rate: float, frequency: float) -> tuple[np.ndarray, FloatArray]:
    """Fit one recording; return peak phasors (ORDERS, n_sensors) and residual (n_sensors, n)."""
    design = _build_design_matrix(piece.shape[1], rate, frequency)
    solution = np.linalg.solve(design.T @ design, design.T @ piece.T)
    n = (design.shape[1] - 2) // 2
    phasors = np.zeros((N_HARMONICS, len(piece)), np.complex128)
    phasors[:n] = solution[:n] - 1j * solution[n : 2 * n]
    return phasors, piece - (design @ solution).T


def _find_mains_frequency(pieces: list[FloatArray], rate: float, nominal: float) -> float:
    """Find the frequency near `nominal` at which the recordings together have the most power."""
    from scipy.optimize import minimize_scalar

    centred = [(p - p.mean(axis=1, keepdims=True)) * np.hanning(p.shape[1]) for p in pieces]
    times = [np.arange(p.shape[1]) / rate for p in pieces]

    def less_power(frequency: float) -> float:
        return -sum(
            float(np.sum(np.abs(p @ np.exp(-2j * np.pi * frequency * t)) ** 2))
            for p, t in zip(centred, times, strict=True)
        )

    grid = nominal * (1 + MAINS_SPREAD * np.linspace(-0.5, 0.5, 41))
    best = float(grid[np.argmin([less_power(f) for f in grid])])
    step = grid[1] - grid[0]
    found = minimize_scalar(less_power, bounds=(best - step, best + step), method="bounded")
    return float(found.x)


def _compute_noise_density(
    pieces: list[FloatArray], rate: float, segment: float, band: tuple[float, float], mean: object
) -> tuple[FloatArray, FloatArray]:
    """Compute the noise density (n_sensors,) in a band by half-overlapping Hann segments, and its frequencies.

    The density is the mean over the band if `mean` is given, otherwise a median, which unknown lines hardly affect.
    """
    from scipy.signal import welch

    length = min(round(segment * rate), *(piece.shape[1] for piece in pieces))
    counts = [(piece.shape[1] - length // 2) // (length - length // 2) for piece in pieces]  # of segments
    spectra = [welch(piece, rate, nperseg=length, detrend=False) for piece in pieces]
    grid = spectra[0][0]
    used = (grid >= band[0]) & (grid <= band[1])
    power = np.average([power[:, used] for _, power in spectra], axis=0, weights=counts)
    if mean is not None:
        return np.sqrt(power.mean(axis=1)), grid[used]
    averages = max(sum(counts) * 0.52, 1.0)  # of independent segments among half-overlapping ones
    return np.sqrt(np.median(power, axis=1) / (1.0 - 1.0 / (9.0 * averages)) ** 3), grid[used]
