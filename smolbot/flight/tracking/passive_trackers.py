"""Trackers of devices that are not steered: one guided externally, or one located independently in each shot."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.rotations import compute_rotation_error, multiply_quaternions, quaternion_from_rotation_vector
from smolbot.core.sensing import Device
from smolbot.core.shots import Shot
from smolbot.flight.tracking.tracker import AMPLITUDE_STD, PROCESS_NOISE_DENSITY, State, Tracker
from smolbot.localization.estimator import Oscillation
from smolbot.motion.external_motion import ExternalMotion

_P, _E, _A, _V, _W = slice(0, 3), slice(3, 6), 6, slice(7, 10), slice(10, 13)
_SIZE = 13
_EYE = np.eye(3)


@dataclass(frozen=True)
class VelocityState(State):
    """Tracker state with a turn rate.

    The drift is the velocity; the covariance is (13, 13), with the turn rate last.

    Attributes
    ----------
    turn_rate : ndarray, shape (3,), in rad/s
        Turn rate in the world frame.
    """

    turn_rate: FloatArray = field(default_factory=lambda: np.zeros(3))


class VelocityTracker(Tracker):
    """Tracker of a device that is guided externally, with velocity and turn rate as states.

    The windows of a shot are assumed to move nothing.

    Parameters
    ----------
    device : Device
    motion : ExternalMotion
        Typical speed, turn rate and correlation time of the motion.
    """

    _state: VelocityState | None

    def __init__(self, device: Device, motion: ExternalMotion) -> None:
        super().__init__(None, device, None)
        self._motion = motion

    @property
    def turn_rate(self) -> FloatArray:
        """Turn rate (3,), in rad/s, in the world frame."""
        return np.zeros(3) if self._state is None else self._state.turn_rate.copy()

    def pose_at(self, time: float) -> Pose:
        """Predict the tracked pose from its velocity and turn rate.

        Parameters
        ----------
        time : float, in s
            On the rig's clock.

        Returns
        -------
        Pose

        Raises
        ------
        ValueError
            Before the first pose.
        """
        if self._last is None or self._state is None:
            raise ValueError("There is no pose yet to predict from.")
        wait = max(time - self._state.time, 0.0)
        state = self._extrapolate(self._state, wait)
        covariance = state.covariance[:6, :6] + np.diag(PROCESS_NOISE_DENSITY**2 * wait)
        return replace(
            self._last, time=time, position=state.position, orientation=state.orientation, covariance=covariance
        )

    def _begin(self, pose: Pose) -> None:
        super()._begin(pose)
        state = self._state
        assert state is not None
        covariance = np.zeros((_SIZE, _SIZE))
        covariance[:7, :7] = state.covariance[:7, :7]
        covariance[_V, _V] = self._motion.speed**2 * _EYE
        covariance[_W, _W] = self._motion.turn_rate**2 * _EYE
        self._state = VelocityState(
            state.time, state.position, state.orientation, state.amplitude, np.zeros(3), covariance
        )

    def _predict(self, shot: Shot, time: float) -> None:
        state = self._state
        assert state is not None
        wait = max(time - state.time, 0.0)
        noise = np.zeros(_SIZE)
        noise[:6] = PROCESS_NOISE_DENSITY**2 * wait
        noise[_A] = AMPLITUDE_STD**2
        ahead = self._extrapolate(state, wait)
        turned = compute_rotation_error(ahead.orientation, state.orientation)
        path = (
            self._motion.compute_process_noise(wait)[0]
            * np.repeat([self._motion.speed, self._motion.turn_rate], 3) ** 2
        )
        self.motion = ahead.position - state.position, turned, noise[:6] + path
        self._state = replace(ahead, time=time, covariance=ahead.covariance + np.diag(noise))

    def _update_further_states(self, change: FloatArray) -> None:
        assert self._state is not None
        self._state = replace(self._state, turn_rate=self._state.turn_rate + change[_W])

    def _extrapolate(self, state: VelocityState, wait: float) -> VelocityState:
        """Predict the state `wait` s ahead from its velocity and turn rate, with the added uncertainty."""
        kept, carried = self._motion.compute_decay(wait)
        turned = multiply_quaternions(quaternion_from_rotation_vector(carried * state.turn_rate), state.orientation)
        path, crossed, rate = self._motion.compute_process_noise(wait)
        through, noise = np.eye(_SIZE), np.zeros((_SIZE, _SIZE))
        for place, speed, size in ((_P, _V, self._motion.speed), (_E, _W, self._motion.turn_rate)):
            through[place, speed], through[speed, speed] = carried * _EYE, kept * _EYE
            noise[place, place], noise[speed, speed] = path * size**2 * _EYE, rate * size**2 * _EYE
            noise[place, speed] = noise[speed, place] = crossed * size**2 * _EYE
        return replace(
            state,
            position=state.position + carried * state.drift,
            orientation=turned / math.sqrt(turned @ turned),
            drift=kept * state.drift,
            turn_rate=kept * state.turn_rate,
            covariance=through @ state.covariance @ through.T + noise,
        )


class SingleShotTracker(Tracker):
    """Tracker for independent measurements: it keeps a pose for one shot only.

    A search ends with a pose, which aims the next excitation. The pose of that next shot is a measurement, after
    which the state is cleared.

    Parameters
    ----------
    device : Device

    Attributes
    ----------
    measurements : int
        Number of measurements.
    """

    def __init__(self, device: Device) -> None:
        super().__init__(None, device, None)
        self.measurements = 0

    def update(self, shot: Shot, pose: Pose | None, swing: Oscillation | None = None) -> Pose | None:
        """Keep the pose that ends a search; return the pose of a measurement, and clear the state.

        Parameters
        ----------
        shot : Shot
        pose : Pose or None
            As located. A measurement without a trusted pose is a miss.
        swing : Oscillation, optional
            Amplitude that was estimated with the pose.

        Returns
        -------
        Pose or None
        """
        if self._state is None:
            misses = self.misses
            found = super().update(shot, pose, swing)
            self.misses = misses if found is not None else self.misses  # a search alone is no success
            return found
        self._state = self._last = None
        if pose is None or not pose.trusted:
            self.misses += 1
            return None
        self.misses = 0
        self.measurements += 1
        return pose
