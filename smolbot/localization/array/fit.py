"""Least squares of the array's calibration: one Gauss-Newton step for all sensors, amplitudes and the holder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.rotations import matrix_from_quaternion, multiply_quaternions, quaternion_from_rotation_vector
from smolbot.core.sensing import Device, Recording, SensorArray
from smolbot.localization.device.fit import compute_power_coefficients
from smolbot.localization.device.thinning import Hum, ThinnedRecording, thin_recording

UNKNOWNS_PER_SENSOR = 6
"""Unknowns of a sensor: ln gain, two tilts, three coordinates."""

UNKNOWNS_OF_HOLDER = 6
"""Unknowns of the holder: position (m) and rotation (rad) of the device in it, body frame."""


AMPLITUDE_PRIOR_WEIGHT = 1e-2
"""Weight of the prior on the change of an amplitude's logarithm: less than the information of any sensor."""

MAX_PRIOR_SIGMAS = 20.0
"""Standard deviations of the priors to which the unknowns are clipped."""

DIPOLE_POWER = 3.0
"""Relative change of a field per relative change of its distance: a dipole falls with the third power."""

STEP_SHARE = 1e-2
"""Step of a difference quotient, as a share of the unknown's prior standard deviation."""

MAX_GROWTH = 1.0
"""Largest change of an amplitude's logarithm in one step."""


@dataclass(frozen=True, eq=False)
class Unknowns:
    """The unknowns of the fit.

    Attributes
    ----------
    sensors : ndarray, shape (n_sensors, UNKNOWNS_PER_SENSOR)
        ln gain, two tilts (rad), three coordinates (m) of each.
    holder : ndarray, shape (UNKNOWNS_OF_HOLDER,)
        Position (m) and turn (rad) of the device in its holder, body frame.
    amplitudes : ndarray, shape (n_recordings,)
        At the end of each drive, in units of `device.fit.REFERENCE`.
    """

    sensors: FloatArray
    holder: FloatArray
    amplitudes: FloatArray


def compute_pose_in_holder(pose: Pose, holder: FloatArray) -> Pose:
    """Compute the pose of a device that is displaced and turned in its holder.

    Parameters
    ----------
    pose : Pose
        Of the holder.
    holder : ndarray, shape (UNKNOWNS_OF_HOLDER,)
        Position (m) and turn (rad) of the device in it, body frame.

    Returns
    -------
    Pose
    """
    turn = multiply_quaternions(np.array(pose.orientation), quaternion_from_rotation_vector(holder[3:]))
    place = pose.position + matrix_from_quaternion(np.array(pose.orientation)) @ holder[:3]
    return Pose(pose.time, place, turn, pose.covariance)


@dataclass(frozen=True, eq=False)
class ReducedRecording:
    """One recording reduced to the size of each power of the deflection in each sensor.

    Attributes
    ----------
    pose : Pose
        The known pose.
    thinned : ThinnedRecording
    first : ndarray, shape (n_blocks,)
        Whitened wave of the first power.
    higher : ndarray, shape (POWERS - 1, n_blocks)
        Whitened waves of the higher powers.
    amplitude : float
        In units of `device.fit.REFERENCE`.
    noise : float, in T
        Standard deviation of a sensor's size of the first power.
    """

    pose: Pose
    thinned: ThinnedRecording
    first: FloatArray
    higher: FloatArray
    amplitude: float
    noise: float

    @classmethod
    def from_recording(
        cls, recording: Recording, pose: Pose, sensors: SensorArray, device: Device, hum: Hum | None
    ) -> ReducedRecording:
        """Reduce one recording.

        Parameters
        ----------
        recording : Recording
        pose : Pose
            The known pose.
        sensors : SensorArray
        device : Device
        hum : Hum or None
            Mains lines in the room.

        Returns
        -------
        ReducedRecording
        """
        thinned = thin_recording(recording, sensors, device.frequency, hum)
        sizes = compute_power_coefficients(sensors, device, pose.position, pose.orientation)[thinned.used]
        wave = thinned.compute_waves(device, [(1, 1)])[0]
        columns = thinned.whiten(np.stack([wave.real, -wave.imag]))
        along = thinned.data.T @ sizes[:, 0] / float(sizes[:, 0] @ sizes[:, 0])
        solved = np.linalg.lstsq(columns.T, along, rcond=None)[0]
        amplitude, phase = float(np.hypot(*solved)), float(np.arctan2(solved[1], solved[0]))
        waves = thinned.whiten(thinned.compute_power_waves(device, phase))
        scaled = sizes * amplitude ** np.arange(1, sizes.shape[1] + 1)
        residual = thinned.data - scaled @ waves
        left = residual - np.outer(residual @ waves[0], waves[0]) / float(waves[0] @ waves[0])
        noise = float(np.sqrt(np.sum(left**2) / max(left.size - len(left), 1) / float(waves[0] @ waves[0])))
        return cls(pose, thinned, waves[0], waves[1:], amplitude, noise)

    def measure_first_power(self, coefficients: FloatArray, amplitude: float) -> FloatArray:
        """Measure the size of the first power in each used sensor, with the higher powers taken from the model.

        Parameters
        ----------
        coefficients : ndarray, shape (n_sensors, POWERS), in T
            Power coefficients of the model.
        amplitude : float
            In units of `device.fit.REFERENCE`.

        Returns
        -------
        ndarray, shape (n_used,), in T
        """
        powers = amplitude ** np.arange(2, coefficients.shape[1] + 1)
        rest = self.thinned.data - (coefficients[self.thinned.used, 1:] * powers) @ self.higher
        size: FloatArray = rest @ self.first / float(self.first @ self.first)
        return size


def compute_gauss_newton_step(
    recordings: Sequence[ReducedRecording],
    sensors: SensorArray,
    device: Device,
    frames: FloatArray,
    now: Unknowns,
    deviations: tuple[FloatArray, FloatArray],
    track_error: float,
) -> tuple[Unknowns, FloatArray, FloatArray]:
    """Compute one Gauss-Newton step.

    Parameters
    ----------
    recordings : sequence of ReducedRecording
    sensors : SensorArray
        As assumed.
    device : Device
    frames : ndarray, shape (n_sensors, 2, 3)
        Directions of each sensor's tilts.
    now : Unknowns
        Before the step.
    deviations : two ndarrays, shapes (UNKNOWNS_PER_SENSOR,) and (UNKNOWNS_OF_HOLDER,)
        Standard deviations of the priors of sensors and holder.
    track_error : float, in m
        Error of the known positions.

    Returns
    -------
    unknowns : Unknowns
        After the step.
    sensor_std : ndarray, shape (n_sensors, UNKNOWNS_PER_SENSOR)
        Remaining standard deviations.
    holder_std : ndarray, shape (UNKNOWNS_OF_HOLDER,)
    """
    n = len(sensors)
    own = n * UNKNOWNS_PER_SENSOR
    base = _compute_sizes(recordings, sensors, device, frames, now.sensors, now.holder)
    slopes, moves = _compute_slopes(recordings, sensors, device, frames, now, deviations, base[:, :, 0])
    n_unknown = own + UNKNOWNS_OF_HOLDER + len(recordings)
    # one row per recording and used sensor: derivatives of its first harmonic, weighted by its standard error
    normal, right = np.zeros((n_unknown, n_unknown)), np.zeros(n_unknown)
    for r, item in enumerate(recordings):
        amplitude = now.amplitudes[r]
        away = np.linalg.norm(sensors.positions - item.pose.position, axis=1)
        measured = item.measure_first_power(base[r], amplitude)
        scale = amplitude * np.abs(base[r, :, 0]).mean()
        for row, s in enumerate(np.flatnonzero(item.thinned.used)):
            model = amplitude * base[r, s, 0]
            error = np.hypot(item.noise, DIPOLE_POWER * track_error / away[s] * max(abs(model), scale))
            index = [
                *range(s * UNKNOWNS_PER_SENSOR, (s + 1) * UNKNOWNS_PER_SENSOR),
                *range(own, own + UNKNOWNS_OF_HOLDER),
                own + UNKNOWNS_OF_HOLDER + r,
            ]
            gradient = np.array([*(amplitude * slopes[:, r, s]), *(amplitude * moves[:, r, s]), model]) / error
            normal[np.ix_(index, index)] += np.outer(gradient, gradient)
            right[index] += gradient * (measured[row] - model) / error
    # priors of sensors and holder
    weights = np.concatenate([np.tile(deviations[0] ** -2, n), deviations[1] ** -2])
    with_prior = np.arange(len(weights))
    normal[with_prior, with_prior] += weights
    right[with_prior] -= weights * np.concatenate([now.sensors.ravel(), now.holder])
    loud = np.arange(len(weights), n_unknown)
    normal[loud, loud] += AMPLITUDE_PRIOR_WEIGHT  # bounds an amplitude that the model cannot explain
    covariance = np.linalg.inv(normal)
    change, spread = covariance @ right, np.sqrt(np.diag(covariance))
    moved = Unknowns(
        _clip_to_priors(now.sensors + change[:own].reshape(n, UNKNOWNS_PER_SENSOR), deviations[0]),
        _clip_to_priors(now.holder + change[own : own + UNKNOWNS_OF_HOLDER], deviations[1]),
        now.amplitudes * np.exp(np.clip(change[own + UNKNOWNS_OF_HOLDER :], -MAX_GROWTH, MAX_GROWTH)),
    )
    return moved, spread[:own].reshape(n, UNKNOWNS_PER_SENSOR), spread[own : own + UNKNOWNS_OF_HOLDER]


def _clip_to_priors(values: FloatArray, deviations: FloatArray) -> FloatArray:
    """Clip values to `MAX_PRIOR_SIGMAS` deviations, so that recordings of another track cannot cause an overflow."""
    return np.clip(values, -MAX_PRIOR_SIGMAS * deviations, MAX_PRIOR_SIGMAS * deviations)


def _compute_slopes(
    recordings: Sequence[ReducedRecording],
    sensors: SensorArray,
    device: Device,
    frames: FloatArray,
    now: Unknowns,
    deviations: tuple[FloatArray, FloatArray],
    base: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Compute the change of every size per unknown of sensor and of holder, shapes (6, n_recordings, n_sensors)."""
    slopes, moves = [], []
    for j in range(UNKNOWNS_PER_SENSOR):
        small, moved = STEP_SHARE * deviations[0][j], now.sensors.copy()
        moved[:, j] += small  # a sensor's unknowns concern its own rows only, so all move at once
        slopes.append((_compute_sizes(recordings, sensors, device, frames, moved, now.holder)[:, :, 0] - base) / small)
    for j in range(UNKNOWNS_OF_HOLDER):
        small, moved = STEP_SHARE * deviations[1][j], now.holder.copy()
        moved[j] += small
        moves.append((_compute_sizes(recordings, sensors, device, frames, now.sensors, moved)[:, :, 0] - base) / small)
    return np.stack(slopes), np.stack(moves)


def _compute_sizes(
    recordings: Sequence[ReducedRecording],
    sensors: SensorArray,
    device: Device,
    frames: FloatArray,
    values: FloatArray,
    holder: FloatArray,
) -> FloatArray:
    """Compute the power coefficients, gains included, shape (n_recordings, n_sensors, POWERS)."""
    array, gains = correct_array(sensors, frames, values), np.exp(values[:, 0])
    poses = [compute_pose_in_holder(h.pose, holder) for h in recordings]
    found = [compute_power_coefficients(array, device, p.position, p.orientation) for p in poses]
    return np.stack(found) * gains[None, :, None]


def correct_array(sensors: SensorArray, frames: FloatArray, values: FloatArray) -> SensorArray:
    """Make the array whose sensors deviate from the assumed ones in tilt and position.

    Parameters
    ----------
    sensors : SensorArray
        As assumed.
    frames : ndarray, shape (n_sensors, 2, 3)
        Directions of each sensor's tilts.
    values : ndarray, shape (n_sensors, UNKNOWNS_PER_SENSOR)
        ln gain (not used), two tilts (rad), three coordinates (m).

    Returns
    -------
    SensorArray
    """
    axes = sensors.axes + np.einsum("nj,njk->nk", values[:, 1:3], frames)
    return SensorArray(sensors.positions + values[:, 3:], axes, sensors.bandwidth)


def compute_transverse_axes(axis: FloatArray) -> FloatArray:
    """Compute two unit vectors perpendicular to an axis and to each other.

    Parameters
    ----------
    axis : ndarray, shape (3,)

    Returns
    -------
    ndarray, shape (2, 3)
    """
    side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(axis, side)])
