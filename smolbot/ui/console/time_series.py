"""Time series that grow row by row and are read as arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from smolbot.core.arrays import FloatArray


class TimeSeries:
    """Rows of equal width, each with a time that does not decrease.

    Grows by doubling, so that reading copies nothing.

    Parameters
    ----------
    width : int
        Number of values in a row.

    Examples
    --------
    >>> columns = TimeSeries(2)
    >>> columns.append(0.5, (1.0, 2.0)); columns.append(1.0, (3.0, 4.0))
    >>> columns.get_values().tolist(), columns.get_values(0.7).tolist()
    ([[1.0, 2.0], [3.0, 4.0]], [[1.0, 2.0]])
    """

    def __init__(self, width: int) -> None:
        self._data = np.empty((64, width + 1))
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, time: float, values: Sequence[float] | FloatArray) -> None:
        """Add a row.

        Parameters
        ----------
        time : float, in s
            A time before that of the last row is replaced by it.
        values : sequence of float, length width
        """
        if self._count == len(self._data):
            self._data = np.vstack([self._data, np.empty_like(self._data)])
        row = self._data[self._count]
        row[0] = max(time, self._data[self._count - 1, 0]) if self._count else time
        row[1:] = values
        self._count += 1

    def count_until(self, time: float | None = None) -> int:
        """Count the rows up to a time.

        Parameters
        ----------
        time : float, in s, optional
            All rows unless given.

        Returns
        -------
        int
        """
        if time is None:
            return self._count
        return int(np.searchsorted(self._data[: self._count, 0], time, side="right"))

    def get_times(self, time: float | None = None) -> FloatArray:
        """Return the times of the rows up to a time.

        Parameters
        ----------
        time : float, in s, optional
            All rows unless given.

        Returns
        -------
        ndarray, shape (n,), in s
        """
        return self._data[: self.count_until(time), 0]

    def get_values(self, time: float | None = None) -> FloatArray:
        """Return the values of the rows up to a time.

        Parameters
        ----------
        time : float, in s, optional
            All rows unless given.

        Returns
        -------
        ndarray, shape (n, width)
        """
        return self._data[: self.count_until(time), 1:]
