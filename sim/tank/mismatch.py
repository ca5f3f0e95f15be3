"""Sample one tank from a seed: every way in which the true tank differs from the model that the controller uses."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from sim.tank.settings import TankSettings
from smolbot.config.mismatch import MismatchSampler
from smolbot.core.arrays import FloatArray
from smolbot.core.sensing import Device

START_CLIP = 2.0  # standard deviations to which the start is clipped


class SampledValues:
    """Base of the dataclasses that hold sampled numbers and arrays."""

    def as_dict(self) -> dict[str, Any]:
        """Return all sampled values as plain lists and numbers, for a run's provenance.

        Returns
        -------
        dict
            One entry per field.
        """
        values = {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]
        return {key: v.tolist() if isinstance(v, np.ndarray) else v for key, v in values.items()}


@dataclass(frozen=True, eq=False)
class TankTruth(SampledValues):
    """Sampled mismatches of one tank. Those without a unit are factors on the nominal value.

    Attributes
    ----------
    coil_places : ndarray, shape (n_coils, 3), in m
        Displacements, world frame. Actuation coils first, in the rig's order, then the excitation coils.
    coil_tilts : ndarray, shape (n_coils, 3), in rad
        Rotation vectors, world frame.
    coil_gains, coil_time_constants : ndarray, shape (n_coils,)
    sensor_places : ndarray, shape (n_sensors, 3), in m
        Displacements, world frame.
    sensor_tilts : ndarray, shape (n_sensors, 3), in rad
        Rotation vectors, world frame.
    sensor_gains : ndarray, shape (n_sensors,)
    drag, rotation_drag : ndarray, shape (3,)
        Along and about the body axes.
    density, moment, l0, theta_max, damping, frequency, noise, mains_frequency, compensation_gain : float
    compensation_tilt : ndarray, shape (3,), in rad
        Rotation vector, world frame.
    start_offset : ndarray, shape (2,), in m
        From the requested to the true start position, along world x and y. Sampled at every scale.
    start_heading : float, in rad
        From world x to the robot's forward axis. Sampled at every scale.
    flow_direction : float, in rad
        Direction of a current in the liquid, from world x toward y. Sampled at every scale.
    flow_sense : float
        1 if the liquid rotates from x toward y, -1 if from y toward x. Sampled at every scale.
    """

    coil_places: FloatArray
    coil_tilts: FloatArray
    coil_gains: FloatArray
    coil_time_constants: FloatArray
    sensor_places: FloatArray
    sensor_tilts: FloatArray
    sensor_gains: FloatArray
    drag: FloatArray
    rotation_drag: FloatArray
    density: float
    moment: float
    l0: float
    theta_max: float
    damping: float
    frequency: float
    noise: float
    mains_frequency: float
    compensation_gain: float
    compensation_tilt: FloatArray
    start_offset: FloatArray
    start_heading: float
    flow_direction: float
    flow_sense: float

    def apply_to_device(self, assumed: Device) -> Device:
        """Apply the sampled factors to the assumed device.

        Parameters
        ----------
        assumed : Device
            As the controller assumes it.

        Returns
        -------
        Device
            As it truly is.
        """
        return replace(
            assumed,
            moment=assumed.moment * self.moment,
            l0=assumed.l0 * self.l0,
            theta_max=assumed.theta_max * self.theta_max,
            frequency=assumed.frequency * self.frequency,
            damping=assumed.damping * self.damping,
        )


@dataclass(frozen=True)
class RandomStreams:
    """Independent random generators of one tank: more samples of one thing do not change another.

    Attributes
    ----------
    mismatch : numpy.random.Generator
        Of the mismatches.
    start : numpy.random.Generator
        Of the start pose.
    field_noise : numpy.random.Generator
        Of the ambient field: directions and phases of its lines.
    sensor_noise : numpy.random.Generator
        Of the sensors' own noise.
    constants : numpy.random.Generator
        Of each channel's unknown constant.
    flow : numpy.random.Generator
        Of the liquid's flow.
    """

    mismatch: np.random.Generator
    start: np.random.Generator
    field_noise: np.random.Generator
    sensor_noise: np.random.Generator
    constants: np.random.Generator
    flow: np.random.Generator

    @classmethod
    def from_seed(cls, seed: int) -> RandomStreams:
        """Spawn all generators from one seed.

        Parameters
        ----------
        seed : int

        Returns
        -------
        RandomStreams
        """
        return cls(*(np.random.Generator(np.random.SFC64(s)) for s in np.random.SeedSequence(seed).spawn(6)))


def sample_truth(
    settings: TankSettings, n_coils: int, n_sensors: int, streams: RandomStreams, *, ideal: bool = False
) -> TankTruth:
    """Sample the mismatches of one tank.

    The order of the samples is fixed, and the scale only multiplies them: the same seed at twice the scale is
    the same tank with every mismatch doubled.

    Parameters
    ----------
    settings : TankSettings
        With the standard deviations.
    n_coils : int
        Number of coils, excitation coils included.
    n_sensors : int
    streams : RandomStreams
        Advanced by the call.
    ideal : bool
        Use the scale 0.

    Returns
    -------
    TankTruth
    """
    section = settings.mismatch
    spreads = MismatchSampler(streams.mismatch, 0.0 if ideal else section.scale)
    spread, factor, one = spreads.sample_offsets, spreads.sample_factors, spreads.sample_factor
    return TankTruth(
        coil_places=spread(section.coil_place, n_coils, 3),
        coil_tilts=spread(section.coil_axis, n_coils, 3),
        coil_gains=factor(section.coil_gain, n_coils),
        coil_time_constants=factor(section.time_constant, n_coils),
        sensor_places=spread(section.sensor_place, n_sensors, 3),
        sensor_tilts=spread(section.sensor_axis, n_sensors, 3),
        sensor_gains=factor(section.sensor_gain, n_sensors),
        drag=one(section.drag) * factor(section.drag_anisotropy, 3),
        rotation_drag=one(section.rotation_drag) * factor(section.drag_anisotropy, 3),
        density=one(section.density),
        moment=one(section.moment),
        l0=one(section.l0),
        theta_max=one(section.theta_max),
        damping=one(section.damping),
        frequency=one(section.frequency),
        noise=one(section.noise),
        mains_frequency=one(section.mains_frequency),
        compensation_gain=one(settings.earth.compensation_gain),
        compensation_tilt=spread(settings.earth.compensation_axis, 3),
        start_offset=settings.start_scatter * np.clip(streams.start.standard_normal(2), -START_CLIP, START_CLIP),
        start_heading=float(streams.start.uniform(-np.pi, np.pi)),
        flow_direction=float(streams.flow.uniform(-np.pi, np.pi)),
        flow_sense=float(streams.flow.choice([-1.0, 1.0])),
    )
