"""The robot in the picture: a clear printed housing, half in the liquid, with its magnet and its meniscus."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.film.camera import Camera, intersect_plane, refract_rays
from sim.film.ray_casting import render_robot
from sim.film.scene import Scene
from smolbot.config.robot import RobotConfig
from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import matrix_from_quaternion

RAYS_PER_SIDE = 3  # rays per pixel along each side
MENISCUS_MARGIN = 2.2e-3  # m around the housing within which its meniscus is visible
BLADE_HALF_SIDES = np.array(
    [0.03e-3, 0.1e-3, 1.6e-3]
)  # half sides of the cantilever, m; thicker than the real one, to be visible
MAGNET_HALF = np.array([0.45e-3, 0.45e-3, 0.5e-3])  # half sides of the magnet, m
SIZE_ERROR, MAGNET_ERROR = 50e-6, 0.05e-3  # m: standard deviations of a printed housing and of a glued magnet
SHADOW_REACH, SHADOW, SHADOW_SIZE = 3e-3, 0.16, 0.8  # m around the robot; depth; size in half the housing
RESIN_DEPTH = 2.6e-3  # m of resin that transmit 1/e of the light


@dataclass(frozen=True, eq=False)
class Appearance:
    """Appearance of a robot.

    Attributes
    ----------
    center, half : ndarray, shape (3,), in m
        Middle of the housing from the rotation centre, and half its sides, body frame.
    magnet_center, magnet_half : ndarray, shape (3,), in m
        The magnet at rest from the rotation centre, and half its sides, body frame.
    resin : ndarray, shape (3,)
        Colour, BGR.
    ring : ndarray, shape (3,)
        Strength and width (m) of the meniscus, and asymmetry of its brightness.
    """

    center: FloatArray
    half: FloatArray
    magnet_center: FloatArray
    magnet_half: FloatArray
    resin: FloatArray
    ring: FloatArray

    def compute_boxes(self, position: FloatArray, rotation_body_to_world: FloatArray) -> FloatArray:
        """Compute middles (world frame) and half sides of housing, magnet and blade.

        Parameters
        ----------
        position : ndarray, shape (3,), in m
            Rotation centre, world frame.
        rotation_body_to_world : ndarray, shape (3, 3)
            From body to world.

        Returns
        -------
        ndarray, shape (3, 2, 3), in m
        """
        blade = np.array([0.0, 0.0, self.magnet_center[2] - BLADE_HALF_SIDES[2]])
        middles = position + np.array([self.center, self.magnet_center, blade]) @ rotation_body_to_world.T
        return np.stack([middles, np.array([self.half, self.magnet_half, BLADE_HALF_SIDES])], axis=1)


def sample_appearance(rng: np.random.Generator, robot: RobotConfig, floating: bool) -> Appearance:
    """Sample a robot's appearance: dimensions by the robot file to 50 µm, colour and meniscus.

    Parameters
    ----------
    rng : numpy.random.Generator
    robot : RobotConfig
    floating : bool
        Whether it floats, with a meniscus around it.

    Returns
    -------
    Appearance
    """
    half = 0.5 * (np.array(robot.size) + rng.normal(0.0, SIZE_ERROR, 3))
    device = robot.device
    return Appearance(
        np.array(robot.center), half,
        np.array([*rng.normal(0.0, MAGNET_ERROR, 2), device.l0]), MAGNET_HALF,
        np.array([rng.uniform(80, 120), rng.uniform(150, 185), rng.uniform(190, 215)]),
        np.array([rng.uniform(0.10, 0.22) if floating else 0.0, rng.uniform(0.35, 0.6) * 1e-3, rng.uniform(0.3, 0.8)]),
    )  # fmt: skip


def find_region(
    camera: Camera, looks: Appearance, position: FloatArray, rotation_body_to_world: FloatArray
) -> tuple[int, int, int, int]:
    """Return the region of the picture that robot and meniscus may fill.

    Parameters
    ----------
    camera : Camera
    looks : Appearance
    position : ndarray, shape (3,), in m
        Rotation centre, world frame.
    rotation_body_to_world : ndarray, shape (3, 3)
        From body to world.

    Returns
    -------
    tuple of 4, in pixels
        First column and row, last column and row (excluded).
    """
    signs = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
    corners = position + (looks.center + signs * (looks.half + MENISCUS_MARGIN)) @ rotation_body_to_world.T
    pixels = camera.project(corners)
    low, high = np.floor(pixels.min(axis=0)).astype(int) - 4, np.ceil(pixels.max(axis=0)).astype(int) + 5
    width, height = camera.size
    u0, v0 = max(int(low[0]), 0), max(int(low[1]), 0)
    return u0, v0, max(min(int(high[0]), width), u0), max(min(int(high[1]), height), v0)


def paint_robot(
    frame: FloatArray, scene: Scene, camera: Camera, looks: Appearance, position: FloatArray, orientation: FloatArray
) -> tuple[int, int, int, int]:
    """Paint the robot into a frame, in place.

    Parameters
    ----------
    frame : ndarray, shape (height, width, 3)
    scene : Scene
    camera : Camera
    looks : Appearance
    position : ndarray, shape (3,), in m
        Rotation centre, world frame.
    orientation : ndarray, shape (4,)
        Unit quaternion, scalar first.

    Returns
    -------
    tuple of 4, in pixels
        The region that it fills: first column and row, last column and row (excluded).
    """
    rotation = matrix_from_quaternion(orientation)
    u0, v0, u1, v1 = find_region(camera, looks, position, rotation)
    width, height = u1 - u0, v1 - v0
    if width < 1 or height < 1:
        return u0, v0, u1, v1
    frame[v0:v1, u0:u1] = render_robot(
        frame[v0:v1, u0:u1].copy(), u0, v0, RAYS_PER_SIDE, camera.lens, scene.surface, scene.index, rotation,
        looks.compute_boxes(position, rotation), looks.resin, RESIN_DEPTH, looks.ring, scene.lamp,
        int(np.argmax(np.abs(rotation[2]))),
    )  # fmt: skip
    return u0, v0, u1, v1


def paint_shadow(frame: FloatArray, scene: Scene, camera: Camera, looks: Appearance, position: FloatArray) -> None:
    """Darken a frame, in place, where the robot's soft shadow falls on the floor.

    Parameters
    ----------
    frame : ndarray, shape (height, width, 3)
    scene : Scene
    camera : Camera
    looks : Appearance
    position : ndarray, shape (3,), in m
        Rotation centre, world frame.
    """
    depth = position[2] - scene.floor
    middle = np.array([*(position[:2] + depth * scene.lamp), scene.floor])
    reach = float(np.max(looks.half)) + SHADOW_REACH
    corners = middle + reach * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    pixels = camera.project(corners)
    (u0, v0), (u1, v1) = pixels.min(axis=0).astype(int), pixels.max(axis=0).astype(int)
    u0, v0, u1, v1 = max(u0, 0), max(v0, 0), min(u1, camera.size[0]), min(v1, camera.size[1])
    if u1 <= u0 or v1 <= v0:
        return
    columns, rows = np.meshgrid(np.arange(u0, u1, dtype=float), np.arange(v0, v1, dtype=float))
    rays = camera.compute_rays(np.column_stack([columns.ravel(), rows.ravel()]))
    wet = intersect_plane(camera.position, rays, scene.surface)
    ground = intersect_plane(wet, refract_rays(rays, scene.index), scene.floor)
    away = np.linalg.norm(ground[:, :2] - middle[:2], axis=1)
    dark = SHADOW * np.exp(-0.5 * (away / (SHADOW_SIZE * float(np.mean(looks.half)))) ** 2) * scene.is_inside(ground)
    frame[v0:v1, u0:u1] *= (1.0 - dark).reshape(v1 - v0, u1 - u0, 1)
