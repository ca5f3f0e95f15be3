"""``smolbot calibrate``: resonance, damping and stops of a device, measured on a rig."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from smolbot.functions.settings import DEFAULT_ROBOT
from smolbot.ui.cli.options import JsonOption, SetOption, parse_settings

if TYPE_CHECKING:
    from smolbot.bench.calibration.device import Calibration


def calibrate(
    target: Annotated[str, typer.Argument(help="Rig, or a mission that names rig and robot.", metavar="RIG|MISSION")],
    z_mm: Annotated[
        float, typer.Option("--z-mm", help="Known height of the cantilever's rotation centre above the sensors.")
    ],
    z_std_mm: Annotated[float, typer.Option("--z-std-mm", min=0.0, help="How well that height is known.")] = 0.2,
    robot: Annotated[
        str | None, typer.Option("--robot", help=f"Robot, by name or path; default: the mission's, or {DEFAULT_ROBOT}.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Device file to write; default: <robot>_device.toml.")
    ] = None,
    cycles: Annotated[int, typer.Option(min=2, help="Length of a burst, in periods; as missions drive it.")] = 5,
    span_hz: Annotated[
        float, typer.Option(help="The sweep reaches so far to both sides of the assumed frequency.")
    ] = 6.0,
    points: Annotated[int, typer.Option(min=2, help="Bursts of the frequency sweep.")] = 9,
    repeats: Annotated[int, typer.Option(min=2, help="Shots from which damping comes.")] = 4,
    seed: Annotated[int, typer.Option(min=0, help="Of a simulated tank.")] = 1,
    set_: SetOption = None,
    json: JsonOption = False,
) -> None:
    """Measure a device at a known height: frequency sweep, damping, largest amplitude; writes a device file."""
    from smolbot.bench.calibration.device import CalibrationPlan
    from smolbot.functions.calibrate import calibrate as measure
    from smolbot.ui.cli.show import show_spinner

    plan = CalibrationPlan(cycles, sweep_span=span_hz, sweep_points=points, repeats=repeats, height_std=1e-3 * z_std_mm)
    with show_spinner("calibrating", quiet=json) as log:
        found = measure(
            target, 1e-3 * z_mm, robot=robot, plan=plan, seed=seed, out=out or "{robot}_device.toml",
            settings=parse_settings(set_), progress=log,
        )  # fmt: skip
    _show(found, json)
    raise typer.Exit(0 if found.stops_reached else 1)


def _show(found: Calibration, json: bool) -> None:
    import numpy as np
    from rich.table import Table

    from smolbot.ui.cli.show import echo_json, make_console, print_table

    device, old, std = found.device, found.assumed, found.std
    values = {
        "theta_max_deg": (np.degrees(device.theta_max), np.degrees(std.theta_max), np.degrees(old.theta_max)),
        "frequency_hz": (device.frequency, std.frequency, old.frequency),
        "damping_per_s": (device.damping, std.damping, old.damping),
    }
    shown = Table(
        title=f"{found.robot} on {found.rig}, at z = {1e3 * found.height:g} mm", title_justify="left", box=None
    )
    for title in ("", "value", "±", "assumed before"):
        shown.add_column(title, justify="left" if not title else "right")
    for key, (value, error, before) in values.items():
        shown.add_row(key, f"{value:.4g}" if key != "frequency_hz" else f"{value:.3f}", f"{error:.2g}", f"{before:g}")
    shown.add_row("damping_model", device.damping_model, f"BIC {found.evidence:.0f}", old.damping_model)
    make_console(err=json).print(shown)
    strongest = max(found.drives, key=lambda d: d.amplitude)
    notes = [
        ("shots", str(found.shots)),
        ("best drive", f"{strongest.current:.2f} A leaves {np.degrees(strongest.amplitude):.2f}°"),
        ("strongest at", f"{max(found.sweep, key=lambda p: p.strength).driven_frequency:.2f} Hz driven"),
        ("written", str(found.file)),
    ]
    if not found.stops_reached:
        notes.append(("warning", "the stops were not reached: theta_max is no more than assumed. Use longer bursts."))
    print_table("", notes, err=json)
    if json:
        echo_json(
            {
                "robot": found.robot,
                "rig": found.rig,
                "z_mm": 1e3 * found.height,
                "device_file": str(found.file),
                **{k: {"value": v, "std": s, "believed": b} for k, (v, s, b) in values.items()},
                "damping_model": device.damping_model,
                "evidence_bic": found.evidence,
                "stops_reached": found.stops_reached,
                "shots": found.shots,
                "sweep": [
                    {
                        "driven_hz": p.driven_frequency,
                        "heard_hz": p.measured_frequency,
                        "heard_hz_std": p.measured_frequency_std,
                        "strength_nt": 1e9 * p.strength,
                    }
                    for p in found.sweep
                ],
                "drives": [
                    {
                        "current_a": p.current,
                        "amplitude_deg": np.degrees(p.amplitude),
                        "std_deg": np.degrees(p.amplitude_std),
                    }
                    for p in found.drives
                ],
            }
        )
