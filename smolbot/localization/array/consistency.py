"""Check of a finished fit: whether each sensor agrees with the others, within what sensors and device may be off.

Near a fit, the data are d = s + J x + D q + n, with x the pose, phase and amplitude, q the deviations of sensors and
device, of covariance Q, and n white noise. A sensor that has failed adds M_j f: its own response M_j to every time
function, each with an unknown size f. With

    C = 1 + D Q D^T,    R = C^-1 - C^-1 J (J^T C^-1 J)^-1 J^T C^-1,    e = M_j^T R d,

e^T (M_j^T R M_j)^-1 e is the decrease of chi-square if sensor j is left out, and has a chi-square distribution as long
as the sensor works (the generalised likelihood ratio test). A changed gain adds one known direction instead of M_j,
so that a smaller change is found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.localization.array.terms import DEVIATIONS_PER_SENSOR, compute_changes
from smolbot.localization.problem import Fit, Problem

MIN_INFORMATION = 1e-6
"""Share of the largest information of a sensor's response below which a direction of it is not tested."""

CHANGED_RESONANCE = 5.0
"""Size of a change of frequency and damping in flight, relative to what is assumed of a device that does not change.
Such a change is heard by all sensors alike, and is no reason to leave one out."""

TINY = 1e-300
"""Information that keeps a quotient finite."""


@dataclass(frozen=True, eq=False)
class ChannelCheck:
    """How far each sensor, and the complete fit, is from what noise and tolerances explain.

    Attributes
    ----------
    sigmas : ndarray, shape (n_sensors,)
        Of each sensor, in standard deviations of a normal distribution; minus infinity for sensors that took no part.
    total : float
        Of the complete residual, likewise.
    excess : float
        Chi-square of the complete residual, less its degrees of freedom.
    """

    sigmas: FloatArray
    total: float
    excess: float


def check_channels(problem: Problem, fit: Fit, frames: FloatArray, covariance: FloatArray) -> ChannelCheck:
    """Check whether each sensor of a finished whitened fit agrees with the others.

    Parameters
    ----------
    problem : Problem
    fit : Fit
    frames : ndarray, shape (n_sensors, 2, 3)
        Directions of each sensor's tilts.
    covariance : ndarray, shape (6 * n_sensors + 2, 6 * n_sensors + 2)
        Of the deviations of sensors and device, see `ArrayPrior`.

    Returns
    -------
    ChannelCheck
    """
    model = problem.model
    changes = compute_changes(problem, fit, frames)
    used = np.concatenate([np.repeat(model.used, DEVIATIONS_PER_SENSOR), np.ones(2, dtype=np.bool_)])
    weights, vectors = np.linalg.eigh(covariance[np.ix_(used, used)])
    spread = (vectors * np.sqrt(np.maximum(weights, 0.0))).T @ changes.deviations
    disturbances = changes.disturbances.copy()
    disturbances[-2:] *= CHANGED_RESONANCE  # frequency and damping
    unknown = np.concatenate([spread, disturbances])
    inner = np.linalg.inv(np.eye(len(unknown)) + unknown @ unknown.T)
    inverse = np.eye(len(changes.out)) - unknown.T @ inner @ unknown  # C^-1
    weighted = changes.jacobian @ inverse
    normal = weighted @ changes.jacobian.T
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), TINY))
    pose = np.linalg.pinv(normal * scale * scale[:, None], hermitian=True) * scale * scale[:, None]
    residual_maker = inverse - weighted.T @ pose @ weighted  # R
    left = residual_maker @ (problem.data - changes.out)
    chi_square = float((problem.data - changes.out) @ left)
    gains = changes.deviations[:-2:DEVIATIONS_PER_SENSOR]
    responses = np.ascontiguousarray(model.matrix.transpose(2, 1, 0))  # (n, n_functions, n_out)
    sigmas = np.full(len(model.used), -np.inf)
    sigmas[model.used] = np.maximum(
        _test_gains(gains, residual_maker, left), _test_responses(responses, residual_maker, left)
    )
    freedom = max(len(left) - len(normal), 1)
    return ChannelCheck(sigmas, float(compute_sigmas(np.array(chi_square), np.array(freedom))), chi_square - freedom)


def compute_gain_sigmas(information: FloatArray, right: FloatArray, covariance: FloatArray) -> FloatArray:
    """Compute the significance of a change of each sensor's gain from what recordings tell on all deviations.

    Parameters
    ----------
    information : ndarray, shape (6 * n_sensors + 2, 6 * n_sensors + 2)
        Of the deviations, with every pose eliminated; see `ArrayTerms`.
    right : ndarray, shape (6 * n_sensors + 2,)
        Its information vector.
    covariance : ndarray, shape (6 * n_sensors + 2, 6 * n_sensors + 2)
        Of the deviations of sensors that work.

    Returns
    -------
    ndarray, shape (n_sensors,)
        In standard deviations; 0 for sensors of which nothing is known.
    """
    # of b = I q + noise, the part that deviations of covariance Q do not explain: (1 + I Q)^-1 b
    maker = np.linalg.inv(np.eye(len(right)) + information @ covariance)
    left, known = maker @ right, np.einsum("ij,ji->i", maker, information)
    at = slice(0, -2, DEVIATIONS_PER_SENSOR)
    sigmas: FloatArray = np.abs(left[at]) / np.sqrt(np.maximum(known[at], TINY))
    return np.where(known[at] > 0.0, sigmas, 0.0)


def compute_sigmas(chi_square: FloatArray, freedom: FloatArray) -> FloatArray:
    """Compute how many standard deviations of a normal distribution are as unlikely as a value of chi-square.

    By the cube root of Wilson and Hilferty, Proceedings of the National Academy of Sciences 17 (1931).

    Parameters
    ----------
    chi_square, freedom : ndarray, of one shape
        At least one degree of freedom each.

    Returns
    -------
    ndarray

    Examples
    --------
    >>> compute_sigmas(np.array([10.0, 30.0]), np.array([10.0, 10.0])).round(1)
    array([0.1, 3.1])
    """
    spread = 2.0 / (9.0 * freedom)
    sigmas: FloatArray = (np.cbrt(chi_square / freedom) - (1.0 - spread)) / np.sqrt(spread)
    return sigmas


def _test_gains(gains: FloatArray, residual_maker: FloatArray, left: FloatArray) -> FloatArray:
    """Compute the significance of a change of each sensor's gain, of response `gains` (n, n_out)."""
    information = np.einsum("nm,nm->n", gains @ residual_maker, gains)
    return np.asarray(np.abs(gains @ left) / np.sqrt(np.maximum(information, TINY)))


def _test_responses(responses: FloatArray, residual_maker: FloatArray, left: FloatArray) -> FloatArray:
    """Compute the significance of an arbitrary response of each sensor, (n, n_functions, n_out)."""
    values, vectors = np.linalg.eigh(responses @ residual_maker @ responses.transpose(0, 2, 1))
    known = values > MIN_INFORMATION * values[:, -1:]
    along = np.einsum("nfk,nf->nk", vectors, responses @ left)
    squares = np.where(known, along**2 / np.where(known, values, 1.0), 0.0)
    return compute_sigmas(squares.sum(axis=1), np.maximum(known.sum(axis=1), 1))
