"""The true sensors: the field of the moving magnet and of decaying coil currents, and the sensors' electronics."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from sim.tank.magnetics.cantilever import L0, MIN_MEASURABLE_CURRENT, MOMENT, REST_X, REST_Z
from sim.tank.magnetics.noise import FieldNoise, SensorNoise
from sim.tank.mismatch import TankTruth
from sim.tank.sensor_faults import SensorFaults
from smolbot.config.rig import RigConfig
from smolbot.core.arrays import BoolArray, FloatArray
from smolbot.core.rotations import matrix_from_quaternion, quaternion_from_rotation_vector

LEAD_TIME_CONSTANTS = 20.0  # of the low pass, computed before the first sample: it starts in steady state
MU_0_OVER_4_PI = 1e-7  # T·m/A


class TrueSensors:
    """The sensors with their true positions, axes, gains and noise.

    Parameters
    ----------
    rig : RigConfig
    truth : TankTruth
    field_rng, sensor_rng, constant_rng : numpy.random.Generator
        Of the ambient field, of the sensors' own noise and of each channel's constant.

    Attributes
    ----------
    positions : ndarray, shape (n, 3), in m
        True positions, world frame.
    axes : ndarray, shape (n, 3)
        True sensitive directions, world frame, with each sensor's gain as length.
    rate : float, in Hz
    lead : float, in s
        Time before the first sample that a recording needs to know.
    field_noise : FieldNoise
    sensor_noise : SensorNoise
    faults : SensorFaults or None
        What is wrong with them, besides their mismatches.
    """

    def __init__(
        self,
        rig: RigConfig,
        truth: TankTruth,
        field_rng: np.random.Generator,
        sensor_rng: np.random.Generator,
        constant_rng: np.random.Generator,
    ) -> None:
        section = rig.sections.sensors
        nominal = section.array  # as built, without calibration
        tilts = [matrix_from_quaternion(quaternion_from_rotation_vector(t)) for t in truth.sensor_tilts]
        self.positions = np.ascontiguousarray(nominal.positions + truth.sensor_places)
        self.axes = np.einsum("nij,nj->ni", np.array(tilts), nominal.axes)
        self.axes *= (truth.sensor_gains * section.gain_of_each)[:, None]
        self.rate = section.sample_rate_hz
        self._tau = 1.0 / (2 * math.pi * nominal.bandwidth) if np.isfinite(nominal.bandwidth) else 0.0
        self.lead = LEAD_TIME_CONSTANTS * self._tau
        self._range = section.range
        volts_per_tesla = section.volts_per_tesla
        self._full_scale = section.adc_range_v / volts_per_tesla
        self._step = 2 * self._full_scale / 2**section.adc_bits
        noise = rig.sections.noise
        self._constant = noise.constant
        self._constants = constant_rng
        self.field_noise = FieldNoise(
            noise, self.positions, self.axes, nominal.bandwidth, truth.noise, truth.mains_frequency, field_rng
        )
        self.sensor_noise = SensorNoise(noise, len(nominal), nominal.bandwidth, self.rate, truth.noise, sensor_rng)
        self.faults: SensorFaults | None = None

    @property
    def time_constant(self) -> float:
        """Time constant of the sensors' low pass, in s."""
        return self._tau

    @property
    def converter_step(self) -> float:
        """Smallest step of the analog-to-digital converter, in T."""
        return self._step

    def record(
        self,
        clock: float,
        n: int,
        device: FloatArray,
        coupling: FloatArray,
        trace_times: FloatArray,
        trace: FloatArray,
        pose_times: FloatArray,
        poses: FloatArray,
    ) -> tuple[FloatArray, BoolArray]:
        """Record `n` samples, with noise and conversion.

        Parameters
        ----------
        clock : float, in s
            Time of the first sample.
        n : int
        device : ndarray
            As `sim.tank.magnetics.cantilever.advance_cantilever` takes it.
        coupling : ndarray, shape (n_coils, n_sensors), in T/A
        trace_times : ndarray, shape (k,), in s
        trace : ndarray, shape (k, 1 + n_coils)
            Deflection (rad) and currents (A).
        pose_times : ndarray, shape (p,), in s
        poses : ndarray, shape (p, 7)
            Rotation centre (m) and orientation (scalar first), world frame.

        Returns
        -------
        field : ndarray, shape (n_sensors, n), in T
        saturated : ndarray of bool, shape (n_sensors,)
        """
        field = self.compute_clean_readings(clock, n, device, coupling, trace_times, trace, pose_times, poses)
        return field, self.measure(field, clock)

    def sample_constants(self) -> FloatArray:
        """Sample each channel's residual offset after manual nulling, for one recording.

        Returns
        -------
        ndarray, shape (n_sensors,), in T
        """
        return self._constant * self._constants.standard_normal(len(self.positions))

    def measure(self, field: FloatArray, clock: float, constants: FloatArray | None = None) -> BoolArray:
        """Turn noiseless readings into measured ones, in place: noise, constants, sensor range, converter.

        Parameters
        ----------
        field : ndarray, shape (n_sensors, n), in T
        clock : float, in s
            Time of the first sample.
        constants : ndarray, shape (n_sensors,), in T, optional
            Of the recording that this is a part of; newly sampled if not given.

        Returns
        -------
        ndarray of bool, shape (n_sensors,)
            Which sensors were saturated.
        """
        self.field_noise.add(field, clock, self.rate)
        if self.faults is None:
            self.sensor_noise.add(field, clock)
        else:
            own_noise = np.zeros_like(field)
            self.sensor_noise.add(own_noise, clock)
            self.faults.disturb(field, own_noise, clock)
        constants = self.sample_constants() if constants is None else constants
        saturated = _convert(field, constants, self._range, self._full_scale, self._step)
        if self.faults is not None:
            self.faults.corrupt(field, saturated, clock)
        return saturated

    def compute_clean_readings(
        self,
        clock: float,
        n: int,
        device: FloatArray,
        coupling: FloatArray,
        trace_times: FloatArray,
        trace: FloatArray,
        pose_times: FloatArray,
        poses: FloatArray,
    ) -> FloatArray:
        """Compute the readings of noiseless sensors with the same low pass.

        Parameters
        ----------
        clock : float, in s
            Time of the first sample.
        n : int
        device : ndarray
            As `sim.tank.magnetics.cantilever.advance_cantilever` takes it.
        coupling : ndarray, shape (n_coils, n_sensors), in T/A
        trace_times : ndarray, shape (k,), in s
        trace : ndarray, shape (k, 1 + n_coils)
            Deflection (rad) and currents (A).
        pose_times : ndarray, shape (p,), in s
        poses : ndarray, shape (p, 7)
            Rotation centre (m) and orientation (scalar first), world frame.

        Returns
        -------
        ndarray, shape (n_sensors, n), in T
        """
        lead = math.ceil(self.lead * self.rate)
        pace = 1.0 / (self.rate * self._tau) if self._tau else np.inf
        keep = math.exp(-pace)
        spread = (1.0 - keep) / pace if self._tau else 0.0
        field = np.empty((len(self.positions), n))
        low_pass = (keep, spread - keep, 1.0 - spread)  # exact for an input that is straight between samples
        magnet = (float(device[MOMENT]), float(device[REST_X]), float(device[REST_Z]), float(device[L0]))
        _compute_readings(
            field, clock, 1.0 / self.rate, lead, low_pass, magnet,
            self.positions, self.axes, coupling, trace_times, trace, pose_times, poses,
        )  # fmt: skip
        return field


@njit(cache=True, error_model="numpy")
def _compute_readings(
    out: FloatArray,
    clock: float,
    step: float,
    lead: int,
    low_pass: tuple[float, float, float],
    magnet: tuple[float, float, float, float],
    positions: FloatArray,
    axes: FloatArray,
    coupling: FloatArray,
    trace_times: FloatArray,
    trace: FloatArray,
    pose_times: FloatArray,
    poses: FloatArray,
) -> None:
    """Compute the low-passed field along each sensor's axis; the dipole is Eq. S5, its motion Eqs. S6 to S8."""
    moment, rest_x, rest_z, l0 = magnet
    keep, before, now = low_pass
    n_sensors, n_coils = len(positions), trace.shape[1] - 1
    raw, last, reading = np.zeros(n_sensors), np.zeros(n_sensors), np.zeros(n_sensors)
    i = j = 0
    m, c = np.empty(3), np.empty(3)
    for s in range(-lead, out.shape[1]):
        # deflection, currents and pose between their samples; the quaternion is normalised in `norm`
        t = clock + s * step
        while i < len(trace_times) - 2 and trace_times[i + 1] < t:
            i += 1
        while j < len(pose_times) - 2 and pose_times[j + 1] < t:
            j += 1
        a = min(max((t - trace_times[i]) / (trace_times[i + 1] - trace_times[i]), 0.0), 1.0)
        f = min(max((t - pose_times[j]) / (pose_times[j + 1] - pose_times[j]), 0.0), 1.0)
        theta = trace[i, 0] + a * (trace[i + 1, 0] - trace[i, 0])
        w = poses[j, 3] + f * (poses[j + 1, 3] - poses[j, 3])
        x = poses[j, 4] + f * (poses[j + 1, 4] - poses[j, 4])
        y = poses[j, 5] + f * (poses[j + 1, 5] - poses[j, 5])
        z = poses[j, 6] + f * (poses[j + 1, 6] - poses[j, 6])
        norm = 2.0 / (w * w + x * x + y * y + z * z)
        xx, xz = 1 - norm * (y * y + z * z), norm * (x * z + y * w)
        yx, yz = norm * (x * y + z * w), norm * (y * z - x * w)
        zx, zz = norm * (x * z - y * w), 1 - norm * (x * x + y * y)
        # moment (A·m²) and magnet position (m), world frame
        sine, cosine = math.sin(theta), math.cos(theta)
        u, v = moment * (rest_x * cosine + rest_z * sine), moment * (rest_z * cosine - rest_x * sine)
        m[0], m[1], m[2] = u * xx + v * xz, u * yx + v * yz, u * zx + v * zz
        u, v = l0 * sine, l0 * cosine
        c[0] = poses[j, 0] + f * (poses[j + 1, 0] - poses[j, 0]) + u * xx + v * xz
        c[1] = poses[j, 1] + f * (poses[j + 1, 1] - poses[j, 1]) + u * yx + v * yz
        c[2] = poses[j, 2] + f * (poses[j + 1, 2] - poses[j, 2]) + u * zx + v * zz
        for k in range(n_sensors):
            rx, ry, rz = positions[k, 0] - c[0], positions[k, 1] - c[1], positions[k, 2] - c[2]
            ax, ay, az = axes[k, 0], axes[k, 1], axes[k, 2]
            inverse = 1.0 / (rx * rx + ry * ry + rz * rz)
            near = MU_0_OVER_4_PI * inverse * math.sqrt(inverse)
            along = (m[0] * rx + m[1] * ry + m[2] * rz) * (ax * rx + ay * ry + az * rz)
            raw[k] = near * (3.0 * along * inverse - (m[0] * ax + m[1] * ay + m[2] * az))
        for q in range(n_coils):
            current = trace[i, 1 + q] + a * (trace[i + 1, 1 + q] - trace[i, 1 + q])
            if abs(current) > MIN_MEASURABLE_CURRENT:
                for k in range(n_sensors):
                    raw[k] += current * coupling[q, k]
        for k in range(n_sensors):
            reading[k] = keep * reading[k] + before * last[k] + now * raw[k] if s > -lead else raw[k]
            last[k] = raw[k]
            if s >= 0:
                out[k, s] = reading[k]


@njit(cache=True, error_model="numpy")
def _convert(
    field: FloatArray, constants: FloatArray, sensor_range: float, full_scale: float, step: float
) -> BoolArray:
    """Add the constants, clip at the sensor's range and the converter's, and round to its steps, in place."""
    saturated = np.zeros(len(field), np.bool_)
    top = full_scale - step
    for i in range(len(field)):
        for j in range(field.shape[1]):
            value = field[i, j] + constants[i]
            if abs(value) >= sensor_range:
                saturated[i] = True
                value = math.copysign(sensor_range, value)
            field[i, j] = step * math.floor(min(max(value, -full_scale), top) / step + 0.5)
    return saturated
