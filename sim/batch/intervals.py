"""Confidence intervals for reports."""

from __future__ import annotations


def compute_wilson_interval(passed: int, total: int) -> tuple[float, float]:
    """Compute the 95 % interval of a rate (Wilson score).

    Parameters
    ----------
    passed, total : int
        Number of trials that passed, and of all.

    Returns
    -------
    low, high : float

    Examples
    --------
    >>> print(tuple(round(v, 3) for v in compute_wilson_interval(20, 20)))
    (0.839, 1.0)
    """
    from scipy.stats import binomtest

    if total <= 0:
        return 0.0, 1.0
    interval = binomtest(passed, total).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)
