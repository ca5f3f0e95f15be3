"""The tracker: a Kalman filter that fuses measured poses with the motion predicted for each shot."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from lookup_tables.errors import OutsideTableError
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.rotations import (
    choose_nearer_orientation,
    compute_rotation_error,
    matrix_from_quaternion,
    multiply_quaternions,
    quaternion_from_rotation_vector,
)
from smolbot.core.sensing import Device
from smolbot.core.shots import Actuate, Rotate, Shot
from smolbot.flight.tracking.kalman import predict, update
from smolbot.localization.estimator import Oscillation
from smolbot.motion.gradient import advance, compute_turn_variance
from smolbot.motion.helix import Helix
from smolbot.motion.robot import Robot

if TYPE_CHECKING:
    from lookup_tables import FieldTable
GATE = 33.1
"""Squared Mahalanobis distance beyond which a pose is an outlier: chi-square of 6 degrees at 1e-5."""

GATE_PER_DEGREE = 2.0
"""Growth of the gate with each further degree of freedom."""

START_COVARIANCE_FACTOR, START_FLOOR = 4.0, np.array([2e-4] * 3 + [2e-2] * 3)
"""Covariance of a new track relative to that of its first pose, and standard deviations (m, rad) added to it."""

START_AMPLITUDE, START_AMPLITUDE_STD = 0.75, 0.3
"""Amplitude of a new track and its standard deviation, as shares of the stops."""

RESTART_MISSES, RESTART_DISTANCE, RESTART_AGREEMENT = 3, 2e-3, 0.95
"""The track restarts after this many misses if two rejected poses agree: largest distance (m), and smallest squared
dot product of their quaternions."""

INNOVATION_OLD, INNOVATION_NEW, MAX_INNOVATION_SCALE = 0.95, 0.05, 25.0
"""Weights of old and new innovations in their exponential average, and the upper bound of that average."""

MOTION_ERROR_SHARE = 0.3
"""Standard deviation of a predicted motion, as a share of it: errors of drag, gain and alignment."""

MODEL_FLOOR = np.array([5e-5, 5e-5, 5e-5, 4e-3, 4e-3, 4e-3, 2e-3])
"""Standard deviation of every pose due to errors of the sensor array, per axis (m, rad, share of the amplitude)."""

PROCESS_NOISE_DENSITY = np.array([5e-5, 5e-5, 3e-5, 2e-2, 2e-2, 2e-2])
"""Process noise per square root of a second, per axis (m, rad), of a robot at a surface."""

SCREW_STEP_STD = np.array([0.35, 0.1, 0.1])
"""Standard deviation of a predicted advance of a helix, as shares of it: along the axis (step-out), sideways, up."""

MAGNET_MOVE_STD = 1e-3
"""Standard deviation (m) of a helix's advance while the magnet approaches and retracts: half a pitch."""

SCREW_TURN_STD = np.array([np.radians(180.0), np.radians(6.0), np.radians(5.0), 0.3])
"""Standard deviations after turns of a helix: roll (rad; unknown), elevation (rad), azimuth (rad), and azimuth as a
share of the predicted turn."""

MAX_START_ANGLE_STD = 0.6
"""Standard deviation of the orientation (rad) above which no fit starts from it."""

AMPLITUDE_STD = 0.02
"""Relative standard deviation of the drive's amplitude from one shot to the next."""

DRIFT_START_STD, DRIFT_NOISE_DENSITY = 3e-5, 1e-5
"""Initial standard deviation of the drift (m/s), and its process noise (m/s per square root of a second)."""

_P, _E, _A, _V = slice(0, 3), slice(3, 6), 6, slice(7, 10)
_SIZE = 10
_MODEL_FLOOR = np.diag(MODEL_FLOOR**2)


@dataclass(frozen=True)
class State:
    """Estimated state at one time.

    Attributes
    ----------
    time : float, in s
    position : ndarray, shape (3,), in m
        In the world frame.
    orientation : ndarray, shape (4,)
        Unit quaternion, scalar first, from body to world.
    amplitude : float
        Amplitude at the end of a drive, as a share of the device's `theta_max`.
    drift : ndarray, shape (3,), in m/s
        Steady velocity in the world frame.
    covariance : ndarray, shape (10, 10)
        Of (position, rotation error in the world frame in rad, amplitude, drift).
    """

    time: float
    position: FloatArray
    orientation: FloatArray
    amplitude: float
    drift: FloatArray
    covariance: FloatArray


class Tracker:
    """A Kalman filter on position, orientation, amplitude of the swing, and drift.

    The prediction moves the pose through a shot's windows by the controller's motion model.
    The update weighs a measured pose by its covariance, scaled by the innovations of recent poses,
    since the residuals of a fit do not show mains noise. Outliers are rejected; once two rejected
    poses in a row agree with each other, the track restarts from them.

    Parameters
    ----------
    robot : Robot, Helix or None
        A helix rests in its gel and moves in mechanical shots only; None for a device that is not steered.
    device : Device
    table : FieldTable or None
        Field of the actuation coils; without it, or without a robot, windows are assumed to cause no motion.

    Attributes
    ----------
    motion : tuple of ndarray, or None
        Predicted motion in the last shot: step (3,) in m, rotation (3,) in rad, and their variances (6,).

    Examples
    --------
    >>> import smolbot
    >>> tracker = smolbot.Tracker(None, smolbot.load_robot("marker").device, None)
    >>> tracker.pose is None  # before the first recording
    True
    """

    _motion_error_share = MOTION_ERROR_SHARE

    def __init__(self, robot: Robot | Helix | None, device: Device, table: FieldTable | None) -> None:
        self._robot = robot
        self._device = device
        self._table = table
        self._state: State | None = None
        self._candidate: Pose | None = None
        self._accepted = 0
        self._innovation_scale = 1.0
        self._embedded = isinstance(robot, Helix)
        self._last: Pose | None = None
        self._innovation: tuple[float, FloatArray] | None = None
        self.motion: tuple[FloatArray, FloatArray, FloatArray] | None = None
        self.misses = 0

    @property
    def pose(self) -> Pose | None:
        """The tracked pose as of the last update; None before the first."""
        return self._last

    @property
    def orientation_uncertain(self) -> bool:
        """True if the orientation is too uncertain to start a fit from, such as a helix's roll after a turn."""
        if self._state is None or not self._embedded:
            return False
        return bool(np.max(np.diag(self._state.covariance)[_E]) > MAX_START_ANGLE_STD**2)

    @property
    def confirmed(self) -> bool:
        """True once two poses have agreed."""
        return self._accepted >= 2

    @property
    def amplitude(self) -> tuple[float, float] | None:
        """Amplitude at the end of a drive and its standard deviation, in rad; None before it was measured."""
        if self._state is None or not np.isfinite(self._state.amplitude):
            return None
        top = self._device.theta_max
        return self._state.amplitude * top, math.sqrt(self._state.covariance[_A, _A]) * top

    @property
    def drift(self) -> FloatArray:
        """Steady velocity (3,), in m/s, in the world frame, that is not caused by windows."""
        return np.zeros(3) if self._state is None else self._state.drift.copy()

    @property
    def learned(self) -> bool:
        """Whether gains and drift are learned in flight, since the assumed ones do not hold."""
        return False

    @property
    def gains(self) -> FloatArray:
        """Factors (n_coils,) on the currents with which the assumed robot would move as the true one does."""
        return np.ones(0 if self._table is None else self._table.n_coils)

    def compute_log_likelihood(self) -> float:
        """Compute the log-likelihood of the pose of the last update before it was used.

            l = -(d^2 + ln det S) / 2

        with its squared Mahalanobis distance d^2 and the covariance S of the innovation.

        Returns
        -------
        float
            Up to a constant; nan if the last update had no trusted pose to compare.
        """
        if self._innovation is None:
            return math.nan
        distance, covariance = self._innovation
        return -0.5 * (distance + float(np.linalg.slogdet(covariance)[1]))

    def pose_at(self, time: float) -> Pose:
        """Predict the tracked pose at a time, with nothing driven in between.

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
        covariance = self._state.covariance[:6, :6] + np.diag(PROCESS_NOISE_DENSITY**2 * wait * (not self._embedded))
        position = self._state.position + wait * self._state.drift
        return replace(self._last, time=time, position=position, covariance=covariance)

    def update(self, shot: Shot, pose: Pose | None, swing: Oscillation | None = None) -> Pose | None:
        """Predict the state through a shot, then update it with the measured pose, if there is one.

        Parameters
        ----------
        shot : Shot
            The shot that was played.
        pose : Pose or None
            As located in the shot's recording.
        swing : Oscillation, optional
            Amplitude that was estimated with the pose; the two are correlated.

        Returns
        -------
        Pose or None
            The tracked pose at the pose's time (or the shot's end), None before the first pose.
            A shot without a listening window moves the robot, but does not count as a miss.
        """
        self._innovation = None
        if shot.listen is None:
            if self._state is not None and self._last is not None:
                self._predict(shot, shot.end)
                self._publish(self._last, self._last.trusted)
            return self._last
        if self._state is None:
            if pose is not None and pose.trusted:
                self._begin(pose)
            else:
                self.misses += 1
            return self._last
        self._predict(shot, shot.end if pose is None else pose.time)
        if pose is not None and self._device.along_cantilever:  # found without a prior, it may be flipped
            nearer = choose_nearer_orientation(pose.orientation, self._state.orientation)
            pose = pose if nearer is pose.orientation else replace(pose, orientation=nearer)
        accepted = pose is not None and pose.trusted and self._apply_measurement(pose, swing)
        if accepted:
            self.misses = 0
            self._accepted += 1
            self._candidate = None
        else:
            self.misses += 1
            if pose is not None and pose.trusted:
                self._restart_if_two_agree(pose)
        return self._publish(pose, accepted)

    def _begin(self, pose: Pose) -> None:
        covariance = np.zeros((_SIZE, _SIZE))
        covariance[:6, :6] = START_COVARIANCE_FACTOR * pose.covariance + np.diag(START_FLOOR**2)
        covariance[_A, _A] = START_AMPLITUDE_STD**2
        covariance[_V, _V] = DRIFT_START_STD**2 * np.eye(3) * (not self._embedded)
        place = np.array(pose.position), np.array(pose.orientation)
        self._state = State(pose.time, *place, START_AMPLITUDE, np.zeros(3), covariance)
        self._accepted, self.misses, self._candidate = 1, 0, None
        self._publish(pose, True)

    def _restart_if_two_agree(self, pose: Pose) -> None:
        """Restart the track if two rejected poses in a row agree with each other."""
        other = self._candidate
        self._candidate = pose
        if other is None or self.misses < RESTART_MISSES:
            return
        orientation = pose.orientation
        if self._device.along_cantilever:
            orientation = choose_nearer_orientation(orientation, other.orientation)
        near = np.linalg.norm(pose.position - other.position) < RESTART_DISTANCE
        if near and np.dot(orientation, other.orientation) ** 2 > RESTART_AGREEMENT:
            self._begin(pose)

    def _predict(self, shot: Shot, time: float) -> None:
        state = self._state
        assert state is not None
        wait = max(time - state.time, 0.0)
        position, orientation = state.position + wait * state.drift, state.orientation
        noise = np.zeros(_SIZE)
        noise[_A] = AMPLITUDE_STD**2
        if isinstance(self._robot, Helix):
            self._predict_helix(self._robot, shot, time, noise)
            return
        noise[:6] = PROCESS_NOISE_DENSITY**2 * wait
        noise[_V] = DRIFT_NOISE_DENSITY**2 * wait
        for window in shot.windows:
            if isinstance(window, Actuate) and any(window.currents):
                orientation = self._move_by_window(window, position, orientation, noise)
        self.motion = (
            position - state.position,
            compute_rotation_error(orientation, state.orientation),
            noise[:6].copy(),
        )
        covariance = self._predict_covariance(state.covariance, wait, noise)
        self._state = replace(state, time=time, position=position, orientation=orientation, covariance=covariance)

    def _move_by_window(
        self, window: Actuate, position: FloatArray, orientation: FloatArray, noise: FloatArray
    ) -> FloatArray:
        """Move `position` through a window and add to the variances `noise`, in place; return the new orientation."""
        state, robot = self._state, self._robot
        assert state is not None
        if self._table is None or not isinstance(robot, Robot):
            return orientation
        try:
            field, gradient = self._table.field_and_gradient(position[None, :])
        except OutsideTableError:
            return orientation
        ahead = matrix_from_quaternion(orientation) @ self._device.moment_in_body
        heading = math.atan2(ahead[1], ahead[0])
        here = field[:, 0], gradient[:, 0], np.array(window.currents), heading, window.duration
        step, turn = self._compute_motion(robot, *here)
        position[:2] += step
        noise[:2] += self._motion_error_share**2 * (step[0] * step[0] + step[1] * step[1])
        noise[5] += (MOTION_ERROR_SHARE * turn) ** 2
        noise[5] += compute_turn_variance(robot, *here, state.covariance[5, 5])
        return multiply_quaternions(quaternion_from_rotation_vector(np.array([0.0, 0.0, turn])), orientation)

    def _compute_motion(
        self,
        robot: Robot,
        field: FloatArray,
        gradient: FloatArray,
        currents: FloatArray,
        heading: float,
        duration: float,
    ) -> tuple[FloatArray, float]:
        """Compute step (2,) in m and turn in rad of one window."""
        step, after = advance(robot, field, gradient, currents, heading, duration)
        return step, after - heading

    def _predict_covariance(self, covariance: FloatArray, wait: float, noise: FloatArray) -> FloatArray:
        """Predict the covariance `wait` s ahead; `noise` (10,) holds variances."""
        return predict(covariance, wait, noise)

    def _predict_helix(self, helix: Helix, shot: Shot, time: float, noise: FloatArray) -> None:
        """Predict the motion of a helix in a shot: it rests, unless the magnet turns."""
        state = self._state
        assert state is not None
        covariance = state.covariance.copy()
        position, orientation = state.position, state.orientation
        if any(isinstance(window, Rotate) for window in shot.windows):
            position, orientation, turns, turned = helix.carry(shot.windows, position, orientation)
            frame = matrix_from_quaternion(orientation)
            ahead = frame[:, 2]
            left = np.array([-ahead[1], ahead[0], 0.0]) / math.hypot(ahead[0], ahead[1])
            axes = np.column_stack([ahead, left, np.cross(ahead, left)])
            places = SCREW_STEP_STD * turns * helix.advance
            places[0] = math.hypot(places[0], MAGNET_MOVE_STD)
            turning = np.array(
                [SCREW_TURN_STD[0], SCREW_TURN_STD[1], math.hypot(SCREW_TURN_STD[2], SCREW_TURN_STD[3] * turned)]
            )
            covariance[_P, _P] += axes @ np.diag(places**2) @ axes.T
            covariance[_E, _E] += axes @ np.diag(turning**2) @ axes.T
        covariance[np.arange(_SIZE), np.arange(_SIZE)] += noise
        self._state = State(time, position, orientation, state.amplitude, state.drift, covariance)

    def _apply_measurement(self, pose: Pose, swing: Oscillation | None) -> bool:
        state = self._state
        assert state is not None
        turned = compute_rotation_error(pose.orientation, state.orientation)
        innovation = np.empty(6 if swing is None else 7)
        innovation[_P], innovation[_E] = pose.position - state.position, turned
        if swing is None:
            measurement_covariance = self._innovation_scale * pose.covariance + _MODEL_FLOOR[:6, :6]
        else:
            top = self._device.theta_max
            innovation[_A] = swing.amplitude / top - state.amplitude
            measurement_covariance = self._innovation_scale * swing.covariance
            measurement_covariance[_A] /= top
            measurement_covariance[:, _A] /= top
            measurement_covariance += _MODEL_FLOOR
        m = len(innovation)
        distance, change, covariance = update(state.covariance, measurement_covariance, innovation)
        self._innovation = distance, state.covariance[:m, :m] + measurement_covariance
        if not distance <= GATE + GATE_PER_DEGREE * (m - 6):
            return False
        scale = INNOVATION_OLD * self._innovation_scale + INNOVATION_NEW * self._innovation_scale * distance / m
        self._innovation_scale = min(max(scale, 1.0), MAX_INNOVATION_SCALE)
        orientation = multiply_quaternions(quaternion_from_rotation_vector(change[_E]), state.orientation)
        self._state = replace(
            state,
            position=state.position + change[_P],
            orientation=orientation / math.sqrt(orientation @ orientation),
            amplitude=state.amplitude + float(change[_A]),
            drift=state.drift + change[_V],
            covariance=covariance,
        )
        self._update_further_states(change)
        return True

    def _update_further_states(self, change: FloatArray) -> None:
        """Update further states that a subclass has; here there are none."""

    def _publish(self, pose: Pose | None, accepted: bool) -> Pose:
        state = self._state
        assert state is not None
        self._last = Pose(
            time=state.time,
            position=state.position,
            orientation=state.orientation,
            covariance=state.covariance[:6, :6],
            r_squared=pose.r_squared if pose is not None else 0.0,
            flip_margin=pose.flip_margin if pose is not None else 1.0,
            trusted=accepted,
        )
        return self._last
