"""The paper's signal chain: same-axis difference, two moving means, time derivative, 4N+1 samples.

The chain is linear, so each of its output samples is a weighted sum of raw samples around it. The
weights (`Taps`) are found by passing impulses through the filters defined here; data and
model both pass through them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError

MEAN_WINDOW = 50
"""Length of each moving mean, in samples: 1 ms at the paper's 50 kS/s."""

_FILTER_REACH = 2 * MEAN_WINDOW + 4
"""Samples either side that two moving means and a central difference use."""

_ROUNDING = 1e-9
"""Share of a half-period that is rounding."""

SAME_AXIS = np.cos(np.radians(2.0))
"""Cosine of the angle within which two sensors have the same axis."""

EDGE_SHARE = 8
"""A short recording is inset by at most this part of its length."""

POINTS_PER_HALF_PERIOD = 4
"""Samples of the filtered signal that are used per half-period."""


def compute_moving_mean(signal: FloatArray, window: int = MEAN_WINDOW, *, later: bool = False) -> FloatArray:
    """Compute a moving mean along the last axis; the window shrinks at both ends.

    An even window cannot be centred: it extends one sample further back, or, if `later`, forward. One
    of each kind in series cause no time shift.

    Parameters
    ----------
    signal : ndarray, shape (..., n)
    window : int
        Length in samples.
    later : bool
        Whether an even window extends forward.

    Returns
    -------
    ndarray, shape (..., n)
    """
    n = signal.shape[-1]
    back = window // 2 - (1 if later and window % 2 == 0 else 0)
    index = np.arange(n)
    first = np.maximum(index - back, 0)
    last = np.minimum(index - back + window, n)
    total = np.concatenate([np.zeros((*signal.shape[:-1], 1)), np.cumsum(signal, axis=-1)], axis=-1)
    means: FloatArray = (total[..., last] - total[..., first]) / (last - first)
    return means


def compute_central_difference(signal: FloatArray, sample_rate: float) -> FloatArray:
    """Compute the time derivative along the last axis, one-sided at both ends.

    Parameters
    ----------
    signal : ndarray, shape (..., n)
    sample_rate : float, in Hz

    Returns
    -------
    ndarray, shape (..., n), per s
    """
    derivative: FloatArray = np.gradient(signal, 1.0 / sample_rate, axis=-1)
    return derivative


def apply_filters(signal: FloatArray, sample_rate: float) -> FloatArray:
    """Apply two moving means and a central difference along the last axis, at full length.

    Parameters
    ----------
    signal : ndarray, shape (..., n)
    sample_rate : float, in Hz

    Returns
    -------
    ndarray, shape (..., n), per s
    """
    smooth = compute_moving_mean(compute_moving_mean(signal), later=True)
    return compute_central_difference(smooth, sample_rate)


def count_half_periods(n_samples: int, sample_rate: float, frequency: float) -> int:
    """Count the complete half-periods N of a recording; one that lacks a single sample still counts.

    Parameters
    ----------
    n_samples : int
    sample_rate : float, in Hz
    frequency : float, in Hz
        Of the device.

    Returns
    -------
    int
    """
    return int(np.floor((n_samples + 1) * 2.0 * frequency / sample_rate + _ROUNDING))


def choose_sample_points(n_samples: int, sample_rate: float, frequency: float) -> FloatArray:
    """Choose the 4N+1 samples, evenly spread over the complete half-periods.

    Samples whose filters extend beyond an end are noisy; where the recording is long enough, the
    outermost samples are therefore moved inward by half a filter.

    Parameters
    ----------
    n_samples : int
    sample_rate : float, in Hz
    frequency : float, in Hz
        Of the device.

    Returns
    -------
    ndarray, shape (4N+1,)
        Indices: integers, as float.

    Raises
    ------
    InputError
        If the recording is shorter than half a period.
    """
    half_periods = count_half_periods(n_samples, sample_rate, frequency)
    if half_periods < 1:
        raise InputError(
            f"The recording lasts {n_samples / sample_rate * 1e3:.2f} ms; a half-period of {frequency:g} Hz "
            f"lasts {500.0 / frequency:.2f} ms, and at least one is needed."
        )
    cut = min(n_samples - 1, round(half_periods * sample_rate / (2.0 * frequency)))
    inset = min(EDGE_INSET, cut // EDGE_SHARE)
    return np.round(np.linspace(inset, cut - inset, POINTS_PER_HALF_PERIOD * half_periods + 1))


EDGE_INSET = MEAN_WINDOW // 2
"""Samples by which the outermost points are inset: half a moving mean, see docs/decisions."""


@dataclass(frozen=True)
class Taps:
    """Weights of the chain for some output samples.

    Attributes
    ----------
    points : ndarray, shape (n_out,)
        Index of each output sample in the recording.
    first : ndarray of int, shape (n_out,)
        First raw sample that it uses.
    weights : ndarray, shape (n_out, width), per s
        Weight of each raw sample from there on; zero beyond the filter's length.
    """

    points: FloatArray
    first: np.ndarray[tuple[int], np.dtype[np.int64]]
    weights: FloatArray


@lru_cache(maxsize=32)
def compute_taps(n_samples: int, sample_rate: float, frequency: float) -> Taps:
    """Compute the weights of the chain's 4N+1 samples.

    Parameters
    ----------
    n_samples : int
        Of the recording.
    sample_rate : float, in Hz
    frequency : float, in Hz
        Of the device.

    Returns
    -------
    Taps
    """
    points = choose_sample_points(n_samples, sample_rate, frequency)
    width = min(n_samples, 2 * _FILTER_REACH + 1)
    first = np.zeros(len(points), dtype=np.int64)
    weights = np.zeros((len(points), width))
    inner: FloatArray | None = None
    for row, point in enumerate(points.astype(int)):
        start = int(np.clip(point - _FILTER_REACH, 0, n_samples - width))
        first[row] = start
        interior = start == point - _FILTER_REACH and width == 2 * _FILTER_REACH + 1
        if interior and inner is not None:
            weights[row] = inner
            continue
        weights[row] = apply_filters(np.eye(width), sample_rate)[:, point - start]
        if interior:
            inner = weights[row]
    for array in (points, first, weights):
        array.setflags(write=False)
    return Taps(points, first, weights)


def make_difference_matrix(axes: FloatArray, positions: FloatArray) -> FloatArray:
    """Make the matrix of the same-axis difference: each sensor minus the reference of its own direction.

    The reference of a group of parallel sensors is the one nearest to the group's middle, since noise
    that varies in space differs least from it.

    Parameters
    ----------
    axes, positions : ndarray, shape (n, 3)

    Returns
    -------
    ndarray, shape (n_differences, n)
        Antiparallel sensors are added instead of subtracted.
    """
    rows: list[FloatArray] = []
    left = list(range(len(axes)))
    while left:
        lead = left[0]
        group = [i for i in left if abs(axes[i] @ axes[lead]) > SAME_AXIS]
        left = [i for i in left if i not in group]
        middle = positions[group].mean(axis=0)
        reference = min(group, key=lambda i: float(np.linalg.norm(positions[i] - middle)))
        for i in group:
            if i != reference:
                row = np.zeros(len(axes))
                row[i] = 1.0
                row[reference] = -float(np.sign(axes[i] @ axes[reference]))
                rows.append(row)
    return np.array(rows).reshape(len(rows), len(axes))
