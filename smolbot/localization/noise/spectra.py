"""Learning of lines and smooth spectrum from recordings of background noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from smolbot.core.arrays import FloatArray
from smolbot.core.sensing import Recording

ComplexArray = npt.NDArray[np.complex128]

BLOCK_RATE = 5000.0
"""Rate, in Hz, to which background recordings are averaged before they are analysed."""

MAX_LINES = 16
"""Largest number of spectral lines in a model."""

LINE_CONTRAST = 12.0
"""Power of a line relative to its neighbourhood, summed over the sensors."""

MIN_LINE_SPACING = 0.25
"""Least distance between two lines, in the reciprocal of a piece's duration. Nearer ones are one line, of which
converter steps or a drifting frequency have left something; fitted together they have no unique solution."""

SEGMENT = 0.2
"""Length, in s, of the segments over which the smooth spectrum is averaged."""

LINE_SEARCH_PASSES = 4
"""Number of searches for lines; each removes those found before."""

LOBE = 2.0
"""Half width of the peak of a line under a Hann window, in 1 / duration."""

NEIGHBOURHOOD = 8
"""Width over which the median power around a line is taken, in half widths of a peak."""

LINE_BAND = (3.0, 0.4)
"""Lowest frequency of a line, in 1 / duration, and the highest, as a share of the rate."""

MIN_REACH = 2.5
"""Smallest half width of the smoothing, in steps of the spectrum."""

COHERENCE_LIMIT, MIN_AVERAGES, MAX_COHERENCE = 7.0, 8.0, 0.9
"""Coherence times the number of averages that chance rarely exceeds (exp(-7)), the fewest averages, and the largest
limit."""

MIN_VARIANCE = 1e-3
"""Smallest eigenvalue of a spectrum, as a share of its largest."""

TINY = 1e-300
"""Power that keeps a logarithm or quotient finite."""

SMOOTHING = 0.12
"""Relative half width over which the spectrum between the lines is averaged."""


class Spectra(NamedTuple):
    """Lines and smooth spectrum of background noise; see `NoiseModel`.

    Attributes
    ----------
    line_frequencies : ndarray, shape (n_lines,), in Hz
    lines : ndarray of complex, shape (n_lines, n_sensors, n_sensors), in T²
    frequencies : ndarray, shape (n_frequencies,), in Hz
    spectrum : ndarray of complex, shape (n_frequencies, n_sensors, n_sensors), in T²/Hz
    block : float, in s
    """

    line_frequencies: FloatArray
    lines: ComplexArray
    frequencies: FloatArray
    spectrum: ComplexArray
    block: float


def learn_spectra(quiet: Sequence[Recording]) -> Spectra:
    """Learn lines and smooth spectrum from recordings that have been checked.

    Parameters
    ----------
    quiet : sequence of Recording
        Of background noise.

    Returns
    -------
    Spectra
    """
    rate = quiet[0].sample_rate
    size = max(round(rate / BLOCK_RATE), 1)
    block_rate = rate / size
    pieces = [average_blocks(np.asarray(r.field), size) for r in quiet]
    found = find_lines(pieces, block_rate)
    phasors, left = remove_lines(pieces, found, block_rate)
    frequencies, spectrum = compute_cross_spectrum(left, block_rate)
    lines = np.einsum("plj,plk->ljk", phasors, phasors.conj()) / len(pieces)
    return Spectra(found, lines, frequencies, spectrum, 1.0 / block_rate)


def average_blocks(field: FloatArray, size: int) -> FloatArray:
    """Average over blocks of samples, and subtract each channel's mean.

    Parameters
    ----------
    field : ndarray, shape (n_sensors, n), in T
    size : int
        Samples per block.

    Returns
    -------
    ndarray, shape (n_sensors, n_blocks), in T
    """
    n = field.shape[1] // size
    blocks = (field[:, : n * size] - field[:, :1]).reshape(len(field), n, size).mean(axis=2)
    out: FloatArray = blocks - blocks.mean(axis=1, keepdims=True)
    return out


def find_lines(pieces: list[FloatArray], rate: float) -> FloatArray:
    """Find lines that stand out in the spectrum summed over channels and pieces.

    Strong lines mask weak ones, so found lines are removed and the rest is searched again.

    Parameters
    ----------
    pieces : list of ndarray, each of shape (n_sensors, n), in T
    rate : float, in Hz
        Sample rate of the pieces.

    Returns
    -------
    ndarray, shape (n_lines,), in Hz
    """
    n = max(p.shape[1] for p in pieces)
    size = 1 << int(np.ceil(np.log2(2 * n)))
    grid = np.asarray(np.fft.rfftfreq(size, 1.0 / rate), dtype=np.float64)
    lobe = max(int(LOBE * size / n), 2)  # half width of a line's own peak, in bins
    considered = (grid > LINE_BAND[0] * rate / n) & (grid < LINE_BAND[1] * rate)
    found: list[float] = []
    left = pieces
    for _ in range(LINE_SEARCH_PASSES):
        power = np.zeros(len(grid))
        for piece in left:
            window = np.hanning(piece.shape[1] + 2)[1:-1]
            power += np.sum(np.abs(np.fft.rfft(piece * window, size, axis=1)) ** 2, axis=0) / np.sum(window**2)
        contrast = np.where(considered, power / _compute_background(power, NEIGHBOURHOOD * lobe), 0.0)
        new: list[float] = []
        while (
            len(found) + len(new) < MAX_LINES and (peak := int(np.argmax(contrast))) and contrast[peak] > LINE_CONTRAST
        ):
            line = _refine_peak(grid, power, peak)
            if all(abs(line - known) > MIN_LINE_SPACING * rate / n for known in found):
                new.append(line)
            contrast[max(peak - 2 * lobe, 0) : peak + 2 * lobe + 1] = 0.0
        if not new:
            break
        found += new
        _, left = remove_lines(pieces, np.array(found), rate)
    return np.array(sorted(found), dtype=np.float64)


def _compute_background(power: FloatArray, width: int) -> FloatArray:
    """Compute the median power around each bin, from medians of stretches `width` long."""
    count = max(len(power) // width, 1)
    medians = (
        np.median(power[: count * width].reshape(count, -1), axis=1) if count > 1 else np.array([np.median(power)])
    )
    middles = (np.arange(len(medians)) + 0.5) * width
    return np.interp(np.arange(len(power)), middles, medians) + TINY


def _refine_peak(grid: FloatArray, power: FloatArray, peak: int) -> float:
    """Interpolate a peak's frequency by a parabola through the logarithm of the peak and its neighbours."""
    if not 0 < peak < len(grid) - 1:
        return float(grid[peak])
    a, b, c = np.log(power[peak - 1 : peak + 2] + TINY)
    curve = a - 2.0 * b + c  # parabola through the logarithms around the peak
    shift = 0.5 * (a - c) / curve if curve < 0 else 0.0
    return float(grid[peak] + np.clip(shift, -0.5, 0.5) * (grid[1] - grid[0]))


def remove_lines(
    pieces: list[FloatArray], frequencies: FloatArray, rate: float
) -> tuple[ComplexArray, list[FloatArray]]:
    """Fit the lines in each piece, and subtract them.

    Parameters
    ----------
    pieces : list of ndarray, each of shape (n_sensors, n), in T
    frequencies : ndarray, shape (n_lines,), in Hz
    rate : float, in Hz
        Sample rate of the pieces.

    Returns
    -------
    phasors : ndarray of complex, shape (n_pieces, n_lines, n_sensors), in T
        Peak phasors.
    left : list of ndarray, each of shape (n_sensors, n), in T
        The pieces without the lines.
    """
    phasors = np.zeros((len(pieces), len(frequencies), len(pieces[0])), dtype=np.complex128)
    left: list[FloatArray] = []
    for number, piece in enumerate(pieces):
        time = np.arange(piece.shape[1]) / rate
        angle = 2.0 * np.pi * np.outer(time, frequencies)
        slow = np.stack([np.ones_like(time), (time - time.mean()) / time[-1]], axis=1)
        design = np.concatenate([np.cos(angle), np.sin(angle), slow], axis=1)
        solution = np.linalg.solve(design.T @ design, design.T @ piece.T)
        n = len(frequencies)
        phasors[number] = solution[:n] - 1j * solution[n : 2 * n]
        left.append(piece - (design @ solution).T)
    return phasors, left


def compute_cross_spectrum(pieces: list[FloatArray], rate: float) -> tuple[FloatArray, ComplexArray]:
    """Compute the smoothed one-sided cross-spectral density.

    Welch's method with half-overlapping Hann segments, then a mean over neighbouring frequencies whose
    width grows with frequency. A cross term that is no larger than by chance is set to zero.

    Parameters
    ----------
    pieces : list of ndarray, each of shape (n_sensors, n), in T
    rate : float, in Hz
        Sample rate of the pieces.

    Returns
    -------
    frequencies : ndarray, shape (n_frequencies,), in Hz
    spectrum : ndarray of complex, shape (n_frequencies, n_sensors, n_sensors), in T²/Hz
    """
    length = min(round(SEGMENT * rate), min(p.shape[1] for p in pieces))
    window = np.hanning(length + 2)[1:-1]
    grid = np.asarray(np.fft.rfftfreq(length, 1.0 / rate), dtype=np.float64)
    n = len(pieces[0])
    total = np.zeros((len(grid), n, n), dtype=np.complex128)
    count = 0
    for piece in pieces:
        for start in range(0, piece.shape[1] - length + 1, max(length // 2, 1)):
            wave = np.fft.rfft(piece[:, start : start + length] * window, axis=1)
            total += np.einsum("jf,kf->fjk", wave, wave.conj())
            count += 1
    total *= 2.0 / (rate * np.sum(window**2) * count)
    smooth = np.zeros_like(total)
    used = np.zeros(len(grid))
    for i, f in enumerate(grid):
        reach = max(SMOOTHING * f, MIN_REACH * grid[1])
        near = (np.abs(grid - f) <= reach) & (grid > 0)
        smooth[i] = total[near].mean(axis=0)
        used[i] = near.sum()
    return grid, _drop_insignificant(smooth, count * used * 0.5)


def _drop_insignificant(spectrum: ComplexArray, averages: FloatArray) -> ComplexArray:
    """Set cross terms with insignificant coherence to zero; keep every matrix positive."""
    power = np.real(np.einsum("fjj->fj", spectrum))
    scale = np.sqrt(power[:, :, None] * power[:, None, :]) + TINY
    coherence = np.abs(spectrum) ** 2 / scale**2
    limit = np.clip(COHERENCE_LIMIT / np.maximum(averages, MIN_AVERAGES), 0.0, MAX_COHERENCE)[:, None, None]
    kept = np.where((coherence > limit) | np.eye(spectrum.shape[1], dtype=bool), spectrum, 0.0)
    values, vectors = np.linalg.eigh(0.5 * (kept + np.conj(np.swapaxes(kept, 1, 2))))
    values = np.maximum(values, MIN_VARIANCE * values.max(axis=1, keepdims=True))
    out: ComplexArray = np.einsum("fjr,fr,fkr->fjk", vectors, values, vectors.conj())
    return out
