"""The free oscillation measured for its own sake: frequency, damping, amplitude.

A recording is thinned by averaging blocks of samples, and what is not the device is taken out of data
and model alike: a constant and a slow drift of each channel, and the mains with its harmonics, whose
frequency may be a little off. They are nuisance parameters with a known size, so that short windows,
which cannot tell 100 Hz from 103.5 Hz, are not robbed of their signal; a long window measures them
when the oscillation has died.

Two models look at the rest. `measure` knows nothing of pose, sensors or amplitude: each channel has
its own size and phase at f and at 2f, only f and the damping are common. `fit_device` is the full
model (Eqs. S2 to S8) with the height held fixed if wished: since B ~ theta / z³, one of the two must be.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from math import comb

import numpy as np
import numpy.typing as npt

from smolbot.arrays import BoolArray, FloatArray
from smolbot.errors import InputError
from smolbot.localization.forward import envelope, sensor_field
from smolbot.rotations import quaternion_from_rotation_vector, quaternion_product
from smolbot.sensing import DampingModel, Device, Recording, SensorArray

ComplexArray = npt.NDArray[np.complex128]

BLOCKS_PER_PERIOD = 20
"""Averages per period of the device that a recording is thinned to."""

LEAST_RATE = 10.0
"""Samples per period of the device, below which its swing is not followed."""

BLOCK_NOISE = 2e-10
"""Expected noise of one block, in T; only its ratio to the sizes of the nuisances counts."""

POWERS = 5
"""Highest power of the deflection in the full model; the rest is below 1e-5 of the signal at 20 degrees."""

REFERENCE = float(np.radians(30.0))
"""Deflection, in rad, by which powers are scaled."""


@dataclass(frozen=True)
class Hum:
    """Lines of the mains in the room, as expected.

    Attributes
    ----------
    frequency : float, in Hz
    sizes : mapping of int to float
        Harmonic order to expected amplitude, in T.
    uncertainty : float
        Relative error of the frequency, one standard deviation.
    """

    frequency: float = 50.0
    sizes: Mapping[int, float] = field(default_factory=lambda: {1: 1e-8, 2: 1e-9, 3: 3e-9, 4: 5e-10, 5: 1e-9})
    uncertainty: float = 4e-4


@dataclass(frozen=True, eq=False)
class Thinned:
    """A recording ready to be fitted: block averages without nuisances.

    Attributes
    ----------
    data : ndarray, shape (n_used, n_blocks), in T
        Whitened against the nuisances.
    used : ndarray of bool, shape (n_sensors,)
        Channels that take part.
    time : ndarray, shape (n_blocks,), in s
        Middle of each block after the end of the drive.
    block : int
        Samples in a block.
    step : float, in s
        Between samples.
    bandwidth : float, in Hz
        Of the sensors' low pass.
    nuisance : ndarray, shape (n_blocks, q)
        Orthonormal; with `share`, what `whiten` takes out.
    share : ndarray, shape (q,)
        Of each nuisance, the share that is taken out: 1 for one that may have any size.
    """

    data: FloatArray
    used: BoolArray
    time: FloatArray
    block: int
    step: float
    bandwidth: float
    nuisance: FloatArray
    share: FloatArray

    def whiten(self, rows: FloatArray) -> FloatArray:
        """Rows (..., n_blocks) with the nuisances weighed down."""
        left: FloatArray = rows - ((rows @ self.nuisance) * self.share) @ self.nuisance.T
        return left

    def waves(self, device: Device, pairs: Sequence[tuple[int, int]]) -> ComplexArray:
        """D^k exp(i h w t) for pairs (k, h), low-passed and block-averaged, shape (n_pairs, n_blocks).

        Exact for exponential damping; linear damping to first order in its fall within a block and within
        the sensors' time constant.
        """
        omega = 2.0 * np.pi * device.frequency
        damping = envelope(device, self.time)
        turn = np.exp(1j * omega * self.time)
        corner = 2.0 * np.pi * self.bandwidth
        out = np.empty((len(pairs), len(self.time)), dtype=np.complex128)
        for row, (k, h) in enumerate(pairs):
            linear = device.damping_model == "linear"
            slope = complex(0.0 if linear else -k * device.damping, h * omega)
            lag = 1.0 + slope / corner
            out[row] = _block_mean(slope * self.step, self.block) / lag * turn**h
            if linear:
                fall = k * device.damping / corner / lag
                out[row] *= np.where(damping > 0, damping**k + fall * damping ** (k - 1), 0.0)
            else:
                out[row] *= damping**k
        return out

    def power_waves(self, device: Device, phase: float) -> FloatArray:
        """(D cos(w t + phase))^k for k = 1 to `POWERS`, low-passed and averaged, shape (POWERS, n_blocks)."""
        out = np.zeros((POWERS, len(self.time)))
        for (k, h), wave in zip(_PAIRS, self.waves(device, _PAIRS), strict=True):
            weight = comb(k, (k - h) // 2) / 2.0**k * (1.0 if h == 0 else 2.0)
            out[k - 1] += weight * np.real(wave * np.exp(1j * h * phase))
        return out


_PAIRS = tuple((k, h) for k in range(1, POWERS + 1) for h in range(k % 2, k + 1, 2))
_FIRST_TWO = ((1, 1), (2, 2), (2, 0))


def _block_mean(turn: complex, block: int) -> complex:
    """Mean of exp(turn j) over `block` whole steps j around 0."""
    if abs(turn) < 1e-9:
        return 1.0 + 0.0j
    return complex(np.sinh(0.5 * block * turn) / (block * np.sinh(0.5 * turn)))


def thin(
    recording: Recording, sensors: SensorArray, frequency: float, hum: Hum | None = None, duration: float | None = None
) -> Thinned:
    """Thin a recording and take the nuisances out of it.

    Parameters
    ----------
    frequency : float, in Hz
        Of the device, roughly; sets the length of a block.
    hum : Hum, optional
    duration : float, in s, optional
        Use only so much of the recording's beginning.

    Raises
    ------
    InputError
        If channels and sensors do not match, no drive preceded the recording, or less than a
        period of four usable channels is left.
    """
    hum = hum or Hum()
    if len(recording.field) != len(sensors):
        raise InputError(
            f"The recording has {len(recording.field)} channels; the sensor array has {len(sensors)} sensors."
        )
    if not (np.isfinite(recording.time_since_drive) and recording.time_since_drive >= 0):
        raise InputError(
            f"A ring-down needs a recording after a drive; time_since_drive is {recording.time_since_drive}."
        )
    samples = recording.field
    if duration is not None:
        samples = samples[:, : max(1, round(duration * recording.sample_rate))]
    constant = np.ptp(samples, axis=1) == 0.0 if samples.shape[1] else np.ones(len(samples), dtype=np.bool_)
    used: BoolArray = np.isfinite(samples.sum(axis=1)) & ~recording.saturated & ~constant
    if used.sum() < 4:
        raise InputError(
            f"Only {int(used.sum())} channels can be used, at least 4 are needed; saturated, dead or not finite: "
            f"{', '.join(str(i) for i in np.flatnonzero(~used))}."
        )
    if recording.sample_rate < LEAST_RATE * frequency:
        raise InputError(
            f"The recording has {recording.sample_rate:g} samples per second; a device of {frequency:g} Hz needs at "
            f"least {LEAST_RATE * frequency:g}. Is the rate in Hz?"
        )
    block = max(1, int(recording.sample_rate / (BLOCKS_PER_PERIOD * frequency)))
    count = samples.shape[1] // block
    if count < BLOCKS_PER_PERIOD:
        raise InputError(
            f"The recording lasts {samples.shape[1] / recording.sample_rate * 1e3:.2f} ms; a ring-down needs at "
            f"least one period, {1e3 / frequency:.2f} ms."
        )
    means = samples[used, : count * block].reshape(int(used.sum()), count, block).mean(axis=2)
    means = means - means.mean(axis=1, keepdims=True)
    step = 1.0 / recording.sample_rate
    local = (np.arange(count) * block + 0.5 * (block - 1)) * step
    lines = tuple(sorted(hum.sizes.items()))
    vectors, share = _nuisances(count, block * step, hum.frequency, lines, hum.uncertainty)
    bare = Thinned(means, used, recording.time_since_drive + local, block, step, sensors.bandwidth, vectors, share)
    return replace(bare, data=bare.whiten(means))


@lru_cache(maxsize=16)
def _nuisances(
    count: int, spacing: float, mains: float, sizes: tuple[tuple[int, float], ...], uncertainty: float
) -> tuple[FloatArray, FloatArray]:
    """Orthonormal nuisances (n, q) of a window of `count` blocks, and the share of each that whitening takes out."""
    time = (np.arange(count) - 0.5 * (count - 1)) * spacing
    half = float(time[-1])
    columns = [1e-5 * (time / half) ** power for power in range(2)]
    columns += [1e-8 * (time / half) ** power * half for power in (2, 3)]
    for order, size in sizes:
        omega = 2.0 * np.pi * mains * order
        drift = min(omega * uncertainty, 1.0 / half) * time
        for wave in (np.cos(omega * time), np.sin(omega * time)):
            columns += [size * wave, size * drift * wave]
    scaled = np.stack(columns, axis=1) / BLOCK_NOISE
    vectors, strengths, _ = np.linalg.svd(scaled, full_matrices=False)
    vectors, share = np.ascontiguousarray(vectors), 1.0 - 1.0 / np.sqrt(1.0 + strengths**2)
    for array in (vectors, share):
        array.setflags(write=False)
    return vectors, share


def _minimised(
    residual: Callable[[FloatArray], FloatArray], start: FloatArray, steps: FloatArray, iterations: int = 30
) -> tuple[FloatArray, FloatArray, float]:
    """Levenberg-Marquardt with forward differences of `steps`, until a step is below 1 % of a standard deviation.

    scipy's own take a singular value decomposition of the tall Jacobian in each iteration, which is most of the time.

    Returns
    -------
    values, covariance : ndarray, shapes (p,) and (p, p)
        Covariance for residuals of unit variance.
    cost : float
        Sum of squares.
    """
    values, left = start, residual(start)
    cost, damping = float(left @ left), 1e-3
    for _ in range(iterations):
        jacobian = np.stack([(residual(values + step) - left) / step.sum() for step in np.diag(steps)])
        normal, gradient = jacobian @ jacobian.T, jacobian @ left
        size = np.diag(normal)
        while True:
            change = -np.linalg.solve(normal + np.diag(damping * size + 1e-30), gradient)
            tried = residual(values + change)
            if (lower := float(tried @ tried)) <= cost or damping > 1e8:
                break
            damping *= 5.0
        if lower > cost:
            break
        values, left, cost, damping = values + change, tried, lower, 0.2 * damping
        if change @ normal @ change < 1e-4 * cost / left.size:
            break
    return values, np.linalg.pinv(normal), cost


@dataclass(frozen=True)
class RingDownFit:
    """Frequency and damping of one recording, whatever the pose.

    Attributes
    ----------
    frequency, frequency_std : float, in Hz
    damping, damping_std : float, in 1/s
    damping_model : {"linear", "exponential"}
    strength : float, in T
        Root of the sum of squares over channels of the oscillation's amplitude at the end of the drive.
    signal_to_noise : float
        Root of explained over expected sum of squares; below about 10 there is no oscillation worth the name.
    """

    frequency: float
    frequency_std: float
    damping: float
    damping_std: float
    damping_model: DampingModel
    strength: float
    signal_to_noise: float


def measure(
    recording: Recording,
    sensors: SensorArray,
    device: Device,
    *,
    hum: Hum | None = None,
    search: float = 10.0,
    damping_model: DampingModel | None = None,
) -> RingDownFit:
    """Frequency and damping of the free oscillation, from all channels, without a pose.

    Least squares with the channels' sizes and phases at f (D) and at 0 and 2f (D²) projected out.

    Parameters
    ----------
    device : Device
        Where to begin: its frequency and damping as believed.
    search : float, in Hz
        How far from the believed frequency the grid looks.
    damping_model : optional
        Which envelope to fit; the device's own if not given.

    Returns
    -------
    RingDownFit
        Standard deviations are those of the fit; what repeats scatter by is larger where noise is not white.

    Raises
    ------
    InputError
        As for `thin`.
    """
    model = damping_model or device.damping_model
    base = replace(device, damping_model=model)
    thinned = thin(recording, sensors, device.frequency, hum)

    def made(values: FloatArray) -> Device:
        frequency = np.clip(values[0], 0.4 * device.frequency, 2.0 * device.frequency)
        return replace(base, frequency=float(frequency), damping=float(np.exp(np.clip(values[1], -7.0, 7.0))))

    def residual(values: FloatArray) -> FloatArray:
        basis = _harmonic_basis(thinned, made(values))
        return np.ravel(thinned.data - (thinned.data @ basis) @ basis.T) / BLOCK_NOISE

    span = min(search, 0.5 * device.frequency)
    rates = np.log(max(device.damping, 0.2) * np.array([0.4, 0.7, 1.0, 1.5, 2.5]))
    grid = [
        np.array([f, rate])
        for rate in rates
        for f in device.frequency + np.linspace(-span, span, 2 * int(span / _resolution(thinned, np.exp(rate))) + 1)
    ]
    heard = [float(np.sum((thinned.data @ _harmonic_basis(thinned, made(values))) ** 2)) for values in grid]
    best = grid[int(np.argmax(heard))]
    values, covariance, cost = _minimised(residual, best, np.array([1e-4, 1e-4]))
    found = made(values)
    channels, blocks = thinned.data.shape
    excess = cost / max(channels * (blocks - 5) - 2, 1)  # over the expected noise
    spread = np.sqrt(np.diag(covariance) * excess)
    basis = _harmonic_basis(thinned, found)
    explained = float(np.sum((thinned.data @ basis) ** 2))
    wave = thinned.waves(found, [(1, 1)])[0]
    columns = thinned.whiten(np.stack([wave.real, wave.imag]))
    sizes = np.linalg.lstsq(columns.T, basis @ (thinned.data @ basis).T, rcond=None)[0]
    return RingDownFit(
        found.frequency,
        float(spread[0]),
        found.damping,
        float(found.damping * spread[1]),
        model,
        float(np.sqrt(np.sum(sizes**2))),
        float(np.sqrt(explained / max(5 * channels * excess, 1e-300)) / BLOCK_NOISE),
    )


def _resolution(thinned: Thinned, damping: float) -> float:
    """Step of a frequency grid that no peak slips through, in Hz."""
    heard = min(float(thinned.time[-1] - thinned.time[0]), 2.0 / damping)
    return max(0.25 / heard, 0.1)


def _harmonic_basis(thinned: Thinned, device: Device) -> FloatArray:
    """Orthonormal (n_blocks, 5): the oscillation at f, and at 2f and 0, with any phase, after whitening."""
    first, second, mean = thinned.waves(device, _FIRST_TWO)
    rows = thinned.whiten(np.stack([first.real, first.imag, second.real, second.imag, mean.real]))
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    basis, _ = np.linalg.qr((rows / np.maximum(size, 1e-30)).T)
    return basis


@dataclass(frozen=True)
class DeviceFit:
    """One recording fitted with the full model.

    Attributes
    ----------
    device : Device
        With the frequency and damping that were fitted; theta_max is as given.
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


def power_coefficients(
    sensors: SensorArray, device: Device, position: FloatArray, orientation: FloatArray
) -> FloatArray:
    """Field along each sensor's axis as a power series of theta / `REFERENCE`.

    Returns
    -------
    ndarray, shape (n_sensors, POWERS), in T
        Of the powers 1 to `POWERS`; the constant is not observable. Exact to 1e-6 of the signal within 40 degrees.
    """
    nodes, inverse = _series()
    values = sensor_field(sensors, device, position, orientation, nodes * REFERENCE)
    coefficients: FloatArray = (values @ inverse.T)[:, 1:]
    return coefficients


def _series() -> tuple[FloatArray, FloatArray]:
    nodes = 1.3 * np.cos(np.pi * (np.arange(POWERS + 1) + 0.5) / (POWERS + 1))
    inverse: FloatArray = np.linalg.inv(np.vander(nodes, POWERS + 1, increasing=True)).astype(np.float64)
    return nodes, inverse


@dataclass(frozen=True, eq=False)
class _FullModel:
    """Residuals of the full model; parameters (x, y, z, e, phase, ln amplitude, frequency, ln damping)."""

    thinned: Thinned
    sensors: SensorArray
    device: Device
    position: FloatArray
    orientation: FloatArray
    free: list[int]
    start: FloatArray
    kept: dict[tuple[float, ...], FloatArray] = field(default_factory=dict)

    @cached_property
    def heard(self) -> SensorArray:
        used = self.thinned.used
        return SensorArray(self.sensors.positions[used], self.sensors.axes[used], self.sensors.bandwidth)

    def unpack(self, values: FloatArray) -> tuple[Device, FloatArray, FloatArray, float, float]:
        full = self.start.copy()
        full[self.free] = values
        frequency = np.clip(full[8], 0.5 * self.device.frequency, 2.0 * self.device.frequency)
        device = replace(self.device, frequency=float(frequency), damping=float(np.exp(np.clip(full[9], -7.0, 7.0))))
        orientation = quaternion_product(quaternion_from_rotation_vector(full[3:6]), self.orientation)
        return (
            device,
            self.position + full[:3],
            orientation,
            float(full[6]),
            float(np.exp(np.clip(full[7], -12.0, 0.4))),
        )

    def residual(self, values: FloatArray) -> FloatArray:
        device, position, orientation, phase, amplitude = self.unpack(values)
        waves = self._waves(device, phase)
        sizes = power_coefficients(self.heard, device, position, orientation)
        sizes = sizes * (amplitude / REFERENCE) ** np.arange(1, POWERS + 1)
        return np.ravel(self.thinned.data - sizes @ waves) / BLOCK_NOISE

    def _waves(self, device: Device, phase: float) -> FloatArray:
        """Kept, since most steps of a Jacobian change the pose only."""
        key = (device.frequency, device.damping, phase)
        if key not in self.kept:
            if len(self.kept) > 8:
                self.kept.clear()
            self.kept[key] = self.thinned.whiten(self.thinned.power_waves(device, phase))
        return self.kept[key]


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
    device : Device
        Frequency and damping to begin with; its damping model is the one that is fitted.
    position : ndarray, shape (3,), in m
        Of the rotation centre, to begin with; its z is kept where `fix_height`.
    orientation : ndarray, shape (4,)
        To begin with, within some 20 degrees, or the fit may end in the other member of the two-fold ambiguity.
    fix_height : bool
        Hold z: B ~ theta / z³, so that z and amplitude are not both known well (Calibration protocol).
    fix_time : bool
        Hold frequency and damping as given.
    hum, duration
        As for `thin`.

    Raises
    ------
    InputError
        As for `thin`.
    """
    thinned = thin(recording, sensors, device.frequency, hum, duration)
    free = [0, 1, *([] if fix_height else [2]), 3, 4, 5, 6, 7, *([] if fix_time else [8, 9])]
    start = np.zeros(10)
    start[7:] = [np.log(0.5 * device.theta_max), device.frequency, np.log(max(device.damping, 1e-3))]
    model = _FullModel(thinned, sensors, device, np.array(position), np.array(orientation), free, start)
    start[6:8] = _phase_and_amplitude(model)
    steps = np.array([1e-6, 1e-6, 1e-6, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4])[free]
    values, covariance, cost = _minimised(model.residual, start[free], steps)
    made, place, turned, phase, amplitude = model.unpack(values)
    n_data = thinned.data.size
    spread = np.sqrt(np.diag(covariance) * cost / max(n_data - len(free), 1))
    sse = cost * BLOCK_NOISE**2
    std = {"amplitude": float(amplitude * spread[free.index(7)]), "frequency": 0.0, "damping": 0.0}
    if not fix_time:
        std |= {"frequency": float(spread[free.index(8)]), "damping": float(made.damping * spread[free.index(9)])}
    total = float(np.sum(thinned.data**2))
    phase = float(np.angle(np.exp(1j * phase)))
    return DeviceFit(made, place, turned, amplitude, phase, std, sse, n_data, 1.0 - sse / max(total, 1e-300))


def _phase_and_amplitude(model: _FullModel) -> tuple[float, float]:
    """Best phase and logarithm of the amplitude at the starting pose, from the first harmonic."""
    wave = model.thinned.waves(model.device, [(1, 1)])[0]
    columns = model.thinned.whiten(np.stack([wave.real, -wave.imag]))
    sizes = power_coefficients(model.heard, model.device, model.position, model.orientation)[:, 0] / REFERENCE
    solved = np.linalg.lstsq(columns.T, model.thinned.data.T @ sizes / max(float(sizes @ sizes), 1e-300), rcond=None)[0]
    size = float(np.hypot(*solved))
    return float(np.arctan2(solved[1], solved[0])), float(np.log(min(max(size, 1e-3), 1.2)))
