"""Model parameters that a controller learns in flight: mobility, agility and drift of the robot."""

from __future__ import annotations

import numpy as np
from numba import njit

from smolbot.core.arrays import FloatArray

MAX_MAHALANOBIS_SQUARED = 9.0
"""Squared distance, in standard deviations, beyond which a measured motion is an outlier (a window was not played)."""

INITIAL_STD = np.array([0.1, 6e-5, 6e-5])
"""First uncertainty of mobility (a factor) and drift (m/s)."""

RANDOM_WALK_STD = np.array([0.004, 6e-6, 6e-6])
"""How much these may change in one window."""

POSE_NOISE, MODEL_NOISE = 3e-5, 0.1
"""Standard deviation of a difference of two tracked poses (m), and share of a predicted motion that is not trusted."""

TURN_NOISE, INITIAL_TURN_STD, TURN_RANDOM_WALK_STD = 0.02, 0.1, 0.002
"""The same for turns: rad, and factors."""

MIN_FACTOR, MAX_FACTOR = 0.6, 1.6
"""Bounds of both factors."""


class Adaptation:
    """Kalman filters of mobility, drift and agility, from measured and predicted motion of each window.

    Attributes
    ----------
    mobility, agility : float
        Measured motion and turn over those predicted with the assumed drag.
    drift : ndarray, shape (2,), in m/s
    """

    def __init__(self) -> None:
        self._x = np.array([1.0, 0.0, 0.0])
        self._p = np.diag(INITIAL_STD**2)
        self.agility = 1.0
        self._adopted = False
        self._turn_variance = INITIAL_TURN_STD**2

    @property
    def mobility(self) -> float:
        """Measured over predicted motion."""
        return float(self._x[0])

    @property
    def drift(self) -> FloatArray:
        """Drift velocity (2,), in m/s."""
        return self._x[1:].copy()

    def adopt(self, drift: FloatArray) -> None:
        """Take over the drift from the tracker, and stop learning: mobility and agility are 1 from then on.

        Parameters
        ----------
        drift : ndarray, shape (2,), in m/s
        """
        self._x[0], self._x[1:] = 1.0, drift
        self.agility = 1.0
        self._adopted = True

    def learn(
        self, measured: FloatArray, predicted: FloatArray, measured_turn: float, predicted_turn: float, duration: float
    ) -> bool:
        """Learn from the measured motion in one window.

        Parameters
        ----------
        measured : ndarray, shape (2,), in m
            Displacement as tracked.
        predicted : ndarray, shape (2,), in m
            Displacement predicted for the window at mobility 1.
        measured_turn : float, in rad
            Change of heading as tracked.
        predicted_turn : float, in rad
            Change of heading predicted at the present agility.
        duration : float, in s
            Between the two poses.

        Returns
        -------
        bool
            False for an outlier, which the window cannot have caused.
        """
        if self._adopted:
            return True
        noise = POSE_NOISE**2 + (MODEL_NOISE**2) * float(predicted @ predicted)
        if not _update(self._x, self._p, measured, predicted, duration, noise):
            return False
        self._x[0] = min(max(self._x[0], MIN_FACTOR), MAX_FACTOR)
        self._update_agility(measured_turn, predicted_turn)
        return True

    def _update_agility(self, turned: float, predicted: float) -> None:
        self._turn_variance += TURN_RANDOM_WALK_STD**2
        noise = TURN_NOISE**2 + (MODEL_NOISE * predicted) ** 2
        gain = self._turn_variance * predicted / (predicted**2 * self._turn_variance + noise)
        self.agility = min(max(self.agility * (1.0 + gain * (turned - predicted)), MIN_FACTOR), MAX_FACTOR)
        self._turn_variance *= 1.0 - gain * predicted


@njit(cache=True, error_model="numpy")
def _update(
    x: FloatArray, p: FloatArray, measured: FloatArray, predicted: FloatArray, duration: float, noise: float
) -> bool:
    """Do one Kalman update in place: measured = mobility * predicted + drift * duration; False for an outlier."""
    for a in range(3):
        p[a, a] += RANDOM_WALK_STD[a] ** 2
    h = np.zeros((2, 3))
    gain = np.zeros((3, 2))  # first P h^T
    for i in range(2):
        h[i, 0], h[i, 1 + i] = predicted[i], duration
        for a in range(3):
            gain[a, i] = p[a, 0] * h[i, 0] + p[a, 1 + i] * duration
    sxx = h[0, 0] * gain[0, 0] + duration * gain[1, 0] + noise
    sxy = h[0, 0] * gain[0, 1] + duration * gain[1, 1]
    syy = h[1, 0] * gain[0, 1] + duration * gain[2, 1] + noise
    det = sxx * syy - sxy * sxy
    mx, my = measured[0] - h[0, 0] * x[0] - duration * x[1], measured[1] - h[1, 0] * x[0] - duration * x[2]
    if (syy * mx * mx - 2.0 * sxy * mx * my + sxx * my * my) / det > MAX_MAHALANOBIS_SQUARED:
        return False
    old = p.copy()
    for a in range(3):
        kx, ky = (syy * gain[a, 0] - sxy * gain[a, 1]) / det, (sxx * gain[a, 1] - sxy * gain[a, 0]) / det
        x[a] += kx * mx + ky * my
        for b in range(3):
            p[a, b] = old[a, b] - kx * gain[b, 0] - ky * gain[b, 1]
    return True
