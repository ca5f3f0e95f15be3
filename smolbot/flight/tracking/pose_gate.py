"""Gate of located poses: a robot cannot be outside its container, nor farther away than it can have moved."""

from __future__ import annotations

import math

import numpy as np

from lookup_tables.errors import OutsideTableError
from lookup_tables.table import FieldTable
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.rotations import choose_nearer_orientation, compute_rotation_error
from smolbot.core.shots import Actuate, Rotate, Shot
from smolbot.motion.helix import Helix
from smolbot.motion.robot import Robot

BOX_MARGIN = 5e-3
"""Distance, in m, outside the allowed box up to which a pose can be one. A robot that really leaves the box is found
within it, and ends the run."""

SPEED_FACTOR = 2.0
"""Highest speed of a robot relative to the one that the model predicts at most: drag may be half of what is assumed."""

DRIFT_SPEED = 2e-3
"""Speed, in m/s, of a robot that nothing drives: flow in the liquid."""

MAGNET_MOVE = 2e-3
"""Distance, in m, by which a magnet may pull a helix while it approaches and retracts."""

MIN_SIGMAS = 5.0
"""Standard deviations by which a pose must be too far away."""

GROSS_DISTANCE, GROSS_TURN = 1.5e-3, math.radians(60.0)
"""Distance, in m, and angle, in rad, from the track beyond which a pose that the tracker rejects is wrong, and not just
uncertain."""

Bounds = tuple[tuple[float, float, float], tuple[float, float, float]]


class PoseGate:
    """Finds poses that cannot be: outside the container, or farther from the track than the robot can have moved.

    Parameters
    ----------
    box : tuple of two tuples, in m, or None
        Lowest and highest corner, in the world frame, of where the robot may be; None for no bound.
    robot : Robot, Helix or None
        None for a device that is not steered: its speed has no bound.
    table : FieldTable or None
        Field of the actuation coils.
    """

    def __init__(self, box: Bounds | None, robot: Robot | Helix | None, table: FieldTable | None) -> None:
        self._box = box
        self._robot = robot
        self._table = table
        self._reach = 0.0

    def add_shot(self, shot: Shot, position: FloatArray | None) -> None:
        """Add a shot in which the robot may have moved.

        Parameters
        ----------
        shot : Shot
        position : ndarray, shape (3,), in m, or None
            Of the robot at its start, if it is known.
        """
        self._reach += DRIFT_SPEED * shot.duration + self._bound_step(shot, position)

    def accept(self) -> None:
        """Count the way of the robot from here on: its pose was found."""
        self._reach = 0.0

    def find_objection(self, pose: Pose, predicted: Pose | None) -> str:
        """Find why a pose cannot be.

        Parameters
        ----------
        pose : Pose
        predicted : Pose or None
            Tracked pose before the shot; None if there is none to rely on.

        Returns
        -------
        str
            Empty if there is no reason.
        """
        if self._box is not None:
            for axis, at, low, high in zip("xyz", pose.position, *self._box, strict=True):
                if not low - BOX_MARGIN <= at <= high + BOX_MARGIN:
                    return (
                        f"the pose is outside the container: {axis} = {1e3 * at:.1f} mm, and the robot may be from "
                        f"{1e3 * low:.1f} to {1e3 * high:.1f} mm"
                    )
        if predicted is None or self._robot is None:
            return ""
        way = pose.position - predicted.position
        distance = float(np.linalg.norm(way))
        if distance <= self._reach:
            return ""
        along = way / distance
        variance = float(along @ (predicted.covariance[:3, :3] + pose.covariance[:3, :3]) @ along)
        if distance <= self._reach + MIN_SIGMAS * math.sqrt(max(variance, 0.0)):
            return ""
        return (
            f"the pose is {1e3 * distance:.1f} mm from where the robot was, which can have moved by at most "
            f"{1e3 * self._reach:.1f} mm"
        )

    def _bound_step(self, shot: Shot, position: FloatArray | None) -> float:
        """Return the longest way, in m, that the windows of a shot can move the robot; infinite if there is none."""
        robot = self._robot
        driving = [w for w in shot.windows if isinstance(w, Rotate) or (isinstance(w, Actuate) and any(w.currents))]
        if not driving or robot is None:
            return 0.0
        if isinstance(robot, Helix):
            turns = sum(w.turns for w in driving if isinstance(w, Rotate))
            return SPEED_FACTOR * turns * robot.advance + MAGNET_MOVE
        if self._table is None or position is None:
            return math.inf
        try:
            gradients = self._table.gradient(position[None, :])[:, 0]
        except OutsideTableError:
            return math.inf
        # F_i = m_j dB_j/dx_i: at most the moment times the largest singular value of the total gradient
        step = 0.0
        for window in driving:
            if isinstance(window, Actuate):
                steepest = float(np.linalg.norm(np.tensordot(np.array(window.currents), gradients, axes=1), 2))
                step += robot.moment * steepest / robot.drag * window.duration
        return SPEED_FACTOR * step


def find_gross_error(pose: Pose, tracked: Pose, *, along_cantilever: bool) -> str:
    """Find whether a pose that the tracker has rejected is far from the track, such as one turned the wrong way round.

    Parameters
    ----------
    pose : Pose
    tracked : Pose
        At the same time.
    along_cantilever : bool
        Whether the device's moment lies along its cantilever, so that half a turn about it is no error.

    Returns
    -------
    str
        How far it is; empty if it is near.
    """
    distance = float(np.linalg.norm(pose.position - tracked.position))
    orientation = pose.orientation
    if along_cantilever:
        orientation = choose_nearer_orientation(orientation, tracked.orientation)
    turn = float(np.linalg.norm(compute_rotation_error(orientation, tracked.orientation)))
    if distance <= GROSS_DISTANCE and turn <= GROSS_TURN:
        return ""
    return f"the pose is {1e3 * distance:.1f} mm and {math.degrees(turn):.0f}° from the track, which rejects it"
