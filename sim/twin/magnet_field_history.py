"""The field of the near magnet at the sensors: a thousand times their range."""

from __future__ import annotations

from collections import deque

import numpy as np

from smolbot.core.arrays import FloatArray


class MagnetFieldHistory:
    """Stores the magnet's recent field at the sensors, interpolated linearly in time.

    Parameters
    ----------
    axes : ndarray, shape (n, 3)
        Of the sensors, with the gain as length, world frame.
    memory : float, in s
        How long it is stored.
    """

    def __init__(self, axes: FloatArray, memory: float) -> None:
        self._axes, self._memory = axes, memory
        self._rows: deque[tuple[float, FloatArray]] = deque()

    def append(self, time: float, field: FloatArray) -> None:
        """Append the field at a time.

        Parameters
        ----------
        time : float, in s
        field : ndarray, shape (n, 3), in T
            At the sensors, world frame.
        """
        measured = np.einsum("ij,ij->i", self._axes, field)
        rows = self._rows
        if len(rows) > 1 and not measured.any() and not rows[-1][1].any() and not rows[-2][1].any():
            rows.pop()  # away, as before
        rows.append((time, measured))
        while len(rows) > 1 and rows[1][0] < time - self._memory:
            rows.popleft()

    def add_to_readings(self, signal: FloatArray, clock: float, rate: float) -> None:
        """Add the magnet's field to readings, in place.

        Parameters
        ----------
        signal : ndarray, shape (n, k), in T
        clock : float, in s
            Time of the first sample.
        rate : float, in Hz
        """
        near: list[tuple[float, FloatArray]] = []
        for row in reversed(self._rows):
            near.append(row)
            if row[0] <= clock:
                break
        near.reverse()
        if not any(measured.any() for _, measured in near):
            return
        times, measured = np.array([time for time, _ in near]), np.array([measured for _, measured in near])
        at = clock + np.arange(signal.shape[1]) / rate
        for own, row in zip(signal, measured.T, strict=True):
            own += np.interp(at, times, row)
