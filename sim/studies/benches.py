"""Devices, benches, localizers and priors that the studies share."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from sim.studies.study import Chunk
from sim.tank.static_bench import StaticBench, with_sensors
from smolbot.config.rig import RigConfig, load_rig
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.rotations import (
    compute_rotation_error,
    multiply_quaternions,
    quaternion_from_axes,
    quaternion_from_rotation_vector,
)
from smolbot.core.sensing import Device, Recording
from smolbot.localization.localizer import Estimator, Localizer
from smolbot.localization.noise.model import NoiseModel

QUIET_SECONDS = 10.0
"""Length, in s, of the background recordings from which a noise model is learned."""


RING_DOWN = 0.02
"""Time from the end of the drive to the first sample, in s."""


CYCLES = 5
"""Length of a drive, in periods of the resonance."""


REFERENCE_POSITION = (0.0, 0.0, 0.08)
"""The paper's reference position, in m."""


PRIOR_SIGMA = (1e-3, math.radians(3.0))
"""Standard deviations of a warm start from the truth, per axis, in m and rad."""

MIN_HALF_WIDTH, WIDTH_SHARE = 0.05, 0.4
"""Half width of a cold start's volume: least, in m, and as a share of the height."""

VOLUME_HEIGHTS = (0.03, 0.12)
"""Bottom and lowest top of that volume, in m."""

MIN_SPACING, SPACING_SHARE = 0.008, 0.06
"""Spacing of its grid: least, in m, and as a share of the height."""

FLIP_DEG = 90.0
"""Error of orientation, in degrees, above which a pose is flipped."""


def make_reference_orientation() -> FloatArray:
    """Return the paper's reference: main axis (body z) along world y, oscillating in the x-y plane.

    Returns
    -------
    ndarray, shape (4,)
        Quaternion, body to world.
    """
    return quaternion_from_axes(np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]), "zy")


def make_characterised_device(damping: float = 1.1, model: Any = "linear") -> Device:
    """Make the paper's calibrated device: 17.8 deg, 103.5 Hz, moment across the cantilever.

    Parameters
    ----------
    damping : float, in 1/s
    model : {"linear", "exponential"}

    Returns
    -------
    Device
    """
    return Device(0.89e-3, np.array([1.0, 0.0, 0.0]), 1.5e-3, math.radians(17.8), 103.5, damping, model)


def make_optimised_device() -> Device:
    """Make the paper's optimised device: 30 deg, 160 Hz.

    Returns
    -------
    Device
    """
    return Device(0.89e-3, np.array([1.0, 0.0, 0.0]), 1.5e-3, math.radians(30.0), 160.0, 1.1, "linear")


@lru_cache(maxsize=8)
def load_rig_once(name: str) -> RigConfig:
    """Read a rig file, once per process.

    Parameters
    ----------
    name : str

    Returns
    -------
    RigConfig
    """
    return load_rig(name)


def open_bench(chunk: Chunk, device: Device, mismatch: float, *, spread: float = 1.0) -> StaticBench:
    """Sample the bench of a chunk from its seed.

    Parameters
    ----------
    chunk : Chunk
    device : Device
    mismatch : float
        Factor on every mismatch of the rig file.
    spread : float
        Scale of the sensor positions about the origin.

    Returns
    -------
    StaticBench
    """
    rig = load_rig_once(chunk["rig"])
    if spread != 1.0:
        rig = with_sensors(rig, spread * rig.sensors.positions, rig.sensors.axes)
    return StaticBench(rig, device, chunk.seed, mismatch)


def make_localizers(
    bench: StaticBench,
    estimators: Sequence[Estimator],
    quiet: float = QUIET_SECONDS,
    reach: float | None = None,
) -> dict[str, Localizer]:
    """Make localizers from nominal sensors and device, with noise learned from background recordings.

    Parameters
    ----------
    bench : StaticBench
    estimators : sequence of str
    quiet : float, in s
        Duration of the background recordings.
    reach : float, optional, in m
        Height up to which poses are searched, where the default is not enough.

    Returns
    -------
    dict of str to Localizer
    """
    from smolbot.localization.cold_start import SearchVolume

    volume = SearchVolume()
    if reach is not None:
        wide = max(MIN_HALF_WIDTH, WIDTH_SHARE * reach)
        (bottom, top), spacing = VOLUME_HEIGHTS, max(MIN_SPACING, SPACING_SHARE * reach)
        volume = SearchVolume((-wide, -wide, bottom), (wide, wide, max(reach, top)), spacing)
    noise = NoiseModel.learn(bench.record_background(quiet)) if "whitened" in estimators else None
    return {e: Localizer(bench.sensors, bench.device, noise, e, volume) for e in estimators}


def sample_prior(position: FloatArray, orientation: FloatArray, rng: np.random.Generator) -> Pose:
    """Sample a warm start: the true pose with a random error of size `PRIOR_SIGMA`.

    Parameters
    ----------
    position : ndarray, shape (3,), in m
    orientation : ndarray, shape (4,)
    rng : numpy.random.Generator

    Returns
    -------
    Pose
    """
    off, turn = PRIOR_SIGMA
    moved = position + off * rng.standard_normal(3)
    turned = multiply_quaternions(quaternion_from_rotation_vector(turn * rng.standard_normal(3)), orientation)
    return Pose(0.0, moved, turned, np.diag([off**2] * 3 + [turn**2] * 3))


def make_pose_row(pose: Pose, position: FloatArray, orientation: FloatArray) -> dict[str, float]:
    """Make one row of `Columns`: errors, standard deviations, NEES, and quality of a pose.

    Parameters
    ----------
    pose : Pose
    position : ndarray, shape (3,), in m
        True.
    orientation : ndarray, shape (4,)
        True.

    Returns
    -------
    dict of str to float
    """
    error = np.concatenate([pose.position - position, compute_rotation_error(pose.orientation, orientation)])
    expected = np.sqrt(np.diag(pose.covariance))
    scale = np.where(expected > 0, expected, 1.0)
    nees = float((error / scale) @ np.linalg.solve(pose.covariance / np.outer(scale, scale), error / scale))
    row = {f"error_{axis}_mm": 1e3 * float(error[i]) for i, axis in enumerate("xyz")}
    row |= {f"error_r{axis}_deg": math.degrees(float(error[3 + i])) for i, axis in enumerate("xyz")}
    row |= {f"sigma_{axis}_mm": 1e3 * float(expected[i]) for i, axis in enumerate("xyz")}
    row |= {"nees": nees, "r_squared": pose.r_squared, "flip_margin": pose.flip_margin, "trusted": float(pose.trusted)}
    return row


def locate_all(
    found: Mapping[str, Localizer],
    recording: Recording,
    position: FloatArray,
    orientation: FloatArray,
    prior: Pose | None,
) -> list[dict[str, Any]]:
    """Locate one recording with each estimator.

    Parameters
    ----------
    found : mapping of str to Localizer
    recording : Recording
    position : ndarray, shape (3,), in m
        True.
    orientation : ndarray, shape (4,)
        True.
    prior : Pose or None

    Returns
    -------
    list of dict
        One row per estimator.
    """
    return [
        {"estimator": name, **make_pose_row(localizer.locate(recording, prior), position, orientation)}
        for name, localizer in found.items()
    ]
