"""A simulated operator who moves the magnet near and away when the stage's lamp requests it."""

from __future__ import annotations

import numpy as np

MAX_SIGMAS = 3.0
"""Standard deviations to which the operator's delay is clipped."""


class MagnetOperator:
    """Position of the magnet, moved at the lamp's request.

    Parameters
    ----------
    duration : float, in s
        Shortest duration of a move: an operator may be late, never early.
    lateness : float
        Standard deviation of the delay, as a fraction of `duration`.
    rng : numpy.random.Generator

    Attributes
    ----------
    magnet_position : {"near", "away"} or None
        None during a move.
    """

    def __init__(self, duration: float, lateness: float, rng: np.random.Generator) -> None:
        self.magnet_position: str | None = "away"
        self._duration, self._lateness, self._rng = duration, lateness, rng
        self._going: tuple[str, float] | None = None

    def move_away(self) -> None:
        """Move the magnet away at once, whatever was requested."""
        self.magnet_position, self._going = "away", None

    def update(self, lamp: str | None, time: float) -> None:
        """Update the magnet's position from the lamp.

        Parameters
        ----------
        lamp : {"near", "away"} or None
            The requested position.
        time : float, in s
        """
        if self._going is not None:
            to, arrives = self._going
            if time >= arrives:
                self.magnet_position, self._going = to, None
        elif lamp is not None and lamp != self.magnet_position:
            late = self._lateness * abs(float(np.clip(self._rng.standard_normal(), -MAX_SIGMAS, MAX_SIGMAS)))
            self.magnet_position, self._going = None, (lamp, time + self._duration * (1.0 + late))
