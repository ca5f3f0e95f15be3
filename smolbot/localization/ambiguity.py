"""Choice among several fits: poses that give the same or nearly the same signal (180° ambiguity)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from smolbot.core.pose import Pose
from smolbot.core.sensing import Device
from smolbot.localization.kernels import N_PARAMETERS
from smolbot.localization.problem import Fit, Problem

MIN_ODDS = 12.0
"""Chi-square by which every other solution must be worse for a cold start to be trusted (odds of 400 to 1)."""

MAX_DECIDING_TURN = np.radians(60.0)
"""Turn since the prior up to which it decides between two orientations half a turn apart: farther, neither is near."""

SAME_POSITION = 2e-3
"""Distance, in m, within which two fits have the same position."""

SAME_ROTATION = 1.0 + 2.0 * np.cos(np.radians(10.0))
"""Trace of the relative rotation of two fits above which they have the same orientation (10 degrees)."""

FLIPPED_STEPS, FLIPPED_TOLERANCE = 8, 1e-3
"""Iterations of the fit of the flipped orientation, and the relative gain at which it ends."""

TINY = 1e-300
"""Residual that keeps a quotient finite."""


class ChosenFit(NamedTuple):
    """The chosen fit, and how clearly it is the best one.

    Attributes
    ----------
    fit : Fit
    flip_margin : float
        Residual of the flipped orientation over that of the fit, at least 1.
    odds : float
        Difference in chi-square to the best other solution.
    clear : bool
        Whether the data, or the prior, decide between this fit and every other solution.
    """

    fit: Fit
    flip_margin: float
    odds: float
    clear: bool


def choose_fit(problem: Problem, found: list[Fit], device: Device, prior: Pose | None) -> ChosenFit:
    """Choose the best fit; the 180° ambiguity is resolved by the least turn since the prior.

    Parameters
    ----------
    problem : Problem
    found : list of Fit
        The best first.
    device : Device
    prior : Pose or None

    Returns
    -------
    ChosenFit
    """
    best, flip_margin, odds = found[0], 1.0, np.inf
    along = device.along_cantilever
    variance = 1.0 if problem.model.white else compute_residual_variance(problem, best)
    if not along:
        best, other = _fit_both_orientations(problem, best, device)
        flip_margin = max(1.0, math.sqrt(other.sse / max(best.sse, TINY)))
        odds = (other.sse - best.sse) / variance
        if prior is not None and odds < MIN_ODDS and _compute_turn(other, prior) < _compute_turn(best, prior):
            best = other
    rivals = [f for f in found[1:] if not (along and _is_flipped(f, best)) and not _is_same_pose(f, best)]
    if rivals:
        odds = min(odds, (min(f.sse for f in rivals) - best.sse) / variance)
    near = prior is not None and (along or _compute_turn(best, prior) < MAX_DECIDING_TURN)
    return ChosenFit(best, flip_margin, odds, near or odds > MIN_ODDS)


def count_degrees_of_freedom(problem: Problem) -> int:
    """Count the degrees of freedom of a fit's residuals.

    Parameters
    ----------
    problem : Problem

    Returns
    -------
    int
        At least 1.
    """
    return max(problem.data.size - N_PARAMETERS, 1)


def compute_residual_variance(problem: Problem, fit: Fit) -> float:
    """Compute the variance of a fit's residuals.

    Parameters
    ----------
    problem : Problem
    fit : Fit

    Returns
    -------
    float, in the squared unit of the data
    """
    return fit.sse / count_degrees_of_freedom(problem)


def _fit_both_orientations(problem: Problem, best: Fit, device: Device) -> tuple[Fit, Fit]:
    """Fit the other member of the two-fold ambiguity as well; the better one first."""
    moment = best.rotation @ device.moment_in_body
    turned = 2.0 * moment[:, None] * device.moment_in_body - best.rotation
    # half a turn about the moment; the magnet stays where it is
    position = best.position + device.l0 * (best.rotation[:, 2] - turned[:, 2])
    other = problem.fit(
        position, turned, best.phase + np.pi, best.amplitude, iterations=FLIPPED_STEPS, tolerance=FLIPPED_TOLERANCE
    )
    low, high = sorted((best, other), key=lambda t: t.sse)
    return low, high


def _compute_turn(fit: Fit, prior: Pose) -> float:
    """Compute the angle between a fit's orientation and the prior's, in rad."""
    return float(np.arccos(np.clip(0.5 * (np.trace(fit.rotation.T @ prior.rotation) - 1.0), -1.0, 1.0)))


def _is_same_pose(a: Fit, b: Fit) -> bool:
    near = float(np.linalg.norm(a.position - b.position)) < SAME_POSITION
    return near and float(np.trace(a.rotation.T @ b.rotation)) > SAME_ROTATION


def _is_flipped(a: Fit, b: Fit) -> bool:
    half_turn = np.array([-1.0, -1.0, 1.0])
    near = float(np.linalg.norm(a.position - b.position)) < SAME_POSITION
    return near and float(np.trace((a.rotation * half_turn).T @ b.rotation)) > SAME_ROTATION
