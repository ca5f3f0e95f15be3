"""Information on sensors and device in one recording, in addition to the pose found in it.

A recording holds more numbers than a pose has. Near a finished fit its data are

    d = s(x_fit) + J (x - x_fit) + T q + V w + n,

with x pose, phase and amplitude, q the deviations of sensors and device from the assumed ones, w other
disturbances, namely the device's turn during the recording and its resonance, and n white noise. In x, q shifts the
result of a fit by -L q; in the directions that no pose can explain, q is observed directly. Both parts are
uncorrelated, and are returned separately.
"""

# mypy: disable-error-code="no-untyped-call,no-untyped-def"
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from scipy.linalg import lapack

from smolbot.core.arrays import FloatArray
from smolbot.localization import kernels as compiled
from smolbot.localization.problem import Fit, Problem

_kernels: Any = compiled

DEVIATIONS_PER_SENSOR = 6
"""Deviations of a sensor: ln gain, two tilts (rad), three coordinates (m)."""

DEVIATIONS_OF_DEVICE = 2
"""Deviations of the device, which come after those of all sensors: ln moment, l0 (m)."""

_POSE_AND_AMPLITUDE = np.array([0, 1, 2, 3, 4, 5, 7])  # of the eight fitted parameters: all but the phase
_L0_STEP = 1e-6  # m: step of the difference quotient for l0
_FITTED = compiled.N_PARAMETERS

TURN_STD = 2e-3
"""Standard deviation, in rad, of a device's rotation while it is recorded: 0.2 rad/s for 10 ms.

It changes the static field; left out, that change would be attributed to the sensors."""

RESONANCE_STD = (0.08, 0.06)
"""Standard deviations of frequency (Hz) and damping (relative) within which they are not relearned; see
`smolbot.flight.tracking.resonance_filter`."""

MAX_MISFIT = 3.0
"""Reduced chi-square of the residuals above which they have another cause than the sensors."""

DOUBT_SIGMAS = 4.0
"""Standard deviations by which the reduced chi-square must exceed 1 to scale the covariance, as for a pose."""

MIN_EIGENVALUE = 1e-10
"""Eigenvalue of the scaled normal matrix below which a pose is not determined."""

TINY = 1e-300
"""Keeps a quotient finite where a parameter has no influence."""


@dataclass(frozen=True, eq=False)
class ArrayTerms:
    """Terms of one recording; the pose vector is (position in m, rotation e in rad, amplitude over the reference).

    Attributes
    ----------
    pose : ndarray, shape (7,)
        From the fit's pose to the one found with the device's turn left free.
    covariance : ndarray, shape (7, 7)
        Of that pose, for sensors as assumed.
    sensitivity : ndarray, shape (7, n)
        Sensitivity L of the found pose to the deviations q (n,), negated: true = found + L q.
    information : ndarray, shape (n, n)
    right : ndarray, shape (n,)
        Information vector of the deviations, from what no pose explains: their estimate is information^-1 right.
    amplitude : float
        Of the fit.
    """

    pose: FloatArray
    covariance: FloatArray
    sensitivity: FloatArray
    information: FloatArray
    right: FloatArray
    amplitude: float


@dataclass(frozen=True, eq=False)
class Changes:
    """Change of a fit's data vector per unit of everything that may differ from what is assumed.

    Attributes
    ----------
    out : ndarray, shape (n_out,)
        Data vector as modelled.
    jacobian : ndarray, shape (8, n_out)
        Per pose, phase and amplitude.
    deviations : ndarray, shape (6 * n_channels + 2, n_out)
        Per deviation of the sensors that take part, then of the device.
    disturbances : ndarray, shape (3, n_out)
        Rotation during the recording, and errors of frequency and damping, each of unit variance.
    """

    out: FloatArray
    jacobian: FloatArray
    deviations: FloatArray
    disturbances: FloatArray


def compute_changes(problem: Problem, fit: Fit, frames: FloatArray) -> Changes:
    """Compute how the data vector of a finished whitened fit changes with pose, sensors, device and disturbances.

    Parameters
    ----------
    problem : Problem
    fit : Fit
    frames : ndarray, shape (n_sensors, 2, 3)
        Directions of each sensor's tilts.

    Returns
    -------
    Changes
    """
    model = problem.model
    matrix, labels, positions, axes, moment, l0, angles, powers = model.constants
    n, size = len(positions), angles.shape[0]
    values, slopes, spare = np.empty((4, n, size)), np.empty((n, size, 6)), np.empty((n, size, 6))
    place = (fit.position, fit.rotation)
    _kernels.compute_series(positions, axes, moment, l0, angles, powers, *place, values[0], slopes)
    for k in range(3):
        along = np.zeros((n, 3))
        along[:, k] = 1.0
        _kernels.compute_series(positions, along, moment, l0, angles, powers, *place, values[1 + k], spare)
    out, jacobian = model.compute_response(*place, fit.phase, fit.amplitude)
    rows = compute_sensor_slopes(
        matrix, labels, values, slopes, frames[model.used], float(fit.phase), float(fit.amplitude)
    )
    longer = np.zeros_like(out)
    _kernels.evaluate_model(
        matrix, labels, positions, axes, moment, l0 + _L0_STEP, angles, powers, *place, fit.phase, fit.amplitude,
        longer, np.zeros((compiled.N_PARAMETERS, len(out))),
    )  # fmt: skip
    # nuisances: rotation during the recording, and errors of frequency and damping
    turning = TURN_STD * slopes[:, 0, 3:].T @ model.ramps  # power 0 is the field of the device at rest
    spread = RESONANCE_STD[0], RESONANCE_STD[1] * model.device.damping
    retuned = np.stack(
        [
            size * model.compute_response(*place, fit.phase, fit.amplitude, slope)[0]
            for size, slope in zip(spread, model.slopes, strict=True)
        ]
    )
    return Changes(
        out,
        np.ascontiguousarray(jacobian.T),
        np.concatenate([rows, out[None], (longer - out)[None] / _L0_STEP]),
        np.concatenate([turning, retuned]),
    )


def compute_array_terms(problem: Problem, fit: Fit, frames: FloatArray) -> ArrayTerms | None:
    """Compute the terms of a finished whitened fit.

    Parameters
    ----------
    problem : Problem
    fit : Fit
    frames : ndarray, shape (n_sensors, 2, 3)
        Directions of each sensor's tilts; rows of sensors that took no part are left at zero.

    Returns
    -------
    ArrayTerms or None
        None where the pose is undetermined, or the misfit is too large to come from the sensors.
    """
    changes = compute_changes(problem, fit, frames)
    out, n, model = changes.out, len(problem.model.positions), problem.model
    determined, step, covariance, sensitivity, information, right, left = separate_pose_and_deviations(
        np.concatenate([changes.jacobian, changes.deviations]),
        changes.disturbances,
        problem.data - out,
    )
    freedom = max(len(out) - compiled.N_PARAMETERS, 1)
    misfit = left / freedom
    if not determined or misfit > MAX_MISFIT:
        return None
    doubt = misfit if misfit > 1.0 + DOUBT_SIGMAS * math.sqrt(2.0 / freedom) else 1.0
    if n < len(model.used):  # zeros for the sensors that were not used
        kept = np.concatenate(
            [np.repeat(model.used, DEVIATIONS_PER_SENSOR), np.ones(DEVIATIONS_OF_DEVICE, dtype=np.bool_)]
        )
        count = len(kept)
        wide_sensitivity, wide_right, wide = np.zeros((7, count)), np.zeros(count), np.zeros((count, count))
        wide_sensitivity[:, kept], wide_right[kept], wide[np.ix_(kept, kept)] = sensitivity, right, information
        sensitivity, right, information = wide_sensitivity, wide_right, wide
    return ArrayTerms(step, doubt * covariance, sensitivity, information / doubt, right / doubt, fit.amplitude)


@njit(cache=True, error_model="python", fastmath=True)
def compute_sensor_slopes(matrix, labels, values, slopes, frames, phase, amplitude):
    """Compute the change of the data vector per deviation of each sensor.

    Parameters
    ----------
    matrix : ndarray, shape (n_functions, n_channels, n_out)
        Response of the linear chain; see `kernels.evaluate_model`.
    labels : ndarray of int, shape (n_functions, 3)
        See `kernels.evaluate_model`.
    values : ndarray, shape (4, n_channels, K), in T
        Power series along each sensor's axis, and along x, y and z.
    slopes : ndarray, shape (n_channels, K, 6), in T/m and T/rad
        Derivatives of the series for the device's position: those for the sensor's position with the other sign.
    frames : ndarray, shape (n_channels, 2, 3)
        Directions of each sensor's tilts.
    phase : float, in rad
    amplitude : float
        As a fraction of the reference angle.

    Returns
    -------
    ndarray, shape (DEVIATIONS_PER_SENSOR * n_channels, n_out)
    """
    n_functions, n, n_out = matrix.shape
    out = np.zeros((DEVIATIONS_PER_SENSOR * n, n_out))
    wave, tilt = np.empty(n_out), np.empty(2)
    for j in range(n):
        first = 0
        size = 1.0
        power = 0
        while first < n_functions:
            k = labels[first, 0]
            while power < k:
                size *= amplitude
                power += 1
            last = first
            wave[:] = 0.0
            while last < n_functions and labels[last, 0] == k:
                h = labels[last, 1]
                c = np.cos(h * phase) if labels[last, 2] == 0 else -np.sin(h * phase)
                for i in range(n_out):
                    wave[i] += c * size * matrix[last, j, i]
                last += 1
            tilt[0] = tilt[1] = 0.0
            for q in range(2):
                for axis in range(3):
                    tilt[q] += frames[j, q, axis] * values[1 + axis, j, k]
            v, s0, s1, s2 = values[0, j, k], slopes[j, k, 0], slopes[j, k, 1], slopes[j, k, 2]
            at = DEVIATIONS_PER_SENSOR * j
            for i in range(n_out):
                w = wave[i]
                out[at, i] += v * w
                out[at + 1, i] += tilt[0] * w
                out[at + 2, i] += tilt[1] * w
                out[at + 3, i] -= s0 * w
                out[at + 4, i] -= s1 * w
                out[at + 5, i] -= s2 * w
            first = last
    return out


@njit(cache=True, error_model="python", fastmath=True)
def compute_inner_products(a, b):
    """Compute the inner products of the rows of two matrices.

    Parameters
    ----------
    a : ndarray, shape (n, k)
    b : ndarray, shape (m, k)

    Returns
    -------
    ndarray, shape (n, m)
    """
    out = np.empty((a.shape[0], b.shape[0]))
    for i in range(a.shape[0]):
        for j in range(b.shape[0]):
            total = 0.0
            for k in range(a.shape[1]):
                total += a[i, k] * b[j, k]
            out[i, j] = total
    return out


def _invert(matrix: FloatArray) -> FloatArray:
    factors, pivots, _ = lapack.dgetrf(matrix)
    return np.asarray(lapack.dgetri(factors, pivots)[0])


def separate_pose_and_deviations(
    rows: FloatArray, disturbances: FloatArray, residual: FloatArray
) -> tuple[bool, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, float]:
    """Separate pose and sensor deviations in one recording's data.

    Parameters
    ----------
    rows : ndarray, shape (8 + m, n_out)
        Change of the data per pose, phase and amplitude, then per deviation.
    disturbances : ndarray, shape (k, n_out)
        Changes of the data by disturbances that count as noise, each of unit variance.
    residual : ndarray, shape (n_out,)

    Returns
    -------
    determined : bool
        False if the pose is undetermined.
    step : ndarray, shape (7,)
        Of the pose.
    covariance : ndarray, shape (7, 7)
        Of the pose.
    sensitivity : ndarray, shape (7, m)
        See `ArrayTerms`.
    information : ndarray, shape (m, m)
        Of the deviations.
    right : ndarray, shape (m,)
        Information vector of the deviations.
    left : float
        Squared residual that remains.
    """
    data = residual.reshape(1, -1)
    inner = _invert(np.eye(len(disturbances)) + compute_inner_products(disturbances, disturbances))
    across = compute_inner_products(rows, disturbances) @ inner
    rest = rows - across @ disturbances  # C^-1 times the rows, C = 1 + disturbances^T disturbances
    normal = compute_inner_products(rows, rest)
    right, projected = compute_inner_products(rest, data)[:, 0], compute_inner_products(disturbances, data)[:, 0]
    square = compute_inner_products(data, data)[0, 0] - projected @ inner @ projected
    information = normal[_FITTED:, _FITTED:]
    scale = 1.0 / np.sqrt(np.maximum(normal.diagonal()[:_FITTED], TINY))
    scaled = normal[:_FITTED, :_FITTED] * scale[:, None] * scale
    if not lapack.dsyevd(scaled, compute_v=0)[0][0] >= MIN_EIGENVALUE:
        nothing = np.zeros(7), np.zeros((7, 7)), np.zeros((7, len(information)))
        return False, *nothing, information, right[_FITTED:], square
    inverse = _invert(scaled)
    inverse *= scale[:, None] * scale
    step, mixed = inverse @ right[:_FITTED], normal[:_FITTED, _FITTED:]
    shift = inverse @ mixed  # (8, m)
    pose, sensitivity, covariance = (
        step[_POSE_AND_AMPLITUDE],
        -shift[_POSE_AND_AMPLITUDE],
        inverse[_POSE_AND_AMPLITUDE[:, None], _POSE_AND_AMPLITUDE],
    )
    information = information - mixed.T @ shift  # Schur complement: the pose is eliminated
    left = square - right[:_FITTED] @ step
    return True, pose, covariance, sensitivity, information, right[_FITTED:] - mixed.T @ step, left
