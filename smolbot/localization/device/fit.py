"""A device fitted with the full model (Eqs. S2 to S8): pose, amplitude, frequency and damping together.

The height may be held fixed: since B ~ theta / z³, one of amplitude and height must be known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import multiply_quaternions, quaternion_from_rotation_vector
from smolbot.core.sensing import Device, Recording, SensorArray
from smolbot.localization.device.least_squares import minimize
from smolbot.localization.device.thinning import BLOCK_NOISE, POWERS, Hum, ThinnedRecording, thin_recording
from smolbot.localization.forward import compute_sensor_field

REFERENCE = float(np.radians(30.0))
"""Deflection, in rad, that scales the powers."""

NODE_SPREAD = 1.3
"""Half range of the Chebyshev nodes, in units of the reference angle."""

FREQUENCY_RANGE = np.array([0.5, 2.0])
"""Range of the frequency in a fit, as factors on the starting value."""

LOG_DAMPING_RANGE = (-7.0, 7.0)
"""Range of the damping's logarithm (1/s) in a fit."""

LOG_AMPLITUDE_RANGE = (-12.0, 0.4)
"""Range of the amplitude's logarithm (rad) in a fit."""

MIN_DAMPING, FIRST_AMPLITUDE = 1e-3, 0.5
"""Smallest starting damping, in 1/s, and starting amplitude as a share of the largest."""

FIRST_AMPLITUDE_RANGE = (1e-3, 1.2)
"""Range, in rad, of the amplitude from the first harmonic."""

STEPS = np.array([1e-6] * 3 + [1e-4] * 7)
"""Steps of the difference quotients: m, rad, phase, ln amplitude, Hz, ln damping."""

KEPT_WAVES = 8
"""Whitened waves that are kept for reuse."""

TINY = 1e-300
"""Keeps a quotient finite where there is no signal."""


@dataclass(frozen=True)
class DeviceFit:
    """One recording fitted with the full model.

    Attributes
    ----------
    device : Device
        With the fitted frequency and damping; theta_max is as given.
    position : ndarray, shape (3,), in m
    orientation : ndarray, shape (4,)
    amplitude : float, in rad
        Deflection at the end of the drive.
    phase : float, in rad
    std : dict
        Standard deviations of ``frequency`` (Hz), ``damping`` (1/s), ``amplitude`` (rad), from the residual.
    sse : float, in T²
    n_data : int
    r_squared : float
        Of the thinned data.
    """

    device: Device
    position: FloatArray
    orientation: FloatArray
    amplitude: float
    phase: float
    std: Mapping[str, float]
    sse: float
    n_data: int
    r_squared: float


def compute_power_coefficients(
    sensors: SensorArray, device: Device, position: FloatArray, orientation: FloatArray
) -> FloatArray:
    """Compute the field along each sensor's axis as a power series of theta / `REFERENCE`.

    Parameters
    ----------
    sensors : SensorArray
    device : Device
    position : ndarray, shape (3,), in m, world frame
        Of the rotation centre.
    orientation : ndarray, shape (4,)
        Unit quaternion, body to world.

    Returns
    -------
    ndarray, shape (n_sensors, POWERS), in T
        Of the powers 1 to `POWERS`; the constant is not observable. Exact to 1e-6 of the signal within 40 degrees.
    """
    nodes = NODE_SPREAD * np.cos(np.pi * (np.arange(POWERS + 1) + 0.5) / (POWERS + 1))
    inverse = np.linalg.inv(np.vander(nodes, POWERS + 1, increasing=True))
    values = compute_sensor_field(sensors, device, position, orientation, nodes * REFERENCE)
    coefficients: FloatArray = (values @ inverse.T)[:, 1:]
    return coefficients


@dataclass(frozen=True, eq=False)
class _FullModel:
    """Residuals of the full model; parameters (x, y, z, e, phase, ln amplitude, frequency, ln damping)."""

    thinned: ThinnedRecording
    sensors: SensorArray
    device: Device
    position: FloatArray
    orientation: FloatArray
    free: list[int]
    start: FloatArray
    wave_cache: dict[tuple[float, ...], FloatArray] = field(default_factory=dict)

    @cached_property
    def used_sensors(self) -> SensorArray:
        used = self.thinned.used
        gains = None if self.sensors.gains is None else self.sensors.gains[used]
        return SensorArray(self.sensors.positions[used], self.sensors.axes[used], self.sensors.bandwidth, gains)

    def unpack(self, values: FloatArray) -> tuple[Device, FloatArray, FloatArray, float, float]:
        full = self.start.copy()
        full[self.free] = values
        frequency = np.clip(full[8], *(FREQUENCY_RANGE * self.device.frequency))
        damping = float(np.exp(np.clip(full[9], *LOG_DAMPING_RANGE)))
        device = replace(self.device, frequency=float(frequency), damping=damping)
        orientation = multiply_quaternions(quaternion_from_rotation_vector(full[3:6]), self.orientation)
        return (
            device,
            self.position + full[:3],
            orientation,
            float(full[6]),
            float(np.exp(np.clip(full[7], *LOG_AMPLITUDE_RANGE))),
        )

    def compute_residual(self, values: FloatArray) -> FloatArray:
        device, position, orientation, phase, amplitude = self.unpack(values)
        waves = self._compute_waves(device, phase)
        sizes = compute_power_coefficients(self.used_sensors, device, position, orientation)
        sizes = sizes * (amplitude / REFERENCE) ** np.arange(1, POWERS + 1)
        return np.ravel(self.thinned.data - sizes @ waves) / BLOCK_NOISE

    def _compute_waves(self, device: Device, phase: float) -> FloatArray:
        """Return the waves, cached since most steps of a Jacobian change only the pose."""
        key = (device.frequency, device.damping, phase)
        if key not in self.wave_cache:
            if len(self.wave_cache) > KEPT_WAVES:
                self.wave_cache.clear()
            self.wave_cache[key] = self.thinned.whiten(self.thinned.compute_power_waves(device, phase))
        return self.wave_cache[key]


def fit_device(
    recording: Recording,
    sensors: SensorArray,
    device: Device,
    position: FloatArray,
    orientation: FloatArray,
    *,
    fix_height: bool = True,
    fix_time: bool = False,
    hum: Hum | None = None,
    duration: float | None = None,
) -> DeviceFit:
    """Fit pose, phase, amplitude, frequency and damping to one recording; the height may be held fixed.

    Parameters
    ----------
    recording : Recording
    sensors : SensorArray
    device : Device
        Start of frequency and damping; its damping model is the one that is fitted.
    position : ndarray, shape (3,), in m, world frame
        Start of the rotation centre; its z is kept with `fix_height`.
    orientation : ndarray, shape (4,)
        Start, within some 20 degrees, or the fit may end in the other member of the two-fold ambiguity.
    fix_height : bool
        Hold z: B ~ theta / z³, so that z and amplitude cannot both be determined well (Calibration protocol).
    fix_time : bool
        Hold frequency and damping as given.
    hum : Hum, optional
        Mains lines in the room; see `thin_recording`.
    duration : float, optional, in s
        Length of the recording's beginning that is used; see `thin_recording`.

    Returns
    -------
    DeviceFit

    Raises
    ------
    InputError
        As for `thin_recording`.
    """
    thinned = thin_recording(recording, sensors, device.frequency, hum, duration)
    # parameters: shift (0..2, m), rotation (3..5, rad), phase 6, ln amplitude 7, frequency 8, ln damping 9
    free = [0, 1, *([] if fix_height else [2]), 3, 4, 5, 6, 7, *([] if fix_time else [8, 9])]
    start = np.zeros(10)
    start[7:] = [np.log(FIRST_AMPLITUDE * device.theta_max), device.frequency, np.log(max(device.damping, MIN_DAMPING))]
    model = _FullModel(thinned, sensors, device, np.array(position), np.array(orientation), free, start)
    start[6:8] = _estimate_phase_and_amplitude(model)
    values, covariance, cost = minimize(model.compute_residual, start[free], STEPS[free])
    made, place, turned, phase, amplitude = model.unpack(values)
    n_data = thinned.data.size
    spread = np.sqrt(np.diag(covariance) * cost / max(n_data - len(free), 1))
    sse = cost * BLOCK_NOISE**2
    std = {"amplitude": float(amplitude * spread[free.index(7)]), "frequency": 0.0, "damping": 0.0}
    if not fix_time:
        std |= {"frequency": float(spread[free.index(8)]), "damping": float(made.damping * spread[free.index(9)])}
    total = float(np.sum(thinned.data**2))
    phase = float(np.angle(np.exp(1j * phase)))
    return DeviceFit(made, place, turned, amplitude, phase, std, sse, n_data, 1.0 - sse / max(total, TINY))


def _estimate_phase_and_amplitude(model: _FullModel) -> tuple[float, float]:
    """Estimate phase and logarithm of the amplitude at the starting pose, from the first harmonic."""
    wave = model.thinned.compute_waves(model.device, [(1, 1)])[0]
    columns = model.thinned.whiten(np.stack([wave.real, -wave.imag]))
    sizes = (
        compute_power_coefficients(model.used_sensors, model.device, model.position, model.orientation)[:, 0]
        / REFERENCE
    )
    solved = np.linalg.lstsq(columns.T, model.thinned.data.T @ sizes / max(float(sizes @ sizes), TINY), rcond=None)[0]
    low, high = FIRST_AMPLITUDE_RANGE
    size = min(max(float(np.hypot(*solved)), low), high)
    return float(np.arctan2(solved[1], solved[0])), float(np.log(size))
