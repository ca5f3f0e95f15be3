"""A recording reduced to block averages for the analysis of the oscillation, with disturbances removed.

A constant and a slow drift of each channel, and the mains with its harmonics, whose frequency may deviate a little,
are removed from data and model alike. They are nuisance parameters of a known size: a short window, which cannot
distinguish 100 Hz from 103.5 Hz, thus keeps its signal, while a long window measures them once the oscillation has
decayed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import comb

import numpy as np
import numpy.typing as npt

from smolbot.core.arrays import BoolArray, FloatArray
from smolbot.core.sensing import Device, Recording, SensorArray
from smolbot.errors import InputError
from smolbot.localization.forward import compute_envelope

ComplexArray = npt.NDArray[np.complex128]

BLOCKS_PER_PERIOD = 20
"""Block averages per period of the device to which a recording is reduced."""

MIN_SAMPLES_PER_PERIOD = 10.0
"""Samples per period of the device below which its oscillation is not resolved."""

BLOCK_NOISE = 2e-10
"""Expected noise of one block, in T; only its ratio to the sizes of the nuisances matters."""

POWERS = 5
"""Highest power of the deflection in the full model; the rest is below 1e-5 of the signal at 20 degrees."""

MIN_CHANNELS = 4
"""Fewest channels from which a ring-down is fitted."""

STRAIGHT_DRIFT, BENT_DRIFT = 1e-5, 1e-8
"""Sizes, in T, of constant and linear drift, and per s of half a recording of quadratic and cubic drift."""

NO_TURN = 1e-9
"""Turn of a wave per sample, in rad, below which the mean of a block is its middle."""


@dataclass(frozen=True)
class Hum:
    """Expected lines of the mains in the room.

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
class ThinnedRecording:
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
        Orthonormal; with `share`, what `whiten` removes.
    share : ndarray, shape (q,)
        Share of each nuisance that is removed: 1 for one that may have any size.
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
        """Reduce the nuisances in some rows.

        Parameters
        ----------
        rows : ndarray, shape (..., n_blocks)

        Returns
        -------
        ndarray, shape (..., n_blocks)
        """
        left: FloatArray = rows - ((rows @ self.nuisance) * self.share) @ self.nuisance.T
        return left

    def compute_waves(self, device: Device, pairs: Sequence[tuple[int, int]]) -> ComplexArray:
        """Compute D^k exp(i h w t), low-passed and block-averaged.

        Exact for exponential damping; linear damping to first order in its decrease within a block and within
        the sensors' time constant.

        Parameters
        ----------
        device : Device
        pairs : sequence of tuple of 2 int
            (k, h).

        Returns
        -------
        ndarray of complex, shape (n_pairs, n_blocks)
        """
        omega = 2.0 * np.pi * device.frequency
        damping = compute_envelope(device, self.time)
        turn = np.exp(1j * omega * self.time)
        corner = 2.0 * np.pi * self.bandwidth
        out = np.empty((len(pairs), len(self.time)), dtype=np.complex128)
        for row, (k, h) in enumerate(pairs):
            linear = device.damping_model == "linear"
            slope = complex(0.0 if linear else -k * device.damping, h * omega)
            lag = 1.0 + slope / corner
            out[row] = _compute_block_mean(slope * self.step, self.block) / lag * turn**h
            if linear:
                fall = k * device.damping / corner / lag
                out[row] *= np.where(damping > 0, damping**k + fall * damping ** (k - 1), 0.0)
            else:
                out[row] *= damping**k
        return out

    def compute_power_waves(self, device: Device, phase: float) -> FloatArray:
        """Compute (D cos(w t + phase))^k for k = 1 to `POWERS`, low-passed and block-averaged.

        Parameters
        ----------
        device : Device
        phase : float, in rad

        Returns
        -------
        ndarray, shape (POWERS, n_blocks)
        """
        out = np.zeros((POWERS, len(self.time)))
        for (k, h), wave in zip(_PAIRS, self.compute_waves(device, _PAIRS), strict=True):
            weight = comb(k, (k - h) // 2) / 2.0**k * (1.0 if h == 0 else 2.0)
            out[k - 1] += weight * np.real(wave * np.exp(1j * h * phase))
        return out


_PAIRS = tuple((k, h) for k in range(1, POWERS + 1) for h in range(k % 2, k + 1, 2))


def _compute_block_mean(turn: complex, block: int) -> complex:
    """Compute the mean of exp(turn j) over `block` integer steps j around 0."""
    if abs(turn) < NO_TURN:
        return 1.0 + 0.0j
    return complex(np.sinh(0.5 * block * turn) / (block * np.sinh(0.5 * turn)))


def thin_recording(
    recording: Recording, sensors: SensorArray, frequency: float, hum: Hum | None = None, duration: float | None = None
) -> ThinnedRecording:
    """Reduce a recording to block averages and remove the nuisances.

    Parameters
    ----------
    recording : Recording
    sensors : SensorArray
    frequency : float, in Hz
        Approximate frequency of the device; sets the length of a block.
    hum : Hum, optional
        Mains lines in the room.
    duration : float, optional, in s
        Length of the recording's beginning that is used.

    Returns
    -------
    ThinnedRecording

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
    if used.sum() < MIN_CHANNELS:
        raise InputError(
            f"Only {int(used.sum())} channels can be used, at least {MIN_CHANNELS} are needed; "
            f"saturated, dead or not finite: {', '.join(str(i) for i in np.flatnonzero(~used))}."
        )
    if recording.sample_rate < MIN_SAMPLES_PER_PERIOD * frequency:
        raise InputError(
            f"The recording has {recording.sample_rate:g} samples per second; a device of {frequency:g} Hz needs at "
            f"least {MIN_SAMPLES_PER_PERIOD * frequency:g}. Is the rate in Hz?"
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
    vectors, share = _make_nuisances(count, block * step, hum.frequency, lines, hum.uncertainty)
    bare = ThinnedRecording(
        means, used, recording.time_since_drive + local, block, step, sensors.bandwidth, vectors, share
    )
    return replace(bare, data=bare.whiten(means))


@lru_cache(maxsize=16)
def _make_nuisances(
    count: int, spacing: float, mains: float, sizes: tuple[tuple[int, float], ...], uncertainty: float
) -> tuple[FloatArray, FloatArray]:
    """Make the orthonormal nuisances (n, q) of a window, and the share that whitening removes of each."""
    time = (np.arange(count) - 0.5 * (count - 1)) * spacing
    half = float(time[-1])
    columns = [STRAIGHT_DRIFT * (time / half) ** power for power in range(2)]
    columns += [BENT_DRIFT * (time / half) ** power * half for power in (2, 3)]
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
