"""A helix embedded in gel: it turns with the rotating magnet, and rests while the magnet is away."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sim.tank.carriers.carrier import Load, State
from sim.tank.carriers.gel import gel_kernels
from sim.tank.carriers.gel.mismatch import make_gel_generators, pack_cube, pack_gel, pack_inclusions, sample_gel
from sim.tank.magnetics.cantilever import MIDDLE
from sim.tank.magnetics.device_packing import pack_true_device
from sim.tank.mismatch import TankTruth
from sim.tank.settings import TankSettings
from smolbot.config.mismatch import MAX_SIGMAS
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import (
    matrix_from_quaternion,
    multiply_quaternions,
    quaternion_from_axes,
    quaternion_from_rotation_vector,
)
from smolbot.core.shots import MoveMagnet, Rotate, Window
from smolbot.errors import InputError


class Embedded:
    """The carrier of a helical robot; implements `sim.tank.carriers.carrier.MagnetDriven`.

    Parameters
    ----------
    rig : RigConfig
    robot : RobotConfig
    settings : TankSettings
    truth : TankTruth
    start : ndarray, shape (2,) or (3,)
        Requested start position (x, y in m) and, optionally, heading (rad), world frame.
    seed : int
    ideal : bool
        Sample no mismatch.

    Raises
    ------
    InputError
        If the robot does not fit into the container there.
    """

    def __init__(
        self, rig: RigConfig, robot: RobotConfig, settings: TankSettings, truth: TankTruth, start: FloatArray,
        seed: int, *, ideal: bool = False,
    ) -> None:  # fmt: skip
        draws, self._operator_rng = make_gel_generators(seed)
        own = sample_gel(settings, draws, ideal=ideal)
        self._truth = own
        self._device = pack_true_device(robot, settings, truth)
        self._gel = pack_gel(rig, robot, settings, own)
        self._cube = pack_cube(rig, own)
        self._inclusions = pack_inclusions(settings)
        self._lateness = 0.0 if ideal else settings.lateness
        self.longest_step = settings.gel.step
        self._steering_rate = rig.limits.max_steering_rate
        self._near, self._steered = False, False
        self._turn_rate, self._steer_to = 0.0, 0.0
        self._state = np.zeros(gel_kernels.GEL_STATE_LENGTH)
        self._load, self._moved = np.zeros(6), np.zeros(6)
        self._set_start_pose(rig, robot, truth, np.asarray(start, dtype=np.float64), own.start_heading, own.start_roll)
        middle = 0.5 * (self._gel[gel_kernels.LOW] + self._gel[gel_kernels.HIGH])
        self._state[2] = middle + own.start_height * (self._gel[gel_kernels.HIGH] - self._gel[gel_kernels.LOW])

    def read_state(self) -> State:
        """Return the present pose of the housing; in a gel the velocities are zero between steps.

        Returns
        -------
        State
        """
        s = self._state
        return (
            (float(s[0]), float(s[1]), float(s[2])),
            (float(s[3]), float(s[4]), float(s[5]), float(s[6])),
            (0.0, 0.0, 0.0),
            (0.0, 0.0, 0.0),
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the sampled parameters of gel, helix and magnet.

        Returns
        -------
        dict
            Plain lists and numbers.
        """
        return self._truth.as_dict()

    def sample_duration(self, window: Window) -> float:
        """Return the true duration of a window: an operator who moves the magnet may be late, never early.

        Parameters
        ----------
        window : Window

        Returns
        -------
        float, in s
        """
        if isinstance(window, MoveMagnet):
            late = abs(float(np.clip(self._operator_rng.standard_normal(), -MAX_SIGMAS, MAX_SIGMAS)))
            return window.duration * (1.0 + self._lateness * late)
        return window.duration

    def begin_window(self, window: Window, time: float) -> None:
        """Prepare a window. While the magnet is away its axis may take any heading at once.

        Parameters
        ----------
        window : Window
        time : float, in s
            Not used.
        """
        self._turn_rate = 0.0
        if isinstance(window, MoveMagnet):
            self._near, self._steered = window.to == "near" and self._near, False
        elif isinstance(window, Rotate):
            self._set_heading(math.atan2(window.axis[1], window.axis[0]), window.frequency)

    def end_window(self, window: Window) -> None:
        """End a window: a magnet that was being moved has arrived.

        Parameters
        ----------
        window : Window
        """
        if isinstance(window, MoveMagnet):
            self._near = window.to == "near"
        self._turn_rate = 0.0

    def _set_heading(self, heading: float, frequency: float) -> None:
        """Steer to `heading` (rad) and turn; if the opposite heading is nearer, steer there and turn the other way."""
        off = _wrap_angle(heading - float(self._state[gel_kernels.STEER]))
        backward = abs(off) > 0.5 * math.pi
        self._turn_rate = (-1.0 if backward else 1.0) * 2.0 * math.pi * frequency
        self._steer_to = heading + (math.pi if backward else 0.0)
        if not self._steered:
            self._state[gel_kernels.STEER] = self._steer_to
            self._steered = True

    def set_measured_magnet(self, turn: float, steering: float, near: bool, span: float) -> None:
        """Set the magnet's measured angles, which it reaches at the end of the next `span` s.

        Used where the magnet is measured instead of commanded.

        Parameters
        ----------
        turn : float, in rad
            About the magnet's axis.
        steering : float, in rad
            Heading of the axis.
        near : bool
            Whether the magnet is near.
        span : float, in s
        """
        if near and not self._near:
            self._state[gel_kernels.STEER], self._state[gel_kernels.TURN] = steering, turn
        self._near, self._steered = near, True
        off = _wrap_angle(steering - float(self._state[gel_kernels.STEER]))
        self._steer_to, self._steering_rate = steering, abs(off) / span
        self._turn_rate = (turn - float(self._state[gel_kernels.TURN])) / span

    def compute_magnet_field(self, points: FloatArray) -> FloatArray:
        """Compute the magnet's present field; zero while it is away.

        Parameters
        ----------
        points : ndarray, shape (n, 3), in m
            World frame.

        Returns
        -------
        ndarray, shape (n, 3), in T
            World frame.
        """
        field = np.zeros((len(points), 3))
        if self._near:
            gradient, work = np.empty((3, 3)), np.empty((4, 3, 3))
            steer, turn = float(self._state[gel_kernels.STEER]), float(self._state[gel_kernels.TURN])
            for point, b in zip(points, field, strict=True):
                gel_kernels.compute_magnet_field(point, self._cube, steer, turn, b, gradient, work)
        return field

    def advance_mechanical(self, step: float, poses: FloatArray) -> None:
        """Advance by as many steps as `poses` has rows.

        Parameters
        ----------
        step : float, in s
        poses : ndarray, shape (n, 7)
            Receives rotation centre (m) and orientation (scalar first), world frame.
        """
        if self._near:
            gel_kernels.advance_screw(
                self._state, self._device, self._gel, self._inclusions, self._cube,
                self._steer_to, self._steering_rate, self._turn_rate, step, poses,
            )  # fmt: skip
        else:
            turn = matrix_from_quaternion(self._state[3:7].copy())
            poses[:, :3] = self._state[:3] - turn @ self._device[MIDDLE : MIDDLE + 3]
            poses[:, 3:] = self._state[3:7]

    def advance(self, state: State, magnetic: Load, time: float, step: float) -> None:
        """Advance by one step: pulled by a near magnet at rest, else by the coils if they exceed the yield stress.

        Parameters
        ----------
        state : State
            Not used.
        magnetic : tuple of 6
            Force (N) and torque (N·m) of the coils, body frame.
        time : float, in s
            Not used.
        step : float, in s
        """
        if self._near:
            self.advance_mechanical(step, np.empty((1, 7)))
            return
        rotation = matrix_from_quaternion(self._state[3:7].copy())
        self._load[:3] = rotation @ magnetic[:3]
        self._load[3:] = rotation @ magnetic[3:]
        gel_kernels.compute_gel_flow(np.ascontiguousarray(rotation[:, 2]), self._load, self._gel, 1.0, 1.0, self._moved)
        if self._moved.any():
            gel_kernels.advance_pose(self._state, self._moved, step)

    def close(self) -> None:
        """Do nothing: there is no resource to release."""

    def _set_start_pose(
        self, rig: RigConfig, robot: RobotConfig, truth: TankTruth, start: FloatArray, off: float, roll: float
    ) -> None:
        away = np.abs(start[:2] - rig.container.center)
        room = 0.5 * rig.container.size - 0.5 * robot.size[2]
        if np.any(away > room):
            raise InputError(
                f"The robot must start within ±{1e3 * room[0]:.1f}, ±{1e3 * room[1]:.1f} mm of the container's middle; "
                f"got ({1e3 * start[0]:.1f}, {1e3 * start[1]:.1f}) mm."
            )
        heading = (float(start[2]) if len(start) > 2 else 0.0) + off
        ahead = np.array([math.cos(heading), math.sin(heading), 0.0])
        level = quaternion_from_axes(ahead, np.array([0.0, 0.0, 1.0]), "zx")
        orientation = multiply_quaternions(level, quaternion_from_rotation_vector(np.array([0.0, 0.0, roll])))
        center = np.array([*(start[:2] + truth.start_offset), 0.0])
        self._state[:3] = center + matrix_from_quaternion(orientation) @ robot.center
        self._state[3:7] = orientation


def _wrap_angle(angle: float) -> float:
    return math.remainder(angle, 2.0 * math.pi)
