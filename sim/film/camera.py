"""A pinhole camera over the tank, slightly tilted, with a small residual lens distortion.

Its projection is written here and nowhere else: `smolbot.runs.optics`, which computes positions from pixels,
has its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sim.film.ray_casting import compute_rays
from smolbot.core.arrays import FloatArray

FRAME_FILL = 0.8
"""Share of the picture's shorter side that the target fills: it may be rotated, and higher than the plate."""

TILT_DEG, TURN_DEG = (2.0, 6.0), (-8.0, 8.0)
"""Ranges of the camera's tilt from vertical and rotation about its axis, in degrees."""

DISTANCE_SPREAD = (0.95, 1.05)
"""Range of its distance, relative to the nominal one."""

AIM_ERROR, LENS_OFFSET, DISTORTION = 0.5e-3, 0.004, 1e-3
"""Standard deviations of its aim (m) and of the lens against the sensor (share of the shorter side), and largest
distortion in the corner of a corrected lens (relative)."""


@dataclass(frozen=True, eq=False)
class Camera:
    """Pose and lens of a camera.

    Attributes
    ----------
    position : ndarray, shape (3,), in m
        Entrance pupil, world frame.
    axes : ndarray, shape (3, 3)
        Rows: world directions of the picture's right and down, and of the view; a rotation from world to camera.
    focal : float, in pixels
    principal_point : tuple of 2, in pixels
        Principal point; (0, 0) is the middle of the first pixel.
    distortion : float
        Radial distortion: a point at the distance r (focal lengths) from the axis appears at ``r (1 + bend r²)``.
    size : tuple of 2, in pixels
        Width and height.
    """

    position: FloatArray
    axes: FloatArray
    focal: float
    principal_point: tuple[float, float]
    distortion: float
    size: tuple[int, int]

    def project(self, points: FloatArray) -> FloatArray:
        """Project world points into the picture.

        Parameters
        ----------
        points : ndarray, shape (n, 3), in m
            World frame.

        Returns
        -------
        ndarray, shape (n, 2), in pixels
        """
        in_camera = (points - self.position) @ self.axes.T
        flat = in_camera[:, :2] / in_camera[:, 2:]
        flat = flat * (1.0 + self.distortion * np.sum(flat**2, axis=1, keepdims=True))
        return np.asarray(self.focal * flat + np.array(self.principal_point))

    @property
    def lens(self) -> FloatArray:
        """Position, axes, focal length, principal point and distortion as the kernels take them, shape (16,)."""
        return np.array([*self.position, *self.axes.ravel(), self.focal, *self.principal_point, self.distortion])

    def compute_rays(self, pixels: FloatArray) -> FloatArray:
        """Compute the viewing directions of pixels.

        Parameters
        ----------
        pixels : ndarray, shape (n, 2)

        Returns
        -------
        ndarray, shape (n, 3)
            Unit vectors, world frame.
        """
        return np.asarray(compute_rays(np.ascontiguousarray(pixels, dtype=np.float64), self.lens))


def sample_camera(
    rng: np.random.Generator, target: FloatArray, span: float, size: tuple[int, int], distance: float
) -> Camera:
    """Sample a camera set up by hand: above `target`, tilted by some degrees and slightly turned.

    Parameters
    ----------
    rng : numpy.random.Generator
    target : ndarray, shape (3,), in m
        Point that it is aimed at, world frame.
    span : float, in m
        Length at the target that the shorter side of the picture must hold.
    size : tuple of 2, in pixels
    distance : float, in m
        From the target; varied by 5 %.

    Returns
    -------
    Camera
    """
    tilt, towards = np.radians(rng.uniform(*TILT_DEG)), rng.uniform(0.0, 2.0 * math.pi)
    turn = np.radians(rng.uniform(*TURN_DEG))
    far = distance * rng.uniform(*DISTANCE_SPREAD)
    back = np.array([math.sin(tilt) * math.cos(towards), math.sin(tilt) * math.sin(towards), math.cos(tilt)])
    place = target + far * back
    aim = target + np.array([*rng.normal(0.0, AIM_ERROR, 2), 0.0])
    view = (aim - place) / np.linalg.norm(aim - place)
    up = np.array([-math.sin(turn), math.cos(turn), 0.0])
    down = -(up - (up @ view) * view)
    down /= np.linalg.norm(down)
    right = np.cross(down, view)
    focal = FRAME_FILL * min(size) * far / span
    offset = rng.normal(0.0, LENS_OFFSET * min(size), 2)
    corner = 0.5 * math.hypot(*size) / focal
    bend = rng.uniform(-DISTORTION, DISTORTION) / corner**2
    middle = (0.5 * (size[0] - 1) + float(offset[0]), 0.5 * (size[1] - 1) + float(offset[1]))
    return Camera(place, np.array([right, down, view]), focal, middle, bend, size)


def intersect_plane(origins: FloatArray, rays: FloatArray, height: float) -> FloatArray:
    """Compute where rays intersect a horizontal plane.

    Parameters
    ----------
    origins : ndarray, shape (3,) or (n, 3), in m
        Origins of the rays, world frame.
    rays : ndarray, shape (n, 3)
        Directions, world frame.
    height : float, in m
        Of the plane.

    Returns
    -------
    ndarray, shape (n, 3), in m
        World frame.
    """
    along = (height - origins[..., 2]) / rays[:, 2]
    return np.asarray(origins + along[:, None] * rays)


def refract_rays(rays: FloatArray, index: float) -> FloatArray:
    """Refract rays that enter a liquid from above through its level surface (Snell).

    Parameters
    ----------
    rays : ndarray, shape (n, 3)
        Unit vectors, world frame.
    index : float
        Refractive index of the liquid.

    Returns
    -------
    ndarray, shape (n, 3)
        Unit vectors, world frame.
    """
    across = rays[:, :2] / index
    down = -np.sqrt(1.0 - np.sum(across**2, axis=1))
    return np.column_stack([across, down])
