"""Least squares over a few parameters and very many data."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from smolbot.core.arrays import FloatArray

FIRST_DAMPING, DAMPING_UP, DAMPING_DOWN, MAX_DAMPING = 1e-3, 5.0, 0.2, 1e8
"""Levenberg-Marquardt damping: its start, its factors after a worse and a better step, and where the search ends."""

CONVERGED = 1e-4
"""Squared length of a step, in variances of the residuals, below which a fit has converged."""

TINY = 1e-30
"""Keeps the normal matrix invertible where a parameter has no influence."""


def minimize(
    residual: Callable[[FloatArray], FloatArray], start: FloatArray, steps: FloatArray, iterations: int = 30
) -> tuple[FloatArray, FloatArray, float]:
    """Minimize by the Levenberg-Marquardt method, until a step is below 1 % of a standard deviation.

    The routine of scipy spends most of its time on a singular value decomposition of the tall Jacobian in each
    iteration.

    Parameters
    ----------
    residual : callable
        From parameters (p,) to residuals (n,).
    start : ndarray, shape (p,)
    steps : ndarray, shape (p,)
        Of the forward differences.
    iterations : int
        Largest number of steps.

    Returns
    -------
    values : ndarray, shape (p,)
    covariance : ndarray, shape (p, p)
        For residuals of unit variance.
    cost : float
        Sum of squares.
    """
    values, left = start, residual(start)
    cost, damping = float(left @ left), FIRST_DAMPING
    for _ in range(iterations):
        jacobian = np.stack([(residual(values + step) - left) / step.sum() for step in np.diag(steps)])
        normal, gradient = jacobian @ jacobian.T, jacobian @ left
        size = np.diag(normal)
        while True:
            change = -np.linalg.solve(normal + np.diag(damping * size + TINY), gradient)
            tried = residual(values + change)
            if (lower := float(tried @ tried)) <= cost or damping > MAX_DAMPING:
                break
            damping *= DAMPING_UP
        if lower > cost:
            break
        values, left, cost, damping = values + change, tried, lower, DAMPING_DOWN * damping
        if change @ normal @ change < CONVERGED * cost / left.size:
            break
    return values, np.linalg.pinv(normal), cost
