"""Detection of sensors that are dead or saturated for several listening windows in a row."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from smolbot.core.sensing import Recording

DEAD, SATURATED = "dead", "saturated"

NO_LIMIT = 1 << 62
"""Number of windows that no flight reaches."""


class SensorMonitor:
    """Counts, for each sensor, the listening windows in a row in which it was constant, or saturated.

    Parameters
    ----------
    n_sensors : int
    max_windows : int
        Number of windows in a row from which a sensor is reported; `NO_LIMIT` for never.
    ignored : collection of int
        Sensors, from 0, that are known to be broken.
    """

    def __init__(self, n_sensors: int, max_windows: int, ignored: Collection[int] = ()) -> None:
        self.max_windows = max_windows
        self._watched = np.array([i not in ignored for i in range(n_sensors)], dtype=np.bool_)
        self._runs = {kind: np.zeros(n_sensors, dtype=np.int64) for kind in (DEAD, SATURATED)}

    def check_recording(self, recording: Recording) -> tuple[str, list[int], int] | None:
        """Add a recording, and check for sensors that have failed for too many windows.

        Parameters
        ----------
        recording : Recording

        Returns
        -------
        tuple or None
            Fault (``dead`` or ``saturated``), sensors from 0, and number of windows in a row; None if all work.
        """
        field = recording.field
        if field.shape[1] < 2:  # a world without samples
            return None
        constant = (field[:, 0] == field[:, -1]) & (field[:, 0] == field[:, field.shape[1] // 2])
        if constant.any():
            constant[constant] = np.all(field[constant] == field[constant, :1], axis=1)
        for kind, now in ((DEAD, constant & ~recording.saturated), (SATURATED, recording.saturated)):
            runs = self._runs[kind]
            runs += 1
            runs[~(now & self._watched)] = 0
            if runs.max() >= self.max_windows:
                return kind, [int(i) for i in np.flatnonzero(runs >= self.max_windows)], int(runs.max())
        return None
