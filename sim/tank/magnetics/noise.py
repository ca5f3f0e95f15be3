"""The reference noise: mains and its harmonics, a slow drift, and the sensors' own noise."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from smolbot.config.rig_sections import NoiseSection
from smolbot.core.arrays import FloatArray

DRIFT_PERIODS = (7.0, 17.0, 41.0)  # s: incommensurate, longer than any listening window
CORNERS_PER_DECADE = 2  # processes whose sum is 1/f noise
TOP_CORNER = 0.4  # highest of their corners, as a share of the bandwidth
RATE_SHARE = 0.25  # highest bandwidth of the white noise, as a share of the sample rate
LOWEST_CORNER = 0.01  # Hz: below it the 1/f noise is flat; in a window it is part of the unknown constant
STEPS_PER_TIME_CONSTANT = 4.0  # of a process; straight in between


class FieldNoise:
    """Ambient field: lines that are coherent on the tank's clock and smooth in space.

        B(r, t) = sum_k Re[(B_k e^{i a_k} + G_k r e^{i b_k}) e^{2 pi i f_k t}]

    Directions of B_k, symmetric traceless gradients G_k and phases are sampled. `mains_nt` is the peak of |B| at 50
    Hz, `mains_gradient_nt_per_m` the peak of its change per metre, root mean square over directions (G's Frobenius
    norm over sqrt 3); harmonics have both in the same proportion. The drift is a sum of slow lines with the given
    rms slope.

    Parameters
    ----------
    section : NoiseSection
    positions, axes : ndarray, shape (n_sensors, 3)
        True positions (m) and sensitive directions with the gain as length, world frame.
    bandwidth : float, in Hz
        Of the sensors' first-order low pass, which the lines pass through.
    level, mains_frequency : float
        Sampled factors.
    rng : numpy.random.Generator

    Attributes
    ----------
    frequencies : ndarray, shape (n_lines,), in Hz
    """

    def __init__(
        self,
        section: NoiseSection,
        positions: FloatArray,
        axes: FloatArray,
        bandwidth: float,
        level: float,
        mains_frequency: float,
        rng: np.random.Generator,
    ) -> None:
        mains = section.mains_hz * mains_frequency
        lines = [(mains, 1.0)] + [(mains * int(order), size) for order, size in section.harmonics.items()]
        sizes = [(section.mains * size, section.mains_gradient * size) for _, size in lines]
        # drift as slow sines: amplitude = slope / angular frequency
        for period in DRIFT_PERIODS:
            lines.append((1.0 / period, 1.0))
            slope = section.drift * math.sqrt(2.0 / len(DRIFT_PERIODS))
            sizes.append((slope * period / (2 * math.pi), 0.0))
        self.frequencies = np.array([frequency for frequency, _ in lines])
        self._amplitudes = np.empty((len(lines), len(positions)), dtype=np.complex128)
        for k, (uniform, change) in enumerate(sizes):
            direction = rng.standard_normal(3)
            direction *= uniform / np.linalg.norm(direction)
            gradient = rng.standard_normal((3, 3))
            gradient = gradient + gradient.T
            gradient -= np.eye(3) * np.trace(gradient) / 3
            gradient *= math.sqrt(3) * change / np.linalg.norm(gradient)
            first, second = np.exp(1j * rng.uniform(0, 2 * math.pi, 2))
            measured = np.einsum("ij,ij->i", axes, first * direction + second * (positions @ gradient))
            self._amplitudes[k] = level * measured / (1 + 1j * self.frequencies[k] / bandwidth)

    @property
    def amplitudes(self) -> npt.NDArray[np.complex128]:
        """Peak phasors (n_lines, n_sensors) in T at clock 0, after the sensors' low pass."""
        return self._amplitudes

    def add(self, signal: FloatArray, clock: float, sample_rate: float) -> None:
        """Add the ambient noise to readings, in place.

        Parameters
        ----------
        signal : ndarray, shape (n_sensors, n), in T
        clock : float, in s
            Time of the first sample.
        sample_rate : float, in Hz
        """
        cycles = np.fmod(self.frequencies * clock, 1.0)
        turned = self._amplitudes * np.exp(2j * math.pi * cycles)[:, None]
        _add_lines(signal, turned.real.copy(), turned.imag.copy(), 2 * math.pi * self.frequencies / sample_rate)


class SensorNoise:
    """Each sensor's own noise.

    Its power spectral density is ``floor² + (at_1hz² - floor²) / f`` up to the bandwidth.
    The floor is one first-order process with the sensor's bandwidth as its corner; the 1/f part is a sum of such
    processes of equal variance with corners spaced evenly in log f. The processes continue between
    recordings: a gap is bridged exactly.

    Parameters
    ----------
    section : NoiseSection
    n_sensors : int
    bandwidth : float, in Hz
    sample_rate : float, in Hz
    level : float
        Sampled factor on the noise amplitude.
    rng : numpy.random.Generator
    """

    def __init__(
        self,
        section: NoiseSection,
        n_sensors: int,
        bandwidth: float,
        sample_rate: float,
        level: float,
        rng: np.random.Generator,
    ) -> None:
        self._rng, self._rate = rng, sample_rate
        top = min(bandwidth, RATE_SHARE * sample_rate)
        floor, excess = section.floor, section.at_1hz
        count = max(int(CORNERS_PER_DECADE * math.log10(TOP_CORNER * top / LOWEST_CORNER)), 1) + 1
        slow = LOWEST_CORNER * 10.0 ** (np.arange(count) / CORNERS_PER_DECADE)
        self._corners = np.concatenate([[top], slow])
        flicker = max(excess**2 - floor**2, 0.0) * math.log(10.0) / CORNERS_PER_DECADE
        variance = np.concatenate([[floor**2 * math.pi * top / 2], np.full(count, flicker)])
        self._deviations = level * np.sqrt(variance)
        self._state = rng.standard_normal((len(self._corners), n_sensors))
        self._known: dict[int, tuple[npt.NDArray[np.int64], int, FloatArray]] = {}
        self._clock = 0.0

    @property
    def processes(self) -> tuple[FloatArray, FloatArray]:
        """Corners in Hz and standard deviations in T of the first-order processes that make up each sensor's noise."""
        return self._corners, self._deviations

    def add(self, signal: FloatArray, clock: float) -> None:
        """Add the sensors' own noise to readings, in place.

        Parameters
        ----------
        signal : ndarray, shape (n_sensors, n), in T
        clock : float, in s
            Time of the first sample.
        """
        n = signal.shape[1]
        rates = 2 * math.pi * self._corners
        kept = np.exp(-rates * max(clock - self._clock, 0.0))[:, None]
        self._state = kept * self._state + np.sqrt(1 - kept**2) * self._rng.standard_normal(self._state.shape)
        knots, total, decay = self._find_knots(n)
        draws = self._rng.standard_normal(total * len(signal), dtype=np.float32)
        _add_processes(signal, self._state, self._deviations, knots, decay, draws)
        self._clock = clock + n / self._rate

    def _find_knots(self, n: int) -> tuple[npt.NDArray[np.int64], int, FloatArray]:
        """Return each process's number of knots in a window of `n` samples, their sum, and the decay between knots."""
        if n not in self._known:
            rates = 2 * math.pi * self._corners
            knots = np.ceil(n * rates * STEPS_PER_TIME_CONSTANT / self._rate).astype(np.int64)
            knots[0] = n
            knots = np.clip(knots, 1, n)
            self._known[n] = (knots, int(knots.sum()), np.exp(-rates * n / knots / self._rate))
        return self._known[n]


@njit(cache=True, error_model="numpy")
def _add_lines(signal: FloatArray, real: FloatArray, imaginary: FloatArray, turn: FloatArray) -> None:
    """Add lines with complex amplitudes (n_lines, n_sensors) whose phases advance by `turn` rad per sample."""
    n = signal.shape[1]
    cosine, sine = np.empty(n), np.empty(n)
    for k in range(len(turn)):
        step_c, step_s, c, s = math.cos(turn[k]), math.sin(turn[k]), 1.0, 0.0
        for j in range(n):
            cosine[j], sine[j] = c, s
            c, s = c * step_c - s * step_s, s * step_c + c * step_s
        for i in range(len(signal)):
            for j in range(n):
                signal[i, j] += real[k, i] * cosine[j] - imaginary[k, i] * sine[j]


@njit(cache=True, error_model="numpy")
def _add_processes(
    signal: FloatArray,
    state: FloatArray,
    deviations: FloatArray,
    knots: npt.NDArray[np.int64],
    decay: FloatArray,
    draws: npt.NDArray[np.float32],
) -> None:
    """Add first-order processes, exact at the knots and linear between them; `state` is advanced in place."""
    n = signal.shape[1]
    at = 0
    for i in range(len(signal)):
        row = signal[i]
        level = slope = 0.0  # sum of all processes that are straight within the window
        for p in range(len(knots)):
            kick = math.sqrt(1.0 - decay[p] * decay[p])
            value, size = state[p, i], deviations[p]
            if knots[p] == n:
                for j in range(n):
                    row[j] += size * value
                    value = decay[p] * value + kick * draws[at + j]
                at += n
            elif knots[p] == 1:
                following = decay[p] * value + kick * draws[at]
                at += 1
                level += size * value
                slope += size * (following - value) / n
                value = following
            else:
                pace = n / knots[p]
                for q in range(knots[p]):
                    following = decay[p] * value + kick * draws[at + q]
                    rise = size * (following - value) / pace
                    offset = size * value - rise * q * pace
                    for j in range(math.ceil(q * pace), min(math.ceil((q + 1) * pace), n)):
                        row[j] += offset + rise * j
                    value = following
                at += knots[p]
            state[p, i] = value
        for j in range(n):
            row[j] += level + slope * j
