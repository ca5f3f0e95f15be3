"""Estimates the sensors' deviations while a robot flies: pose and sensors in one Kalman filter.

Small deviations of the sensors bias every pose, and averaging does not remove that bias. But ten sensors measure
more than a pose needs, and a robot cannot jump while it only turns: over a hundred poses both facts separate the
sensors' errors from the robot's motion. Since an estimated pose is itself biased by the sensors, it must not be
treated as known. So the filter's state holds the pose, with the predicted motion, and the sensors together, and the
covariance between them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import FloatArray, freeze
from smolbot.core.pose import Pose
from smolbot.core.rotations import compute_rotation_error, multiply_quaternions, quaternion_from_rotation_vector
from smolbot.core.sensing import Device, SensorArray
from smolbot.errors import InputError
from smolbot.localization.array.fit import compute_transverse_axes
from smolbot.localization.array.terms import DEVIATIONS_OF_DEVICE, DEVIATIONS_PER_SENSOR, ArrayTerms

UPDATE_INTERVAL = 10
"""Recordings after which their information on the sensors is added, all at once: it costs as much as for one."""

MIN_POSE_CHANGE = 1.5e-5
"""Change of a pose, in m, from which a new array is built."""

AMPLITUDE_VARIATION = 0.02
"""Relative standard deviation of the amplitude from one shot to the next."""

MIN_SIGMAS = 4.0
"""Standard deviations by which chi-square must exceed its expectation under noise before sensors are corrected.

Without it, noise would move sensors whose positions are right."""

LEARNED = 0.5
"""Share of the prior variance below which a combination of deviations counts as measured."""

INITIAL_STD = np.array([3e-3] * 3 + [0.3] * 3 + [0.3])
"""Standard deviations at the start of a track: m, rad, share of the amplitude."""

MAX_MAHALANOBIS_SQUARED = 60.0
"""Squared Mahalanobis distance of a pose (7 degrees of freedom) above which it is rejected."""

MAX_REJECTED = 3
"""Poses rejected in a row after which the track restarts; what was learned of the sensors is kept."""

_POSE = 7
"""Length of the pose part of the state: position (3), rotation error (3), amplitude."""


@dataclass(frozen=True, eq=False)
class ArrayPrior:
    """The assumed array and device, and the covariance of their deviations from the true ones.

    Attributes
    ----------
    sensors, device : SensorArray, Device
        As assumed before anything is learned.
    covariance : ndarray, shape (6 * n + 2, 6 * n + 2)
        Of the deviations: for each sensor ln gain, two tilts (rad) and position (m); then ln moment, and l0 (m).
    frames : ndarray, shape (n, 2, 3)
        Directions of the tilts, perpendicular to each axis.
    """

    sensors: SensorArray
    device: Device
    covariance: FloatArray
    frames: FloatArray

    def __post_init__(self) -> None:
        n = DEVIATIONS_PER_SENSOR * len(self.sensors) + DEVIATIONS_OF_DEVICE
        if self.covariance.shape != (n, n):
            raise InputError(f"ArrayPrior covariance must have shape ({n}, {n}); got {self.covariance.shape}.")

    def make_array(self, deviations: FloatArray) -> SensorArray:
        """Make the array whose sensors deviate from the assumed ones.

        Parameters
        ----------
        deviations : ndarray, shape (DEVIATIONS_PER_SENSOR * n + DEVIATIONS_OF_DEVICE,)

        Returns
        -------
        SensorArray
        """
        by_sensor, s = deviations[:-DEVIATIONS_OF_DEVICE].reshape(-1, DEVIATIONS_PER_SENSOR), self.sensors
        gains = np.exp(by_sensor[:, 0]) * (1.0 if s.gains is None else s.gains)
        axes = s.axes + np.einsum("nj,njk->nk", by_sensor[:, 1:3], self.frames)
        return SensorArray(s.positions + by_sensor[:, 3:], axes, s.bandwidth, gains)

    def compute_moment_and_l0(self, deviations: FloatArray) -> tuple[float, float]:
        """Compute moment and l0 of a device that deviates from the assumed one.

        Parameters
        ----------
        deviations : ndarray, shape (DEVIATIONS_PER_SENSOR * n + DEVIATIONS_OF_DEVICE,)

        Returns
        -------
        moment : float, in A·m²
        l0 : float, in m
        """
        moment, l0 = self.device.moment * np.exp(deviations[-2]), self.device.l0 + deviations[-1]
        return float(moment), max(float(l0), 0.0)


def compute_tilt_frames(sensors: SensorArray) -> FloatArray:
    """Compute the directions of each sensor's tilts.

    Parameters
    ----------
    sensors : SensorArray

    Returns
    -------
    ndarray, shape (n, 2, 3)
    """
    return freeze(np.stack([compute_transverse_axes(axis) for axis in sensors.axes]))


class ArrayFilter:
    """Kalman filter of a device's position, orientation and amplitude, and of the deviations of sensors and device.

    For every recording, call `predict` with the predicted motion of the robot, then `update` with the recording's
    terms. When `update` returns True, enough was learned: use `sensors`, `moment` and `l0` from then on; later
    terms must come from fits with those.

    Parameters
    ----------
    prior : ArrayPrior

    Attributes
    ----------
    prior : ArrayPrior
    deviations : ndarray, shape (n,)
        Of sensors and device, as estimated.
    sensors, moment, l0 : SensorArray, float in A·m², float in m
        To be used, as of the last `update` that returned True.
    recordings : int
        Number of recordings used.
    """

    def __init__(self, prior: ArrayPrior) -> None:
        n = len(prior.covariance)
        self.prior = prior
        self.deviations = np.zeros(n)
        self.sensors, self.moment, self.l0 = prior.sensors, prior.device.moment, prior.device.l0
        self.recordings = 0
        self._applied = np.zeros(n)
        self._significant = False
        self._covariance = np.zeros((_POSE + n, _POSE + n))
        self._covariance[_POSE:, _POSE:] = prior.covariance
        self._position: FloatArray | None = None
        self._orientation = np.array([1.0, 0.0, 0.0, 0.0])
        self._amplitude = 0.0
        self._left_out = 0
        self._information, self._right, self._waiting = np.zeros((n, n)), np.zeros(n), 0

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the remaining deviations, shape (n, n)."""
        return self._covariance[_POSE:, _POSE:].copy()

    @property
    def applied(self) -> FloatArray:
        """Deviations (n,) that `sensors`, `moment` and `l0` take into account."""
        return self._applied

    def predict(self, step: FloatArray, turn: FloatArray, variance: FloatArray) -> None:
        """Predict: add the motion of the robot.

        Parameters
        ----------
        step : ndarray, shape (3,), in m, world frame
        turn : ndarray, shape (3,), in rad, world frame
        variance : ndarray, shape (6,), in m² and rad²
            Of both.
        """
        if self._position is None:
            return
        self._position = self._position + step
        self._orientation = multiply_quaternions(quaternion_from_rotation_vector(turn), self._orientation)
        index = np.arange(6)
        self._covariance[index, index] += variance

    def update(self, pose: Pose, terms: ArrayTerms) -> bool:
        """Update the filter with one recording.

        Parameters
        ----------
        pose : Pose
            Result of the fit, with the 180° ambiguity resolved.
        terms : ArrayTerms
            Of the same fit.

        Returns
        -------
        bool
            Whether the localizer's array and device should be replaced.
        """
        if self._position is None:
            self._restart(pose, terms)
        self._covariance[6, 6] += (AMPLITUDE_VARIATION * self._amplitude) ** 2
        if not self._update_pose(pose, terms):
            self._left_out += 1
            if self._left_out <= MAX_REJECTED:
                return False
            self._restart(pose, terms)
            self._update_pose(pose, terms)
        self._left_out = 0
        self.recordings += 1
        self._information += terms.information
        self._right += terms.right + terms.information @ self._applied
        self._waiting += 1
        if self._waiting < UPDATE_INTERVAL:
            return False
        self._update_deviations()
        self._significant = self._significant or is_significant(self.deviations, self.covariance, self.prior.covariance)
        if not self._significant:
            return False
        change = terms.sensitivity[:3] @ (self.deviations - self._applied)
        if not float(np.linalg.norm(change)) > MIN_POSE_CHANGE:
            return False
        self._applied = self.deviations.copy()
        self.sensors = self.prior.make_array(self._applied)
        self.moment, self.l0 = self.prior.compute_moment_and_l0(self._applied)
        return True

    def _restart(self, pose: Pose, terms: ArrayTerms) -> None:
        self._position, self._orientation = np.array(pose.position), np.array(pose.orientation)
        self._amplitude = terms.amplitude
        self._covariance[:_POSE] = 0.0
        self._covariance[:, :_POSE] = 0.0
        spread = INITIAL_STD.copy()
        spread[6] *= self._amplitude
        self._covariance[np.arange(_POSE), np.arange(_POSE)] = spread**2
        self._left_out = 0

    def _update_pose(self, pose: Pose, terms: ArrayTerms) -> bool:
        """Update with a pose; return False, with nothing changed, if it fails the gate."""
        assert self._position is not None
        unapplied = self.deviations - self._applied
        innovation = terms.pose + terms.sensitivity @ unapplied
        innovation[:3] += pose.position - self._position
        innovation[3:6] += compute_rotation_error(pose.orientation, self._orientation)
        innovation[6] += terms.amplitude - self._amplitude
        # found = true - sensitivity @ deviations: the measurement matrix is (1, -sensitivity)
        cross = self._covariance[:, :_POSE] - self._covariance[:, _POSE:] @ terms.sensitivity.T
        total = cross[:_POSE] - terms.sensitivity @ cross[_POSE:] + terms.covariance
        gain = np.linalg.solve(total, cross.T).T
        if not float(innovation @ np.linalg.solve(total, innovation)) < MAX_MAHALANOBIS_SQUARED:
            return False
        self._apply_change(gain @ innovation)
        self._covariance -= gain @ cross.T
        return True

    def _update_deviations(self) -> None:
        """Update the deviations with what no pose could explain in the recordings since the last time."""
        information, right = self._information, self._right
        n = len(right)
        toward = self._covariance[:, _POSE:]
        own = toward[_POSE:]
        # information update of the joint covariance: P - P H (1 + I P)^-1 I P
        change = np.linalg.solve(np.eye(n) + information @ own, information @ toward.T)
        self._covariance -= toward @ change
        self._covariance = 0.5 * (self._covariance + self._covariance.T)
        self._apply_change(self._covariance[:, _POSE:] @ (right - information @ self.deviations))
        self._information[:] = 0.0
        self._right[:] = 0.0
        self._waiting = 0

    def _apply_change(self, change: FloatArray) -> None:
        assert self._position is not None
        self._position = self._position + change[:3]
        self._orientation = multiply_quaternions(quaternion_from_rotation_vector(change[3:6]), self._orientation)
        self._orientation /= np.linalg.norm(self._orientation)
        self._amplitude += float(change[6])
        self.deviations = self.deviations + change[_POSE:]


def is_significant(deviations: FloatArray, covariance: FloatArray, prior: FloatArray) -> bool:
    """Return whether estimated deviations are significant: larger than noise alone would make them.

    Only directions are tested of which more is known now than before: there a deviation of zero would be estimated
    with a variance of v (1 - v), where v is the remaining part of a prior variance of one.

    Parameters
    ----------
    deviations : ndarray, shape (n,)
    covariance : ndarray, shape (n, n)
        Present covariance of the deviations.
    prior : ndarray, shape (n, n)
        Their covariance before anything was learned.

    Returns
    -------
    bool
    """
    # covariance in units of the prior: eigenvalues near 1 are directions of which nothing was learned
    own = np.sqrt(np.diag(prior))
    free = own > 0.0
    scale = own[free]
    values, vectors = np.linalg.eigh(covariance[np.ix_(free, free)] / np.outer(scale, scale))
    known = (values < LEARNED) & (values > 0.0)
    count = int(known.sum())
    if count == 0:
        return False
    components = vectors[:, known].T @ (deviations[free] / scale)
    square = float(np.sum(components**2 / (values[known] * (1.0 - values[known]))))
    return square > count + MIN_SIGMAS * math.sqrt(2.0 * count)
