"""Draws one tank from a seed: every way in which the world differs from what the controller believes."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from sim.tank.settings import TankSettings
from smolbot.core.arrays import FloatArray
from smolbot.core.sensing import Device

CLIP = 3.0  # standard deviations to which mismatches are clipped: no lab builds a coil 2 mm away
START_CLIP = 2.0  # standard deviations to which the start is clipped
MIN_FACTOR = 0.05  # least factor on a value: it must stay positive


class DrawnValues:
    """Base of what was drawn: dataclasses of numbers and arrays."""

    def as_dict(self) -> dict[str, Any]:
        """All drawn values as plain lists and numbers, for a run's provenance."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]
        return {key: v.tolist() if isinstance(v, np.ndarray) else v for key, v in values.items()}


class Spreads:
    """Draws mismatches about nominal values, none beyond `CLIP` standard deviations; the scale only multiplies them."""

    def __init__(self, rng: np.random.Generator, scale: float) -> None:
        self._rng = rng
        self._scale = scale

    def spread(self, deviation: float, *shape: int) -> FloatArray:
        """Offsets with a standard deviation, of any unit."""
        return self._scale * deviation * np.clip(self._rng.standard_normal(shape), -CLIP, CLIP)

    def factor(self, deviation: float, *shape: int) -> FloatArray:
        """Factors about 1, all of them above 0."""
        return np.maximum(1.0 + self.spread(deviation, *shape), MIN_FACTOR)

    def one(self, deviation: float) -> float:
        """A single factor."""
        return float(self.factor(deviation, 1)[0])


@dataclass(frozen=True, eq=False)
class Truth(DrawnValues):
    """What was drawn. Places in m, tilts as rotation vectors in rad, everything else a factor on the nominal value.

    Attributes
    ----------
    coil_places, coil_tilts : ndarray, shape (n_coils, 3)
    coil_gains, coil_time_constants : ndarray, shape (n_coils,)
        Actuation coils first, in the rig's order, then the excitation coils.
    sensor_places, sensor_tilts : ndarray, shape (n_sensors, 3)
    sensor_gains : ndarray, shape (n_sensors,)
    drag, rotation_drag : ndarray, shape (3,)
        Along and about the body axes.
    density, moment, l0, theta_max, damping, frequency, noise, mains_frequency, compensation_gain : float
    compensation_tilt : ndarray, shape (3,)
    start_offset : ndarray, shape (2,), in m
    start_heading : float, in rad
        From world x to the robot's forward axis. Drawn, as the offset is, at every scale.
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

    def device(self, believed: Device) -> Device:
        """The device as it was drawn, of one as it is believed to be."""
        return replace(
            believed,
            moment=believed.moment * self.moment,
            l0=believed.l0 * self.l0,
            theta_max=believed.theta_max * self.theta_max,
            frequency=believed.frequency * self.frequency,
            damping=believed.damping * self.damping,
        )


@dataclass(frozen=True)
class Streams:
    """Independent random generators of one tank, so that more of one thing does not change another."""

    mismatch: np.random.Generator
    start: np.random.Generator
    field_noise: np.random.Generator
    sensor_noise: np.random.Generator
    constants: np.random.Generator

    @classmethod
    def from_seed(cls, seed: int) -> Streams:
        """Spawn all streams from one seed."""
        return cls(*(np.random.Generator(np.random.SFC64(s)) for s in np.random.SeedSequence(seed).spawn(5)))


def draw(settings: TankSettings, n_coils: int, n_sensors: int, streams: Streams, *, ideal: bool = False) -> Truth:
    """Draw a tank with `n_coils` coils (excitation coils included) and `n_sensors` sensors.

    The order of draws is fixed, and the scale only multiplies them: the same seed at twice the scale is
    the same tank with every mismatch doubled. `ideal` is the scale 0.
    """
    section = settings.mismatch
    spreads = Spreads(streams.mismatch, 0.0 if ideal else section.scale)
    spread, factor, one = spreads.spread, spreads.factor, spreads.one
    return Truth(
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
    )
