"""How hot a bench's coils were left: the next run starts from there, and not from cold coils."""

from __future__ import annotations

import json
import os
import re
import time
import warnings
from collections.abc import Callable
from pathlib import Path

from smolbot.core.coil_heat import CoilHeat

EVERY = 5.0
"""Seconds between two notes while a run goes on, so that a killed one is remembered too."""


class HeatMemory:
    """Notes temperatures in a file, and reads them back cooled by the time that went by.

    A file that is not there, that says nothing of a coil, or that was written in the future leaves coils as they are.

    Parameters
    ----------
    path : path
        Where it is kept, see `kept_at`.
    clock : callable
        Seconds since the epoch, for they outlive a process.
    """

    def __init__(self, path: Path, clock: Callable[[], float] = time.time) -> None:
        self.path = path
        self._clock = clock
        self._kept = -float("inf")

    @classmethod
    def of(cls, rig: str) -> HeatMemory:
        """That of the rig of that name, on this machine."""
        return cls(kept_at(rig))

    def recall(self, heat: CoilHeat) -> None:
        """Set a model's temperatures to what is left of those that were noted."""
        try:
            data = json.loads(self.path.read_text(encoding="utf-8"))
            since = self._clock() - float(data["time"])
            noted = {str(name): float(value) for name, value in data["temperatures_c"].items()}
        except (OSError, ValueError, TypeError, KeyError, AttributeError):  # nothing that could be read was kept
            return
        if since < 0.0:
            return
        for i, coil in enumerate(heat.coils):
            if coil is not None and coil.name in noted:
                heat.temperatures[i] = max(noted[coil.name], heat.ambient)
        heat.advance((), since)
        heat.peaks = list(heat.temperatures)

    def keep(self, heat: CoilHeat, *, now: bool = False) -> None:
        """Note a model's temperatures, if the last note is some seconds old, or `now`."""
        clock = self._clock()
        if self._kept == float("inf") or (not now and 0.0 <= clock - self._kept < EVERY):
            return
        self._kept = clock
        try:
            self._write(clock, heat)
        except OSError as error:
            warnings.warn(f"{self.path}: how hot the coils are cannot be kept for the next run: {error}", stacklevel=2)
            self._kept = float("inf")

    def _write(self, clock: float, heat: CoilHeat) -> None:
        known = [(c.name, t) for c, t in zip(heat.coils, heat.temperatures, strict=True) if c is not None]
        part = self.path.with_suffix(".part")
        part.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(json.dumps({"time": clock, "temperatures_c": dict(known)}), encoding="utf-8")
        os.replace(part, self.path)


def kept_at(rig: str) -> Path:
    """The file of the rig of that name, in the user's cache."""
    from lookup_tables.cache import default_cache_dir

    return default_cache_dir() / "heat" / f"{re.sub(r'[^A-Za-z0-9_-]', '_', rig)}.json"
