"""Where the sensors truly stand: gains, axes and places from recordings of a device on a known track.

With the device's pose known, what each sensor should hear is known too, up to the amplitude of each shot.
What it hears instead tells its gain, the tilt of its axis and its place: six numbers a sensor, found by least
squares under weak priors, so that what the track does not tell stays as believed. A gain common to all
sensors cannot be told from the amplitudes and stays 1. Some recordings are held out, and located with the
old and the new array: only they show whether anything was gained.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from smolbot.arrays import FloatArray, frozen
from smolbot.errors import InputError
from smolbot.localization.devicefit import power_coefficients
from smolbot.localization.thinning import Hum, Thinned, thin
from smolbot.poses import Pose
from smolbot.rotations import rotation_error
from smolbot.sensing import Device, Recording, SensorArray

PER_SENSOR = 6
"""Unknowns of a sensor: ln gain, two tilts, three coordinates."""

ROUNDS = 4
"""Gauss-Newton steps; each also renews what the higher harmonics are taken to be."""


@dataclass(frozen=True)
class Priors:
    """How far the array may be from what is believed: one standard deviation of each.

    Attributes
    ----------
    place : float, in m, per axis
    gain : float, relative
    axis : float, in rad, about each direction across it
    track : float, in m
        Error of the known places, per axis: what no array can explain.
    """

    place: float = 2e-4
    gain: float = 5e-3
    axis: float = float(np.radians(0.3))
    track: float = 2e-5


@dataclass(frozen=True)
class HeldOut:
    """Errors of poses located in recordings that took no part: rms, in m and rad.

    Attributes
    ----------
    recordings : int
    position_before, position_after : float, in m, per axis
    orientation_before, orientation_after : float, in rad, per axis
    """

    recordings: int
    position_before: float
    position_after: float
    orientation_before: float
    orientation_after: float


@dataclass(frozen=True, eq=False)
class ArrayCalibration:
    """The array as it was found to be.

    Attributes
    ----------
    sensors : SensorArray
        Corrected places and axes.
    gains : ndarray, shape (n_sensors,)
        Of each sensor relative to what is believed; divide a recording by them (`corrected`).
    place_std : ndarray, shape (n_sensors, 3), in m
    gain_std : ndarray, shape (n_sensors,)
    tilt_std : ndarray, shape (n_sensors, 2), in rad
        Standard deviations that are left; as large as the priors where the track tells nothing.
    held_out : HeldOut
    """

    sensors: SensorArray
    gains: FloatArray
    place_std: FloatArray
    gain_std: FloatArray
    tilt_std: FloatArray
    held_out: HeldOut

    def corrected(self, recording: Recording) -> Recording:
        """The recording as sensors of unit gain would have made it."""
        return replace(recording, field=recording.field / self.gains[:, None])


def calibrate_sensors(
    recordings: Sequence[Recording],
    track: Sequence[Pose],
    sensors: SensorArray,
    device: Device,
    *,
    priors: Priors | None = None,
    hum: Hum | None = None,
    hold_out: int = 4,
) -> ArrayCalibration:
    """Gains, axes and places of the sensors from recordings with the device at known poses.

        y_rs = g_s A_r c(p_s, a_s; pose_r)

    y is the size of the oscillation in recording r and sensor s, c the field per deflection along the sensor's
    axis (Eqs. S5 to S8), A_r the amplitude of the shot, free.

    Parameters
    ----------
    recordings : sequence of Recording
        Each after a drive; of some twenty poses or more, spread over the volume and over headings.
    track : sequence of Pose
        The known pose of each; covariances are not used.
    sensors, device : SensorArray, Device
        As believed; the device calibrated, or its frequency's error is taken for the sensors'.
    priors : Priors, optional
    hum : Hum, optional
        Mains lines in the room.
    hold_out : int
        Every so many-th recording takes no part and is located before and after.

    Raises
    ------
    InputError
        If recordings and poses do not match in number, or there are too few of them.
    """
    priors = priors or Priors()
    if len(recordings) != len(track):
        raise InputError(
            f"There are {len(recordings)} recordings but {len(track)} poses; each recording needs its own."
        )
    if hold_out < 2:
        raise InputError(f"hold_out must be at least 2: every so many-th recording is held out; got {hold_out}.")
    held = set(range(hold_out - 1, len(recordings), hold_out))
    used = [i for i in range(len(recordings)) if i not in held]
    if len(used) < 8 or len(held) < 2:
        raise InputError(
            f"{len(recordings)} recordings leave {len(used)} to learn from and {len(held)} to check with; at least 8 "
            "and 2 are needed, and three times as many are wise."
        )
    heard = [_Heard.of(recordings[i], track[i], sensors, device, hum) for i in used]
    values = np.zeros((len(sensors), PER_SENSOR))
    frames = np.stack([_across(axis) for axis in sensors.axes])
    deviations = np.array([priors.gain, priors.axis, priors.axis, *[priors.place] * 3])
    amplitudes = np.array([h.amplitude for h in heard])
    for _ in range(ROUNDS):
        values, amplitudes, spread = _step(heard, sensors, device, frames, values, amplitudes, deviations, priors.track)
    array, gains = _array(sensors, frames, values), np.exp(values[:, 0])
    check = [(recordings[i], track[i]) for i in sorted(held)]
    before = _errors([r for r, _ in check], check, sensors, device)
    after = _errors([replace(r, field=r.field / gains[:, None]) for r, _ in check], check, array, device)
    report = HeldOut(len(check), before[0], after[0], before[1], after[1])
    return ArrayCalibration(
        array, frozen(gains), frozen(spread[:, 3:]), frozen(spread[:, 0]), frozen(spread[:, 1:3]), report
    )


@dataclass(frozen=True, eq=False)
class _Heard:
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
    def of(cls, recording: Recording, pose: Pose, sensors: SensorArray, device: Device, hum: Hum | None) -> _Heard:
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


def _step(
    heard: Sequence[_Heard],
    sensors: SensorArray,
    device: Device,
    frames: FloatArray,
    values: FloatArray,
    amplitudes: FloatArray,
    deviations: FloatArray,
    track: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """One Gauss-Newton step for all sensors and amplitudes (over `ringdown.REFERENCE`); also their deviations."""
    n = len(sensors)
    steps = 1e-2 * deviations
    base = _sizes(heard, sensors, device, frames, values)
    slopes = []
    for j in range(PER_SENSOR):
        moved = values.copy()
        moved[:, j] += steps[j]  # a sensor's unknowns concern its own rows only, so all move at once
        slopes.append((_sizes(heard, sensors, device, frames, moved)[:, :, 0] - base[:, :, 0]) / steps[j])
    n_unknown = n * PER_SENSOR + len(heard)
    normal, right = np.zeros((n_unknown, n_unknown)), np.zeros(n_unknown)
    for r, item in enumerate(heard):
        place = np.linalg.norm(sensors.positions - item.pose.position, axis=1)
        measured = item.first_size(base[r], amplitudes[r])
        for row, s in enumerate(np.flatnonzero(item.thinned.used)):
            model = amplitudes[r] * base[r, s, 0]
            scale = amplitudes[r] * np.abs(base[r, :, 0]).mean()
            error = np.hypot(item.noise, 3.0 * track / place[s] * max(abs(model), scale))
            index = [*range(s * PER_SENSOR, (s + 1) * PER_SENSOR), n * PER_SENSOR + r]
            gradient = np.array([*(amplitudes[r] * slope[r, s] for slope in slopes), model]) / error
            normal[np.ix_(index, index)] += np.outer(gradient, gradient)
            right[index] += gradient * (measured[row] - model) / error
    weights = np.tile(deviations**-2, n)
    normal[np.arange(len(weights)), np.arange(len(weights))] += weights
    right[: len(weights)] -= weights * values.ravel()
    covariance = np.linalg.inv(normal)
    change = covariance @ right
    spread = np.sqrt(np.diag(covariance)[: len(weights)]).reshape(n, PER_SENSOR)
    moved = values + change[: len(weights)].reshape(n, PER_SENSOR)
    return moved, amplitudes * np.exp(change[len(weights) :]), spread


def _sizes(
    heard: Sequence[_Heard], sensors: SensorArray, device: Device, frames: FloatArray, values: FloatArray
) -> FloatArray:
    """Power coefficients of every recording and sensor, gain included, shape (n_recordings, n_sensors, POWERS)."""
    array, gains = _array(sensors, frames, values), np.exp(values[:, 0])
    found = [power_coefficients(array, device, h.pose.position, h.pose.orientation) for h in heard]
    return np.stack(found) * gains[None, :, None]


def _array(sensors: SensorArray, frames: FloatArray, values: FloatArray) -> SensorArray:
    axes = sensors.axes + np.einsum("nj,njk->nk", values[:, 1:3], frames)
    return SensorArray(sensors.positions + values[:, 3:], axes, sensors.bandwidth)


def _across(axis: FloatArray) -> FloatArray:
    """Two unit vectors across `axis`, shape (2, 3)."""
    side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(axis, side)])


def _errors(
    recordings: Sequence[Recording], check: Sequence[tuple[Recording, Pose]], array: SensorArray, device: Device
) -> tuple[float, float]:
    """Rms error per axis of poses located from the known ones: m, rad."""
    from smolbot.localization.localizer import Localizer

    loose = replace(device, theta_max=min(1.2 * device.theta_max, 1.0))
    localizer = Localizer(sensors=array, device=loose)
    places, turns = [], []
    for recording, (_, pose) in zip(recordings, check, strict=True):
        found = localizer.locate(recording, pose)
        places.append(found.position - pose.position)
        turns.append(rotation_error(np.array(found.orientation), np.array(pose.orientation)))
    return float(np.sqrt(np.mean(np.square(places)))), float(np.sqrt(np.mean(np.square(turns))))
