"""A law of the lab's own: one coil pulls, the nearest to where the path ends."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from smolbot import Actuate, Command, Curve, Gain, Pose, Setup


class Drift:
    """Pulls with a constant current toward the end of the path."""

    gains: ClassVar[Mapping[str, Gain]] = {
        "current_a": Gain(2.0, 0.1, 8.0, meaning="of the coil that pulls"),
        "window_ms": Gain(40.0, 10.0, 95.0, meaning="actuation per cycle"),
    }

    def __init__(self, setup: Setup, gains: Mapping[str, float]) -> None:
        self._setup = setup
        self._current = gains.get("current_a", self.gains["current_a"].default)
        self._window = 1e-3 * gains.get("window_ms", self.gains["window_ms"].default)

    def reset(self, path: Curve, pose: Pose) -> None:
        """Begin a path."""
        self._end = path.at(path.length)

    def command(self, pose: Pose) -> Command:
        """One window in which one coil pulls."""
        way = (self._end - pose.position)[:2]
        if float(np.linalg.norm(way)) < self._setup.tolerance:
            return Command(None, note="there", done=True)
        field = self._setup.table.field(pose.position[None, :])[:, 0, :2]
        currents = np.zeros(len(field))
        currents[int(np.argmax(field @ way))] = self._current
        return Command(Actuate(tuple(currents.tolist()), self._window), note="drifting")
