"""Calibration of gains, axes and positions of the sensors from recordings of a device on a known track.

With the device's pose known, the signal of each sensor is known too, up to the amplitude of each shot. The
difference to the measured signal determines the sensor's gain, the tilt of its axis and its position: six numbers
per sensor, found by least squares under weak priors, so that what the track does not determine stays as assumed. A
gain common to all sensors cannot be distinguished from the amplitudes and stays 1. The position of the cantilever's
rotation centre in its holder is rarely known to a tenth of a millimetre: six more numbers, common to all poses,
describe how the device sits in the holder that the stage carries. Some recordings are held out and located with the
old and the new array; they alone show whether the calibration is an improvement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from smolbot.core.arrays import FloatArray, freeze
from smolbot.core.pose import Pose
from smolbot.core.rotations import compute_rotation_error
from smolbot.core.sensing import Device, Recording, SensorArray
from smolbot.errors import InputError
from smolbot.localization.array.fit import (
    UNKNOWNS_OF_HOLDER,
    UNKNOWNS_PER_SENSOR,
    ReducedRecording,
    Unknowns,
    compute_gauss_newton_step,
    compute_pose_in_holder,
    compute_transverse_axes,
    correct_array,
)
from smolbot.localization.device.thinning import Hum

GAUSS_NEWTON_STEPS = 4
"""Gauss-Newton steps; each also updates the estimated higher harmonics."""

ORIENTATION_SLACK = 1.1
"""Factor by which held-out orientations may become worse where positions improve."""

MIN_LEARNED, MIN_HELD_OUT = 8, 2
"""Fewest recordings to learn from, and to check with."""

LOOSE_AMPLITUDE, MAX_AMPLITUDE = 1.2, 1.0
"""Factor on the largest amplitude while sensors are checked, and its limit in rad: a fit must not stop at its bound."""


@dataclass(frozen=True)
class Priors:
    """Standard deviations of the assumed array, device and track.

    Attributes
    ----------
    place : float, in m, per axis
        Of a sensor's position.
    gain : float, relative
    axis : float, in rad, about each direction across it
        Tilt of a sensor's axis.
    track : float, in m, per axis
        Error of the known positions, which no change of the array can explain.
    holder_place : float, in m, per axis
        Of the device in its holder, the same in all poses.
    holder_turn : float, in rad, per axis
        Of the device in its holder, the same in all poses.
    """

    place: float = 2e-4
    gain: float = 5e-3
    axis: float = float(np.radians(0.3))
    track: float = 2e-5
    holder_place: float = 3e-4
    holder_turn: float = float(np.radians(1.0))


@dataclass(frozen=True)
class HeldOut:
    """Rms errors of poses located in recordings that were not used for the calibration.

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

    @property
    def better(self) -> bool:
        """Whether positions improved, and orientations, which are dominated by noise, are not clearly worse."""
        limit = ORIENTATION_SLACK * self.orientation_before
        return self.position_after < self.position_before and self.orientation_after < limit


@dataclass(frozen=True, eq=False)
class Holder:
    """Offset of the device in its holder from what the track assumes.

    Attributes
    ----------
    place : ndarray, shape (3,), in m, body frame
        Of the rotation centre.
    turn : ndarray, shape (3,), in rad, body frame
    place_std : ndarray, shape (3,), in m
    turn_std : ndarray, shape (3,), in rad
    """

    place: FloatArray
    turn: FloatArray
    place_std: FloatArray
    turn_std: FloatArray


@dataclass(frozen=True, eq=False)
class ArrayCalibration:
    """Result of a calibration of the array.

    Attributes
    ----------
    sensors : SensorArray
        Calibrated positions and axes.
    gains : ndarray, shape (n_sensors,)
        Of each sensor relative to the assumed gain; divide a recording by them (`correct_recording`).
    place_std : ndarray, shape (n_sensors, 3), in m
    gain_std : ndarray, shape (n_sensors,)
    tilt_std : ndarray, shape (n_sensors, 2), in rad
        Remaining standard deviations; as large as the priors where the track determines nothing.
    holder : Holder
    held_out : HeldOut
    """

    sensors: SensorArray
    gains: FloatArray
    place_std: FloatArray
    gain_std: FloatArray
    tilt_std: FloatArray
    holder: Holder
    held_out: HeldOut

    def correct_recording(self, recording: Recording) -> Recording:
        """Divide a recording by the sensors' gains.

        Parameters
        ----------
        recording : Recording

        Returns
        -------
        Recording
            As sensors of unit gain would have made it.
        """
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
    """Calibrate gains, axes and positions of the sensors from recordings with the device at known poses.

        y_rs = g_s A_r c(p_s, a_s; pose_r h)

    y is the size of the oscillation in recording r and sensor s, c the field per deflection along the sensor's axis
    (Eqs. S5 to S8), A_r the free amplitude of the shot, and h the device's pose in its holder, the same in all.

    Parameters
    ----------
    recordings : sequence of Recording
        Each after a drive; of some twenty poses or more, spread over the volume and over headings.
    track : sequence of Pose
        The known pose of each; covariances are not used.
    sensors : SensorArray
        As assumed.
    device : Device
        Calibrated; an error of its frequency would be attributed to the sensors.
    priors : Priors, optional
    hum : Hum, optional
        Mains lines in the room.
    hold_out : int
        Every so many-th recording is not used, and located before and after.

    Returns
    -------
    ArrayCalibration

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
        raise InputError(f"hold_out must be at least 2: of so many recordings one is held out; got {hold_out}.")
    aside = set(range(hold_out - 1, len(recordings), hold_out))
    used = [i for i in range(len(recordings)) if i not in aside]
    if len(used) < MIN_LEARNED or len(aside) < MIN_HELD_OUT:
        raise InputError(
            f"{len(recordings)} recordings leave {len(used)} to learn from and {len(aside)} to check with; at least "
            f"{MIN_LEARNED} and {MIN_HELD_OUT} are needed, and three times as many are recommended."
        )
    reduced = [ReducedRecording.from_recording(recordings[i], track[i], sensors, device, hum) for i in used]
    frames = np.stack([compute_transverse_axes(axis) for axis in sensors.axes])
    deviations = (
        np.array([priors.gain, priors.axis, priors.axis, *[priors.place] * 3]),
        np.array([*[priors.holder_place] * 3, *[priors.holder_turn] * 3]),
    )
    found = Unknowns(
        np.zeros((len(sensors), UNKNOWNS_PER_SENSOR)),
        np.zeros(UNKNOWNS_OF_HOLDER),
        np.array([r.amplitude for r in reduced]),
    )
    for _ in range(GAUSS_NEWTON_STEPS):
        found, spread, loose = compute_gauss_newton_step(
            reduced, sensors, device, frames, found, deviations, priors.track
        )
    array, gains = correct_array(sensors, frames, found.sensors), np.exp(found.sensors[:, 0])
    check = [(recordings[i], compute_pose_in_holder(track[i], found.holder)) for i in sorted(aside)]
    before = _compute_errors([r for r, _ in check], check, sensors, device)
    after = _compute_errors([replace(r, field=r.field / gains[:, None]) for r, _ in check], check, array, device)
    return ArrayCalibration(
        sensors=array,
        gains=freeze(gains),
        place_std=freeze(spread[:, 3:]),
        gain_std=freeze(spread[:, 0]),
        tilt_std=freeze(spread[:, 1:3]),
        holder=Holder(*(freeze(part) for part in (found.holder[:3], found.holder[3:], loose[:3], loose[3:]))),
        held_out=HeldOut(len(check), before[0], after[0], before[1], after[1]),
    )


def _compute_errors(
    recordings: Sequence[Recording], check: Sequence[tuple[Recording, Pose]], array: SensorArray, device: Device
) -> tuple[float, float]:
    """Compute the rms errors per axis of poses located from the known ones: m, rad."""
    from smolbot.localization.localizer import Localizer

    loose = replace(device, theta_max=min(LOOSE_AMPLITUDE * device.theta_max, MAX_AMPLITUDE))
    localizer = Localizer(sensors=array, device=loose)
    places, turns = [], []
    for recording, (_, pose) in zip(recordings, check, strict=True):
        found = localizer.locate(recording, pose)
        places.append(found.position - pose.position)
        turns.append(compute_rotation_error(np.array(found.orientation), np.array(pose.orientation)))
    return float(np.sqrt(np.mean(np.square(places)))), float(np.sqrt(np.mean(np.square(turns))))
