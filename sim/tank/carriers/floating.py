"""A robot afloat: Bullet moves its housing, the liquid brakes and carries it."""

from __future__ import annotations

import math

import numpy as np

from sim.tank.carriers.bullet import Bodies
from sim.tank.carriers.carrier import Magnetic, State
from sim.tank.carriers.hydrodynamics import Hull, float_step
from sim.tank.mismatch import Truth
from sim.tank.settings import TankSettings
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import matrix_from_quaternion, quaternion_from_axes
from smolbot.core.shots import Window
from smolbot.errors import InputError


class Floating:
    """The carrier of a gradient-pulled robot; keeps the promise of `sim.tank.carriers.carrier.Carrier`."""

    def __init__(
        self, rig: RigConfig, robot: RobotConfig, settings: TankSettings, truth: Truth, start: FloatArray,
        *, gui: bool = False,
    ) -> None:  # fmt: skip
        self.hull = Hull.build(rig, robot, settings, truth)
        position, orientation = put_down(rig, robot, truth, self.hull, start)
        self.bodies = Bodies(rig, robot, position, orientation, friction=settings.wall_friction, gui=gui)
        self.state = self.bodies.state  # called 1000 times per second of flight: no layer between

    def begin(self, window: Window, time: float) -> None:
        """Nothing but the coils moves this robot."""

    def advance(self, state: State, magnetic: Magnetic, time: float, step: float) -> None:
        """One step under the mean force and torque `magnetic`."""
        position, quaternion, velocity, spin = state
        hull = self.hull
        velocity, spin = float_step(
            position, quaternion, velocity, spin, magnetic, hull.values, hull.float_height, step
        )
        self.bodies.move(velocity, spin, step)

    def close(self) -> None:
        """Let go of Bullet's world."""
        self.bodies.close()


def put_down(
    rig: RigConfig, robot: RobotConfig, truth: Truth, hull: Hull, start: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Middle (3,) in m and orientation (4,) of the housing: afloat, level, near `start` (m), its heading drawn."""
    wanted = np.asarray(start, dtype=np.float64)[:2]
    away = np.abs(wanted - rig.container.center)
    room = 0.5 * rig.container.size - np.hypot(robot.size[0], robot.size[2]) / 2
    if np.any(away > room):
        raise InputError(
            f"The robot must start within ±{1e3 * room[0]:.1f}, ±{1e3 * room[1]:.1f} mm of the container's middle; "
            f"got ({1e3 * wanted[0]:.1f}, {1e3 * wanted[1]:.1f}) mm."
        )
    heading = truth.start_heading
    ahead = np.array([math.cos(heading), math.sin(heading), 0.0])
    orientation = quaternion_from_axes(ahead, np.array([0.0, 0.0, 1.0]), "zy")
    middle = np.array([*(wanted + truth.start_offset), 0.0]) + matrix_from_quaternion(orientation) @ robot.center
    middle[2] = hull.float_height
    return middle, orientation
