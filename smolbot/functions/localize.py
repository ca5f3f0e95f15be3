"""``localize``: poses from a lab's own samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from smolbot.bench.calibration.background_noise import BackgroundNoise, learn_background_noise
from smolbot.config.rig import RigConfig, load_rig
from smolbot.config.samples import SampleRecordings, make_recordings, read_samples
from smolbot.core.pose import Pose
from smolbot.core.results import Readable, as_columns
from smolbot.core.sensing import Device, Recording
from smolbot.errors import InputError
from smolbot.functions.targets import find_device
from smolbot.localization.localizer import Localizer

COLUMNS = (
    "shot", "segment", "time_s", "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz",
    "sigma_x_mm", "sigma_y_mm", "sigma_z_mm", "sigma_rx_deg", "sigma_ry_deg", "sigma_rz_deg",
    "r_squared", "flip_margin", "trusted", "note",
)  # fmt: skip
"""Columns of a table of poses; sigmas are one standard deviation, turns about world axes."""


@dataclass(frozen=True, repr=False)
class LocatedShot(Readable):
    """A pose from one shot, or from one segment of it.

    Attributes
    ----------
    shot, segment : int
    time : float, in s
        Middle of the recording.
    pose : Pose or None
        None where nothing could be fitted.
    note : str
        Channels that were left out, why there is no pose, or why it is not trusted.
    """

    shot: int
    segment: int
    time: float
    pose: Pose | None
    note: str = ""

    @property
    def trusted(self) -> bool:
        """Whether there is a trusted pose."""
        return self.pose is not None and self.pose.trusted

    def row(self) -> dict[str, Any]:
        """Return this pose as a row of the table.

        Returns
        -------
        dict
            The `COLUMNS`, in the units of their names; nan if there is no pose.
        """
        row: dict[str, Any] = dict.fromkeys(COLUMNS, math.nan)
        if self.pose is None:
            row |= {"r_squared": 0.0, "flip_margin": 1.0}
        else:
            pose, spread = self.pose, np.sqrt(np.diag(self.pose.covariance))
            measured = [
                *(1e3 * pose.position), *pose.orientation, *(1e3 * spread[:3]), *np.degrees(spread[3:]),
                pose.r_squared, pose.flip_margin,
            ]  # fmt: skip
            row |= dict(zip(COLUMNS[3:], map(float, measured), strict=False))
        own = {"shot": self.shot, "segment": self.segment, "time_s": float(self.time)}
        return row | own | {"trusted": int(self.trusted), "note": self.note}


@dataclass(frozen=True, repr=False)
class Localization(Readable):
    """Poses of a device in recorded samples.

    Attributes
    ----------
    samples : Path
    rig, robot : str
        Names of both.
    device : str or None
        The device file that was used; None for the values of the robot file.
    quiet : str or None
        File from which the noise was learned; None for the localizer's default.
    estimator : str
    sample_rate : float, in Hz
    shots : int
        Number of shots in the file.
    poses : tuple of LocatedShot
        In order, one for each shot or segment.
    """

    samples: Path
    rig: str
    robot: str
    device: str | None
    quiet: str | None
    estimator: str
    sample_rate: float
    shots: int
    poses: tuple[LocatedShot, ...]

    @property
    def trusted(self) -> int:
        """Number of trusted poses."""
        return sum(pose.trusted for pose in self.poses)

    def table(self) -> dict[str, np.ndarray[Any, Any]]:
        """Return all poses as columns.

        Returns
        -------
        dict of str to ndarray
            The `COLUMNS`, in the units of their names.
        """
        return as_columns((pose.row() for pose in self.poses), COLUMNS)


def localize(
    samples: str | Path,
    rig: str,
    *,
    robot: str | None = None,
    device: str | Path | None = None,
    half_periods: int | None = None,
    superfast: int | None = None,
    estimator: str | None = None,
    quiet: str | Path | None = None,
) -> Localization:
    """Locate a device in recorded samples: a pose for each shot, or for each segment of it.

    Parameters
    ----------
    samples : path
        Samples in V: .npz, .mat, .h5 or .csv.
    rig : str
        The rig whose sensors recorded them, by name or path.
    robot : str, optional
        By name or path; by default the device file's, or ``gradient``.
    device : path, optional
        Device file, as `calibrate` writes it.
    half_periods : int, optional
        Number of half-periods to use from the start of each shot.
    superfast : int, optional
        Half-periods in each segment of a shot, for a pose from every segment.
    estimator : str, optional
        ``whitened`` or ``paper``; by default the localizer's own.
    quiet : path, optional
        Samples without a drive, to learn the noise from.

    Returns
    -------
    Localization

    Raises
    ------
    InputError, ConfigError, MissingFileError
        For samples, a rig or a device that cannot be used.

    Examples
    --------
    >>> import smolbot
    >>> smolbot.localize("monday.csv", rig="tank")
    Traceback (most recent call last):
    smolbot.errors.MissingFileError: monday.csv: no such file.
    """
    if half_periods is not None and superfast is not None:
        raise InputError("--half-periods and --superfast exclude each other: one pose a shot, or one a segment.")
    samples = Path(samples)
    config = load_rig(rig)
    name, known = find_device(robot, device)
    held = read_samples(samples)
    shots = make_recordings(held, config)
    localizer, noise = make_localizer(config, known, estimator, quiet, held.sample_rate)
    try:
        poses = locate_all(
            localizer, shots if noise is None else noise.remove_broken_channels(shots), half_periods, superfast
        )
    except InputError as error:
        raise InputError(f"{samples}: {error}") from error
    return Localization(
        samples, config.name, name, str(device) if device else None, None if noise is None else noise.remark,
        localizer.estimator, held.sample_rate, len(shots.recordings), poses,
    )  # fmt: skip


def make_localizer(
    rig: RigConfig, device: Device, estimator: str | None, quiet: str | Path | None, rate: float
) -> tuple[Localizer, BackgroundNoise | None]:
    """Make a localizer for the rig's array, with the noise learned from background samples if they are given.

    Parameters
    ----------
    rig : RigConfig
    device : Device
    estimator : str or None
        None for the localizer's own.
    quiet : path or None
        Samples without a drive.
    rate : float, in Hz
        Of the recordings to be located.

    Returns
    -------
    tuple of Localizer, BackgroundNoise or None

    Raises
    ------
    InputError
        If the localizer has no such estimator, or nothing can be learned for samples of that rate.
    """
    heard = None if quiet is None else learn_background_noise(Path(quiet), rig, rate)
    options: dict[str, Any] = {} if estimator is None else {"estimator": estimator}
    noise = None if heard is None else heard.noise
    return Localizer(sensors=rig.sensors, device=device, noise=noise, **options), heard


def locate_all(
    localizer: Localizer, shots: SampleRecordings, half_periods: int | None = None, segments: int | None = None
) -> tuple[LocatedShot, ...]:
    """Locate all shots in order, each with the last trusted pose as prior; one without a pose keeps its row.

    Parameters
    ----------
    localizer : Localizer
    shots : SampleRecordings
    half_periods : int, optional
        Number of half-periods to use from each shot; by default all.
    segments : int, optional
        Half-periods in each segment, for a pose from every segment.

    Returns
    -------
    tuple of LocatedShot

    Raises
    ------
    InputError
        If the recordings are shorter than requested, or no shot could be fitted.
    """
    located: list[LocatedShot] = []
    faults: list[str] = []
    prior: Pose | None = None
    for number, (recording, said) in enumerate(zip(shots.recordings, shots.notes, strict=True)):
        used = _cut(recording, localizer.device.frequency, segments or half_periods or 1, half_periods)
        try:
            poses: Sequence[Pose] = (
                (localizer.locate(used, prior),)
                if segments is None
                else localizer.locate_segments(used, segments, prior)
            )
        except InputError as error:
            faults.append(f"shot {number}: {error}")
            located.append(LocatedShot(number, 0, used.middle, None, "; ".join(filter(None, [said, str(error)]))))
            continue
        for segment, pose in enumerate(poses):
            note = "; ".join(filter(None, [said, _doubt(pose)]))
            located.append(LocatedShot(number, segment, pose.time, pose, note))
            prior = pose if pose.trusted else prior
    if len(faults) == len(shots.recordings):
        raise InputError(faults[0] if len(faults) == 1 else f"no shot can be located; {faults[0]}")
    return tuple(located)


def _cut(recording: Recording, frequency: float, least: int, half_periods: int | None) -> Recording:
    """Cut the first `half_periods` from a recording, which must hold `least`."""
    n = recording.field.shape[1]
    n_needed = round(least * recording.sample_rate / (2.0 * frequency))
    if n + 1 < n_needed or n < 2:
        raise InputError(
            f"Each shot lasts {1e3 * recording.duration:.2f} ms ({n} samples at {recording.sample_rate:g} Hz); "
            f"{least} half-period{'s' * (least > 1)} of {frequency:g} Hz take{'' if least > 1 else 's'} "
            f"{500.0 * least / frequency:.2f} ms."
        )
    return recording if half_periods is None else replace(recording, field=recording.field[:, : max(n_needed, 2)])


def _doubt(pose: Pose) -> str:
    """Why a pose is not trusted; empty if it is."""
    sigma = 1e3 * float(np.sqrt(np.diag(pose.covariance)[:3].max()))
    reason = f"not trusted: R² {pose.r_squared:.3f}, flip margin {pose.flip_margin:.2f}, σ {sigma:.2g} mm"
    return "" if pose.trusted else reason
