"""``smolbot localize``: poses from a lab's own samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smolbot.core.text_table import write_rows
from smolbot.errors import InputError, writing
from smolbot.ui.cli.options import DEFAULT_ROBOT, DeviceOption, JsonOption, RobotOption

if TYPE_CHECKING:
    from smolbot.bench.calibration.quiet_samples import Quiet
    from smolbot.config.device import DeviceConfig
    from smolbot.config.rig import RigConfig
    from smolbot.config.samples import Shots
    from smolbot.core.pose import Pose
    from smolbot.core.sensing import Device, Recording
    from smolbot.localization.localizer import Localizer

COLUMNS = (
    "shot", "segment", "time_s", "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz",
    "sigma_x_mm", "sigma_y_mm", "sigma_z_mm", "sigma_rx_deg", "sigma_ry_deg", "sigma_rz_deg",
    "r_squared", "flip_margin", "trusted", "note",
)  # fmt: skip
"""Columns of the file that is written; sigmas are one standard deviation, turns about world axes."""

Row = dict[str, Any]


def localize(
    samples: Annotated[Path, typer.Argument(help="Samples in V: .npz, .mat, .h5 or .csv.", metavar="SAMPLES")],
    rig: Annotated[str, typer.Option("--rig", help="Rig whose sensors heard them, by name or path.")],
    robot: RobotOption = None,
    device: DeviceOption = None,
    half_periods: Annotated[
        int | None,
        typer.Option("--half-periods", min=1, metavar="N", help="Use the first N half-periods of each shot."),
    ] = None,
    superfast: Annotated[
        int | None, typer.Option(min=1, metavar="N_SEG", help="A pose from every N_SEG half-periods of each shot.")
    ] = None,
    estimator: Annotated[str | None, typer.Option(help="whitened or paper; default: the localizer's own.")] = None,
    quiet: Annotated[Path | None, typer.Option(help="Quiet samples, without a drive, to learn the noise from.")] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Write the poses to a .csv or .json file.")] = None,
    json: JsonOption = False,
) -> None:
    """Locate the device in recorded samples: a pose for each shot, or each segment of it, with its uncertainty."""
    from smolbot.config.rig import load_rig
    from smolbot.config.samples import read_samples, recordings_from

    if half_periods is not None and superfast is not None:
        raise InputError("--half-periods and --superfast exclude each other: one pose a shot, or one a segment.")
    if out is not None and out.suffix.lower() not in (".csv", ".json"):
        raise InputError(f"--out writes .csv or .json; got '{out}'.")
    rig_config = load_rig(rig)
    name, known = find_device(robot, device)
    held = read_samples(samples)
    shots = recordings_from(held, rig_config)
    localizer, heard = make_localizer(rig_config, known, estimator, quiet, held.sample_rate)
    try:
        rows = locate_all(localizer, shots if heard is None else heard.taken_from(shots), half_periods, superfast)
    except InputError as error:
        raise InputError(f"{samples}: {error}") from error
    head = {
        "samples": str(samples), "rig": rig_config.name, "robot": name, "device": str(device) if device else None,
        "quiet": None if heard is None else heard.told,
        "estimator": localizer.estimator, "shots": len(shots.recordings), "sample_rate_hz": held.sample_rate,
        "trusted": sum(row["trusted"] for row in rows),
    }  # fmt: skip
    if out is not None:
        _write(out, head, rows)
    _show(head, rows, out, json)
    raise typer.Exit(0 if any(row["trusted"] for row in rows) else 1)


def find_device(robot: str | None, device: Path | None) -> tuple[str, Device]:
    """Name of the robot, and its device: calibrated where a device file is given, else as the robot file believes.

    Raises
    ------
    ConfigError
        If the device file belongs to another robot.
    """
    from smolbot.config.robot import load_robot

    if device is None:
        config = load_robot(robot or DEFAULT_ROBOT)
        return config.name, config.device
    from smolbot.config.device import load_device

    found: DeviceConfig = load_device(device, load_robot(robot).name if robot is not None else None)
    return found.robot, found.device


def make_localizer(
    rig: RigConfig, device: Device, estimator: str | None, quiet: Path | None, rate: float
) -> tuple[Localizer, Quiet | None]:
    """A localizer for the rig's array, with the noise learned from quiet samples where they are given.

    Raises
    ------
    InputError
        If the localizer has no such estimator, or nothing can be learned for samples of that rate (Hz).
    """
    from smolbot.localization.localizer import Localizer

    options: dict[str, Any] = {} if estimator is None else {"estimator": estimator}
    if quiet is None:
        return Localizer(sensors=rig.sensors, device=device, **options), None
    from smolbot.bench.calibration.quiet_samples import learn_quiet

    heard = learn_quiet(quiet, rig, rate)
    return Localizer(sensors=rig.sensors, device=device, noise=heard.noise, **options), heard


def locate_all(
    localizer: Localizer, shots: Shots, half_periods: int | None = None, segments: int | None = None
) -> list[Row]:
    """Poses in order, each with the last trusted one as prior; a shot that cannot be located keeps its row.

    Parameters
    ----------
    half_periods : int, optional
        Use so many half-periods of each shot; all of them if not given.
    segments : int, optional
        Half-periods in each segment, for a pose from every segment.

    Raises
    ------
    InputError
        If the recordings are shorter than what is asked for, or no shot could be fitted at all.
    """
    rows: list[Row] = []
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
            rows.append(_lost(number, used, "; ".join(filter(None, [said, str(error)]))))
            continue
        for segment, pose in enumerate(poses):
            rows.append(_row(number, segment, pose, said))
            prior = pose if pose.trusted else prior
    if len(faults) == len(shots.recordings):
        raise InputError(faults[0] if len(faults) == 1 else f"no shot can be located; {faults[0]}")
    return rows


def _cut(recording: Recording, frequency: float, least: int, half_periods: int | None) -> Recording:
    """The first `half_periods` of a recording, which must hold `least`."""
    from dataclasses import replace

    n = recording.field.shape[1]
    wanted = round(least * recording.sample_rate / (2.0 * frequency))
    if n + 1 < wanted or n < 2:
        raise InputError(
            f"Each shot lasts {1e3 * recording.duration:.2f} ms ({n} samples at {recording.sample_rate:g} Hz); "
            f"{least} half-period{'s' * (least > 1)} of {frequency:g} Hz take{'' if least > 1 else 's'} "
            f"{500.0 * least / frequency:.2f} ms."
        )
    return recording if half_periods is None else replace(recording, field=recording.field[:, : max(wanted, 2)])


def _row(number: int, segment: int, pose: Pose, said: str) -> Row:
    import numpy as np

    spread = np.sqrt(np.diag(pose.covariance))
    values = [
        number, segment, pose.time, *(1e3 * pose.position), *pose.orientation, *(1e3 * spread[:3]),
        *np.degrees(spread[3:]), pose.r_squared, pose.flip_margin, int(pose.trusted),
    ]  # fmt: skip
    doubt = (
        f"not trusted: R² {pose.r_squared:.3f}, flip margin {pose.flip_margin:.2f}, σ {1e3 * spread[:3].max():.2g} mm"
    )
    note = "; ".join(filter(None, [said, "" if pose.trusted else doubt]))
    return dict(zip(COLUMNS, [v if isinstance(v, int) else float(v) for v in values] + [note], strict=True))


def _lost(number: int, recording: Recording, note: str) -> Row:
    row: Row = dict.fromkeys(COLUMNS, math.nan)
    return row | {"shot": number, "segment": 0, "time_s": recording.middle, "r_squared": 0.0, "flip_margin": 1.0} | {
        "trusted": 0, "note": note,
    }  # fmt: skip


def _write(out: Path, head: dict[str, Any], rows: list[Row]) -> None:
    from smolbot.ui.cli.show import json_text

    with writing(out):
        if out.suffix.lower() == ".json":
            out.write_text(json_text({**head, "poses": rows}), encoding="utf-8")
            return
        cells = (["" if isinstance(v, float) and math.isnan(v) else v for v in row.values()] for row in rows)
        write_rows(out, COLUMNS, cells)


def _show(head: dict[str, Any], rows: list[Row], out: Path | None, json: bool) -> None:
    from rich.table import Table

    from smolbot.ui.cli.show import console, echo_json, table

    facts = [(key.replace("_", " "), str(value)) for key, value in head.items() if value is not None]
    if out is not None:
        facts.append(("written", str(out)))
    table("localize", facts, err=json)
    shown = Table(title_justify="left", box=None, pad_edge=False)
    columns = [
        ("shot", "shot", "d"), ("time_s", "time (s)", ".4f"), ("x_mm", "x (mm)", ".3f"), ("y_mm", "y (mm)", ".3f"),
        ("z_mm", "z (mm)", ".3f"), ("sigma_x_mm", "± x", ".3f"), ("sigma_y_mm", "± y", ".3f"),
        ("sigma_z_mm", "± z", ".3f"), ("r_squared", "R²", ".4f"), ("flip_margin", "flip", ".2f"),
    ]  # fmt: skip
    for _, title, _ in columns:
        shown.add_column(title, justify="right")
    shown.add_column("trusted")
    shown.add_column("note", overflow="fold")
    for row in rows:
        cells = ["" if isinstance(row[k], float) and math.isnan(row[k]) else format(row[k], f) for k, _, f in columns]
        shown.add_row(*cells, "yes" if row["trusted"] else "no", row["note"])
    console(err=json, width=160).print(shown)
    if json:
        echo_json({**head, "poses": rows})
