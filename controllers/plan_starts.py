"""Initial currents for the search for a plan."""

from __future__ import annotations

import itertools

import numpy as np

from smolbot.core.arrays import FloatArray

MAX_STARTS = 64
"""Sets of currents tried with many coils; each costs a rollout."""


def make_plan_starts(low: FloatArray, high: FloatArray) -> FloatArray:
    """Make sets of currents to start from: every coil on or off; with many coils, at most two of them on.

    Parameters
    ----------
    low, high : ndarray, shape (n_coils,), in A
        Limits; coils that can be reversed have a negative `low`.

    Returns
    -------
    ndarray, shape (n, n_coils), in A

    Examples
    --------
    >>> make_plan_starts(np.zeros(2), np.full(2, 8.0))
    array([[0., 0.],
           [0., 8.],
           [8., 0.],
           [8., 8.]])
    """
    n = len(high)
    levels = [(0.0, 1.0)] * n if np.all(low >= 0.0) else [(-1.0, 0.0, 1.0)] * n
    if np.prod([float(len(level)) for level in levels]) > 81:
        pairs = [*itertools.combinations(range(n), 2), *((i, i) for i in range(n))]
        signs = (1.0,) if np.all(low >= 0.0) else (1.0, -1.0)
        rows = [np.zeros(n)]
        for (i, j), p, q in itertools.product(pairs, signs, signs):
            row = np.zeros(n)
            row[i], row[j] = p, q
            rows.append(row)
        return np.array(rows[:MAX_STARTS]) * high
    return np.array(list(itertools.product(*levels))) * high
