"""Learned motion model of a helix, updated at every pause: advance, steering, offset of the axis, drift."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.motion import helix_kernels as kernels
from smolbot.motion.helix import Helix

INITIAL_STD = np.array([0.08, 0.2, math.radians(3.0), 3e-5])
"""How far off beliefs may be, one sigma: advance and steering (shares), offset of the axis (rad), drift (m)."""

RANDOM_WALK_STD = np.array([0.01, 0.03, math.radians(0.5), 1e-5])
"""How far they change from one leg to the next: with the place under the magnet, and what the model leaves out."""

_FACTOR_STEPS = np.array([0.01, 0.02, math.radians(0.5), 1e-5])


@dataclass(frozen=True)
class Leg:
    """A part of a maneuver with constant course.

    Attributes
    ----------
    course : float, in rad
        Of the magnet's axis.
    sense : float
        1 forward, -1 back.
    turns : float
    frequency : float, in Hz
    """

    course: float
    sense: float
    turns: float
    frequency: float


class ScrewModel:
    """A helix whose advance, steering, axis offset and drift are learned by a Kalman filter over maneuvers.

    Parameters
    ----------
    helix : Helix
    heading_noise : float, in rad
        Standard deviation of the heading's random change in one turn.

    Attributes
    ----------
    factors : ndarray, shape (4,)
        In the order of `smolbot.motion.helix_kernels`.
    covariance : ndarray, shape (4, 4)
    heading_noise : float, in rad
    """

    def __init__(self, helix: Helix, heading_noise: float) -> None:
        self.helix = helix
        self.heading_noise = heading_noise
        self.factors = helix.factors.copy()
        self.covariance = np.diag(INITIAL_STD**2)

    def predict(self, state: FloatArray, legs: list[Leg], factors: FloatArray | None = None) -> FloatArray:
        """Predict the state after some legs, with the magnet's axis free before the first.

        Parameters
        ----------
        state : ndarray, shape (6,)
            As described in `smolbot.motion.helix_kernels`.
        legs : list of Leg
        factors : ndarray, shape (4,), optional
            Used in place of the learned ones.

        Returns
        -------
        ndarray, shape (6,)
        """
        out, used = state.copy(), self.factors if factors is None else factors
        out[kernels.COURSE] = np.nan
        for leg in legs:
            out = kernels.advance_screw(self.helix.body, used, out, leg.course, leg.sense, leg.turns, leg.frequency)
        return out

    def predict_covariance(self, state: FloatArray, legs: list[Leg], covariance: FloatArray) -> FloatArray:
        """Predict the covariance of the end of some legs.

        It combines the covariance of the pose, that of the learned factors, and the random changes of each turn.

        Parameters
        ----------
        state : ndarray, shape (6,)
            At the start.
        legs : list of Leg
        covariance : ndarray, shape (6, 6)
            Of the pose at the start, in m and rad.

        Returns
        -------
        ndarray, shape (3, 3), in m² and rad²
            Along and across the heading at the end, and of the heading.
        """
        end, frame, jacobian = self._compute_jacobian(state, legs)
        turns = sum(leg.turns for leg in legs)
        out = jacobian @ self.covariance @ jacobian.T
        out[:2, :2] += frame @ covariance[:2, :2] @ frame.T
        moved = frame @ (end[:2] - state[:2])
        lever = np.array([-moved[1], moved[0], 1.0])  # of a heading that is off at the start
        out += np.outer(lever, lever) * covariance[5, 5]
        chance = self.heading_noise**2 * turns
        out[1, 1] += chance * moved[0] ** 2 / 3.0
        out[1, 2] += chance * moved[0] / 2.0
        out[2, 1] += chance * moved[0] / 2.0
        out[2, 2] += chance
        out[0, 0] += (0.05 * self.helix.advance * turns) ** 2
        return out

    def learn(
        self, state: FloatArray, legs: list[Leg], measured: FloatArray, covariance: FloatArray, advance_std: float
    ) -> None:
        """Update the factors with the measured end of some legs.

        Parameters
        ----------
        state : ndarray, shape (6,)
            At the start.
        legs : list of Leg
        measured : ndarray, shape (6,)
            Measured at the end.
        covariance : ndarray, shape (6, 6)
            Of the measured pose, in m and rad.
        advance_std : float, in m
            Uncertainty of the advance, since the roll was not known at the start.
        """
        end, frame, jacobian = self._compute_jacobian(state, legs)
        turns = sum(leg.turns for leg in legs)
        off = np.append(
            frame @ (measured[:2] - end[:2]), kernels.wrap_angle(measured[kernels.HEADING] - end[kernels.HEADING])
        )
        length = self.helix.advance * turns
        noise = np.diag(
            [
                (0.05 * length) ** 2 + advance_std**2,
                self.heading_noise**2 * turns * length**2 / 3.0 + 1e-4**2,
                self.heading_noise**2 * turns + math.radians(1.0) ** 2,
            ]
        )
        noise[:2, :2] += 2.0 * frame @ covariance[:2, :2] @ frame.T
        noise[2, 2] += 2.0 * covariance[5, 5]
        prior = self.covariance + np.diag(RANDOM_WALK_STD**2)
        gain = prior @ jacobian.T @ np.linalg.inv(jacobian @ prior @ jacobian.T + noise)
        self.factors = self.factors + gain @ off
        self.factors[:2] = np.clip(self.factors[:2], 0.5 * self.helix.factors[:2], 2.0 * self.helix.factors[:2])
        left = np.eye(4) - gain @ jacobian
        self.covariance = left @ prior @ left.T + gain @ noise @ gain.T

    def _compute_jacobian(self, state: FloatArray, legs: list[Leg]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compute the end of some legs, the frame (2, 2) along and across there, and the end's derivatives (3, 4).

        Derivatives are for each factor; their rows are along, across and in heading.
        """
        end = self.predict(state, legs)
        forward = np.array([math.cos(end[kernels.HEADING]), math.sin(end[kernels.HEADING])])
        frame = np.array([forward, [-forward[1], forward[0]]])
        jacobian = np.empty((3, 4))
        for i, step in enumerate(_FACTOR_STEPS):
            factors = self.factors.copy()
            factors[i] += step
            other = self.predict(state, legs, factors)
            jacobian[:2, i] = frame @ (other[:2] - end[:2]) / step
            jacobian[2, i] = kernels.wrap_angle(other[kernels.HEADING] - end[kernels.HEADING]) / step
        return end, frame, jacobian
