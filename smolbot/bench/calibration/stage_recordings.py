"""Recordings of a device at known poses: from a lab's own files, or from a stage in the rig's world."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from smolbot.bench.calibration.device import MIN_SNR, compute_weighted_mean
from smolbot.config.known_track import plan_track, read_known_track, write_known_track
from smolbot.config.samples import make_recordings, read_samples
from smolbot.core.pose import Pose
from smolbot.core.sensing import Device, Recording
from smolbot.errors import InputError, report_write_errors

if TYPE_CHECKING:
    from smolbot.config.rig import RigConfig
    from smolbot.localization.device.thinning import Hum

HALF_PERIODS = 20
"""Length of a recording on a rig's own stage, in half-periods."""

SEARCH_SPAN = 3.0
"""Half width, in Hz, of the search for the resonance about the assumed frequency."""

MIN_RECORDINGS = 11
"""Smallest number of recordings for calibration and held-out check together."""


@dataclass(frozen=True)
class KnownRecording:
    """One recording at a known pose.

    Attributes
    ----------
    name : str
        Where it comes from.
    recording : Recording
    pose : Pose
    note : str
        Remark for the report; empty if there is none.
    """

    name: str
    recording: Recording
    pose: Pose
    note: str = ""


def read_known_recordings(track: Path, samples: Path | None, rig: RigConfig) -> list[KnownRecording]:
    """Read a lab's own recordings; rows of the track that name the same file take its shots in order.

    Parameters
    ----------
    track : Path
        File of known poses.
    samples : Path or None
        Recordings of the rows that name no file.
    rig : RigConfig

    Returns
    -------
    list of KnownRecording

    Raises
    ------
    InputError
        If track or samples cannot be read, a row has no samples, or a file has another number of shots than rows.
    """
    known = read_known_track(track)
    rows: dict[Path, list[Pose]] = {}
    for row, (file, pose) in enumerate(zip(known.files, known.poses, strict=True), 1):
        chosen = file or samples
        if chosen is None:
            raise InputError(f"{track}: row {row} names no samples; give a column 'file', or one file by --samples.")
        rows.setdefault(chosen, []).append(pose)
    found = []
    for file, poses in rows.items():
        shots = make_recordings(read_samples(file), rig)
        if len(shots.recordings) != len(poses):
            raise InputError(
                f"{track}: {len(poses)} rows, but {file} holds {len(shots.recordings)} shots; each row needs its own."
            )
        for number, heard in enumerate(zip(shots.recordings, poses, shots.notes, strict=True)):
            found.append(KnownRecording(f"{file.name}, shot {number}", *heard))
    return found


def record_on_stage(
    rig: RigConfig, device: Device, count: int, seed: int, save_to: Path | None
) -> list[KnownRecording]:
    """Record on the stage of the rig's world.

    Parameters
    ----------
    rig : RigConfig
    device : Device
    count : int
        Number of poses.
    seed : int
        Of a simulated stage.
    save_to : Path or None
        New folder in which to save track and samples; None to save nothing.

    Returns
    -------
    list of KnownRecording

    Raises
    ------
    InputError
        If the world has no stage, or the folder is in use.
    """
    from smolbot.config.plugins import load_world
    from smolbot.config.world import StagedWorld

    if save_to is not None and save_to.exists() and (not save_to.is_dir() or any(save_to.iterdir())):
        raise InputError(f"--keep {save_to}: must be a new or empty folder, so that no recording is lost.")
    world = load_world(rig.world, rig.document)
    if not isinstance(world, StagedWorld):
        raise InputError(
            f"World '{rig.world}' of rig '{rig.name}' has no stage of its own; give a TRACK with recordings."
        )
    box = rig.container
    stage = world.stage(rig, device, seed)
    track = plan_track(box.low, box.high + np.array([0.0, 0.0, box.wall_height]), count)
    recordings = [stage.record(p.position, np.array(p.orientation), HALF_PERIODS) for p in track]
    if save_to is not None:
        _save(save_to, track, recordings, rig)
    return [KnownRecording(f"pose {i}", h, p) for i, (h, p) in enumerate(zip(recordings, track, strict=True))]


def _save(folder: Path, track: list[Pose], recordings: list[Recording], rig: RigConfig) -> None:
    """Write track and samples in the format of a lab's own files."""
    scale = rig.sections.sensors.volts_per_tesla
    with report_write_errors(f"--keep {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(
            folder / "samples.npz",
            volts=np.stack([scale * rig.sensor_gains[:, None] * h.field for h in recordings]),
            sample_rate_hz=recordings[0].sample_rate,
            time_since_drive_ms=[1e3 * h.time_since_drive for h in recordings],
            clock_s=[h.clock for h in recordings],
        )
    write_known_track(folder / "track.csv", track, ["samples.npz"] * len(track))


def select_ringing(
    shots: list[KnownRecording], rig: RigConfig, device: Device, hum: Hum
) -> tuple[list[KnownRecording], Device, list[str]]:
    """Select the recordings in which the device oscillates, and estimate its resonance and damping.

    Both are those of the device as it is mounted, in the field of the room now.

    Parameters
    ----------
    shots : list of KnownRecording
    rig : RigConfig
    device : Device
        As assumed.
    hum : Hum
        Mains lines expected in the room.

    Returns
    -------
    used : list of KnownRecording
    device : Device
        With the estimated frequency and damping.
    left_out : list of str
        A sentence for each recording that was left out.

    Raises
    ------
    InputError
        If too few are left.
    """
    from smolbot.localization.device.ringdown import measure_ring_down

    used, amplitudes, left_out = [], [], []
    for shot in shots:
        try:
            rang = measure_ring_down(shot.recording, rig.sensors, device, hum=hum, search=SEARCH_SPAN)
        except InputError as error:
            left_out.append(f"{shot.name}: left out: {error}")
            continue
        if rang.signal_to_noise < MIN_SNR:
            left_out.append(f"{shot.name}: left out: nothing rings (signal to noise {rang.signal_to_noise:.1f})")
            continue
        used.append(shot)
        amplitudes.append(rang)
    if len(used) < MIN_RECORDINGS:
        why = "".join(f"\n{line}" for line in left_out[:10])
        raise InputError(
            f"{len(used)} of {len(shots)} recordings can be used; at least {MIN_RECORDINGS} are needed.{why}"
        )
    frequency, _ = compute_weighted_mean([(r.frequency, r.frequency_std) for r in amplitudes])
    damping, _ = compute_weighted_mean([(r.damping, r.damping_std) for r in amplitudes])
    return used, replace(device, frequency=frequency, damping=damping), left_out
