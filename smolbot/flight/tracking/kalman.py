"""The two steps of a Kalman filter, compiled; the last three states are the rates of the first three."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from smolbot.core.arrays import FloatArray


@njit(cache=True, error_model="numpy")
def predict(covariance: FloatArray, wait: float, noise: FloatArray) -> FloatArray:
    """Predict the covariance of the state: ``P <- F P F^T + diag(noise)``.

    ``F`` adds `wait` times the last three states, which are rates, to the first three.

    Parameters
    ----------
    covariance : ndarray, shape (n, n)
    wait : float, in s
    noise : ndarray, shape (n,)
        Variance that each state gains.

    Returns
    -------
    ndarray, shape (n, n)
        Predicted covariance.
    """
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
def update(
    covariance: FloatArray, measurement_covariance: FloatArray, innovation: FloatArray
) -> tuple[float, FloatArray, FloatArray]:
    """Update the state with a measurement of its first m entries.

        S = H P H^T + R,   K = P H^T S^-1,   dx = K y,   P <- (1 - K H) P (1 - K H)^T + K R K^T

    Parameters
    ----------
    covariance : ndarray, shape (n, n)
        Predicted covariance P.
    measurement_covariance : ndarray, shape (m, m)
        Covariance R of the measurement.
    innovation : ndarray, shape (m,)
        Measured minus predicted, y.

    Returns
    -------
    distance : float
        Squared Mahalanobis distance of the innovation; infinite if its covariance S is not positive definite.
    change : ndarray, shape (n,)
        Change dx of the state.
    covariance : ndarray, shape (n, n)
        Updated covariance, in Joseph's form, which stays positive definite.
    """
    n, m = len(covariance), len(innovation)
    factor = np.zeros((m, m))
    for i in range(m):  # Cholesky of the innovation's covariance
        for j in range(i + 1):
            left = covariance[i, j] + measurement_covariance[i, j]
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
                spread[i, j] += gain[i, k] * measurement_covariance[k, j]
    out = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            out[i, j] = kept[i, j]
            for k in range(m):
                out[i, j] += (spread[i, k] - kept[i, k]) * gain[j, k]
    return distance, change, out
