"""Confidence intervals of a run's figures by bootstrap over blocks of time: successive errors are correlated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import FloatArray

RESAMPLES, SEED, LEVEL = 2000, 0, 0.95

METHOD = (
    f"Intervals hold {100 * LEVEL:.0f} %: circular block bootstrap over time, {RESAMPLES} resamples, seed {SEED}; "
    "blocks have twice the integrated autocorrelation time, at least the cube root of the number of values. They give "
    "the uncertainty within this one run, not the spread between seeds: for that, do several runs, or smolbot "
    "simulate."
)
"""Explanation of the intervals, for readers of a comparison."""

Statistic = Callable[[FloatArray], FloatArray]
"""Of values (..., n), along the last axis."""


@dataclass(frozen=True)
class Estimate:
    """A figure with its confidence interval.

    Attributes
    ----------
    value : float
    low, high : float or None
        None if the run gives a single number.
    """

    value: float
    low: float | None = None
    high: float | None = None


def compute_mean(values: FloatArray) -> FloatArray:
    """Compute the arithmetic mean.

    Parameters
    ----------
    values : ndarray, shape (..., n)

    Returns
    -------
    ndarray, shape (...)
    """
    found: FloatArray = np.mean(values, axis=-1)
    return found


def compute_p95(values: FloatArray) -> FloatArray:
    """Compute the 95th percentile.

    Parameters
    ----------
    values : ndarray, shape (..., n)

    Returns
    -------
    ndarray, shape (...)
    """
    found: FloatArray = np.percentile(values, 95.0, axis=-1)
    return found


def compute_median(values: FloatArray) -> FloatArray:
    """Compute the median.

    Parameters
    ----------
    values : ndarray, shape (..., n)

    Returns
    -------
    ndarray, shape (...)
    """
    found: FloatArray = np.median(values, axis=-1)
    return found


def compute_autocorrelation_time(values: FloatArray) -> float:
    """Compute the integrated autocorrelation time of a series.

        tau = 1 + 2 sum_k rho(k), up to Sokal's window k >= 5 tau

    Parameters
    ----------
    values : ndarray, shape (n,)

    Returns
    -------
    float, in samples
        1 for independent values.
    """
    from scipy.signal import correlate

    n = len(values)
    off = values - values.mean()
    square = float(off @ off)
    if square == 0.0:
        return 1.0
    correlation = correlate(off, off, method="fft")[n - 1 :] / square
    total = 1.0
    for lag in range(1, n):
        total += 2.0 * float(correlation[lag])
        if lag >= 5.0 * total:  # Sokal's window: it covers the correlated lags, and no more
            break
    return max(total, 1.0)


def compute_block_length(values: FloatArray) -> int:
    """Compute the block length of the bootstrap.

    It is twice the autocorrelation time, and at most a quarter of the series.

    Parameters
    ----------
    values : ndarray, shape (n,)

    Returns
    -------
    int, in samples
    """
    n = len(values)
    return max(min(round(max(2.0 * compute_autocorrelation_time(values), n ** (1.0 / 3.0))), n // 4), 1)


def draw_resamples(values: FloatArray, rng: np.random.Generator, resamples: int = RESAMPLES) -> FloatArray:
    """Draw series from blocks of a series; blocks continue from its end to its beginning.

    Parameters
    ----------
    values : ndarray, shape (n,)
    rng : numpy.random.Generator
    resamples : int

    Returns
    -------
    ndarray, shape (resamples, n)
    """
    n, length = len(values), compute_block_length(values)
    starts = rng.integers(0, n, size=(resamples, -(-n // length)))
    index = (starts[:, :, None] + np.arange(length)) % n
    return values[index.reshape(resamples, -1)[:, :n]]


def estimate_with_interval(values: FloatArray, statistic: Statistic) -> Estimate:
    """Compute a statistic of a series with its confidence interval.

    Parameters
    ----------
    values : ndarray, shape (n,)
    statistic : callable
        Along the last axis.

    Returns
    -------
    Estimate
        Without an interval for fewer than 8 values.
    """
    value = float(statistic(values))
    if len(values) < 8:
        return Estimate(value)
    resampled = statistic(draw_resamples(values, np.random.default_rng(SEED)))
    low, high = np.percentile(resampled, [50.0 * (1.0 - LEVEL), 50.0 * (1.0 + LEVEL)])
    return Estimate(value, float(low), float(high))


def estimate_difference(values: FloatArray, others: FloatArray, statistic: Statistic) -> Estimate:
    """Compute the difference of a statistic between two independent series, with its confidence interval.

    Parameters
    ----------
    values, others : ndarray, shape (n,)
    statistic : callable
        Along the last axis.

    Returns
    -------
    Estimate
        Of `values` minus `others`; without an interval for fewer than 8 values.
    """
    value = float(statistic(values) - statistic(others))
    if min(len(values), len(others)) < 8:
        return Estimate(value)
    first, second = (np.random.default_rng([SEED, which]) for which in (1, 2))
    resampled = statistic(draw_resamples(values, first)) - statistic(draw_resamples(others, second))
    low, high = np.percentile(resampled, [50.0 * (1.0 - LEVEL), 50.0 * (1.0 + LEVEL)])
    return Estimate(value, float(low), float(high))
