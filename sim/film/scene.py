"""The static scene before the camera: plate with printed markers, container, liquid, uneven light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.film.camera import Camera
from sim.film.ray_casting import Sheet, render_empty
from smolbot.config.rig import RigConfig
from smolbot.core.arrays import BoolArray, FloatArray

DICTIONARY = "4x4_50"
MARKER_SIDE = 8e-3  # of a marker's black square, in m
MARKER_BORDER = 1.2e-3  # m: white border around it
WALL_THICKNESS = 2e-3  # m: thickness of the container's walls
MARKER_GAP = 5e-3  # m: between wall and marker, as a wall hides part of the plate from the camera
PRINT_RESOLUTION = 16  # pixels of the printed plate per mm
PRINT_ERROR, PRINT_TURN_DEG = 50e-6, 0.1  # standard deviations of a marker's position (m) and rotation
RAYS_PER_SIDE = 2  # rays per pixel along each side
WATER, GLYCEROL = 1.34, 1.47  # refractive indices; gel is mostly water
MARKER_PIXELS = 60  # of a marker's picture


@dataclass(frozen=True)
class Marker:
    """A printed marker.

    Attributes
    ----------
    number : int
        Its id.
    center, true_center : tuple of 2, in m
        Nominal and true middle (x, y), world frame.
    rotation : float, in rad
        True rotation about z.
    raised : bool
        Whether it is on a post.
    """

    number: int
    center: tuple[float, float]
    true_center: tuple[float, float]
    rotation: float
    raised: bool


@dataclass(frozen=True, eq=False)
class Scene:
    """Container and plate, and their lighting; lengths in m, world frame.

    Attributes
    ----------
    center, half : ndarray, shape (2,)
        Middle and half sides of the container's inside.
    floor, surface, top : float
        Heights of floor, liquid surface and wall.
    index : float
        Refractive index of the liquid or gel.
    markers : tuple of Marker
    lamp : ndarray, shape (2,)
        Horizontal displacement of a shadow, per metre of height.
    tones : ndarray, shape (4, 3)
        Colours (BGR, 0 to 255) of plate, ink, wall, and the tint of the liquid (a factor times 255).
    shading : ndarray, shape (5,)
        Of the light over the picture: slope right and down, decrease outwards, and position of a lamp's reflection.
    """

    center: FloatArray
    half: FloatArray
    floor: float
    surface: float
    top: float
    index: float
    markers: tuple[Marker, ...]
    lamp: FloatArray
    tones: FloatArray
    shading: FloatArray

    @property
    def span(self) -> float:
        """Side of the square, in m, that a picture must hold."""
        return (
            2.0 * float(np.max(np.abs([m.center for m in self.markers] - self.center)))
            + MARKER_SIDE
            + 2.0 * MARKER_BORDER
        )

    @property
    def posts(self) -> FloatArray:
        """Middle and half sides (m) of each post, shape (n, 6)."""
        middle, half = 0.5 * (self.floor + self.surface), 0.5 * (self.surface - self.floor)
        wide = 0.5 * MARKER_SIDE + MARKER_BORDER
        rows = [[*m.center, middle, wide, wide, half] for m in self.markers if m.raised]
        return np.array(rows).reshape(-1, 6)

    def is_inside(self, points: FloatArray, margin: float = 0.0) -> BoolArray:
        """Return which points lie over the container's floor.

        Parameters
        ----------
        points : ndarray, shape (n, 2) or (n, 3), in m
            World frame.
        margin : float, in m
            Added around the floor.

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        away = np.abs(points[:, :2] - self.center) - margin
        return np.asarray(np.all(away < self.half, axis=1))


def sample_scene(rng: np.random.Generator, rig: RigConfig, *, posts: bool = True) -> Scene:
    """Sample the scene: the rig's container on a plate, with markers at its corners and on posts at its sides.

    The posts end at the liquid's surface: markers in two planes determine the camera's position, and those at the
    robot's height show it without parallax. Markers in one plane leave the camera's tilt uncertain by half a
    degree.

    Parameters
    ----------
    rng : numpy.random.Generator
    rig : RigConfig
    posts : bool
        Put markers on posts too, not on the plate only.

    Returns
    -------
    Scene
    """
    box = rig.container
    center, half = box.center, 0.5 * box.size
    out = half + WALL_THICKNESS + MARKER_GAP + 0.5 * MARKER_SIDE
    markers = []
    corners, sides = ((-1, 1), (1, 1), (1, -1), (-1, -1)), ((-1, 0), (0, 1), (1, 0), (0, -1))
    for number, (sx, sy) in enumerate(corners + sides if posts else corners):
        place = np.round(center + out * np.array([sx, sy]), 4)
        true = place + rng.normal(0.0, PRINT_ERROR, 2)
        markers.append(
            Marker(number, (float(place[0]), float(place[1])), (float(true[0]), float(true[1])),
                   float(np.radians(rng.normal(0.0, PRINT_TURN_DEG))), number >= len(corners))
        )  # fmt: skip
    light = rng.uniform(0.0, 2.0 * np.pi)
    tones = np.array(
        [
            rng.uniform(150, 185) + rng.normal(0, 4, 3),
            rng.uniform(25, 45) + rng.normal(0, 2, 3),
            rng.uniform(95, 125) + rng.normal(0, 4, 3),
            255.0 * np.array([0.90, 0.95, 0.96]),
        ]
    )
    slope = rng.uniform(0.10, 0.25) * np.array([np.cos(light), np.sin(light)])
    glare = rng.uniform(-0.25, 0.25, 2)
    return Scene(
        center, half, box.floor_z, box.surface_z, box.floor_z + box.wall_height,
        WATER if rig.sections.medium.yield_stress_pa > 0 else GLYCEROL,
        tuple(markers), rng.uniform(0.2, 0.4) * np.array([np.cos(light), np.sin(light)]), tones,
        np.array([*slope, rng.uniform(0.1, 0.2), *glare]),
    )  # fmt: skip


def draw_sheets(scene: Scene, rng: np.random.Generator) -> tuple[Sheet, Sheet, FloatArray]:
    """Draw the plate and the posts' tops as seen from straight above.

    Parameters
    ----------
    scene : Scene
    rng : numpy.random.Generator

    Returns
    -------
    plate, caps : ndarray of float32, shape (n, n, 3)
        Grey levels; row 0 is the lowest y.
    low : ndarray, shape (2,), in m
        Their lower left corner, world frame.
    """
    import cv2

    reach = 0.8 * scene.span
    low = scene.center - reach
    n = int(2e3 * reach * PRINT_RESOLUTION)
    grain = cv2.GaussianBlur(rng.normal(0.0, 1.0, (n, n)).astype(np.float32), (0, 0), 0.06 * PRINT_RESOLUTION)
    blotches = cv2.resize(rng.normal(0.0, 1.0, (9, 9)).astype(np.float32), (n, n), interpolation=cv2.INTER_CUBIC)
    tone = 1.0 + 0.012 * grain / grain.std() + 0.015 * blotches
    plate: Sheet = (scene.tones[0] * tone[:, :, None]).astype(np.float32)
    caps: Sheet = np.full_like(plate, 0.0)
    caps[:] = scene.tones[0]
    lines = 1e3 * (np.arange(n) / (1e3 * PRINT_RESOLUTION) + low[:, None])  # in mm
    for axis in (0, 1):  # a faint grid of 10 mm
        near = np.abs((lines[axis] + 5.0) % 10.0 - 5.0)
        ink = 1.0 - 0.12 * (near < 0.1)
        ink = ink.astype(np.float32)
        plate *= ink[None, :, None] if axis == 0 else ink[:, None, None]
    for marker in scene.markers:
        _print_marker(caps if marker.raised else plate, marker, low, scene.tones[1])
    return plate, caps, low


def _print_marker(sheet: Sheet, marker: Marker, low: FloatArray, ink: FloatArray) -> None:
    import cv2

    words = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{DICTIONARY.upper()}"))
    bits = cv2.aruco.generateImageMarker(words, marker.number, MARKER_PIXELS).astype(np.float64) / 255.0
    reach = 0.5 * MARKER_SIDE + MARKER_BORDER
    first = np.floor(1e3 * PRINT_RESOLUTION * (np.array(marker.true_center) - 1.5 * reach - low)).astype(int)
    last = np.ceil(1e3 * PRINT_RESOLUTION * (np.array(marker.true_center) + 1.5 * reach - low)).astype(int)
    columns, rows = np.meshgrid(np.arange(first[0], last[0]), np.arange(first[1], last[1]))
    x = columns / (1e3 * PRINT_RESOLUTION) + low[0] - marker.true_center[0]
    y = rows / (1e3 * PRINT_RESOLUTION) + low[1] - marker.true_center[1]
    c, s = np.cos(marker.rotation), np.sin(marker.rotation)
    right, down = c * x + s * y, s * x - c * y
    beyond = np.maximum(np.abs(right), np.abs(down))
    paper = beyond < reach
    black = np.clip(
        0.5 + 1e3 * PRINT_RESOLUTION * (0.5 * MARKER_SIDE - beyond), 0.0, 1.0
    )  # a pixel on the edge is partly black
    i = np.clip((MARKER_PIXELS * (down / MARKER_SIDE + 0.5)).astype(int), 0, MARKER_PIXELS - 1)
    j = np.clip((MARKER_PIXELS * (right / MARKER_SIDE + 0.5)).astype(int), 0, MARKER_PIXELS - 1)
    value = 1.0 - black * (1.0 - bits[i, j])
    patch = sheet[first[1] : last[1], first[0] : last[0]]
    white = np.array([225.0, 228.0, 228.0])
    patch[paper] = ink + value[paper, None] * (white - ink)


def photograph(scene: Scene, camera: Camera, rng: np.random.Generator) -> FloatArray:
    """Render the empty scene, without noise and blur.

    Parameters
    ----------
    scene : Scene
    camera : Camera
    rng : numpy.random.Generator

    Returns
    -------
    ndarray, shape (height, width, 3)
        Grey levels.
    """
    plate, caps, low = draw_sheets(scene, rng)
    width, height = camera.size
    box = np.array([*scene.center, *scene.half, scene.floor, scene.surface, scene.top, WALL_THICKNESS, scene.index])
    return np.asarray(
        render_empty(
            1e3 * PRINT_RESOLUTION,
            width,
            height,
            camera.lens,
            box,
            plate,
            caps,
            low,
            scene.posts,
            scene.tones,
            scene.shading,
            RAYS_PER_SIDE,
        )
    )
