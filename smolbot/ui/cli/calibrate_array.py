"""``smolbot calibrate-array``: gains, axes and positions of the sensors, from a device on a known track."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smolbot.errors import InputError
from smolbot.ui.cli.options import DeviceOption, JsonOption, RobotOption, SetOption, parse_settings

if TYPE_CHECKING:
    from smolbot.config.rig import RigConfig
    from smolbot.config.sensors import SensorsFile
    from smolbot.core.sensing import Device
    from smolbot.localization.array.calibration import ArrayCalibration

DEFAULT_POSES = 60
MAX_HELD_OUT_ERROR = 5e-3
"""Held-out error, in m, above which track and recordings probably do not belong together."""


def calibrate_array(
    rig: Annotated[str, typer.Option("--rig", help="Rig whose sensors recorded it, by name or path.")],
    track: Annotated[
        Path | None, typer.Argument(help="Known track: .csv, a row per recording; see above.", metavar="TRACK")
    ] = None,
    samples: Annotated[
        Path | None, typer.Option(help="Samples of all rows, a shot each, where the track has no column 'file'.")
    ] = None,
    robot: RobotOption = None,
    device: DeviceOption = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Sensors file to write; default: <rig>_sensors.toml.")
    ] = None,
    poses: Annotated[
        int, typer.Option(min=12, help="Without a track: so many poses on the rig's own stage, such as the tank's.")
    ] = DEFAULT_POSES,
    seed: Annotated[int, typer.Option(min=0, help="Of a simulated tank.")] = 1,
    keep: Annotated[
        Path | None, typer.Option(help="Without a track: new folder for track and samples, as a lab would have them.")
    ] = None,
    set_: SetOption = None,
    json: JsonOption = False,
) -> None:
    """Calibrate gains, axes and positions of the sensors with a device at known poses; writes a sensors file.

    TRACK has named columns: x_mm, y_mm, z_mm of the cantilever's rotation centre in the rig's world frame; along_x,
    along_y, along_z and swing_x, swing_y, swing_z, the directions of the cantilever and of its swing (or qw, qx, qy,
    qz); and, unless --samples is given, file: the samples of the row, as smolbot localize reads them. Give some
    sixty poses, over the volume and over headings. Every fourth is held out and shows whether anything was gained.

    Estimated along with the sensors: amplitude and phase of each drive, the device's resonance and damping, and its
    pose in the holder (to 0.3 mm and 1 degree). Needed: the position of the stage, to some 20 um, and l0. A gain
    common to all sensors cannot be distinguished from the drive and stays 1.

    Without TRACK the rig's own stage moves to the poses by itself; the simulated tank has one.
    """
    from smolbot.bench.calibration.stage_recordings import read_known_recordings, record_on_stage, select_ringing
    from smolbot.config.rig import load_rig
    from smolbot.config.sensors import write_sensors
    from smolbot.functions.targets import check_writable, expected_hum, find_device
    from smolbot.localization.array.calibration import calibrate_sensors

    if track is None and samples is not None:
        raise InputError("--samples needs a TRACK: where the device was in each shot.")
    if track is not None and keep is not None:
        raise InputError("--keep is for the rig's own stage; with a TRACK there is nothing to keep.")
    settings = {key.removeprefix("rig."): value for key, value in parse_settings(set_).items()}
    config = load_rig(rig, settings or None)
    name, assumed = find_device(robot, device)
    path = out or Path(f"{config.name}_sensors.toml")
    check_writable(path)
    shots = (
        record_on_stage(config, assumed, poses, seed, keep)
        if track is None
        else read_known_recordings(track, samples, config)
    )
    used, known, left_out = select_ringing(shots, config, assumed, expected_hum(config))
    found = calibrate_sensors(
        [s.recording for s in used], [s.pose for s in used], config.sensors, known, hum=expected_hum(config)
    )
    better = found.held_out.better
    if better:
        write_sensors(path, make_sensors_file(found, config))
    notes = [f"{s.name}: {s.note}" for s in used if s.note] + left_out
    _show(found, config, name, known, len(used), notes, path if better else None, json)
    raise typer.Exit(0 if better else 1)


def make_sensors_file(found: ArrayCalibration, rig: RigConfig) -> SensorsFile:
    """Build the sensors file: calibrated positions, axes and gains, everything else from the rig file.

    Parameters
    ----------
    found : ArrayCalibration
    rig : RigConfig

    Returns
    -------
    SensorsFile
    """
    import numpy as np

    from smolbot.config.sensors import SensorsFile, UncertaintySection

    check = found.held_out
    gains = rig.sensor_gains * found.gains
    section = rig.sections.sensors.model_copy(
        update={
            "positions_mm": [tuple(row) for row in (1e3 * found.sensors.positions).tolist()],
            "axes": [tuple(row) for row in found.sensors.axes.tolist()],
            "gains": gains.tolist(),
            "calibrated": None,
        }
    )
    uncertainty = UncertaintySection(
        positions_mm=[tuple(row) for row in (1e3 * found.place_std).tolist()],
        axes_deg=[tuple(row) for row in np.degrees(found.tilt_std).tolist()],
        gains=found.gain_std.tolist(),
        held_out=check.recordings,
        position_mm=(1e3 * check.position_before, 1e3 * check.position_after),
        orientation_deg=(float(np.degrees(check.orientation_before)), float(np.degrees(check.orientation_after))),
    )
    return SensorsFile(rig=rig.name, date=datetime.date.today(), sensors=section, uncertainty=uncertainty)


def _show(
    found: ArrayCalibration, rig: RigConfig, robot: str, device: Device, used: int, notes: list[str], path: Path | None,
    json: bool,
) -> None:  # fmt: skip
    import numpy as np
    from rich.table import Table

    from smolbot.ui.cli.show import echo_json, make_console, print_table

    check, holder = found.held_out, found.holder
    moved = 1e3 * (found.sensors.positions - rig.sensors.positions)
    tilted = np.degrees(np.arccos(np.clip(np.sum(found.sensors.axes * rig.sensors.axes, axis=1), -1.0, 1.0)))
    tilt_std = np.degrees(np.sqrt(np.mean(found.tilt_std**2, axis=1)))
    shown = Table(title=f"sensors of {rig.name}: their deviations", title_justify="left", box=None, pad_edge=False)
    for title in ("sensor", "x (mm)", "y (mm)", "z (mm)", "±", "gain (%)", "±", "tilt (°)", "±"):
        shown.add_column(title, justify="right")
    for i in range(len(moved)):
        gain, gain_std = 100.0 * (found.gains[i] - 1.0), 100.0 * found.gain_std[i]
        place_std = 1e3 * float(np.sqrt(np.mean(found.place_std[i] ** 2)))
        cells = [*(f"{v:+.3f}" for v in moved[i]), f"{place_std:.3f}", f"{gain:+.2f}", f"{gain_std:.2f}"]
        shown.add_row(str(i), *cells, f"{tilted[i]:.2f}", f"{tilt_std[i]:.2f}")
    make_console(err=json).print(shown)
    turns = np.degrees([check.orientation_before, check.orientation_after])
    places = 1e3 * np.array([check.position_before, check.position_after])
    rows = [
        ("recordings", f"{used}, of which {check.recordings} held out"),
        ("held out, rms", f"position {places[0]:.3f} → {places[1]:.3f} mm, turn {turns[0]:.3f} → {turns[1]:.3f}°"),
        ("device", f"{robot}: {device.frequency:.3f} Hz, {device.damping:.3g} 1/s, as measured"),
        ("in its holder", _format_triple(1e3 * holder.place, 1e3 * holder.place_std, "mm") + "; "
         + _format_triple(np.degrees(holder.turn), np.degrees(holder.turn_std), "°")),
        ("written", str(path) if path is not None else "nothing: held-out poses came out no better"),
        *(("note", note) for note in notes),
    ]  # fmt: skip
    if check.position_before > MAX_HELD_OUT_ERROR:
        rows.append(("warning", "held-out poses are far from the track: do rows and recordings belong together?"))
    print_table("", rows, err=json)
    if json:
        echo_json(
            {
                "rig": rig.name,
                "robot": robot,
                "recordings": used,
                "held_out": check.recordings,
                "held_out_position_mm": {"before": places[0], "after": places[1]},
                "held_out_orientation_deg": {"before": turns[0], "after": turns[1]},
                "verdict": "passed" if check.better else "failed",
                "sensors_file": None if path is None else str(path),
                "positions_mm": {"value": 1e3 * found.sensors.positions, "std": 1e3 * found.place_std},
                "axes": {"value": found.sensors.axes, "std_deg": np.degrees(found.tilt_std)},
                "gains": {"value": rig.sensor_gains * found.gains, "std": found.gain_std},
                "frequency_hz": device.frequency,
                "damping_per_s": device.damping,
                "holder_mm": {"value": 1e3 * holder.place, "std": 1e3 * holder.place_std},
                "holder_deg": {"value": np.degrees(holder.turn), "std": np.degrees(holder.turn_std)},
                "notes": notes,
            }
        )


def _format_triple(value: Any, std: Any, unit: str) -> str:
    return ", ".join(f"{v:+.2f} ± {s:.2f}" for v, s in zip(value, std, strict=True)) + f" {unit}"
