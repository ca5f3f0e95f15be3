"""One fit made ready: a recording's data, the time basis and the sensors that take part."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from smolbot.arrays import BoolArray, FloatArray
from smolbot.errors import InputError
from smolbot.localization import basis as time_functions
from smolbot.localization import kernels as compiled
from smolbot.localization.chain import Taps, difference_matrix, taps
from smolbot.sensing import Device, Recording, SensorArray

_kernels: Any = compiled  # the type of a compiled function says nothing of its arguments

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
class ChainModel:
    """What stays the same from one recording to the next like it: chain, time basis, sensors that take part.

    Attributes
    ----------
    mixing : ndarray, shape (n_differences, n_sensors)
    chain : Taps
    basis : ndarray of complex, shape (K, K, n_out)
    """

    sensors: SensorArray
    device: Device
    mixing: FloatArray
    chain: Taps
    basis: time_functions.ComplexArray

    @property
    def amplitude_max(self) -> float:
        """Stop of the deflection, with room for its own error, as a fraction of the reference angle."""
        return 1.1 * self.device.theta_max / time_functions.REFERENCE_ANGLE

    @cached_property
    def constants(self) -> tuple[Any, ...]:
        """Arguments that every kernel of the fit begins with."""
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

    def response(
        self, position: FloatArray, rotation: FloatArray, phase: float, amplitude: float
    ) -> tuple[FloatArray, FloatArray]:
        """Model (n_differences, n_out) and its Jacobian (n_differences, n_out, 8) at one set of parameters."""
        out = np.zeros((len(self.mixing), len(self.chain.first)))
        jacobian = np.zeros((*out.shape, compiled.N_PARAMETERS))
        place = (np.ascontiguousarray(position, dtype=float), np.ascontiguousarray(rotation))
        _kernels.model(*self.constants, *place, float(phase), float(amplitude), out, jacobian)
        return out, jacobian


@lru_cache(maxsize=64)
def chain_model(
    sensors: SensorArray, device: Device, usable: bytes, n_samples: int, sample_rate: float, since: float
) -> ChainModel:
    """Chain and time basis for recordings of one kind, kept for the next one like it.

    Parameters
    ----------
    usable : bytes
        Of a bool array (n_sensors,): the sensors that take part.
    since : float, in s
        From the end of the drive to the first sample.
    """
    mixing = difference_matrix(sensors.axes, sensors.positions, np.frombuffer(usable, dtype=np.bool_))
    chain = taps(n_samples, sample_rate, device.frequency)
    basis = time_functions.time_basis(device, chain, sample_rate, since, sensors.bandwidth)
    return ChainModel(sensors, device, mixing, chain, basis)


@dataclass(frozen=True)
class Problem:
    """One fit made ready.

    Attributes
    ----------
    model : ChainModel
    data : ndarray, shape (n_differences, n_out), in T/s
        Output of the signal chain.
    """

    model: ChainModel
    data: FloatArray

    @cached_property
    def total_sum_of_squares(self) -> float:
        """Eq. S21."""
        off = self.data - self.data.mean()
        return float(np.vdot(off, off))

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
        limits = (self.model.amplitude_max, iterations, tolerance)
        return Fit(*_kernels.fit(self.data, *self.model.constants, *start, *limits))

    def phase_and_amplitude(self, position: FloatArray, rotation: FloatArray) -> tuple[float, float]:
        """Best phase and amplitude at a fixed pose, from a linear solve."""
        place = (np.ascontiguousarray(position), np.ascontiguousarray(rotation))
        top = self.model.amplitude_max
        phase, size = _kernels.linear_start(self.data, *self.model.constants, *place, 0.5 * top)
        return phase, min(max(size, 0.05 * top), 0.98 * top)


def usable_channels(recording: Recording, sensors: SensorArray) -> BoolArray:
    """Channels that take part: not saturated, finite.

    Raises
    ------
    InputError
        If the recording does not fit the sensors, or too few channels can be used; names them.
    """
    if len(recording.field) != len(sensors):
        raise InputError(
            f"The recording has {len(recording.field)} channels; the sensor array has {len(sensors)} sensors."
        )
    finite = np.isfinite(recording.field.sum(axis=1))  # a sum with nan or infinity is neither
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
            "A pose needs a recording after a drive, with time_since_drive of at least 0 s; "
            f"got {recording.time_since_drive}."
        )
    n_samples = recording.field.shape[1]
    model = chain_model(sensors, device, usable.tobytes(), n_samples, recording.sample_rate, recording.time_since_drive)
    if len(model.mixing) < MIN_CHANNELS:
        bad = ", ".join(str(i) for i in np.flatnonzero(~usable)) or "none"
        raise InputError(
            f"Only {len(model.mixing)} same-axis differences can be formed; at least {MIN_CHANNELS} are needed. "
            f"Channels saturated or not finite: {bad}."
        )
    data = _kernels.chain_output(recording.field, model.chain.first, model.chain.weights, model.mixing)
    return Problem(model, data)
