"""What a controller learns in flight: how readily the robot moves and turns, and what carries it off."""

from __future__ import annotations

import numpy as np

from smolbot.arrays import FloatArray

GATE = 9.0
"""Squared distance, in standard deviations, beyond which a motion is not believed: was its window played at all?"""

SPREAD = np.array([0.1, 6e-5, 6e-5])
"""First uncertainty of mobility (a factor) and drift (m/s)."""

WANDER = np.array([0.004, 6e-6, 6e-6])
"""How much these may change in one window."""

POSE_NOISE, MODEL_NOISE = 3e-5, 0.1
"""Standard deviation of a difference of two tracked poses (m), and share of a predicted motion that is not trusted."""

TURN_NOISE, TURN_SPREAD, TURN_WANDER = 0.02, 0.1, 0.002
"""The same for turns: rad, and factors."""

LEAST, MOST = 0.6, 1.6
"""Bounds of both factors."""


class Adaptation:
    """Kalman filters on mobility, drift and agility: what was seen of a window against what was predicted.

    Attributes
    ----------
    mobility, agility : float
        Motion and turn seen over those predicted by the belief in drag.
    drift : ndarray, shape (2,), in m/s
    """

    def __init__(self) -> None:
        self._x = np.array([1.0, 0.0, 0.0])
        self._p = np.diag(SPREAD**2)
        self.agility = 1.0
        self._turn_variance = TURN_SPREAD**2

    @property
    def mobility(self) -> float:
        return float(self._x[0])

    @property
    def drift(self) -> FloatArray:
        return self._x[1:].copy()

    def learn(self, seen: FloatArray, predicted: FloatArray, turned: float, wanted: float, duration: float) -> bool:
        """Learn from one window; False where what was seen cannot be its doing.

        Parameters
        ----------
        seen, predicted : ndarray, shape (2,), in m
            Displacement, as tracked and as the window should have caused it at mobility 1.
        turned, wanted : float, in rad
            Likewise for the heading, at the present agility.
        duration : float, in s
            Between the two poses.
        """
        self._p += np.diag(WANDER**2)
        h = np.array([[predicted[0], duration, 0.0], [predicted[1], 0.0, duration]])
        noise = POSE_NOISE**2 + (MODEL_NOISE**2) * float(predicted @ predicted)
        miss = seen - h @ self._x
        inverse = np.linalg.inv(h @ self._p @ h.T + noise * np.eye(2))
        if float(miss @ inverse @ miss) > GATE:
            return False
        gain = self._p @ h.T @ inverse
        self._x = self._x + gain @ miss
        self._x[0] = min(max(self._x[0], LEAST), MOST)
        self._p = (np.eye(3) - gain @ h) @ self._p
        self._turn(turned, wanted)
        return True

    def _turn(self, turned: float, wanted: float) -> None:
        self._turn_variance += TURN_WANDER**2
        noise = TURN_NOISE**2 + (MODEL_NOISE * wanted) ** 2
        gain = self._turn_variance * wanted / (wanted**2 * self._turn_variance + noise)
        self.agility = min(max(self.agility * (1.0 + gain * (turned - wanted)), LEAST), MOST)
        self._turn_variance *= 1.0 - gain * wanted
