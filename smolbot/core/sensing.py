"""The sensor array, the resonant device that it measures, and one recording."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from smolbot.core.arrays import BoolArray, FloatArray, as_floats, freeze
from smolbot.core.shots import Excite
from smolbot.errors import InputError

DampingModel = Literal["linear", "exponential"]

MIN_LENGTH = 1e-9
"""Length below which a vector has no direction."""

PARALLEL = 1 - 1e-9
"""Cosine above which the moment lies along the cantilever."""

OUT_OF_PLANE = 1e-6
"""Component of the moment across the plane of oscillation that is more than rounding."""

PRIOR_AMPLITUDE, PRIOR_AMPLITUDE_STD = 0.75, 0.3
"""Amplitude and its standard deviation before one is measured, as shares of theta_max."""


@dataclass(frozen=True, eq=False)
class SensorArray:
    """Single-axis magnetic sensors.

    Attributes
    ----------
    positions : ndarray, shape (n, 3), in m, world frame
    axes : ndarray, shape (n, 3)
        Sensitive directions in the world frame, of unit length.
    bandwidth : float, in Hz
        Corner of the first-order low pass that each sensor is; ``inf`` for an ideal one.
    gains : ndarray, shape (n,), optional
        Output of each sensor over its nominal output, as learned; ones if not given.

    Examples
    --------
    >>> import smolbot
    >>> array = smolbot.SensorArray([[0.03, 0, 0], [-0.03, 0, 0]], [[0, 0, 1], [1, 0, 0]])
    >>> len(array), array.axes.shape
    (2, (2, 3))
    """

    positions: FloatArray
    axes: FloatArray
    bandwidth: float = np.inf
    gains: FloatArray | None = None

    def __post_init__(self) -> None:
        positions = as_floats(self.positions, (None, 3), "SensorArray positions")
        axes = as_floats(self.axes, (None, 3), "SensorArray axes")
        if len(positions) != len(axes):
            raise InputError(
                f"SensorArray has {len(positions)} positions but {len(axes)} axes; each sensor needs both."
            )
        lengths = np.linalg.norm(axes, axis=1)
        if np.any(lengths < MIN_LENGTH):
            raise InputError(f"SensorArray axis {int(np.argmin(lengths))} has no direction.")
        if not self.bandwidth > 0:
            raise InputError(f"SensorArray bandwidth must be positive, in Hz; got {self.bandwidth}.")
        object.__setattr__(self, "positions", freeze(positions))
        object.__setattr__(self, "axes", freeze(axes / lengths[:, None]))
        if self.gains is not None:
            gains = as_floats(self.gains, (len(positions),), "SensorArray gains")
            if not np.all(gains > 0):
                raise InputError(f"SensorArray gains must be positive; got {gains.min():.4g}.")
            object.__setattr__(self, "gains", freeze(gains))

    @property
    def responses(self) -> FloatArray:
        """Output of each sensor per tesla along x, y and z, shape (n, 3): its axis times its gain."""
        return self.axes if self.gains is None else self.axes * self.gains[:, None]

    def __len__(self) -> int:
        return len(self.positions)


@dataclass(frozen=True, eq=False)
class Device:
    """A magnet on a resonant cantilever, as assumed.

    Attributes
    ----------
    moment : float, in A·m²
    moment_in_body : ndarray, shape (3,)
        Unit direction of the moment at rest; the cantilever lies along body +z and swings about body y.
    l0 : float, in m
        From the rotation centre to the magnet (Eq. S7).
    theta_max : float, in rad
        Stop of the deflection; the amplitude at the end of a drive is at most this.
    frequency : float, in Hz
    damping : float, in 1/s
    damping_model : {"linear", "exponential"}
        Envelope of the free oscillation: Eq. S3 or Eq. S4.
    amplitude, amplitude_std : float or None, in rad
        Amplitude at the end of a drive, as learned; without it, any amplitude up to the stop is likely.

    Examples
    --------
    >>> import smolbot
    >>> device = smolbot.Device(1e-3, [0, 0, 1], 0.0035, 0.31, frequency=103.5, damping=31.7)
    >>> device.along_cantilever
    True
    """

    moment: float
    moment_in_body: FloatArray
    l0: float
    theta_max: float
    frequency: float
    damping: float
    damping_model: DampingModel = "exponential"
    amplitude: float | None = None
    amplitude_std: float | None = None

    def __post_init__(self) -> None:
        direction = as_floats(self.moment_in_body, (3,), "Device moment_in_body")
        length = float(np.linalg.norm(direction))
        if length < MIN_LENGTH:
            raise InputError("Device moment_in_body has no direction.")
        object.__setattr__(self, "moment_in_body", freeze(direction / length))
        for name in ("moment", "theta_max", "frequency"):
            if not 0 < getattr(self, name) < np.inf:
                raise InputError(f"Device {name} must be positive; got {getattr(self, name)}.")
        for name in ("l0", "damping"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InputError(f"Device {name} must not be negative; got {getattr(self, name)}.")
        if self.damping_model not in get_args(DampingModel):
            raise InputError(f"Device damping_model must be 'linear' or 'exponential'; got {self.damping_model!r}.")
        if abs(self.moment_in_body[1]) > OUT_OF_PLANE:
            raise InputError("Device moment_in_body must lie in the plane of oscillation (body x, z).")

    @property
    def amplitude_prior(self) -> tuple[float, float]:
        """Mean and standard deviation of the amplitude at the end of a drive, in rad."""
        if self.amplitude is not None and self.amplitude_std is not None:
            return self.amplitude, self.amplitude_std
        return PRIOR_AMPLITUDE * self.theta_max, PRIOR_AMPLITUDE_STD * self.theta_max

    @property
    def drive_direction_in_body(self) -> FloatArray:
        """Unit body vector y x m: only the field along it drives the oscillation (Eq. S1)."""
        x, _, z = self.moment_in_body
        return np.array([z, 0.0, -x])

    @property
    def along_cantilever(self) -> bool:
        """True if the moment lies along the cantilever, so that a half turn about it changes no signal."""
        return bool(abs(self.moment_in_body[2]) > PARALLEL)


@dataclass(frozen=True, eq=False)
class Recording:
    """Samples of all sensors in one listening window.

    Attributes
    ----------
    field : ndarray, shape (n_sensors, n), in T
        Raw and unfiltered; each channel carries an unknown constant.
    sample_rate : float, in Hz
    time_since_drive : float, in s
        From the end of the excitation to the first sample.
    saturated : ndarray of bool, shape (n_sensors,)
    drive : Excite or None
        The excitation that preceded it; None for a recording of background noise.
    clock : float, in s
        Time of the first sample on the rig's clock.

    Examples
    --------
    >>> import numpy as np
    >>> import smolbot
    >>> recording = smolbot.Recording(np.zeros((10, 500)), 50e3, time_since_drive=0.02, clock=1.0)
    >>> print(f"{recording.duration:.3f} s long, middle at {recording.middle:.3f} s")
    0.010 s long, middle at 1.005 s
    """

    field: FloatArray
    sample_rate: float
    time_since_drive: float
    saturated: BoolArray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    drive: Excite | None = None
    clock: float = 0.0

    def __post_init__(self) -> None:
        samples = as_floats(self.field, (None, None), "Recording field", finite=False)
        object.__setattr__(self, "field", samples)
        if not 0 < self.sample_rate < np.inf:
            raise InputError(f"Recording sample_rate must be positive, in Hz; got {self.sample_rate}.")
        saturated = np.asarray(self.saturated, dtype=np.bool_)
        if saturated.shape == (0,):
            saturated = np.zeros(len(samples), dtype=np.bool_)
        if saturated.shape != (len(samples),):
            raise InputError(f"Recording saturated must have shape ({len(samples)},); got {saturated.shape}.")
        object.__setattr__(self, "saturated", saturated)

    @property
    def duration(self) -> float:
        """Length of the recording in s."""
        return self.field.shape[1] / self.sample_rate

    @property
    def middle(self) -> float:
        """Time of the middle on the rig's clock, in s."""
        return self.clock + 0.5 * self.duration
