"""Tracks the robot: fuses poses with the motion that the windows should have caused."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from smolbot.arrays import FloatArray
from smolbot.motion.gradient import advance
from smolbot.motion.robot import Robot
from smolbot.poses import Pose
from smolbot.rotations import (
    matrix_from_quaternion,
    quaternion_from_rotation_vector,
    quaternion_product,
    rotation_error,
)
from smolbot.sensing import Device
from smolbot.shots import Actuate, Shot

if TYPE_CHECKING:
    from lookup_tables import FieldTable

GATE = 33.1
"""Squared Mahalanobis distance beyond which a pose is an outlier: chi-square of 6 degrees at 1e-5."""

MOTION_ERROR = 0.3
"""Share of a believed motion that is taken as its standard deviation: drag, gain, alignment."""

MODEL_FLOOR = np.array([5e-5, 5e-5, 5e-5, 4e-3, 4e-3, 4e-3])
"""What sensors slightly out of place leave in every pose, per axis (m, rad); noise does not show it."""

WANDER = np.array([5e-5, 5e-5, 3e-5, 2e-2, 2e-2, 2e-2])
"""Unexplained motion per square root of a second, per axis (m, rad), of a robot at a surface."""


_MODEL_FLOOR = np.diag(MODEL_FLOOR**2)
_EYE = np.eye(6)


@dataclass(frozen=True)
class _State:
    time: float
    position: FloatArray
    orientation: FloatArray
    covariance: FloatArray


class Tracker:
    """A Kalman filter on position and orientation.

    Prediction moves the believed pose through a shot's windows by the controller's motion model.
    Correction weighs a pose by its covariance, scaled by how surprising poses have been of late,
    since a fit cannot see mains noise in its own residuals. Outliers are gated; when several in a
    row agree with each other, they are believed and the track begins anew.

    Parameters
    ----------
    robot : Robot
    device : Device
    table : FieldTable or None
        Field of the actuation coils; without one, windows are taken to cause no motion.
    """

    def __init__(self, robot: Robot, device: Device, table: FieldTable | None) -> None:
        self._robot = robot
        self._device = device
        self._table = table
        self._state: _State | None = None
        self._candidate: Pose | None = None
        self._accepted = 0
        self._surprise = 1.0
        self._last: Pose | None = None
        self.misses = 0

    @property
    def pose(self) -> Pose | None:
        """The tracked pose as of the last update; None before the first."""
        return self._last

    @property
    def confirmed(self) -> bool:
        """True once two poses have agreed."""
        return self._accepted >= 2

    def pose_at(self, time: float) -> Pose:
        """The tracked pose carried on to `time` s, with nothing driven in between.

        Raises
        ------
        ValueError
            Before the first pose.
        """
        if self._last is None or self._state is None:
            raise ValueError("There is no pose yet to carry on.")
        wait = max(time - self._state.time, 0.0)
        covariance = self._state.covariance + np.diag(WANDER**2 * wait)
        return replace(self._last, time=time, covariance=covariance)

    def update(self, shot: Shot, pose: Pose | None) -> Pose | None:
        """Predict through a shot, then correct by the pose that it gave, if any.

        Returns
        -------
        Pose or None
            The tracked pose at the pose's time (or the shot's end), None before the first pose.
        """
        if self._state is None:
            if pose is not None and pose.trusted:
                self._begin(pose)
            else:
                self.misses += 1
            return self._last
        self._predict(shot, shot.end if pose is None else pose.time)
        believed = pose is not None and pose.trusted and self._correct(pose)
        if believed:
            self.misses = 0
            self._accepted += 1
            self._candidate = None
        else:
            self.misses += 1
            if pose is not None and pose.trusted:
                self._consider(pose)
        return self._publish(pose, believed)

    def _begin(self, pose: Pose) -> None:
        covariance = 4.0 * pose.covariance + np.diag(np.array([2e-4] * 3 + [2e-2] * 3) ** 2)
        self._state = _State(pose.time, np.array(pose.position), np.array(pose.orientation), covariance)
        self._accepted, self.misses, self._candidate = 1, 0, None
        self._publish(pose, True)

    def _consider(self, pose: Pose) -> None:
        """Begin anew where two gated poses in a row agree with each other."""
        other = self._candidate
        self._candidate = pose
        if other is None or self.misses < 3:
            return
        if (
            np.linalg.norm(pose.position - other.position) < 2e-3
            and np.dot(pose.orientation, other.orientation) ** 2 > 0.95
        ):
            self._begin(pose)

    def _predict(self, shot: Shot, time: float) -> None:
        state = self._state
        assert state is not None
        position, orientation = state.position.copy(), state.orientation
        noise = WANDER**2 * max(time - state.time, 0.0)
        for window in shot.windows:
            if not isinstance(window, Actuate) or self._table is None or not any(window.currents):
                continue
            if not self._table.contains(position[None, :])[0]:
                continue
            ahead = matrix_from_quaternion(orientation) @ self._device.moment_in_body
            heading = math.atan2(ahead[1], ahead[0])
            field, gradient = self._table.field_and_gradient(position[None, :])
            step, after = advance(
                self._robot, field[:, 0], gradient[:, 0], np.array(window.currents), heading, window.duration
            )
            turn = after - heading
            position[:2] += step
            orientation = quaternion_product(quaternion_from_rotation_vector(np.array([0.0, 0.0, turn])), orientation)
            noise[:2] += (MOTION_ERROR * np.linalg.norm(step)) ** 2
            noise[5] += (MOTION_ERROR * turn) ** 2
        self._state = _State(time, position, orientation, state.covariance + np.diag(noise))

    def _correct(self, pose: Pose) -> bool:
        state = self._state
        assert state is not None
        innovation = np.concatenate(
            [pose.position - state.position, rotation_error(pose.orientation, state.orientation)]
        )
        heard = self._surprise * pose.covariance + _MODEL_FLOOR
        inverse = np.linalg.inv(state.covariance + heard)
        distance = float(innovation @ inverse @ innovation)
        if distance > GATE:
            return False
        surprise = 0.95 * self._surprise + 0.05 * self._surprise * distance / 6.0
        self._surprise = float(np.clip(surprise, 1.0, 25.0))
        gain = state.covariance @ inverse
        change = gain @ innovation
        left = _EYE - gain
        covariance = left @ state.covariance @ left.T + gain @ heard @ gain.T
        orientation = quaternion_product(quaternion_from_rotation_vector(change[3:]), state.orientation)
        self._state = _State(
            state.time, state.position + change[:3], orientation / np.linalg.norm(orientation), covariance
        )
        return True

    def _publish(self, pose: Pose | None, believed: bool) -> Pose:
        state = self._state
        assert state is not None
        self._last = Pose(
            time=state.time,
            position=state.position,
            orientation=state.orientation,
            covariance=state.covariance,
            r_squared=pose.r_squared if pose is not None else 0.0,
            flip_margin=pose.flip_margin if pose is not None else 1.0,
            trusted=believed,
        )
        return self._last
