"""The rigid bodies: Bullet moves the robot and keeps it inside the container.

Bullet is made for objects of 0.05 to 10 m, so its world is scaled: a millimetre counts as a metre and a milligram
as a kilogram; seconds stay. All conversions are in this file; everything outside it is SI.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError, RigError

LENGTH = 1e3  # Bullet units per metre: its tolerances are for bodies of about 1
MASS = 1e6  # Bullet units per kilogram
WALL = 10.0  # thickness of walls and floor, in Bullet units
Triple = tuple[float, float, float]
Quadruple = tuple[float, float, float, float]


class Bodies:
    """Container and robot in one Bullet world. The origin of the robot's frame is the middle of its housing.

    Parameters
    ----------
    rig, robot : RigConfig, RobotConfig
    position : ndarray, shape (3,), in m
        Middle of the housing, world frame.
    orientation : ndarray, shape (4,)
        Unit quaternion, scalar first.
    friction : float
        Coefficient between robot and walls.
    gui : bool
        Show Bullet's own window.

    Raises
    ------
    InputError
        If the window is requested and there is no display.
    RigError
        If Bullet cannot open a world.
    """

    def __init__(
        self,
        rig: RigConfig,
        robot: RobotConfig,
        position: FloatArray,
        orientation: FloatArray,
        *,
        friction: float = 0.1,
        gui: bool = False,
    ) -> None:
        import pybullet

        if gui and not os.environ.get("DISPLAY"):
            raise InputError(
                "Bullet's window needs a display, and DISPLAY is not set; omit gui to run without a window."
            )
        self._bullet = pybullet
        self._client = pybullet.connect(pybullet.GUI if gui else pybullet.DIRECT)
        if self._client < 0:
            raise RigError("Bullet could not open a world.")
        pybullet.setGravity(0, 0, 0, physicsClientId=self._client)  # weight is one of the tank's forces
        pybullet.setPhysicsEngineParameter(numSubSteps=0, deterministicOverlappingPairs=1, physicsClientId=self._client)
        self._build_container(rig, friction)
        w, x, y, z = (float(v) for v in orientation)
        self._robot = pybullet.loadURDF(
            str(find_urdf(robot)),
            [float(v) * LENGTH for v in position],
            [x, y, z, w],
            useMaximalCoordinates=True,
            physicsClientId=self._client,
        )
        mass = robot.mass * MASS
        pybullet.changeDynamics(
            self._robot,
            -1,
            mass=mass,
            localInertiaDiagonal=(compute_box_inertia(robot) * MASS * LENGTH**2).tolist(),
            linearDamping=0.0,  # the tank computes drag itself, implicitly
            angularDamping=0.0,
            lateralFriction=friction,
            restitution=0.0,
            activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=self._client,
        )
        self._step = 0.0

    def read_state(self) -> tuple[Triple, Quadruple, Triple, Triple]:
        """Return the state of the housing's middle, world frame.

        Returns
        -------
        position : tuple of 3, in m
        orientation : tuple of 4
            Unit quaternion, scalar first.
        velocity : tuple of 3, in m/s
        spin : tuple of 3, in rad/s
        """
        bullet, robot, client = self._bullet, self._robot, self._client
        (x, y, z), (i, j, k, w) = bullet.getBasePositionAndOrientation(robot, client)
        (u, v, t), spin = bullet.getBaseVelocity(robot, client)
        return (x * 1e-3, y * 1e-3, z * 1e-3), (w, i, j, k), (u * 1e-3, v * 1e-3, t * 1e-3), spin

    def move(self, velocity: Triple, spin: Triple, duration: float) -> None:
        """Move the robot for one step, unless a wall is in the way.

        Parameters
        ----------
        velocity : tuple of 3, in m/s
            World frame.
        spin : tuple of 3, in rad/s
            World frame.
        duration : float, in s
        """
        bullet = self._bullet
        if duration != self._step:
            bullet.setTimeStep(duration, self._client)
            self._step = duration
        u, v, w = velocity
        bullet.resetBaseVelocity(self._robot, (u * 1e3, v * 1e3, w * 1e3), spin, self._client)
        bullet.stepSimulation(self._client)

    def set_pose(self, position: FloatArray, orientation: FloatArray) -> None:
        """Set the robot's pose, at rest.

        Parameters
        ----------
        position : ndarray, shape (3,), in m
            Middle of the housing, world frame.
        orientation : ndarray, shape (4,)
            Unit quaternion, scalar first.
        """
        w, x, y, z = (float(v) for v in orientation)
        self._bullet.resetBasePositionAndOrientation(
            self._robot, [float(v) * LENGTH for v in position], [x, y, z, w], self._client
        )
        self._bullet.resetBaseVelocity(self._robot, (0, 0, 0), (0, 0, 0), self._client)

    def close(self) -> None:
        """Release the Bullet world; harmless when repeated."""
        if self._client >= 0:
            self._bullet.disconnect(self._client)
            self._client = -1

    def _build_container(self, rig: RigConfig, friction: float) -> None:
        section = rig.sections.container
        (cx, cy), (sx, sy) = section.center_mm, section.size_mm
        floor, height = section.floor_z_mm, section.wall_height_mm
        middle = floor + 0.5 * height
        half, tall = 0.5 * WALL, 0.5 * height + WALL
        for side in (-1.0, 1.0):
            self._add_wall((half, 0.5 * sy + WALL, tall), (cx + side * (0.5 * sx + half), cy, middle), friction)
            self._add_wall((0.5 * sx + WALL, half, tall), (cx, cy + side * (0.5 * sy + half), middle), friction)
        self._add_wall((0.5 * sx + WALL, 0.5 * sy + WALL, half), (cx, cy, floor - half), friction)

    def _add_wall(self, half_sides: Triple, center: Triple, friction: float) -> None:
        bullet: Any = self._bullet
        shape = bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=half_sides, physicsClientId=self._client)
        wall = bullet.createMultiBody(0, shape, -1, center, useMaximalCoordinates=True, physicsClientId=self._client)
        bullet.changeDynamics(wall, -1, lateralFriction=friction, restitution=0.0, physicsClientId=self._client)


def compute_box_inertia(robot: RobotConfig) -> FloatArray:
    """Compute the principal moments of inertia of the housing as a solid box.

    Parameters
    ----------
    robot : RobotConfig

    Returns
    -------
    ndarray, shape (3,), in kg·m²
    """
    squares = np.square(robot.size)
    return robot.mass / 12.0 * (np.sum(squares) - squares)


def find_urdf(robot: RobotConfig) -> Path:
    """Find the robot's URDF, beside the robot file or among those shipped with the tank.

    Parameters
    ----------
    robot : RobotConfig

    Returns
    -------
    Path

    Raises
    ------
    RigError
        If it is in neither folder.
    """
    name = robot.body.urdf or ""
    beside, ours = robot.document.folder(("body", "urdf")) / name, Path(__file__).parent / "urdf" / name
    for path in (beside, ours):
        if path.is_file():
            return path
    shipped = ", ".join(sorted(path.name for path in ours.parent.glob("*.urdf")))
    raise RigError(
        f"{robot.document.path}: body.urdf: '{name}' is neither beside the file nor shipped; shipped: {shipped}."
    )
