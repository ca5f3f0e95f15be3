"""How large a share of the time each coil is driven, over a sliding time."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence


class Duty:
    """Driven spans of each coil within the last `window` s.

    Attributes
    ----------
    peaks : list of float
        The largest share of each coil so far.

    Examples
    --------
    >>> duty = Duty(("+x",), window=10.0)
    >>> for second in range(20):
    ...     _ = duty.drive(0, second, second + 0.25)
    >>> round(duty.peaks[0], 3)
    0.25
    """

    def __init__(self, names: Sequence[str], window: float) -> None:
        self.names = tuple(names)
        self.window = window
        self.peaks = [0.0] * len(self.names)
        self._spans: list[deque[tuple[float, float]]] = [deque() for _ in self.names]
        self._totals = [0.0] * len(self.names)

    def drive(self, coil: int, start: float, end: float) -> float:
        """Note that a coil is driven from `start` to `end` s, later than all before; its share at `end`."""
        spans, begin = self._spans[coil], end - self.window
        spans.append((start, end))
        self._totals[coil] += end - start
        while spans[0][1] <= begin:
            gone = spans.popleft()
            self._totals[coil] -= gone[1] - gone[0]
        cut = max(begin - spans[0][0], 0.0)
        share = (self._totals[coil] - cut) / self.window
        self.peaks[coil] = max(self.peaks[coil], share)
        return share
