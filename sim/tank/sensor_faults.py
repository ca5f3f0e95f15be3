"""Faults of the tank's sensors: they change readings before they are converted, or the converted values."""

from __future__ import annotations

import math

import numpy as np

from sim.tank.faults import FaultSchedule
from sim.tank.tank_faults import find_channels
from smolbot.config.rig import RigConfig
from smolbot.core.arrays import BoolArray, FloatArray
from smolbot.errors import InputError

NANO = 1e-9  # T per nT
DIAGONAL = np.ones(3) / math.sqrt(3.0)  # direction of the ambient hum: every sensor along an axis measures the same

BEFORE_CONVERSION = (
    "sensor_gain", "sensor_offset", "sensor_drift", "sensor_hum", "sensor_noise", "sensor_spikes", "ambient_hum",
)  # fmt: skip
AFTER_CONVERSION = (
    "sensor_dead", "sensor_frozen", "sensor_stuck_bit", "sensor_clipped", "sensors_saturated", "sensors_swapped",
)  # fmt: skip


class SensorFaults:
    """Applies the present faults to the readings of one recording.

    Parameters
    ----------
    schedule : FaultSchedule
    rig : RigConfig
    axes : ndarray, shape (n_sensors, 3)
        True sensitive directions with the gain as length, world frame.
    rng : numpy.random.Generator
        Of the spikes.

    Raises
    ------
    InputError
        If the rig has no such channel, or the converter no such bit.
    """

    def __init__(self, schedule: FaultSchedule, rig: RigConfig, axes: FloatArray, rng: np.random.Generator) -> None:
        section = rig.sections.sensors
        self._schedule, self._rng = schedule, rng
        self._rate, self._range, self._bits = section.sample_rate_hz, section.range, section.adc_bits
        self._step = 2 * section.adc_range_v / section.volts_per_tesla / 2**section.adc_bits
        self._along = axes @ DIAGONAL
        self._held = np.full(len(axes), np.nan)
        self._channels = [find_channels(fault, rig) for fault in schedule.faults]
        for fault in schedule.faults:
            if fault.name == "sensor_stuck_bit" and fault.values[0] not in range(self._bits):
                raise InputError(f"--fault {fault.text}: the converter has bits 0 to {self._bits - 1}.")

    def disturb(self, field: FloatArray, own_noise: FloatArray, clock: float) -> None:
        """Add the sensors' own noise to their readings, and change both by the present faults, in place.

        Parameters
        ----------
        field : ndarray, shape (n_sensors, n), in T
            What the sensors measure, ambient field included.
        own_noise : ndarray, shape (n_sensors, n), in T
        clock : float, in s
            Time of the first sample.
        """
        times = clock + np.arange(field.shape[1]) / self._rate
        added = np.zeros_like(field)
        gains = np.ones_like(field)
        for index, fault in enumerate(self._schedule.faults):
            if fault.name not in BEFORE_CONVERSION or not (at := self._find_samples(index, times)).any():
                continue
            if fault.name == "ambient_hum":
                field += np.where(at, self._along[:, None] * _make_line(times, *fault.values), 0.0)
            for i in self._channels[index]:
                if fault.name == "sensor_gain":
                    gains[i, at] *= fault.values[0]
                elif fault.name == "sensor_noise":
                    own_noise[i, at] *= fault.values[0]
                elif fault.name == "sensor_offset":
                    added[i, at] += NANO * fault.values[0]
                elif fault.name == "sensor_drift":
                    added[i, at] += NANO * fault.values[0] * (times[at] - self._schedule.find_span(index)[0])
                elif fault.name == "sensor_hum":
                    added[i, at] += _make_line(times[at], *fault.values)
                elif fault.name == "sensor_spikes":
                    added[i, at] += self._make_spikes(int(at.sum()), *fault.values)
        field += own_noise
        field *= gains
        field += added

    def corrupt(self, field: FloatArray, saturated: BoolArray, clock: float) -> None:
        """Change converted values by the present faults, in place.

        Parameters
        ----------
        field : ndarray, shape (n_sensors, n), in T
        saturated : ndarray of bool, shape (n_sensors,)
        clock : float, in s
            Time of the first sample.
        """
        times = clock + np.arange(field.shape[1]) / self._rate
        for index, fault in enumerate(self._schedule.faults):
            if fault.name not in AFTER_CONVERSION:
                continue
            at = self._find_samples(index, times)
            for i in self._channels[index]:
                if fault.name == "sensor_frozen":
                    self._freeze(field, i, at)
                if not at.any():
                    continue
                if fault.name == "sensor_dead":
                    field[i, at], saturated[i] = 0.0, saturated[i] and not at.all()
                elif fault.name == "sensor_stuck_bit":
                    field[i, at] = self._set_bit(field[i, at], int(fault.values[0]))
                elif fault.name == "sensor_clipped":
                    field[i, at] = np.minimum(field[i, at], NANO * fault.values[0])
                elif fault.name == "sensors_saturated":
                    field[i, at], saturated[i] = self._range, True
                elif fault.name == "sensors_swapped":
                    pair, other = [i, int(fault.values[0])], [int(fault.values[0]), i]
                    field[pair] = np.where(at, field[other], field[pair])
                    saturated[pair] = saturated[other]

    def _find_samples(self, index: int, times: FloatArray) -> BoolArray:
        """Return during which samples a fault is present."""
        start, end = self._schedule.find_span(index)
        return np.asarray((times >= start) & (times < end))

    def _freeze(self, field: FloatArray, i: int, at: BoolArray) -> None:
        """Hold a sensor at the last value before the fault, or at its first one if the fault was there before it."""
        first = int(np.argmax(at)) if at.any() else len(at)
        if first > 0:
            self._held[i] = field[i, first - 1]
        elif math.isnan(self._held[i]):
            self._held[i] = field[i, 0]
        field[i, at] = self._held[i]

    def _make_spikes(self, n: int, height: float, per_second: float) -> FloatArray:
        hits = self._rng.random(n) < per_second / self._rate
        return np.asarray(NANO * height * hits * np.where(self._rng.random(n) < 0.5, -1.0, 1.0))

    def _set_bit(self, values: FloatArray, bit: int) -> FloatArray:
        middle = 1 << (self._bits - 1)
        codes = np.rint(values / self._step).astype(np.int64) + middle
        return np.asarray(self._step * ((codes | (1 << bit)) - middle))


def _make_line(times: FloatArray, amplitude: float, frequency: float) -> FloatArray:
    return np.asarray(NANO * amplitude * np.sin(2 * math.pi * frequency * times))
