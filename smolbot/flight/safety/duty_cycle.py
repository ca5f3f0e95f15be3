"""Duty cycle of each coil over a sliding time window."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence


class DutyCycle:
    """Duty cycle of each coil within the last `window` s.

    Parameters
    ----------
    coil_names : sequence of str
        Names of the coils, in order.
    window : float, in s
        Length of the sliding window.

    Attributes
    ----------
    peaks : list of float
        Highest duty cycle of each coil so far, from 0 to 1.

    Examples
    --------
    >>> duty = DutyCycle(("+x",), window=10.0)
    >>> for second in range(20):
    ...     _ = duty.add_span(0, second, second + 0.25)
    >>> round(duty.peaks[0], 3)
    0.25
    """

    def __init__(self, coil_names: Sequence[str], window: float) -> None:
        self.coil_names = tuple(coil_names)
        self.window = window
        self.peaks = [0.0] * len(self.coil_names)
        self._spans: list[deque[tuple[float, float]]] = [deque() for _ in self.coil_names]
        self._totals = [0.0] * len(self.coil_names)

    def add_span(self, coil: int, start: float, end: float) -> float:
        """Add a time span in which a coil is driven; it must lie after all spans that were added before.

        Parameters
        ----------
        coil : int
            Index of the coil, from 0.
        start : float, in s
        end : float, in s

        Returns
        -------
        float
            Duty cycle of the coil at `end`, from 0 to 1.
        """
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
