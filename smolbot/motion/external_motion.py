"""Motion that is not commanded: a device that is externally guided, for instance by hand."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class ExternalMotion:
    """Stochastic model of an externally guided device.

    Velocity and turn rate vary randomly about zero (an Ornstein-Uhlenbeck process in each axis): in the short run
    the motion continues as it is, in the long run nothing can be predicted.

    Attributes
    ----------
    speed : float, in m/s
        Standard deviation of the velocity, per axis.
    turn_rate : float, in rad/s
        Standard deviation of the turn rate, per axis.
    correlation_time : float, in s
        Correlation time of both.
    """

    speed: float
    turn_rate: float
    correlation_time: float

    def compute_decay(self, wait: float) -> tuple[float, float]:
        """Compute how a rate decays, and the displacement per unit of initial rate.

            kept = exp(-t / tau),   path = tau (1 - kept)

        Parameters
        ----------
        wait : float, in s

        Returns
        -------
        kept : float
            Share of the rate that is left.
        path : float, in s
            Integral of the decaying share over the wait.
        """
        kept = math.exp(-wait / self.correlation_time)
        return kept, self.correlation_time * (1.0 - kept)

    def compute_process_noise(self, wait: float) -> tuple[float, float, float]:
        """Compute the process noise of a wait, for a rate of unit variance.

        Parameters
        ----------
        wait : float, in s

        Returns
        -------
        path : float, in s²
            Variance of the displacement.
        path_rate : float, in s
            Covariance of displacement and rate.
        rate : float
            Variance of the rate.
        """
        kept, carried = self.compute_decay(wait)
        path = self.correlation_time * (2.0 * wait - self.correlation_time * (3.0 - 4.0 * kept + kept**2))
        return max(path, 0.0), carried**2 / self.correlation_time, 1.0 - kept**2
