"""A simulated hand that brings the magnet near and takes it away, when the stage's lamp asks for it."""

from __future__ import annotations

import numpy as np

MAX_SIGMAS = 3.0
"""Standard deviations to which the operator's delay is clipped."""


class Hand:
    """Where the magnet is, moved at the lamp's request.

    Attributes
    ----------
    place : {"near", "away"} or None
        None while it is on its way.

    Parameters
    ----------
    duration : float, in s
        A move, at the least: a hand is late, never early.
    lateness : float
        Standard deviation of how much longer it takes, as a share of that.
    rng : numpy.random.Generator
    """

    def __init__(self, duration: float, lateness: float, rng: np.random.Generator) -> None:
        self.place: str | None = "away"
        self._duration, self._lateness, self._rng = duration, lateness, rng
        self._going: tuple[str, float] | None = None

    def put_away(self) -> None:
        """Take the magnet away at once, whatever was asked for."""
        self.place, self._going = "away", None

    def look(self, lamp: str | None, time: float) -> None:
        """What the lamp asks for at `time` s."""
        if self._going is not None:
            to, arrives = self._going
            if time >= arrives:
                self.place, self._going = to, None
        elif lamp is not None and lamp != self.place:
            late = self._lateness * abs(float(np.clip(self._rng.standard_normal(), -MAX_SIGMAS, MAX_SIGMAS)))
            self.place, self._going = None, (lamp, time + self._duration * (1.0 + late))
