"""Two steps of a Kalman filter whose state ends with a steady drift of its first three entries, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from smolbot.core.arrays import FloatArray


@njit(cache=True, error_model="numpy")
def carried_on(covariance: FloatArray, wait: float, noise: FloatArray) -> FloatArray:
    """Covariance (n, n) after `wait` s: the last three entries are rates of the first three, `noise` (n,) is added."""
    n = len(covariance)
    out = covariance.copy()
    for i in range(3):
        for j in range(n):
            out[i, j] += wait * covariance[n - 3 + i, j]
    for j in range(3):
        for i in range(n):
            out[i, j] += wait * out[i, n - 3 + j]
    for i in range(n):
        out[i, i] += noise[i]
    return out


@njit(cache=True, error_model="numpy")
def corrected(
    covariance: FloatArray, heard: FloatArray, innovation: FloatArray
) -> tuple[float, FloatArray, FloatArray]:
    """Correction by a measurement of the first m entries of a state.

    Parameters
    ----------
    covariance : ndarray, shape (n, n)
    heard : ndarray, shape (m, m)
        Covariance of the measurement.
    innovation : ndarray, shape (m,)
        Measured minus believed.

    Returns
    -------
    distance : float
        Squared Mahalanobis distance of the innovation; infinite where its covariance is not positive.
    change : ndarray, shape (n,)
        Of the state.
    covariance : ndarray, shape (n, n)
        Afterwards, in Joseph's form, which stays positive.
    """
    n, m = len(covariance), len(innovation)
    factor = np.zeros((m, m))
    for i in range(m):  # Cholesky of the innovation's covariance
        for j in range(i + 1):
            left = covariance[i, j] + heard[i, j]
            for k in range(j):
                left -= factor[i, k] * factor[j, k]
            if i > j:
                factor[i, j] = left / factor[j, j]
            elif left > 0.0:
                factor[i, i] = math.sqrt(left)
            else:
                return math.inf, np.zeros(n), covariance.copy()
    white = innovation.copy()  # factor^-1 innovation
    gain = covariance[:, :m].copy()  # becomes P H^T S^-1, a row after the other
    distance = 0.0
    for i in range(m):
        for k in range(i):
            white[i] -= factor[i, k] * white[k]
        white[i] /= factor[i, i]
        distance += white[i] * white[i]
    change = np.zeros(n)
    for r in range(n):
        for i in range(m):
            for k in range(i):
                gain[r, i] -= factor[i, k] * gain[r, k]
            gain[r, i] /= factor[i, i]
            change[r] += gain[r, i] * white[i]
        for i in range(m - 1, -1, -1):
            for k in range(i + 1, m):
                gain[r, i] -= factor[k, i] * gain[r, k]
            gain[r, i] /= factor[i, i]
    kept, spread = covariance.copy(), np.zeros((n, m))  # (1 - K H) P, and K R
    for i in range(n):
        for k in range(m):
            for j in range(n):
                kept[i, j] -= gain[i, k] * covariance[k, j]
            for j in range(m):
                spread[i, j] += gain[i, k] * heard[k, j]
    out = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            out[i, j] = kept[i, j]
            for k in range(m):
                out[i, j] += (spread[i, k] - kept[i, k]) * gain[j, k]
    return distance, change, out
