"""Motion that nobody commands: a device that something else leads, such as a hand."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Motion:
    """How a device is thought to move for reasons of its own, such as the hand that leads it.

    Velocity and turn rate wander about zero (an Ornstein-Uhlenbeck process in each axis): the next moment goes on like
    this one, and in the long run nothing is known.

    Attributes
    ----------
    speed : float, in m/s
        Standard deviation of the velocity, per axis.
    turn : float, in rad/s
        The same of the turn rate.
    change : float, in s
        Time in which either becomes another one.
    """

    speed: float
    turn: float
    change: float

    def carry(self, wait: float) -> tuple[float, float]:
        """How much of a rate is left after `wait` s, and the time in s by which it has carried the device on."""
        kept = math.exp(-wait / self.change)
        return kept, self.change * (1.0 - kept)

    def spread(self, wait: float) -> tuple[float, float, float]:
        """Variances, for a rate of unit variance, that `wait` s add: of the path, of path with rate, of the rate."""
        kept, carried = self.carry(wait)
        path = self.change * (2.0 * wait - self.change * (3.0 - 4.0 * kept + kept**2))
        return max(path, 0.0), carried**2 / self.change, 1.0 - kept**2
