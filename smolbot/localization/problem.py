"""One fit made ready: a recording's data, the time basis and the sensors that take part."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from smolbot.arrays import BoolArray, FloatArray
from smolbot.errors import InputError
from smolbot.localization import basis as time_functions
from smolbot.localization import kernels
from smolbot.localization.chain import Taps, difference_matrix, taps
from smolbot.sensing import Device, Recording, SensorArray

MIN_CHANNELS = 6
"""Fewest differences that can hold the eight unknowns of a fit over a few samples."""


class Fit(NamedTuple):
    """Outcome of one Levenberg-Marquardt fit. `normal` is J^T J for (position, e, phase, amplitude)."""

    position: FloatArray
    rotation: FloatArray
    phase: float
    amplitude: float
    sse: float
    normal: FloatArray
    converged: bool


@dataclass(frozen=True)
class Problem:
    """Data and model of one fit; everything that stays the same while the pose varies.

    Attributes
    ----------
    data : ndarray, shape (n_differences, n_out), in T/s
        Output of the signal chain.
    basis : ndarray of complex, shape (K, K, n_out)
    mixing : ndarray, shape (n_differences, n_sensors)
    """

    sensors: SensorArray
    device: Device
    data: FloatArray
    basis: time_functions.ComplexArray
    mixing: FloatArray

    @property
    def amplitude_max(self) -> float:
        """Stop of the deflection, with room for its own error, as a fraction of the reference angle."""
        return 1.1 * self.device.theta_max / time_functions.REFERENCE_ANGLE

    @property
    def total_sum_of_squares(self) -> float:
        """Eq. S21."""
        return float(np.sum((self.data - self.data.mean()) ** 2))

    def _constants(self) -> tuple[Any, ...]:
        return (
            self.basis,
            self.sensors.positions,
            self.sensors.axes,
            self.mixing,
            self.device.moment * self.device.moment_in_body,
            self.device.l0,
            time_functions.nodes() * time_functions.REFERENCE_ANGLE,
            time_functions.power_matrix(),
        )

    def fit(
        self,
        position: FloatArray,
        rotation: FloatArray,
        phase: float,
        amplitude: float,
        *,
        iterations: int = 40,
        tolerance: float = 1e-7,
    ) -> Fit:
        """Levenberg-Marquardt from one start; amplitudes are fractions of the reference angle."""
        start = (np.ascontiguousarray(position), np.ascontiguousarray(rotation), float(phase), float(amplitude))
        return Fit(
            *kernels.fit(self.data, *self._constants(), *start, self.amplitude_max, iterations, tolerance)
        )

    def model(self, position: FloatArray, rotation: FloatArray, phase: float, amplitude: float) -> tuple[FloatArray, FloatArray]:
        """Model (n_differences, n_out) and its Jacobian (n_differences, n_out, 8) at one set of parameters."""
        out = np.zeros_like(self.data)
        jacobian = np.zeros((*self.data.shape, kernels.N_PARAMETERS))
        kernels.model(
            *self._constants(),
            np.ascontiguousarray(position),
            np.ascontiguousarray(rotation),
            float(phase),
            float(amplitude),
            out,
            jacobian,
        )
        return out, jacobian


@lru_cache(maxsize=32)
def _cached_basis(key: tuple[Any, ...]) -> time_functions.ComplexArray:
    frequency, damping, damping_model, n_samples, sample_rate, time_since_drive, bandwidth = key
    device = Device(1.0, np.array([1.0, 0.0, 0.0]), 1e-3, 0.1, frequency, damping, damping_model)
    return time_functions.time_basis(
        device, taps(n_samples, sample_rate, frequency), sample_rate, time_since_drive, bandwidth
    )


def basis_for(device: Device, sensors: SensorArray, n_samples: int, sample_rate: float, since: float) -> time_functions.ComplexArray:
    """Time basis of a device for recordings of one length, kept for the next recording like it."""
    key = (device.frequency, device.damping, device.damping_model, n_samples, sample_rate, since, sensors.bandwidth)
    return _cached_basis(key)


def usable_channels(recording: Recording, sensors: SensorArray) -> BoolArray:
    """Channels that take part: not saturated, finite.

    Raises
    ------
    InputError
        If the recording does not fit the sensors, or too few channels can be used; names them.
    """
    if len(recording.field) != len(sensors):
        raise InputError(f"The recording has {len(recording.field)} channels; the sensor array has {len(sensors)} sensors.")
    finite = np.isfinite(recording.field).all(axis=1)
    usable: BoolArray = finite & ~recording.saturated
    return usable


def prepare(recording: Recording, sensors: SensorArray, device: Device) -> Problem:
    """Pass a recording through the paper's chain and make its fit ready.

    Raises
    ------
    InputError
        If channels do not match the sensors, too few of them can be used, the recording holds no
        half-period, or no drive preceded it.
    """
    usable = usable_channels(recording, sensors)
    if not np.isfinite(recording.time_since_drive) or recording.time_since_drive < 0:
        raise InputError(
            f"A pose needs a recording after a drive, with time_since_drive of at least 0 s; got {recording.time_since_drive}."
        )
    mixing = difference_matrix(sensors.axes, sensors.positions, usable)
    if len(mixing) < MIN_CHANNELS:
        bad = ", ".join(str(i) for i in np.flatnonzero(~usable)) or "none"
        raise InputError(
            f"Only {len(mixing)} same-axis differences can be formed; at least {MIN_CHANNELS} are needed. "
            f"Channels saturated or not finite: {bad}."
        )
    n_samples = recording.field.shape[1]
    chain: Taps = taps(n_samples, recording.sample_rate, device.frequency)
    data = kernels.chain_output(recording.field, chain.first, chain.weights, mixing)
    basis = basis_for(device, sensors, n_samples, recording.sample_rate, recording.time_since_drive)
    return Problem(sensors, device, data, basis, mixing)


