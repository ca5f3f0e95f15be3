"""One linear fit around the truth, compiled: Jacobian, normal equations, solution, covariance."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from smolbot.core.arrays import FloatArray

N_PARAMETERS = 8  # position (3), rotation (3), phase, amplitude
MAX_CONDITION = 1e11
"""Condition number above which a fit is undetermined, as in `smolbot.localization.kernels.compute_covariance`."""

MAX_VARIANCE = 1e300
"""Variance above which a fit is undetermined."""


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc"})
def compute_linear_fit(
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
    """Compute the result of a fit that starts from the true pose, and its covariance.

    Parameters
    ----------
    values : ndarray, shape (n_channels, K)
        Power series of the channels in the deflection, with assumed parameters, at the true pose.
    slopes : ndarray, shape (n_channels, K, 6)
        Derivatives of `values` by position and rotation.
    truth : ndarray, shape (n_channels, K)
        As `values`, with true parameters.
    now, ahead : ndarray, shape (n_channels * (K - 1), n_out)
        The data's response to each power but the constant, and its derivative by the phase.
    size : float
        True amplitude, as a fraction of the reference angle.
    noise : ndarray, shape (n_out,)
    mean, weight : float
        Prior of the amplitude (fraction of the reference angle), and the inverse of its variance.
    reference : float, in rad
        The reference angle.

    Returns
    -------
    change : ndarray, shape (8,)
        Of position (m), rotation (rad), phase (rad), amplitude (fraction).
    covariance : ndarray, shape (7, 7)
        Of position (m), rotation (rad), amplitude (rad), for residuals of unit variance; infinite where a direction
        is not observable.
    sse, total : float
        Sums of squares of the residual and of the data.
    """
    n_channels, n_powers = values.shape
    n_out = len(noise)
    jacobian, residual, data = np.zeros((N_PARAMETERS, n_out)), noise.copy(), noise.copy()
    row = 0
    # derivatives of the assumed model at the true pose; residual: true less modelled signal, and noise
    for c in range(n_channels):
        power = 1.0
        for k in range(1, n_powers):
            grown = k * power * values[c, k]
            power *= size
            level, measured = power * values[c, k], power * truth[c, k]
            s0, s1, s2 = power * slopes[c, k, 0], power * slopes[c, k, 1], power * slopes[c, k, 2]
            s3, s4, s5 = power * slopes[c, k, 3], power * slopes[c, k, 4], power * slopes[c, k, 5]
            for i in range(n_out):  # along memory
                w = now[row, i]
                jacobian[0, i] += s0 * w
                jacobian[1, i] += s1 * w
                jacobian[2, i] += s2 * w
                jacobian[3, i] += s3 * w
                jacobian[4, i] += s4 * w
                jacobian[5, i] += s5 * w
                jacobian[6, i] += level * ahead[row, i]
                jacobian[7, i] += grown * w
                residual[i] += (measured - level) * w
                data[i] += measured * w
            row += 1
    normal, gradient = np.empty((N_PARAMETERS, N_PARAMETERS)), np.empty(N_PARAMETERS)
    for a in range(N_PARAMETERS):
        gradient[a] = _dot(jacobian[a], residual)
        for b in range(a + 1):
            normal[a, b] = normal[b, a] = _dot(jacobian[a], jacobian[b])
    normal[7, 7] += weight
    gradient[7] += weight * (mean - size)
    covariance = _invert(normal)
    joint = np.empty((7, 7))
    for a in range(7):
        for b in range(7):
            unit = (reference if a == 6 else 1.0) * (reference if b == 6 else 1.0)
            joint[a, b] = unit * covariance[a + a // 6, b + b // 6]  # without the phase
    change = np.zeros(N_PARAMETERS)
    if covariance[0, 0] > MAX_VARIANCE:
        return change, joint, 0.0, 1.0
    for a in range(N_PARAMETERS):
        for b in range(N_PARAMETERS):
            change[a] += covariance[a, b] * gradient[b]
    for a in range(N_PARAMETERS):
        for i in range(n_out):
            residual[i] -= change[a] * jacobian[a, i]
    return change, joint, _dot(residual, residual), _dot(data, data)


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _dot(a: FloatArray, b: FloatArray) -> float:
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@njit(cache=True, error_model="numpy")
def _invert(matrix: FloatArray) -> FloatArray:
    """Invert a positive definite matrix (8, 8), scaled first to equalise units; infinite if it is singular."""
    scale, factor, inverse = (
        np.empty(N_PARAMETERS),
        np.zeros((N_PARAMETERS, N_PARAMETERS)),
        np.zeros((N_PARAMETERS, N_PARAMETERS)),
    )
    for a in range(N_PARAMETERS):
        if matrix[a, a] <= 0.0:
            return np.full((N_PARAMETERS, N_PARAMETERS), np.inf)
        scale[a] = 1.0 / math.sqrt(matrix[a, a])
    for a in range(N_PARAMETERS):  # Cholesky
        for b in range(a + 1):
            left = matrix[a, b] * scale[a] * scale[b]
            for c in range(b):
                left -= factor[a, c] * factor[b, c]
            if a > b:
                factor[a, b] = left / factor[b, b]
            elif left <= 0.0:
                return np.full((N_PARAMETERS, N_PARAMETERS), np.inf)
            else:
                factor[a, a] = math.sqrt(left)
    for b in range(N_PARAMETERS):  # inverse of the factor
        for a in range(b, N_PARAMETERS):
            left = 1.0 if a == b else 0.0
            for c in range(b, a):
                left -= factor[a, c] * inverse[c, b]
            inverse[a, b] = left / factor[a, a]
    out = np.empty((N_PARAMETERS, N_PARAMETERS))
    for a in range(N_PARAMETERS):
        for b in range(a + 1):
            total = 0.0
            for c in range(a, N_PARAMETERS):
                total += inverse[c, a] * inverse[c, b]
            if a == b and total > MAX_CONDITION:
                return np.full((N_PARAMETERS, N_PARAMETERS), np.inf)
            out[a, b] = out[b, a] = total * scale[a] * scale[b]
    return out
