"""A pinhole camera over the tank, not quite upright, with what a lens leaves of its distortion.

Its projection is written here and nowhere else: `smolbot.runs.optics`, which has to find its way back from pixels,
has its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sim.film.kernels import rays
from smolbot.core.arrays import FloatArray

FRAMED = 0.8
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
    """Where a camera is, and where it looks.

    Attributes
    ----------
    place : ndarray, shape (3,), in m
        Entrance pupil, world frame.
    axes : ndarray, shape (3, 3)
        Rows: world directions of the picture's right and down, and of the view.
    focal : float, in pixels
    middle : tuple of 2, in pixels
        Where the view's axis meets the picture; (0, 0) is the middle of the first pixel.
    bend : float
        Radial distortion: a point at the distance r (focal lengths) from the axis is seen at ``r (1 + bend r²)``.
    size : tuple of 2, in pixels
        Width and height.
    """

    place: FloatArray
    axes: FloatArray
    focal: float
    middle: tuple[float, float]
    bend: float
    size: tuple[int, int]

    def project(self, points: FloatArray) -> FloatArray:
        """Pixels (n, 2) of world points (n, 3) in m."""
        seen = (points - self.place) @ self.axes.T
        flat = seen[:, :2] / seen[:, 2:]
        flat = flat * (1.0 + self.bend * np.sum(flat**2, axis=1, keepdims=True))
        return np.asarray(self.focal * flat + np.array(self.middle))

    @property
    def lens(self) -> FloatArray:
        """Place, axes, focal length, middle and bend as the kernels take them, shape (16,)."""
        return np.array([*self.place, *self.axes.ravel(), self.focal, *self.middle, self.bend])

    def rays(self, pixels: FloatArray) -> FloatArray:
        """World directions (n, 3), of unit length, of what is seen at pixels (n, 2)."""
        return np.asarray(rays(np.ascontiguousarray(pixels, dtype=np.float64), self.lens))


def draw_camera(
    rng: np.random.Generator, target: FloatArray, span: float, size: tuple[int, int], distance: float
) -> Camera:
    """A camera put up by hand: over `target`, some degrees off the vertical, turned a little.

    Parameters
    ----------
    target : ndarray, shape (3,), in m
        What it is pointed at.
    span : float, in m
        What the shorter side of the picture must hold at the target.
    size : tuple of 2, in pixels
    distance : float, in m
        From the target, give or take a twentieth.
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
    focal = FRAMED * min(size) * far / span
    offset = rng.normal(0.0, LENS_OFFSET * min(size), 2)
    corner = 0.5 * math.hypot(*size) / focal
    bend = rng.uniform(-DISTORTION, DISTORTION) / corner**2
    middle = (0.5 * (size[0] - 1) + float(offset[0]), 0.5 * (size[1] - 1) + float(offset[1]))
    return Camera(place, np.array([right, down, view]), focal, middle, bend, size)


def crossing(place: FloatArray, rays: FloatArray, height: float) -> FloatArray:
    """Where rays (n, 3) from places (3,) or (n, 3) cross the horizontal plane at `height`, shape (n, 3)."""
    along = (height - place[..., 2]) / rays[:, 2]
    return np.asarray(place + along[:, None] * rays)


def refracted(rays: FloatArray, index: float) -> FloatArray:
    """Unit rays (n, 3) that come down on a level surface from air, within a liquid of refractive `index` (Snell)."""
    across = rays[:, :2] / index
    down = -np.sqrt(1.0 - np.sum(across**2, axis=1))
    return np.column_stack([across, down])
