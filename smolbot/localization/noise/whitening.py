"""The whitened chain: reduces a recording to a few numbers with white noise, without loss of information.

Samples are averaged over blocks of half a millisecond, whitened by the learned covariance (with a free
constant in every channel), and projected on the directions that a signal can have.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from math import factorial

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.sensing import DampingModel, Device, Recording, SensorArray
from smolbot.errors import InputError
from smolbot.localization import basis as time_functions
from smolbot.localization.chain import Taps, count_half_periods
from smolbot.localization.noise.excitation_transients import NEGLIGIBLE_AFTER, make_decay_columns
from smolbot.localization.noise.model import NoiseModel
from smolbot.localization.problem import LinearModel, Problem, check_enough, find_usable_channels

MAX_BLOCK = 0.5e-3
"""Longest block, in s: its mean keeps 80 % of the fourth harmonic of 180 Hz."""

MIN_STRENGTH = 0.1
"""Size of a strong signal, in standard deviations of the noise, below which a direction is dropped."""

TYPICAL_FIELD = 1e-7
"""First harmonic, in T, of a strong signal."""

POWER_RATIO = 0.6
"""Size of a power of the deflection relative to the one before, before division by its factorial."""

MAX_SHORTENING = 4
"""A block may be shorter than the longest by one part in this many, so that fewer samples are left over."""

REGULARISATION = 1e-9
"""Share of the mean variance added to a covariance before it is inverted."""

CLOCK_DIGITS = 8
"""Decimals, in s, of the time since the drive: 10 ns of rounding do not make a new model."""


def make_block_taps(n_samples: int, sample_rate: float, block: float = MAX_BLOCK) -> Taps:
    """Make the taps of means over equal blocks, with the block length that leaves out the fewest samples.

    Parameters
    ----------
    n_samples : int
    sample_rate : float, in Hz
    block : float, in s
        Longest block.

    Returns
    -------
    Taps
    """
    longest = max(int(block * sample_rate), 1)
    sizes = range(max(longest - longest // MAX_SHORTENING, 1), longest + 1)
    size = min(sizes, key=lambda b: (n_samples % b, -b))
    count = n_samples // size
    first = size * np.arange(count, dtype=np.int64)
    return Taps(np.asarray(first + 0.5 * (size - 1), dtype=np.float64), first, np.full((count, size), 1.0 / size))


@lru_cache(maxsize=16)
def _compute_whitener(noise: NoiseModel, usable: bytes, n_blocks: int, block: float) -> FloatArray:
    """Compute the inverse Cholesky factor (m, m) of the noise of all usable channels."""
    used = np.frombuffer(usable, dtype=np.bool_)
    rows = np.repeat(used, n_blocks)
    covariance = noise.covariance(n_blocks, block)[np.ix_(rows, rows)]
    floor = REGULARISATION * np.trace(covariance) / len(covariance)
    factor = np.linalg.cholesky(covariance + floor * np.eye(len(covariance)))
    return np.asarray(np.linalg.inv(factor), dtype=np.float64)


@lru_cache(maxsize=64)
def make_whitened_model(
    sensors: SensorArray,
    device: Device,
    noise: NoiseModel,
    usable: bytes,
    n_samples: int,
    sample_rate: float,
    since: float,
    trend: int = 0,
    transients: tuple[float, ...] = (),
) -> LinearModel:
    """Make the whitened chain for recordings of one kind by one array; cached for similar recordings.

    See `make_common_model`.

    Parameters
    ----------
    sensors : SensorArray
    device : Device
    noise : NoiseModel
    usable : bytes
        Of a bool array (n_sensors,): the sensors that take part.
    n_samples : int
    sample_rate : float, in Hz
    since : float, in s
        From the end of the drive to the first sample.
    trend : int
        Degree of the polynomial that is free in every channel.
    transients : tuple of float, in s
        Time constants of decays that are free in every channel.

    Returns
    -------
    LinearModel
    """
    reference = _make_reference_device(device.frequency, device.damping, device.damping_model)
    common = make_common_model(
        sensors.bandwidth, reference, noise, usable, n_samples, sample_rate, since, trend, transients
    )
    used = common.used
    return replace(
        common,
        device=device,
        positions=np.ascontiguousarray(sensors.positions[used]),
        axes=np.ascontiguousarray(sensors.responses[used]),
        common=common,
    )


@lru_cache(maxsize=64)
def _make_reference_device(frequency: float, damping: float, damping_model: DampingModel) -> Device:
    """Make one device that represents all with the same frequency and damping."""
    return Device(1.0, np.array([0.0, 0.0, 1.0]), 0.0, 1.0, frequency, damping, damping_model)


@lru_cache(maxsize=64)
def make_common_model(
    bandwidth: float,
    device: Device,
    noise: NoiseModel,
    usable: bytes,
    n_samples: int,
    sample_rate: float,
    since: float,
    trend: int = 0,
    transients: tuple[float, ...] = (),
) -> LinearModel:
    """Make the part of the whitened chain that does not depend on the array, moment or l0.

    Positions, axes, moment and l0 of the result have no meaning. The result is insensitive to a polynomial in every
    channel, and to a decay of each of the time constants.

    Parameters
    ----------
    bandwidth : float, in Hz
        Of the sensors' low pass.
    device : Device
        Of which only frequency and damping are used.
    noise : NoiseModel
    usable : bytes
        Of a bool array (n_sensors,): the sensors that take part.
    n_samples : int
    sample_rate : float, in Hz
    since : float, in s
        From the end of the drive to the first sample.
    trend : int
        Degree of the polynomial: 0 for the unknown constant, 1 for a constant and a slope.
    transients : tuple of float, in s
        Time constants of decays that are still measurable.

    Returns
    -------
    LinearModel

    Raises
    ------
    InputError
        If the noise hides every possible signal.
    """
    used = np.frombuffer(usable, dtype=np.bool_)
    n_channels = int(used.sum())
    chain = make_block_taps(n_samples, sample_rate)
    n_blocks, size = chain.weights.shape
    whiten = _compute_whitener(noise, usable, n_blocks, size / sample_rate)
    polynomials = np.vander(np.linspace(-1.0, 1.0, n_blocks), trend + 1, increasing=True)
    decays = make_decay_columns(since + (chain.first + 0.5 * size) / sample_rate, transients)
    free = np.column_stack([polynomials, decays])
    constants = np.linalg.qr(whiten @ np.kron(np.eye(n_channels), free))[0]
    functions, changes = time_functions.compute_functions_and_slopes(device, chain, sample_rate, since, bandwidth)
    by_channel = whiten.reshape(-1, n_channels, n_blocks)
    responses = np.einsum("mjt,ft->mfj", by_channel, functions, optimize=True)
    flat = responses.reshape(len(responses), -1)
    flat -= constants @ (constants.T @ flat)
    # directions that a signal can take, weighted by the possible strength of each power of the deflection
    powers = time_functions.list_labels()[:, 0]
    strength = TYPICAL_FIELD * np.repeat([POWER_RATIO ** (k - 1) / factorial(k) for k in powers], n_channels)
    values, vectors = np.linalg.eigh((flat * strength).T @ (flat * strength))
    kept = values > MIN_STRENGTH**2
    if not kept.any():
        raise InputError(
            f"No oscillation is measurable {1e3 * since:g} ms after the drive in the noise that was learned. Is that "
            "time right, and was the device at rest in the background recordings?"
        )
    directions = (flat * strength) @ (vectors[:, kept] / np.sqrt(values[kept]))  # orthonormal columns
    matrix = (directions.T @ flat).reshape(int(kept.sum()), len(functions), n_channels)
    projection = directions.T @ whiten - (directions.T @ constants) @ (constants.T @ whiten)
    return LinearModel(
        device=device,
        positions=np.zeros((0, 3)),
        axes=np.zeros((0, 3)),
        used=used,
        chain=chain,
        mixing=np.ascontiguousarray(projection),
        matrix=np.ascontiguousarray(matrix),
        slopes=np.stack([_project_functions(projection, change, n_channels) for change in changes]),
        functions=functions,
        free=free,
        separable=False,
        white=True,
    )


def _project_functions(projection: FloatArray, functions: FloatArray, n_channels: int) -> FloatArray:
    """Compute the response (n_rows, n_functions, n_channels) of projected data to time functions."""
    by_channel = projection.reshape(len(projection), n_channels, -1)
    return np.ascontiguousarray(np.einsum("mjt,ft->mfj", by_channel, functions, optimize=True))


def prepare_whitened(
    recording: Recording,
    sensors: SensorArray,
    device: Device,
    noise: NoiseModel,
    trend: int = 0,
    transients: tuple[float, ...] = (),
) -> Problem:
    """Whiten a recording and prepare its fit.

    Parameters
    ----------
    recording : Recording
    sensors : SensorArray
    device : Device
    noise : NoiseModel
    trend : int
        Degree of the polynomial that is free in every channel.
    transients : tuple of float, in s
        Time constants of the excitation coils' ring-down.

    Returns
    -------
    Problem

    Raises
    ------
    InputError
        If channels do not match the sensors or the noise model, too few of them can be used, the
        recording is shorter than half a period, or no drive preceded it.
    """
    usable = find_usable_channels(recording, sensors, device)
    if noise.n_sensors != len(sensors):
        raise InputError(f"The noise model has {noise.n_sensors} sensors; the sensor array has {len(sensors)}.")
    check_enough(int(usable.sum()), "channels", usable)
    n_samples = recording.field.shape[1]
    if count_half_periods(n_samples, recording.sample_rate, device.frequency) < 1:
        raise InputError(
            f"The recording lasts {recording.duration * 1e3:.2f} ms; a half-period of {device.frequency:g} Hz lasts "
            f"{500.0 / device.frequency:.2f} ms, and at least one is needed."
        )
    since = round(recording.time_since_drive, CLOCK_DIGITS)
    measurable = tuple(tau for tau in transients if since < NEGLIGIBLE_AFTER * tau)
    model = make_whitened_model(
        sensors, device, noise, usable.tobytes(), n_samples, recording.sample_rate, since, trend, measurable
    )
    field = recording.field if usable.all() else np.ascontiguousarray(recording.field[usable])
    return Problem(model, model.compute_data_vector(field))
