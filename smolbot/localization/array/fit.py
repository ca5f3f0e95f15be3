"""The least squares behind the calibration of an array: one step for all sensors, amplitudes and the holder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.rotations import matrix_from_quaternion, quaternion_from_rotation_vector, quaternion_product
from smolbot.core.sensing import Device, Recording, SensorArray
from smolbot.localization.device.fit import power_coefficients
from smolbot.localization.device.thinning import Hum, Thinned, thin

PER_SENSOR = 6
"""Unknowns of a sensor: ln gain, two tilts, three coordinates."""

HOLDER = 6
"""Unknowns of the holder: position (m) and rotation (rad) of the device in it, body frame."""


LOOSE = 1e-2
"""Weight of the prior on the change of an amplitude's logarithm: less than the information of any sensor."""

FARTHEST = 20.0
"""Standard deviations of the priors to which the unknowns are clipped."""

DIPOLE_POWER = 3.0
"""Relative change of a field per relative change of its distance: a dipole falls with the third power."""

STEP_SHARE = 1e-2
"""Step of a difference quotient, as a share of the unknown's prior standard deviation."""

MAX_GROWTH = 1.0
"""Largest change of an amplitude's logarithm in one step."""


@dataclass(frozen=True, eq=False)
class Unknowns:
    """What is fitted.

    Attributes
    ----------
    sensors : ndarray, shape (n_sensors, PER_SENSOR)
    holder : ndarray, shape (HOLDER,)
    amplitudes : ndarray, shape (n_recordings,)
        Over `ringdown.REFERENCE`, at the end of each drive.
    """

    sensors: FloatArray
    holder: FloatArray
    amplitudes: FloatArray


def held(pose: Pose, holder: FloatArray) -> Pose:
    """Where a device is that stands and points off in its holder by `holder`, when the holder is at `pose`."""
    turn = quaternion_product(np.array(pose.orientation), quaternion_from_rotation_vector(holder[3:]))
    place = pose.position + matrix_from_quaternion(np.array(pose.orientation)) @ holder[:3]
    return Pose(pose.time, place, turn, pose.covariance)


@dataclass(frozen=True, eq=False)
class Heard:
    """One recording boiled down: how much of each power of the deflection each sensor hears.

    `first` (n_blocks,) is the wave of the first power, `higher` (POWERS - 1, n_blocks) the others, all whitened.
    """

    pose: Pose
    thinned: Thinned
    first: FloatArray
    higher: FloatArray
    amplitude: float
    noise: float

    @classmethod
    def of(cls, recording: Recording, pose: Pose, sensors: SensorArray, device: Device, hum: Hum | None) -> Heard:
        thinned = thin(recording, sensors, device.frequency, hum)
        sizes = power_coefficients(sensors, device, pose.position, pose.orientation)[thinned.used]
        wave = thinned.waves(device, [(1, 1)])[0]
        columns = thinned.whiten(np.stack([wave.real, -wave.imag]))
        along = thinned.data.T @ sizes[:, 0] / float(sizes[:, 0] @ sizes[:, 0])
        solved = np.linalg.lstsq(columns.T, along, rcond=None)[0]
        amplitude, phase = float(np.hypot(*solved)), float(np.arctan2(solved[1], solved[0]))
        waves = thinned.whiten(thinned.power_waves(device, phase))
        scaled = sizes * amplitude ** np.arange(1, sizes.shape[1] + 1)
        residual = thinned.data - scaled @ waves
        left = residual - np.outer(residual @ waves[0], waves[0]) / float(waves[0] @ waves[0])
        noise = float(np.sqrt(np.sum(left**2) / max(left.size - len(left), 1) / float(waves[0] @ waves[0])))
        return cls(pose, thinned, waves[0], waves[1:], amplitude, noise)

    def first_size(self, coefficients: FloatArray, amplitude: float) -> FloatArray:
        """Size of the first power in each used sensor, the higher ones taken from the model, in T."""
        powers = amplitude ** np.arange(2, coefficients.shape[1] + 1)
        rest = self.thinned.data - (coefficients[self.thinned.used, 1:] * powers) @ self.higher
        size: FloatArray = rest @ self.first / float(self.first @ self.first)
        return size


def step(
    heard: Sequence[Heard],
    sensors: SensorArray,
    device: Device,
    frames: FloatArray,
    now: Unknowns,
    deviations: tuple[FloatArray, FloatArray],
    track: float,
) -> tuple[Unknowns, FloatArray, FloatArray]:
    """One Gauss-Newton step.

    Parameters
    ----------
    frames : ndarray, shape (n_sensors, 2, 3)
        Directions of each sensor's tilts (`across`).
    deviations : two ndarrays, shapes (PER_SENSOR,) and (HOLDER,)
        How far sensors and holder may be off: one standard deviation.
    track : float, in m
        Error of the known places.

    Returns
    -------
    Unknowns
    ndarray, shape (n_sensors, PER_SENSOR)
        Standard deviations that are left.
    ndarray, shape (HOLDER,)
    """
    n = len(sensors)
    own = n * PER_SENSOR
    base = _sizes(heard, sensors, device, frames, now.sensors, now.holder)
    slopes, moves = _slopes(heard, sensors, device, frames, now, deviations, base[:, :, 0])
    n_unknown = own + HOLDER + len(heard)
    # one row per recording and used sensor: derivatives of its first harmonic, weighted by its standard error
    normal, right = np.zeros((n_unknown, n_unknown)), np.zeros(n_unknown)
    for r, item in enumerate(heard):
        amplitude = now.amplitudes[r]
        away = np.linalg.norm(sensors.positions - item.pose.position, axis=1)
        measured = item.first_size(base[r], amplitude)
        scale = amplitude * np.abs(base[r, :, 0]).mean()
        for row, s in enumerate(np.flatnonzero(item.thinned.used)):
            model = amplitude * base[r, s, 0]
            error = np.hypot(item.noise, DIPOLE_POWER * track / away[s] * max(abs(model), scale))
            index = [*range(s * PER_SENSOR, (s + 1) * PER_SENSOR), *range(own, own + HOLDER), own + HOLDER + r]
            gradient = np.array([*(amplitude * slopes[:, r, s]), *(amplitude * moves[:, r, s]), model]) / error
            normal[np.ix_(index, index)] += np.outer(gradient, gradient)
            right[index] += gradient * (measured[row] - model) / error
    # priors of sensors and holder
    weights = np.concatenate([np.tile(deviations[0] ** -2, n), deviations[1] ** -2])
    believed = np.arange(len(weights))
    normal[believed, believed] += weights
    right[believed] -= weights * np.concatenate([now.sensors.ravel(), now.holder])
    loud = np.arange(len(weights), n_unknown)
    normal[loud, loud] += LOOSE  # bounds an amplitude that the model cannot explain
    covariance = np.linalg.inv(normal)
    change, spread = covariance @ right, np.sqrt(np.diag(covariance))
    moved = Unknowns(
        _within(now.sensors + change[:own].reshape(n, PER_SENSOR), deviations[0]),
        _within(now.holder + change[own : own + HOLDER], deviations[1]),
        now.amplitudes * np.exp(np.clip(change[own + HOLDER :], -MAX_GROWTH, MAX_GROWTH)),
    )
    return moved, spread[:own].reshape(n, PER_SENSOR), spread[own : own + HOLDER]


def _within(values: FloatArray, deviations: FloatArray) -> FloatArray:
    """Values no further off than `FARTHEST` deviations: recordings of another track lead nowhere, not to overflow."""
    return np.clip(values, -FARTHEST * deviations, FARTHEST * deviations)


def _slopes(
    heard: Sequence[Heard],
    sensors: SensorArray,
    device: Device,
    frames: FloatArray,
    now: Unknowns,
    deviations: tuple[FloatArray, FloatArray],
    base: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Change of every size per unknown of its sensor and of the holder, shapes (6, n_recordings, n_sensors)."""
    slopes, moves = [], []
    for j in range(PER_SENSOR):
        small, moved = STEP_SHARE * deviations[0][j], now.sensors.copy()
        moved[:, j] += small  # a sensor's unknowns concern its own rows only, so all move at once
        slopes.append((_sizes(heard, sensors, device, frames, moved, now.holder)[:, :, 0] - base) / small)
    for j in range(HOLDER):
        small, moved = STEP_SHARE * deviations[1][j], now.holder.copy()
        moved[j] += small
        moves.append((_sizes(heard, sensors, device, frames, now.sensors, moved)[:, :, 0] - base) / small)
    return np.stack(slopes), np.stack(moves)


def _sizes(
    heard: Sequence[Heard],
    sensors: SensorArray,
    device: Device,
    frames: FloatArray,
    values: FloatArray,
    holder: FloatArray,
) -> FloatArray:
    """Power coefficients of every recording and sensor, gain included, shape (n_recordings, n_sensors, POWERS)."""
    array, gains = corrected_array(sensors, frames, values), np.exp(values[:, 0])
    poses = [held(h.pose, holder) for h in heard]
    found = [power_coefficients(array, device, p.position, p.orientation) for p in poses]
    return np.stack(found) * gains[None, :, None]


def corrected_array(sensors: SensorArray, frames: FloatArray, values: FloatArray) -> SensorArray:
    """The array with its sensors tilted and moved by `values` (n_sensors, PER_SENSOR)."""
    axes = sensors.axes + np.einsum("nj,njk->nk", values[:, 1:3], frames)
    return SensorArray(sensors.positions + values[:, 3:], axes, sensors.bandwidth)


def across(axis: FloatArray) -> FloatArray:
    """Two unit vectors across `axis`, shape (2, 3)."""
    side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(axis, side)])
