"""Where along a path a robot was at each of its positions, for figures over arc length."""

from __future__ import annotations

import numpy as np

from smolbot.core.arrays import FloatArray, as_floats
from smolbot.paths.curve import Curve

CELLS = 1000
"""Cells into which a path is cut: a figure is no finer."""

ADVANCE_COST, RETURN_COST = 0.05e-3, 0.1e-3
"""Cost of each meter of arc length that lies between two positions, in m²: ahead, and back.

To change strands at a crossing and return costs 15 mm² for each 10 cm between the strands, more than the few positions
near a crossing gain by it. A part that was really left out costs less than the many positions that would be far off.
"""

SLACK = 1e-3
"""Difference in m within which the nearest place of all is the one meant: no other strand begins so near."""


def assign_arc_lengths(path: Curve, positions: FloatArray) -> FloatArray:
    """Assign an arc length to each position of a robot, so that it moves along the path without needless jumps.

    The nearest place alone may lie on the other strand of a crossing, or on another turn. Of all assignments the one
    counts whose squared distances, and costs of arc length passed over between two positions, add up to the least.

    Parameters
    ----------
    path : Curve
    positions : ndarray, shape (n, 3), in m, world frame
        In the order of time.

    Returns
    -------
    ndarray, shape (n,), in m

    Examples
    --------
    >>> path = Curve([[0, 0, 0], [0.004, 0, 0], [0, 0, 0]])  # there and back
    >>> flown = np.array([[0, 0, 0], [0.001, 0, 0], [0.004, 0, 0], [0.001, 0, 0], [0, 0, 0]])
    >>> print((1e3 * assign_arc_lengths(path, flown)).round(1))
    [0. 1. 4. 7. 8.]
    """
    positions = as_floats(positions, (None, 3), "positions")
    if not len(positions):
        return np.zeros(0)
    arc = np.linspace(0.0, path.length, CELLS + 1)
    cells = path.at(arc)[:, :2]
    ahead, back = ADVANCE_COST * arc, RETURN_COST * arc
    costs = np.zeros((len(positions), len(arc)), dtype=np.float32)  # (n, cells): least sum up to each position
    reach = ahead.copy()  # the robot comes from the path's beginning
    for i, place in enumerate(positions[:, :2]):
        cost = reach + np.sum((cells - place) ** 2, axis=1)
        costs[i] = cost = cost - cost.min()
        reach = np.minimum(
            np.minimum.accumulate(cost - ahead) + ahead,
            np.minimum.accumulate((cost + back)[::-1])[::-1] - back,
        )
    chosen = np.zeros(len(positions), dtype=int)
    chosen[-1] = np.argmin(costs[-1])
    for i in range(len(positions) - 2, -1, -1):
        step = arc[chosen[i + 1]] - arc
        chosen[i] = np.argmin(costs[i] + np.where(step > 0.0, ADVANCE_COST, -RETURN_COST) * step)
    nearest = path.project(positions)[0]
    return np.where(np.abs(nearest - arc[chosen]) <= SLACK, nearest, arc[chosen])
