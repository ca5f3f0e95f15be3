"""Coil temperatures stored on disk, so that the next run does not start from cold coils."""

from __future__ import annotations

import json
import os
import re
import time
import warnings
from collections.abc import Callable
from pathlib import Path

from smolbot.core.coil_heat import CoilHeat

SAVE_INTERVAL = 5.0
"""Seconds between two writes during a run, so that a killed run is remembered too."""


class HeatMemory:
    """Stores coil temperatures in a file, and restores them cooled by the time that has passed.

    If the file is missing, does not mention a coil, or is dated in the future, temperatures stay as they are.

    Parameters
    ----------
    path : path
        The file; see `find_heat_file`.
    clock : callable
        Returns seconds since the epoch, which stay comparable between processes.
    """

    def __init__(self, path: Path, clock: Callable[[], float] = time.time) -> None:
        self.path = path
        self._clock = clock
        self._saved_at = -float("inf")

    @classmethod
    def from_rig_name(cls, rig_name: str) -> HeatMemory:
        """Make the heat memory of a rig on this computer.

        Parameters
        ----------
        rig_name : str
            Name of the rig.

        Returns
        -------
        HeatMemory
        """
        return cls(find_heat_file(rig_name))

    def restore(self, heat: CoilHeat) -> None:
        """Set the temperatures of a heat model to the stored ones, cooled until now.

        Parameters
        ----------
        heat : CoilHeat
            Changed in place.
        """
        try:
            data = json.loads(self.path.read_text(encoding="utf-8"))
            since = self._clock() - float(data["time"])
            noted = {str(name): float(value) for name, value in data["temperatures_c"].items()}
        except (OSError, ValueError, TypeError, KeyError, AttributeError):  # no readable file
            return
        if since < 0.0:
            return
        for i, coil in enumerate(heat.coils):
            if coil is not None and coil.name in noted:
                heat.temperatures[i] = max(noted[coil.name], heat.ambient)
        heat.advance((), since)
        heat.peaks = list(heat.temperatures)

    def keep(self, heat: CoilHeat, *, now: bool = False) -> None:
        """Store the temperatures of a heat model, at most once every `SAVE_INTERVAL` s.

        A file that cannot be written gives one warning and is not tried again.

        Parameters
        ----------
        heat : CoilHeat
        now : bool
            Store at once, however recent the last time was.
        """
        clock = self._clock()
        if self._saved_at == float("inf") or (not now and 0.0 <= clock - self._saved_at < SAVE_INTERVAL):
            return
        self._saved_at = clock
        try:
            self._write(clock, heat)
        except OSError as error:
            warnings.warn(f"{self.path}: coil temperatures cannot be kept for the next run: {error}", stacklevel=2)
            self._saved_at = float("inf")

    def _write(self, clock: float, heat: CoilHeat) -> None:
        known = [(c.name, t) for c, t in zip(heat.coils, heat.temperatures, strict=True) if c is not None]
        part = self.path.with_suffix(".part")
        part.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(json.dumps({"time": clock, "temperatures_c": dict(known)}), encoding="utf-8")
        os.replace(part, self.path)


def find_heat_file(rig_name: str) -> Path:
    """Return the path of a rig's temperature file in the user's cache.

    Parameters
    ----------
    rig_name : str
        Name of the rig.

    Returns
    -------
    Path
    """
    from lookup_tables.cache import get_default_cache_dir

    return get_default_cache_dir() / "heat" / f"{re.sub(r'[^A-Za-z0-9_-]', '_', rig_name)}.json"
