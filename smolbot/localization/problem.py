"""A prepared fit: a recording reduced to a data vector, and the linear map from time functions to it.

Both estimators have this form; only their linear chains differ.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from smolbot.core.arrays import BoolArray, FloatArray
from smolbot.core.sensing import Device, Recording, SensorArray
from smolbot.errors import InputError
from smolbot.localization import basis as time_functions
from smolbot.localization import kernels as compiled
from smolbot.localization.chain import Taps, compute_taps, make_difference_matrix
from smolbot.localization.forward import compute_envelope

_kernels: Any = compiled  # a compiled function's type does not cover its arguments

AMPLITUDE_SLACK = 1.1
"""Largest amplitude of a fit, relative to theta_max, which itself is not exact."""

FIRST_AMPLITUDE, MIN_FIRST, MAX_FIRST = 0.5, 0.05, 0.98
"""Amplitude at which the linear start is computed, and the range of its result, as shares of the largest."""

MAX_CONDITION = 1e10
"""Condition number above which frequency and damping are not determined."""


class Fit(NamedTuple):
    """Outcome of one Levenberg-Marquardt fit.

    Attributes
    ----------
    position : ndarray, shape (3,), in m, world frame
    rotation : ndarray, shape (3, 3)
        Body to world.
    phase : float, in rad
    amplitude : float
        As a fraction of the reference angle.
    sse : float
        Sum squared error.
    normal : ndarray, shape (8, 8)
        J^T J for (position, e, phase, amplitude).
    converged : bool
    """

    position: FloatArray
    rotation: FloatArray
    phase: float
    amplitude: float
    sse: float
    normal: FloatArray
    converged: bool


@dataclass(frozen=True, eq=False)
class DeviceChange:
    """Change of the device that a finished fit suggests, if it is free to swing otherwise than assumed.

    Attributes
    ----------
    offset : ndarray, shape (2,), in Hz and 1/s
        Estimated minus assumed frequency and damping.
    covariance : ndarray, shape (2, 2)
        Of the offset, for residuals of variance one.
    before, after : float
        Sum squared error without and with the change.
    held : bool
        Whether the fit's amplitude is at its bound: nothing swings beyond the stops, so that the model is wrong.
    """

    offset: FloatArray
    covariance: FloatArray
    before: float
    after: float
    held: bool


@dataclass(frozen=True, eq=False)
class LinearModel:
    """The part of a fit that is the same for all recordings of one kind.

    Attributes
    ----------
    device : Device
    positions : ndarray, shape (n_channels, 3), in m, world frame
        Of the sensors that take part.
    axes : ndarray, shape (n_channels, 3)
        Of the same sensors; an axis is as long as its sensor's gain.
    used : ndarray of bool, shape (n_sensors,)
        Sensors that take part.
    chain : Taps
        Reduces raw samples to fewer ones, channel by channel.
    mixing : ndarray, shape (n_rows, n_channels * n_taps) or (n_differences, n_channels)
        Reduces those to the data vector; see `separable`.
    matrix : ndarray, shape (n_out, n_functions, n_channels)
        Response of the data vector to each time function in each channel.
    slopes : ndarray, shape (2, n_out, n_functions, n_channels)
        Change of `matrix` per Hz of the resonance, and per 1/s of the damping.
    functions : ndarray, shape (n_functions, n_taps)
        The time functions themselves, after the chain.
    free : ndarray, shape (n_taps, n_free)
        Time functions with a free size in every channel, which carry no information on the device.
    separable : bool
        True if `mixing` acts on channels alone, in the same way for every tap.
    white : bool
        True if the data vector's noise is white and of unit variance.
    common : LinearModel, optional
        The part that is the same for every array; see `array_independent`.
    """

    device: Device
    positions: FloatArray
    axes: FloatArray
    used: BoolArray
    chain: Taps
    mixing: FloatArray
    matrix: FloatArray
    slopes: FloatArray
    functions: FloatArray
    free: FloatArray
    separable: bool
    white: bool
    common: LinearModel | None = None

    @property
    def amplitude_max(self) -> float:
        """Stop of the deflection, with a margin for its own error, as a fraction of the reference angle."""
        return AMPLITUDE_SLACK * self.device.theta_max / time_functions.REFERENCE_ANGLE

    @property
    def array_independent(self) -> LinearModel:
        """One object for all models that differ only in positions, axes, gains, moment and l0."""
        return self.common or self

    @cached_property
    def ramps(self) -> FloatArray:
        """Response (n_channels, n_out) of the data vector to a rise by 1 T over the recording, in each channel."""
        time = np.linspace(-0.5, 0.5, len(self.chain.first))
        by_channel = self.mixing.reshape(len(self.mixing), -1, len(time))
        return np.ascontiguousarray((by_channel @ time).T)

    @cached_property
    def amplitude_prior(self) -> FloatArray:
        """Prior of the amplitude: mean and inverse variance (0, so no prior, if the noise is not white)."""
        scale = time_functions.REFERENCE_ANGLE
        mean, std = self.device.amplitude_prior
        return np.array([mean / scale, (scale / std) ** 2 if self.white else 0.0])

    @cached_property
    def constants(self) -> tuple[Any, ...]:
        """First arguments of all kernels of the fit."""
        return (
            np.ascontiguousarray(self.matrix.transpose(1, 2, 0)),
            time_functions.list_labels(),
            self.positions,
            self.axes,
            self.device.moment * self.device.moment_in_body,
            self.device.l0,
            time_functions.compute_nodes() * time_functions.REFERENCE_ANGLE,
            time_functions.compute_power_matrix(),
        )

    def compute_data_vector(self, field: FloatArray) -> FloatArray:
        """Compute the data vector of raw samples.

        Parameters
        ----------
        field : ndarray, shape (n_channels, n), in T

        Returns
        -------
        ndarray, shape (n_out,)
        """
        tapped = _kernels.apply_taps(field, self.chain.first, self.chain.weights)
        return _kernels.mix_channels(self.mixing, tapped if self.separable else tapped.reshape(-1, 1))

    def compute_response(
        self,
        position: FloatArray,
        rotation: FloatArray,
        phase: float,
        amplitude: float,
        matrix: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Compute the modelled data vector and its Jacobian.

        Parameters
        ----------
        position : ndarray, shape (3,), in m, world frame
        rotation : ndarray, shape (3, 3)
            Body to world.
        phase : float, in rad
        amplitude : float
            As a fraction of the reference angle.
        matrix : ndarray, shape (n_out, n_functions, n_channels), optional
            Used in place of the model's own, such as one of its slopes.

        Returns
        -------
        out : ndarray, shape (n_out,)
        jacobian : ndarray, shape (n_out, 8)
            Derivatives for the rotation are for e in exp(e) R.
        """
        first = self.constants[0] if matrix is None else np.ascontiguousarray(matrix.transpose(1, 2, 0))
        out = np.zeros(first.shape[2])
        jacobian = np.zeros((compiled.N_PARAMETERS, len(out)))
        place = (np.ascontiguousarray(position, dtype=float), np.ascontiguousarray(rotation))
        _kernels.evaluate_model(first, *self.constants[1:], *place, float(phase), float(amplitude), out, jacobian)
        return out, jacobian.T


@lru_cache(maxsize=64)
def make_paper_model(
    sensors: SensorArray, device: Device, usable: bytes, n_samples: int, sample_rate: float, since: float
) -> LinearModel:
    """Make the paper's chain for recordings of one kind; cached for similar recordings.

    Parameters
    ----------
    sensors : SensorArray
    device : Device
    usable : bytes
        Of a bool array (n_sensors,): the sensors that take part.
    n_samples : int
    sample_rate : float, in Hz
    since : float, in s
        From the end of the drive to the first sample.

    Returns
    -------
    LinearModel
    """
    used = np.frombuffer(usable, dtype=np.bool_)
    mixing = make_difference_matrix(sensors.axes[used], sensors.positions[used])
    chain = compute_taps(n_samples, sample_rate, device.frequency)
    functions, changes = time_functions.compute_functions_and_slopes(
        device, chain, sample_rate, since, sensors.bandwidth
    )

    def through(functions: FloatArray) -> FloatArray:
        responses = np.einsum("qj,fi->qifj", mixing, functions)
        return np.ascontiguousarray(responses.reshape(-1, len(functions), int(used.sum())))

    return LinearModel(
        device=device,
        positions=np.ascontiguousarray(sensors.positions[used]),
        axes=np.ascontiguousarray(sensors.responses[used]),
        used=used,
        chain=chain,
        mixing=mixing,
        matrix=through(functions),
        slopes=np.stack([through(change) for change in changes]),
        functions=functions,
        free=np.zeros((functions.shape[1], 0)),
        separable=True,
        white=False,
    )


@dataclass(frozen=True, eq=False)
class Problem:
    """A prepared fit.

    Attributes
    ----------
    model : LinearModel
    data : ndarray, shape (n_out,)
    """

    model: LinearModel
    data: FloatArray

    @cached_property
    def total_sum_of_squares(self) -> float:
        """Total sum of squares (Eq. S21); of whitened data about zero, since their mean has no meaning."""
        centered = self.data if self.model.white else self.data - self.data.mean()
        return float(np.vdot(centered, centered))

    def fit(
        self,
        position: FloatArray,
        rotation: FloatArray,
        phase: float,
        amplitude: float,
        *,
        iterations: int = 40,
        tolerance: float = 1e-5,
    ) -> Fit:
        """Fit by the Levenberg-Marquardt method from one start.

        Parameters
        ----------
        position : ndarray, shape (3,), in m, world frame
        rotation : ndarray, shape (3, 3)
            Body to world.
        phase : float, in rad
        amplitude : float
            As a fraction of the reference angle.
        iterations : int
            Largest number of steps.
        tolerance : float
            Relative decrease of the cost below which the fit has converged.

        Returns
        -------
        Fit
        """
        start = (np.array(position), np.array(rotation, order="C"), float(phase), float(amplitude))
        limits = (self.model.amplitude_max, self.model.amplitude_prior, iterations, tolerance)
        return Fit(*_kernels.fit(self.data, *self.model.constants, *start, *limits))

    def estimate_resonance_error(self, fit: Fit, variance: float) -> tuple[FloatArray, FloatArray]:
        """Estimate the error of the device's frequency and damping.

        One Gauss-Newton step from a finished fit, with pose, phase and amplitude left free.

        Parameters
        ----------
        fit : Fit
        variance : float
            Of the residuals.

        Returns
        -------
        offset : ndarray, shape (2,), in Hz and 1/s
            Estimated minus assumed frequency and damping; zero where undetermined.
        covariance : ndarray, shape (2, 2)
            Infinite where undetermined.
        """
        # effect of frequency and damping on the samples, without the part that the eight parameters explain
        model = self.model
        place = (fit.position, fit.rotation, fit.phase, fit.amplitude)
        out, jacobian = model.compute_response(*place)
        change = np.stack([model.compute_response(*place, matrix=slope)[0] for slope in model.slopes], axis=1)
        residual = self.data - out
        solve = np.linalg.solve(fit.normal, jacobian.T @ change)
        free = change - jacobian @ solve
        information = free.T @ free
        if not np.isfinite(information).all() or np.linalg.cond(information) > MAX_CONDITION:
            return np.zeros(2), np.full((2, 2), np.inf)
        inverse = np.linalg.inv(information)
        uncertainty = np.asarray(variance * inverse, dtype=np.float64)
        return inverse @ (free.T @ residual), uncertainty

    def estimate_device_change(self, fit: Fit) -> DeviceChange | None:
        """Estimate by how much frequency and damping differ from the device's, and how much that explains.

        One Gauss-Newton step for ten parameters, in which no bound holds the amplitude.

        Parameters
        ----------
        fit : Fit

        Returns
        -------
        DeviceChange or None
            None where frequency and damping are not determined.
        """
        place = (fit.position, fit.rotation, fit.phase, fit.amplitude)
        out, jacobian = self.model.compute_response(*place)
        slopes = [self.model.compute_response(*place, matrix=slope)[0] for slope in self.model.slopes]
        design = np.column_stack([jacobian, *slopes])
        scale = np.sqrt(np.einsum("ij,ij->j", design, design))
        if not (np.isfinite(scale).all() and (scale > 0.0).all()):
            return None
        design /= scale
        normal = design.T @ design
        if np.linalg.cond(normal) > MAX_CONDITION:
            return None
        residual = self.data - out
        inverse = np.linalg.inv(normal)
        step = inverse @ (design.T @ residual)
        left = residual - design @ step
        return DeviceChange(
            step[-2:] / scale[-2:],
            inverse[-2:, -2:] / np.outer(scale[-2:], scale[-2:]),
            float(residual @ residual),
            float(left @ left),
            held=bool(fit.amplitude >= self.model.amplitude_max),
        )

    def estimate_phase_and_amplitude(self, position: FloatArray, rotation: FloatArray) -> tuple[float, float]:
        """Estimate phase and amplitude at a fixed pose by a linear solve.

        Parameters
        ----------
        position : ndarray, shape (3,), in m, world frame
        rotation : ndarray, shape (3, 3)
            Body to world.

        Returns
        -------
        phase : float, in rad
        amplitude : float
            As a fraction of the reference angle; at most the stop.
        """
        place = (np.array(position), np.array(rotation, order="C"))
        top = self.model.amplitude_max
        start = *self.model.constants, *place, FIRST_AMPLITUDE * top
        phase, size = _kernels.estimate_phase_and_amplitude(self.data, *start)
        return phase, min(max(size, MIN_FIRST * top), MAX_FIRST * top)


MIN_OUTPUTS = 6
"""Fewest differences, or channels, that determine the eight unknowns of a fit."""


MIN_SAMPLES_PER_PERIOD = 10.0
"""Samples per period of the device below which its oscillation is not resolved."""

MIN_ENVELOPE = 1e-6
"""Share of the amplitude below which an oscillation is not measurable."""


def find_usable_channels(recording: Recording, sensors: SensorArray, device: Device) -> BoolArray:
    """Find the channels that take part: not saturated, finite, and not constant.

    Parameters
    ----------
    recording : Recording
    sensors : SensorArray
    device : Device

    Returns
    -------
    ndarray of bool, shape (n_sensors,)

    Raises
    ------
    InputError
        If the recording does not fit sensors or device, no drive preceded it, or the drive was too long ago.
    """
    n_channels = len(recording.field)
    if n_channels != len(sensors):
        raise InputError(f"The recording has {n_channels} channels; the sensor array has {len(sensors)} sensors.")
    if not np.isfinite(recording.time_since_drive) or recording.time_since_drive < 0:
        raise InputError(
            "A pose needs a recording after a drive, with time_since_drive of at least 0 s; "
            f"got {recording.time_since_drive} s."
        )
    if recording.sample_rate < MIN_SAMPLES_PER_PERIOD * device.frequency:
        raise InputError(
            f"The recording has {recording.sample_rate:g} samples per second; a device of {device.frequency:g} Hz "
            f"needs at least {MIN_SAMPLES_PER_PERIOD * device.frequency:g}. Is the rate in Hz?"
        )
    since = recording.time_since_drive
    if not float(compute_envelope(device, np.array([since]))[0]) > MIN_ENVELOPE:
        raise InputError(
            f"The oscillation has decayed {1e3 * since:g} ms after the drive (damping {device.damping:g} 1/s, "
            f"{device.damping_model}). Is the time in ms?"
        )
    moving: BoolArray = _kernels.find_varying_channels(recording.field)
    return moving & ~recording.saturated


def find_constant_channels(field: FloatArray) -> BoolArray:
    """Find the channels that give no signal: constant, or with values that are not finite.

    Parameters
    ----------
    field : ndarray, shape (n_sensors, n), in T
        Raw samples.

    Returns
    -------
    ndarray of bool, shape (n_sensors,)
    """
    constant: BoolArray = ~_kernels.find_varying_channels(field)
    return constant


def check_enough(count: int, what: str, usable: BoolArray) -> None:
    """Raise an error that names the channels left out, if too few remain.

    Parameters
    ----------
    count : int
        What remains.
    what : str
        Its name, for the message.
    usable : ndarray of bool, shape (n_sensors,)

    Raises
    ------
    InputError
        If `count` is less than `MIN_OUTPUTS`.
    """
    if count < MIN_OUTPUTS:
        bad = ", ".join(str(i) for i in np.flatnonzero(~usable)) or "none"
        raise InputError(
            f"Only {count} {what} can be used; at least {MIN_OUTPUTS} are needed. "
            f"Channels saturated, constant, not finite or left out: {bad}."
        )


def prepare_paper(recording: Recording, sensors: SensorArray, device: Device) -> Problem:
    """Pass a recording through the paper's chain and prepare its fit.

    Parameters
    ----------
    recording : Recording
    sensors : SensorArray
    device : Device

    Returns
    -------
    Problem

    Raises
    ------
    InputError
        If channels do not match the sensors, too few of them can be used, the recording holds no
        half-period, or no drive preceded it.
    """
    usable = find_usable_channels(recording, sensors, device)
    check_enough(int(usable.sum()), "channels", usable)
    model = make_paper_model(
        sensors,
        device,
        usable.tobytes(),
        recording.field.shape[1],
        recording.sample_rate,
        recording.time_since_drive,
    )
    check_enough(len(model.mixing), "same-axis differences", usable)
    field = recording.field if usable.all() else np.ascontiguousarray(recording.field[usable])
    return Problem(model, model.compute_data_vector(field))
