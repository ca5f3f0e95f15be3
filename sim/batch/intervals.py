"""Small statistics that reports need."""

from __future__ import annotations

import math


def wilson_interval(passed: int, total: int, z: float = 1.959964) -> tuple[float, float]:
    """Interval (95 % by default) of a rate from `passed` of `total` trials (Wilson score).

    Examples
    --------
    >>> print(tuple(round(v, 3) for v in wilson_interval(20, 20)))
    (0.839, 1.0)
    """
    if total <= 0:
        return 0.0, 1.0
    p = passed / total
    middle = (p + z * z / (2 * total)) / (1 + z * z / total)
    half = z / (1 + z * z / total) * math.sqrt(p * (1 - p) / total + z * z / (4 * total * total))
    return max(0.0, middle - half), min(1.0, middle + half)
