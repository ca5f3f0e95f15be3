"""One linear fit around the truth, compiled: Jacobian, normal equations, solution, covariance."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from smolbot.arrays import FloatArray

N = 8  # position (3), rotation (3), phase, amplitude
WORST = 1e11
"""Condition beyond which a fit says nothing, as in `smolbot.localization.kernels.covariance`."""


@njit(cache=True, error_model="numpy")
def linear_fit(
    values: FloatArray,
    slopes: FloatArray,
    truth: FloatArray,
    now: FloatArray,
    ahead: FloatArray,
    size: float,
    noise: FloatArray,
    mean: float,
    weight: float,
    reference: float,
) -> tuple[FloatArray, FloatArray, float, float]:
    """Where a fit ends that starts from the true pose, and what it claims.

    Parameters
    ----------
    values, truth : ndarray, shape (n_channels, K)
        Power series of the channels in the deflection, as believed and as they are, at the true pose.
    slopes : ndarray, shape (n_channels, K, 6)
        Derivatives of `values` for position and rotation.
    now, ahead : ndarray, shape (n_out, n_channels * (K - 1))
        The data's answer to each power but the constant, and its derivative for the phase.
    size : float
        True amplitude, as a fraction of the reference angle.
    noise : ndarray, shape (n_out,)
    mean, weight : float
        Belief in the amplitude, and the inverse of its variance.
    reference : float, in rad
        The reference angle.

    Returns
    -------
    change : ndarray, shape (8,)
        Of position (m), rotation (rad), phase (rad), amplitude (fraction).
    covariance : ndarray, shape (7, 7)
        Of position (m), rotation (rad), amplitude (rad), for residuals of unit variance; infinite where a direction is
        not told.
    sse, total : float
        Squares of the residual and of the data.
    """
    n_channels, n_powers = values.shape
    width = n_channels * (n_powers - 1)
    columns = np.empty((width, N))
    level, wrong = np.empty(width), np.empty(width)
    row = 0
    for c in range(n_channels):
        power = 1.0
        for k in range(1, n_powers):
            columns[row, 7] = k * power * values[c, k]
            power *= size
            level[row] = power * values[c, k]
            wrong[row] = power * truth[c, k] - level[row]
            for p in range(6):
                columns[row, p] = power * slopes[c, k, p]
            columns[row, 6] = 0.0
            row += 1
    jacobian = np.dot(now, columns)
    jacobian[:, 6] = np.dot(ahead, level)
    residual = np.dot(now, wrong) + noise
    out = np.dot(now, level)
    normal = np.dot(jacobian.T, jacobian)
    gradient = np.dot(jacobian.T, residual)
    normal[7, 7] += weight
    gradient[7] += weight * (mean - size)
    covariance = _inverse(normal)
    joint = np.empty((7, 7))
    for a in range(7):
        for b in range(7):
            unit = (reference if a == 6 else 1.0) * (reference if b == 6 else 1.0)
            joint[a, b] = unit * covariance[a + a // 6, b + b // 6]  # all but the phase
    if not math.isfinite(covariance[0, 0]):
        return np.zeros(N), joint, 0.0, 1.0
    change = np.dot(covariance, gradient)
    left = residual - np.dot(jacobian, change)
    data = out + residual
    return change, joint, np.dot(left, left), np.dot(data, data)


@njit(cache=True, error_model="numpy")
def _inverse(matrix: FloatArray) -> FloatArray:
    """Inverse of a symmetric positive matrix (8, 8), scaled first so that units cost no precision; else infinite."""
    scale, factor, inverse = np.empty(N), np.zeros((N, N)), np.zeros((N, N))
    for a in range(N):
        if matrix[a, a] <= 0.0:
            return np.full((N, N), np.inf)
        scale[a] = 1.0 / math.sqrt(matrix[a, a])
    for a in range(N):  # Cholesky
        for b in range(a + 1):
            left = matrix[a, b] * scale[a] * scale[b]
            for c in range(b):
                left -= factor[a, c] * factor[b, c]
            if a > b:
                factor[a, b] = left / factor[b, b]
            elif left <= 0.0:
                return np.full((N, N), np.inf)
            else:
                factor[a, a] = math.sqrt(left)
    for b in range(N):  # inverse of the factor
        for a in range(b, N):
            left = 1.0 if a == b else 0.0
            for c in range(b, a):
                left -= factor[a, c] * inverse[c, b]
            inverse[a, b] = left / factor[a, a]
    out = np.dot(inverse.T, inverse)
    for a in range(N):
        if out[a, a] > WORST:
            return np.full((N, N), np.inf)
    for a in range(N):
        for b in range(N):
            out[a, b] *= scale[a] * scale[b]
    return out
