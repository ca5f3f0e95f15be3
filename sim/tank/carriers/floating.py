"""A floating robot: Bullet moves its housing under weight, buoyancy and drag."""

from __future__ import annotations

import math

import numpy as np

from sim.tank.carriers.bullet import Bodies
from sim.tank.carriers.carrier import Load, State
from sim.tank.carriers.hydrodynamics import DRAG, FLOW_X, SWIRL, TURN_DRAG, WEIGHT, Hull, compute_float_step
from sim.tank.mismatch import TankTruth
from sim.tank.settings import TankSettings
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import matrix_from_quaternion, quaternion_from_axes
from smolbot.core.shots import Window
from smolbot.errors import InputError


class Floating:
    """The carrier of a gradient-pulled robot; implements `sim.tank.carriers.carrier.Carrier`.

    Parameters
    ----------
    rig : RigConfig
    robot : RobotConfig
    settings : TankSettings
    truth : TankTruth
    start : ndarray, shape (2,), in m
        Requested start position (x, y), world frame.
    gui : bool
        Show Bullet's window.
    """

    def __init__(
        self, rig: RigConfig, robot: RobotConfig, settings: TankSettings, truth: TankTruth, start: FloatArray,
        *, gui: bool = False,
    ) -> None:  # fmt: skip
        self.hull = Hull.build(rig, robot, settings, truth)
        self._drags, self._flow = self.hull.values[DRAG:WEIGHT].copy(), self.hull.values[FLOW_X:SWIRL].copy()
        position, orientation = compute_start_pose(rig, robot, truth, self.hull, start)
        self.bodies = Bodies(rig, robot, position, orientation, friction=settings.wall_friction, gui=gui)
        self.read_state = self.bodies.read_state  # called 1000 times per second of flight: no layer between

    def begin_window(self, window: Window, time: float) -> None:
        """Do nothing: only the coils move this robot.

        Parameters
        ----------
        window : Window
        time : float, in s
        """

    def advance(self, state: State, magnetic: Load, time: float, step: float) -> None:
        """Advance by one step under the mean magnetic force and torque.

        Parameters
        ----------
        state : State
            As just read.
        magnetic : tuple of 6
            Force (N) and torque about the housing's middle (N·m), body frame.
        time : float, in s
        step : float, in s
        """
        position, quaternion, velocity, spin = state
        hull = self.hull
        velocity, spin = compute_float_step(
            position, quaternion, velocity, spin, magnetic, hull.values, hull.float_height, step
        )
        self.bodies.move(velocity, spin, step)

    def scale_drag(self, translation: float, rotation: float) -> None:
        """Set the drag to a multiple of what it was at the start.

        Parameters
        ----------
        translation, rotation : float
            Factors on the drag against translation and against rotation.
        """
        self.hull.values[DRAG:TURN_DRAG] = translation * self._drags[: TURN_DRAG - DRAG]
        self.hull.values[TURN_DRAG:WEIGHT] = rotation * self._drags[TURN_DRAG - DRAG :]

    def add_flow(self, x: float, y: float) -> None:
        """Set the liquid's flow to what it was at the start plus a uniform current.

        Parameters
        ----------
        x, y : float, in m/s
            World frame.
        """
        self.hull.values[FLOW_X:SWIRL] = self._flow + np.array([x, y])

    def close(self) -> None:
        """Release Bullet's world."""
        self.bodies.close()


def compute_start_pose(
    rig: RigConfig, robot: RobotConfig, truth: TankTruth, hull: Hull, start: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Compute the start pose of the housing: floating, level, near `start`, with a sampled heading.

    Parameters
    ----------
    rig : RigConfig
    robot : RobotConfig
    truth : TankTruth
    hull : Hull
    start : ndarray, shape (2,), in m
        Requested start position (x, y), world frame.

    Returns
    -------
    position : ndarray, shape (3,), in m
        Middle of the housing, world frame.
    orientation : ndarray, shape (4,)
        Unit quaternion, scalar first.

    Raises
    ------
    InputError
        If the robot does not fit into the container there.
    """
    requested = np.asarray(start, dtype=np.float64)[:2]
    away = np.abs(requested - rig.container.center)
    room = 0.5 * rig.container.size - np.hypot(robot.size[0], robot.size[2]) / 2
    if np.any(away > room):
        raise InputError(
            f"The robot must start within ±{1e3 * room[0]:.1f}, ±{1e3 * room[1]:.1f} mm of the container's middle; "
            f"got ({1e3 * requested[0]:.1f}, {1e3 * requested[1]:.1f}) mm."
        )
    heading = truth.start_heading
    ahead = np.array([math.cos(heading), math.sin(heading), 0.0])
    orientation = quaternion_from_axes(ahead, np.array([0.0, 0.0, 1.0]), "zy")
    middle = np.array([*(requested + truth.start_offset), 0.0]) + matrix_from_quaternion(orientation) @ robot.center
    middle[2] = hull.float_height
    return middle, orientation
