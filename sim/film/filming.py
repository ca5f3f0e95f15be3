"""Film a trajectory: frame by frame, with noise, blur, flicker and compression losses, into a video file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sim.film.appearance import Appearance, paint_robot, paint_shadow, sample_appearance
from sim.film.camera import Camera, sample_camera
from sim.film.scene import DICTIONARY, MARKER_SIDE, PRINT_ERROR, Scene, photograph, sample_scene
from sim.film.trail import Trail
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import matrix_from_quaternion
from smolbot.errors import InputError

CAMERA_DISTANCE = 0.35  # m from camera to floor: a 35 mm lens above the coils
RULER_ERROR = 2e-3  # m: standard deviation of a camera's height measured by ruler
NOISE_POOL = 5  # noise pictures, of which each frame uses one, shifted at random
NOISE_MARGIN = 64  # pixels of that shift
BLUR = (0.7, 1.1)  # range of the lens blur, in pixels
PADDING = 8  # pixels around a region that is drawn again
SHADOW_REACH = 3.5e-3  # m beyond the robot that its shadow reaches
ROD_HALF_WIDTH = 6e-3  # m
FLICKER, READ_NOISE, SHOT_NOISE = 0.004, 0.6, 0.012  # of the light (relative); variances: constant, and per grey level


@dataclass(frozen=True, eq=False)
class Film:
    """A film's ground truth, and the camera height that the lab knows.

    Attributes
    ----------
    camera, scene, appearance : Camera, Scene, Appearance
        As sampled.
    times : ndarray, shape (n,), in s
        Of the frames, on the run's clock.
    positions : ndarray, shape (n, 3), in m
        True rotation centres in the frames, world frame.
    orientations : ndarray, shape (n, 4)
        True unit quaternions in the frames, scalar first.
    hidden : ndarray of bool, shape (n,)
        Frames in which something covers the robot.
    camera_height : float, in m
        Of the camera over the world's z = 0, measured with a ruler.
    """

    camera: Camera
    scene: Scene
    appearance: Appearance
    times: FloatArray
    positions: FloatArray
    orientations: FloatArray
    hidden: Any
    camera_height: float

    @property
    def headings(self) -> FloatArray:
        """True azimuth of body z in the frames, shape (n,), in rad."""
        ahead = np.array([matrix_from_quaternion(q)[:, 2] for q in self.orientations])
        return np.asarray(np.arctan2(ahead[:, 1], ahead[:, 0]))

    def format_fiducials(self) -> str:
        """Format the file in which a lab describes its markers and camera.

        Returns
        -------
        str
        """
        lines = [
            "# Markers around the container, and the camera over it; mm in the rig's world frame.",
            "[fiducials]",
            f'dictionary = "{DICTIONARY}"',
            f"side_mm = {1e3 * MARKER_SIDE:g}                # of the black square",
            f"height_mm = {1e3 * self.scene.floor:g}             # z of the plate that they lie on",
            f"place_tolerance_mm = {1e3 * PRINT_ERROR:g}  # print and ruler, one standard deviation",
            "",
            "[camera]",
            f"height_mm = {1e3 * self.camera_height:.0f}.0           # z of the lens, by ruler",
        ]
        for marker in self.scene.markers:
            x, y = (1e3 * v for v in marker.center)
            lines += ["", "[[fiducials.markers]]", f"id = {marker.number}", f"center_mm = [{x:g}, {y:g}]"]
            if marker.raised:
                lines.append(f"height_mm = {1e3 * self.scene.surface:g}             # on a post, as high as the liquid")
        return "\n".join(lines) + "\n"

    def write_truth(self, path: Path) -> None:
        """Write a CSV row per frame: time_s, rotation centre in m, heading_rad, hidden.

        Parameters
        ----------
        path : Path
        """
        rows = ["frame,time_s,x_m,y_m,z_m,heading_rad,hidden"]
        for i, (time, place, heading) in enumerate(zip(self.times, self.positions, self.headings, strict=True)):
            values = ",".join(f"{v:.9g}" for v in (time, *place, heading))
            rows.append(f"{i},{values},{int(self.hidden[i])}")
        path.write_text("\n".join(rows) + "\n", encoding="utf-8")


def film_run(
    trail: Trail, rig: RigConfig, robot: RobotConfig, path: Path, *, seed: int = 1, fps: float = 25.0,
    begin: float | None = None, end: float | None = None, size: tuple[int, int] = (1280, 960),
    hidden: Sequence[tuple[float, float]] = (), posts: bool = True,
) -> Film:  # fmt: skip
    """Film a trajectory from above into a video.

    Parameters
    ----------
    trail : Trail
    rig, robot : RigConfig, RobotConfig
        Container, liquid and housing.
    path : Path
        Of the video.
    seed : int
        Of the camera's pose, markers, light, colours, meniscus and noise.
    fps : float, in 1/s
    begin, end : float, in s, optional
        On the run's clock; the complete trajectory if not given.
    size : tuple of 2, in pixels
        Width and height.
    hidden : sequence of (float, float), in s
        Times during which a rod covers the robot.
    posts : bool
        Put markers on posts too, not on the plate only.

    Returns
    -------
    Film

    Raises
    ------
    InputError
        If there are fewer than two frames, or the file cannot be written.
    """
    rng = np.random.default_rng([seed, 0xF11])
    begin = float(trail.times[0]) if begin is None else begin
    end = float(trail.times[-1]) if end is None else end
    if not 0 < fps < 1e5:
        raise InputError(f"A film needs a positive frame rate; got {fps:g} frames per second.")
    times = begin + np.arange(math.floor((end - begin) * fps) + 1) / fps
    if end <= begin or len(times) < 2:
        raise InputError(f"A film needs two frames or more; got {begin:g} to {end:g} s at {fps:g} frames per second.")
    positions, orientations = trail.interpolate(times)
    stage = sample_scene(rng, rig, posts=posts)
    camera = sample_camera(rng, np.array([*stage.center, stage.floor]), stage.span, size, CAMERA_DISTANCE)
    afloat = rig.sections.medium.yield_stress_pa == 0
    looks = sample_appearance(rng, robot, afloat)
    covered = np.array([any(a <= t <= b for a, b in hidden) for t in times])
    made = Film(
        camera,
        stage,
        looks,
        times,
        positions,
        orientations,
        covered,
        float(camera.position[2] + rng.normal(0.0, RULER_ERROR)),
    )
    _write_frames(made, path, fps, rng)
    return made


def _write_frames(made: Film, path: Path, fps: float, rng: np.random.Generator) -> None:
    camera, stage, looks = made.camera, made.scene, made.appearance
    empty = photograph(stage, camera, rng)
    blur = rng.uniform(*BLUR)
    noise = CameraNoise(rng, camera.size)
    with VideoFile(path, fps, camera.size) as writer:
        soft = blur_image(empty, blur)
        for i in range(len(made.times)):
            frame = soft.copy()
            sharp = empty.copy()
            paint_shadow(sharp, stage, camera, looks, made.positions[i])
            u0, v0, u1, v1 = paint_robot(sharp, stage, camera, looks, made.positions[i], made.orientations[i])
            changed = _find_changed_region(camera, stage, looks, made.positions[i], (u0, v0, u1, v1))
            (u0, v0, u1, v1), patch = blur_region(sharp, changed, blur)
            frame[v0:v1, u0:u1] = patch
            if made.hidden[i]:
                _draw_rod(frame, camera, made.positions[i])
            writer.write(noise.apply(frame))


Region = tuple[int, int, int, int]


def _find_changed_region(
    camera: Camera, stage: Scene, looks: Appearance, position: FloatArray, robot: Region
) -> Region:
    """Return the region that robot and shadow together may change."""
    depth = position[2] - stage.floor
    shadow = np.array([*(position[:2] + depth * stage.lamp), stage.floor])
    reach = float(np.max(looks.half)) + SHADOW_REACH
    pixels = camera.project(shadow + reach * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]))
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    return (
        max(min(robot[0], int(low[0])) - PADDING, 0), max(min(robot[1], int(low[1])) - PADDING, 0),
        min(max(robot[2], int(high[0])) + PADDING, camera.size[0]),
        min(max(robot[3], int(high[1])) + PADDING, camera.size[1]),
    )  # fmt: skip


def blur_image(image: FloatArray, sigma: float) -> FloatArray:
    """Blur an image with a Gaussian.

    Parameters
    ----------
    image : ndarray, shape (height, width, 3)
    sigma : float, in pixels

    Returns
    -------
    ndarray, shape (height, width, 3)
    """
    import cv2

    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma))


def blur_region(image: FloatArray, region: Region, sigma: float) -> tuple[Region, FloatArray]:
    """Blur a region of an image, with a margin so that no edge shows.

    Parameters
    ----------
    image : ndarray, shape (height, width, 3)
    region : tuple of 4, in pixels
        First column and row, last column and row (excluded).
    sigma : float, in pixels

    Returns
    -------
    region : tuple of 4
        As given.
    patch : ndarray, shape (rows, columns, 3)
    """
    u0, v0, u1, v1 = region
    a, b = max(u0 - PADDING, 0), max(v0 - PADDING, 0)
    patch = blur_image(image[b : v1 + PADDING, a : u1 + PADDING], sigma)
    return region, patch[v0 - b : v1 - b, u0 - a : u1 - a]


def _draw_rod(frame: FloatArray, camera: Camera, position: FloatArray) -> None:
    """Draw a rod of 12 mm over the robot, from the right edge of the picture."""
    scale = camera.focal / float(np.linalg.norm(position - camera.position))
    (u, v), half = camera.project(position[None])[0], ROD_HALF_WIDTH * scale
    rows = slice(max(int(v - half), 0), max(int(v + half), 0))
    column = max(int(u - half), 0)
    shape = frame[rows, column:].shape[:2]
    across = np.linspace(-1.0, 1.0, max(shape[0], 1))[: shape[0], None, None]
    frame[rows, column:] = 120.0 * np.sqrt(np.maximum(1.0 - 0.8 * across**2, 0.1)) * np.array([0.75, 0.8, 0.9])


class CameraNoise:
    """Adds a sensor's noise and the light's flicker, and rounds to 8 bits.

    Parameters
    ----------
    rng : numpy.random.Generator
    size : tuple of 2, in pixels
        Width and height.
    """

    def __init__(self, rng: np.random.Generator, size: tuple[int, int]) -> None:
        width, height = size
        self._rng = rng
        self._pool = [
            rng.standard_normal((height + NOISE_MARGIN, width + NOISE_MARGIN, 3), dtype=np.float32)
            for _ in range(NOISE_POOL)
        ]

    def apply(self, frame: FloatArray) -> Any:
        """Convert a frame to a noisy 8-bit picture.

        Parameters
        ----------
        frame : ndarray, shape (height, width, 3)
            Grey levels.

        Returns
        -------
        ndarray of uint8, shape (height, width, 3)
        """
        height, width = frame.shape[:2]
        pool = self._pool[int(self._rng.integers(NOISE_POOL))]
        a, b = self._rng.integers(0, NOISE_MARGIN, 2)
        bright = frame.astype(np.float32) * np.float32(1.0 + FLICKER * self._rng.standard_normal())
        bright += np.sqrt(np.maximum(READ_NOISE + SHOT_NOISE * bright, 0.0)) * pool[a : a + height, b : b + width]
        return np.clip(np.rint(bright), 0, 255).astype(np.uint8)


class VideoFile:
    """A video file of 8-bit colour frames; MPEG-4 in .mp4, motion JPEG in .avi.

    Parameters
    ----------
    path : Path
    fps : float, in 1/s
        At which it is to be played.
    size : tuple of 2, in pixels
        Width and height.

    Raises
    ------
    InputError
        If the file cannot be written, or has another suffix.
    """

    def __init__(self, path: Path, fps: float, size: tuple[int, int]) -> None:
        import cv2

        codecs = {".mp4": "mp4v", ".avi": "MJPG"}
        if path.suffix.lower() not in codecs:
            raise InputError(f"{path}: a film is written to {' or '.join(codecs)}; got '{path.suffix}'.")
        if not path.parent.is_dir():
            raise InputError(f"{path}: cannot be written; there is no folder {path.parent}.")
        self._writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codecs[path.suffix.lower()]), fps, size)
        if not self._writer.isOpened():
            raise InputError(f"{path}: cannot be written as a video.")

    def __enter__(self) -> VideoFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.release()

    def write(self, frame: Any) -> None:
        """Append a frame.

        Parameters
        ----------
        frame : ndarray of uint8, shape (height, width, 3)
            BGR.
        """
        self._writer.write(frame)
