"""Check before anything moves that a rig's sensors can hear a mission's device, and learn the room's noise first."""

from __future__ import annotations

import numpy as np

from smolbot.config.document import Fault
from smolbot.config.mission_base import MissionBase
from smolbot.core.arrays import BoolArray, FloatArray
from smolbot.core.sensing import PRIOR_AMPLITUDE
from smolbot.localization.chain import MEAN_WINDOW
from smolbot.localization.forward import compute_envelope, compute_sensor_field
from smolbot.localization.noise.model import MIN_SEGMENTS
from smolbot.localization.noise.spectra import SEGMENT
from smolbot.localization.problem import MIN_OUTPUTS

MU_0 = 4e-7 * np.pi
"""Magnetic constant, in T·m/A."""

MIN_STEPS = 4.0
"""Steps of the converter that a swing must span to be a sine and not a square wave."""

SAME_AXIS = np.cos(np.radians(2.0))
"""Cosine above which two sensors have the same axis."""


def find_sensor_faults(mission: MissionBase) -> list[Fault]:
    """Find every reason why the rig's sensors cannot hear the device.

    Parameters
    ----------
    mission : MissionBase

    Returns
    -------
    list of Fault
        Empty if there is none.
    """
    rig, frequency = mission.rig, mission.robot.device.frequency
    section, noise = rig.sections.sensors, rig.sections.noise
    messages = []
    differences = _count_differences(rig.sensors.axes)
    if differences < MIN_OUTPUTS:
        messages.append(
            f"its {len(rig.sensors)} sensors form {differences} same-axis differences; a pose needs {MIN_OUTPUTS}."
        )
    least = 2.0 * frequency * MEAN_WINDOW
    if rig.sample_rate < least:
        messages.append(
            f"it samples at {rig.sample_rate:g} Hz; a device of {frequency:g} Hz needs {least:g} Hz or more."
        )
    if section.bandwidth_hz < frequency:
        messages.append(
            f"its sensors have a bandwidth of {section.bandwidth_hz:g} Hz, below the device's resonance of "
            f"{frequency:g} Hz: they lag too far behind it, and behind the coils' ring-down; they need more."
        )
    always = noise.constant + noise.mains
    if always >= rig.sensor_range:
        messages.append(
            f"its sensors measure up to {1e9 * rig.sensor_range:g} nT, and the room alone has {1e9 * always:g} nT "
            "([noise] constant_nt and mains_nt): they saturate. They need a larger range, or a better nulled field."
        )
    return [*(Fault(("rig",), message) for message in messages), *_find_quiet_faults(mission)]


def _count_differences(axes: FloatArray) -> int:
    """Count the sensors that can be subtracted from an earlier one of their axis."""
    parallel = np.abs(axes @ axes.T) > SAME_AXIS
    return int(np.sum(np.tril(parallel, -1).any(axis=1)))


def _find_quiet_faults(mission: MissionBase) -> list[Fault]:
    """Find that the quiet shots, none longer than the rig may listen, are too short to learn the noise from."""
    duration, longest = mission.base.localization.background_noise_duration, mission.rig.limits.max_listen
    if duration <= 0.0:
        return []
    half_period = 0.5 / mission.robot.device.frequency  # a window is whole half-periods
    needed = MIN_SEGMENTS * SEGMENT + half_period
    if longest < 2.0 * needed:  # the quiet time is divided into equal shots, each at least half as long as it may be
        message = f"it may listen for {1e3 * longest:g} ms; learning noise takes {2e3 * needed:.0f} ms (max_listen_ms)."
        return [Fault(("rig",), message)]
    if duration < needed:
        message = (
            f"{duration:g} s are too short to learn the noise from; give {needed:.2f} s or more, at best 10 s, or 0 to "
            "fly with the rig file's noise."
        )
        return [Fault(("localization", "quiet_s"), message)]
    return []


def find_range_faults(mission: MissionBase, points: FloatArray, orientations: list[FloatArray]) -> list[Fault]:
    """Find where too few sensors give a pose: the robot's magnet saturates them, or its swing is lost in the converter.

    Parameters
    ----------
    mission : MissionBase
    points : ndarray, shape (n, 3), in m
        Places of the robot, in the world frame.
    orientations : list of ndarray, shape (4,)
        Unit quaternions, one for each point.

    Returns
    -------
    list of Fault
        Empty if there is none.
    """
    rig = mission.rig
    free = rig.sensor_range - rig.sections.noise.constant
    sizes = _compute_largest_fields(rig.sensors.positions, rig.sensors.axes, points) * mission.robot.device.moment
    heard: BoolArray = sizes < free
    for point, size, usable in zip(points, sizes, heard, strict=True):
        if _count_differences(rig.sensors.axes[usable]) < MIN_OUTPUTS:
            x, y, z = 1e3 * point
            message = (
                f"at ({x:.1f}, {y:.1f}, {z:.1f}) mm the robot's magnet saturates {int(np.sum(~usable))} of "
                f"{len(usable)} sensors, with up to {1e6 * size.max():.1f} µT each; they measure up to "
                f"{1e6 * rig.sensor_range:g} µT. Move them away, or choose a larger range."
            )
            return [Fault(("rig",), message)]
    return _find_converter_faults(mission, points, orientations)


def _find_converter_faults(mission: MissionBase, points: FloatArray, orientations: list[FloatArray]) -> list[Fault]:
    """Find where the swing is not seen over the converter's steps, which are also coarser than the sensors' noise.

    Steps are white noise of density step / sqrt(6 rate) only while other noise is larger.
    """
    rig, device = mission.rig, mission.robot.device
    step = rig.converter_step
    if step / np.sqrt(6.0 * rig.sample_rate) <= rig.sections.noise.floor:
        return []
    envelope = compute_envelope(device, np.array([mission.cycle.ring_down]))
    swing = PRIOR_AMPLITUDE * device.theta_max * float(envelope[0]) * np.array([-1.0, 1.0])
    for point, orientation in zip(points, orientations, strict=True):
        heard = np.ptp(compute_sensor_field(rig.sensors, device, point, orientation, swing), axis=1)
        clear = int(np.sum(heard > MIN_STEPS * step))
        if clear < MIN_OUTPUTS:
            x, y, z = 1e3 * point
            message = (
                f"at ({x:.1f}, {y:.1f}, {z:.1f}) mm the device's swing spans {MIN_STEPS:g} steps of the converter in "
                f"{clear} of {len(heard)} sensors; a pose needs {MIN_OUTPUTS}. A step is {1e9 * step:.2g} nT: choose "
                "more adc_bits or a smaller adc_range_v."
            )
            return [Fault(("rig",), message)]
    return []


def _compute_largest_fields(positions: FloatArray, axes: FloatArray, points: FloatArray) -> FloatArray:
    """Compute the largest reading (n_points, n_sensors) of a dipole of 1 A·m² over all its directions, in T.

    b(r, a) = mu_0 / (4 pi |r|^3) * |3 n (n . a) - a|,   n = r / |r|        (from Eq. S5)
    """
    offsets = positions - points[:, None, :]
    distance = np.linalg.norm(offsets, axis=2)
    ahead = offsets / distance[..., None]
    seen = 3.0 * ahead * np.sum(ahead * axes, axis=2)[..., None] - axes
    sizes: FloatArray = MU_0 / (4.0 * np.pi * distance**3) * np.linalg.norm(seen, axis=2)
    return sizes
