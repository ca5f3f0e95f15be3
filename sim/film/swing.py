"""High-speed clips of a cantilever that is excited and released, as under a microscope (Movie S1 and Fig. S2)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim.film.filming import CameraNoise, VideoFile, blur_image
from sim.tank.magnetics.cantilever import DRIVE, ETA, L0, MIDDLE, STATE_LENGTH, advance_cantilever
from sim.tank.magnetics.coil_fields import COMMAND, SINE
from sim.tank.magnetics.device_packing import pack_true_device
from sim.tank.magnetics.tank_coils import TankCoils
from sim.tank.magnetics.true_sensors import TrueSensors
from sim.tank.mismatch import RandomStreams, sample_truth
from sim.tank.settings import TankSettings
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import matrix_from_quaternion, quaternion_from_axes
from smolbot.errors import InputError

STEP, SUBSTEPS = 1e-3, 50  # s: as in the tank
SCALE = 80e3  # pixels per m
SIZE = (320, 288)  # pixels
PIVOT = (160.0, 244.0)  # pixel of the rotation centre, before the clip is turned and shifted
PLAYBACK_RATE = 25.0  # frames per second in the file, as high-speed cameras write it
EXPOSURE, EXPOSED = 60e-6, 3  # s; pictures that are averaged for one frame
FRAMES_PER_PERIOD, MAX_FPS = 8.0, 1e6  # fewest frames per period, and most per second
MAGNET_HALF, BLADE_HALF = 0.5e-3, 0.02e-3  # m: half a side of the magnet, half the thickness of the cantilever


@dataclass(frozen=True, eq=False)
class SwingFilm:
    """A clip's ground truth.

    Attributes
    ----------
    times : ndarray, shape (n,), in s
        Of the frames.
    angles : ndarray, shape (n,), in rad
        Deflections.
    released : float, in s
        End of the drive.
    frequency : float, in Hz
    damping : float, in 1/s
        Of an exponential decay.
    amplitude_loss : float, in rad/s
        Decrease of the amplitude in a linear decay.
    theta_max : float, in rad
    """

    times: FloatArray
    angles: FloatArray
    released: float
    frequency: float
    damping: float
    amplitude_loss: float
    theta_max: float

    def write_truth(self, path: Path) -> None:
        """Write a CSV row per frame: frame, time_s, angle_rad.

        Parameters
        ----------
        path : Path
        """
        rows = [f"{i},{t:.9g},{a:.9g}" for i, (t, a) in enumerate(zip(self.times, self.angles, strict=True))]
        path.write_text("\n".join(["frame,time_s,angle_rad", *rows]) + "\n", encoding="utf-8")


def simulate_swing(
    rig: RigConfig, robot: RobotConfig, seed: int, cycles: int, free_time: float, current: float
) -> tuple[FloatArray, FloatArray, float, FloatArray]:
    """Simulate the tank's cantilever in a housing held over the excitation coils: driven, then free.

    Parameters
    ----------
    rig : RigConfig
    robot : RobotConfig
    seed : int
    cycles : int
        Length of the drive, in periods of the assumed resonance.
    free_time : float, in s
        Time after the drive.
    current : float, in A
        Amplitude of the drive.

    Returns
    -------
    times : ndarray, shape (n,), in s
    angles : ndarray, shape (n,), in rad
        Deflection.
    released : float, in s
        End of the drive.
    device : ndarray
        As `sim.tank.magnetics.cantilever.advance_cantilever` takes it.
    """
    settings = rig.section_of("tank", TankSettings)
    streams = RandomStreams.from_seed(seed)
    truth = sample_truth(settings, len(rig.driven), len(rig.sensors), streams)
    sensors = TrueSensors(rig, truth, streams.field_noise, streams.sensor_noise, streams.constants)
    coils = TankCoils.build(rig, settings, truth, sensors.positions, sensors.axes)
    device = pack_true_device(robot, settings, truth)
    # the field of the first coil is along world x: it must be across the moment, in the plane of oscillation
    across = "x" if robot.device.along_cantilever else "z"
    quaternion = quaternion_from_axes(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), f"{across}y")
    place = np.array([*rig.container.center, rig.container.surface_z])
    middle = place + matrix_from_quaternion(quaternion) @ device[MIDDLE : MIDDLE + 3]
    drive = cycles / robot.device.frequency
    steps = math.ceil((drive + free_time) / STEP)
    state, poses = np.zeros(STATE_LENGTH), np.zeros((steps, 7))
    trace = np.zeros((steps * SUBSTEPS, 1 + len(coils.circuits)))
    state[DRIVE] = 2.0 * math.pi * robot.device.frequency
    coils.circuits[coils.n_actuation, SINE] = current
    on = round(drive / STEP)  # to a millisecond
    for i in range(steps):
        if i == on:
            coils.circuits[:, COMMAND : SINE + 1] = 0.0
        advance_cantilever(
            tuple(middle), tuple(quaternion), device, np.zeros(3), coils.fields.rows, coils.fields.coefficients,
            coils.circuits, state, poses, i, trace, i * SUBSTEPS, STEP, SUBSTEPS, np.zeros((0, 1)), 0,
        )  # fmt: skip
    times = np.asarray(STEP / SUBSTEPS * np.arange(1, len(trace) + 1), np.float64)
    return times, trace[:, 0], on * STEP, device


def film_swing(
    rig: RigConfig, robot: RobotConfig, path: Path, *, seed: int = 1, fps: float = 5000.0, cycles: int = 10,
    free_time: float = 0.15, current: float = 6.0,
) -> SwingFilm:  # fmt: skip
    """Film a cantilever with a bright magnet, along its axis of oscillation, into a clip.

    The file is to be played at 25 frames per second and its header contains that rate.

    Parameters
    ----------
    rig : RigConfig
    robot : RobotConfig
    path : Path
        Of the clip.
    seed : int
    fps : float, in 1/s
        At which it is recorded.
    cycles : int
        Length of the drive, in periods of the assumed resonance.
    free_time : float, in s
        Time after the drive.
    current : float, in A
        Amplitude of the drive.

    Returns
    -------
    SwingFilm

    Raises
    ------
    InputError
        If the frame rate is too low for the oscillation, or the file cannot be written.
    """
    fewest = FRAMES_PER_PERIOD * robot.device.frequency
    if not fewest <= fps <= MAX_FPS:
        raise InputError(
            f"An oscillation of {robot.device.frequency:g} Hz needs {fewest:.0f} to {MAX_FPS:g} frames per second; "
            f"got {fps:g}."
        )
    rng = np.random.default_rng([seed, 0x5711])
    times, theta, released, device = simulate_swing(rig, robot, seed, cycles, free_time, current)
    frames = (np.arange(math.floor(times[-1] * fps)) + 0.5) / fps
    l0, theta_max, omega2, friction, eta = (float(v) for v in device[L0 : ETA + 1])
    frequency = math.sqrt(omega2 - eta**2) / (2.0 * math.pi)
    loss = friction * 4.0 * frequency / omega2  # of dry friction, in rad/s
    made = SwingFilm(frames, np.interp(frames, times, theta), released, frequency, eta, loss, theta_max)
    scene = _SwingScene(rng, l0)
    grain = CameraNoise(rng, SIZE)
    with VideoFile(path, PLAYBACK_RATE, SIZE) as writer:
        for time in frames:
            parts = [
                scene.render(float(np.interp(time + shift, times, theta)))
                for shift in EXPOSURE * (np.arange(EXPOSED) - 1) / EXPOSED
            ]
            writer.write(grain.apply(blur_image(np.mean(parts, axis=0), scene.blur)))
    return made


class _SwingScene:
    """A dark chamber, a steel blade and a bright magnet, viewed slightly off the axis and rotated."""

    def __init__(self, rng: np.random.Generator, l0: float) -> None:
        self.l0, self.blur = l0, rng.uniform(0.8, 1.3)
        roll, oblique, towards = np.radians(rng.uniform(-4, 4)), np.radians(rng.uniform(0, 4)), rng.uniform(0, math.pi)
        u, v = np.meshgrid(np.arange(SIZE[0], dtype=float), np.arange(SIZE[1], dtype=float))
        shift = rng.uniform(-6, 6, 2)
        right, up = (u - PIVOT[0] - shift[0]) / SCALE, (PIVOT[1] + shift[1] - v) / SCALE
        c, s = math.cos(towards), math.sin(towards)
        along = (c * right + s * up) / math.cos(oblique)  # foreshortened in one direction
        aside = -s * right + c * up
        right, up = c * along - s * aside, s * along + c * aside
        c, s = math.cos(roll), math.sin(roll)
        self.x, self.z = c * right + s * up, -s * right + c * up
        self.light = (
            1.0 + rng.uniform(-0.15, 0.15) * (u / SIZE[0] - 0.5) + rng.uniform(-0.15, 0.15) * (v / SIZE[1] - 0.5)
        )
        self.polish = rng.uniform(-0.2, 0.2, 2)
        wall = 0.5 + 0.5 * np.tanh((np.abs(self.x) - 1.35e-3) / 0.05e-3)
        self.chamber = 18.0 + 30.0 * wall + 6.0 * rng.uniform() * (self.z < -0.3e-3)

    def render(self, theta: float) -> FloatArray:
        """Render the scene (rows, columns, 3) with the magnet deflected by `theta` rad, without noise and blur."""
        half = MAGNET_HALF
        c, s = math.cos(theta), math.sin(theta)
        # own axes of the magnet: ahead along the deflected cantilever
        ahead, aside = s * self.x + c * self.z - self.l0, c * self.x - s * self.z
        reach = np.maximum(np.abs(ahead), np.abs(aside)) - half
        magnet = np.clip(0.5 - SCALE * reach, 0.0, 1.0)
        shine = 185.0 * (1.0 + self.polish[0] * ahead / half + self.polish[1] * aside / half)
        bend = 0.5 * math.tan(theta) * np.clip(self.z + self.l0, 0.0, None) ** 2 / (2.0 * self.l0)
        blade = (
            np.clip(0.5 - SCALE * (np.abs(self.x - bend) - BLADE_HALF), 0.0, 1.0)
            * (self.z < self.l0)
            * (self.z > -self.l0)
        )
        picture = self.chamber + 40.0 * blade
        picture = (1.0 - magnet) * picture + magnet * shine
        return np.repeat((picture * self.light)[:, :, None], 3, axis=2) * np.array([0.98, 1.0, 1.02])
