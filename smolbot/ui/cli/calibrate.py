"""``smolbot calibrate``: resonance, damping and stops of a device, measured on a rig."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from smolbot.errors import InputError
from smolbot.ui.cli.options import DEFAULT_ROBOT, JsonOption, SetOption, settings_from

if TYPE_CHECKING:
    from smolbot.bench.calibration.device import Calibration
    from smolbot.config.rig import RigConfig
    from smolbot.config.robot import RobotConfig
    from smolbot.localization.device.thinning import Hum


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
        float, typer.Option(help="The sweep reaches so far to both sides of the believed frequency.")
    ] = 6.0,
    points: Annotated[int, typer.Option(min=2, help="Bursts of the frequency sweep.")] = 9,
    repeats: Annotated[int, typer.Option(min=2, help="Shots from which damping comes.")] = 4,
    seed: Annotated[int, typer.Option(min=0, help="Of a simulated tank.")] = 1,
    set_: SetOption = None,
    json: JsonOption = False,
) -> None:
    """Measure a device at a known height: frequency sweep, damping, largest amplitude; writes a device file."""
    from smolbot.bench.calibration.device import Plan
    from smolbot.bench.calibration.device import calibrate as measure
    from smolbot.config.device import DeviceConfig, write_device
    from smolbot.config.plugins import load_world
    from smolbot.config.world import World
    from smolbot.ui.cli.show import spinner

    plan = Plan(cycles, sweep_span=span_hz, sweep_points=points, repeats=repeats, height_std=1e-3 * z_std_mm)
    rig_config, robot_config, start = find_target(target, robot, settings_from(set_))
    _check_height(z_mm, rig_config)
    path = out or Path(f"{robot_config.name}_device.toml")
    check_writable(path)
    world: World = load_world(rig_config.world, rig_config.document)
    rig = world.open(rig_config, robot_config, start, seed)
    try:
        with spinner("calibrating", quiet=json) as tell:
            found = measure(
                rig, robot_config.device, 1e-3 * z_mm, plan=plan, hum=expected_hum(rig_config), progress=tell
            )
    finally:
        rig.close()
    today = datetime.date.today()
    config = DeviceConfig(robot_config.name, rig_config.name, today, found.device, found.std, found.height)
    write_device(path, config)
    _show(found, robot_config.name, rig_config.name, path, json)
    raise typer.Exit(0 if found.stops_reached else 1)


def check_writable(path: Path) -> None:
    """Refuse a file that cannot be written before time is spent on what it shall hold."""
    if path.is_dir():
        raise InputError(f"--out {path}: is a folder; name a file.")
    if not path.parent.is_dir():
        raise InputError(f"--out {path}: there is no folder {path.parent}.")


def find_target(
    target: str, robot: str | None, settings: dict[str, str] | None = None
) -> tuple[RigConfig, RobotConfig, tuple[float, float]]:
    """Rig, robot and the place (x, y) in m where the robot is put down: under the middle, or a mission's start.

    Raises
    ------
    InputError
        If a name is neither a rig nor a mission; lists what there is.
    """
    from smolbot.config.library import holds_rig, shipped
    from smolbot.config.mission import load_mission
    from smolbot.config.rig import load_rig
    from smolbot.config.robot import load_robot

    settings = settings or {}
    rigs, missions = shipped("rigs"), shipped("missions")
    is_path = target.endswith(".toml") or "/" in target or "\\" in target
    if not is_path and target not in rigs and target not in missions:
        raise InputError(
            f"No rig or mission is named '{target}'. Rigs: {', '.join(rigs)}. Missions: {', '.join(missions)}. "
            f"Your own is given by its path, such as ./{target}.toml."
        )
    is_rig = holds_rig(Path(target)) if is_path else target in rigs
    if is_rig:
        config = load_rig(target, {key.removeprefix("rig."): value for key, value in settings.items()} or None)
        x, y = config.container.center.tolist()
        return config, load_robot(robot or DEFAULT_ROBOT), (x, y)
    mission = load_mission(target, None, settings)
    chosen = mission.robot if robot is None else load_robot(robot, beside=mission.document.path.parent)
    return mission.rig, chosen, mission.start


def expected_hum(rig: RigConfig) -> Hum:
    """Mains lines as the rig file expects them."""
    from smolbot.localization.device.thinning import Hum

    noise = rig.sections.noise
    first = max(noise.mains, 1e-10)
    sizes = {1: first} | {int(order): max(first * size, 1e-10) for order, size in noise.harmonics.items()}
    return Hum(noise.mains_hz, sizes)


def _check_height(z_mm: float, rig: RigConfig) -> None:
    box = rig.sections.container
    low, high = box.floor_z_mm, box.surface_z_mm + box.wall_height_mm
    if not low <= z_mm <= high:
        raise InputError(
            f"--z-mm must lie within the container of rig '{rig.name}', {low:g} to {high:g} mm above the sensors "
            f"(liquid's surface at {box.surface_z_mm:g}); got {z_mm:g}."
        )


def _show(found: Calibration, robot: str, rig: str, path: Path, json: bool) -> None:
    import numpy as np
    from rich.table import Table

    from smolbot.ui.cli.show import console, echo_json, table

    device, old, std = found.device, found.believed, found.std
    values = {
        "theta_max_deg": (np.degrees(device.theta_max), np.degrees(std.theta_max), np.degrees(old.theta_max)),
        "frequency_hz": (device.frequency, std.frequency, old.frequency),
        "damping_per_s": (device.damping, std.damping, old.damping),
    }
    shown = Table(title=f"{robot} on {rig}, at z = {1e3 * found.height:g} mm", title_justify="left", box=None)
    for title in ("", "value", "±", "believed before"):
        shown.add_column(title, justify="left" if not title else "right")
    for key, (value, error, before) in values.items():
        shown.add_row(key, f"{value:.4g}" if key != "frequency_hz" else f"{value:.3f}", f"{error:.2g}", f"{before:g}")
    shown.add_row("damping_model", device.damping_model, f"BIC {found.evidence:.0f}", old.damping_model)
    console(err=json).print(shown)
    strongest = max(found.drives, key=lambda d: d.amplitude)
    notes = [
        ("shots", str(found.shots)),
        ("best drive", f"{strongest.current:.2f} A leaves {np.degrees(strongest.amplitude):.2f}°"),
        ("strongest at", f"{max(found.sweep, key=lambda p: p.strength).driven:.2f} Hz driven"),
        ("written", str(path)),
    ]
    if not found.stops_reached:
        notes.append(("warning", "the stops were not reached: theta_max is no more than believed. Use longer bursts."))
    table("", notes, err=json)
    if json:
        echo_json(
            {
                "robot": robot,
                "rig": rig,
                "z_mm": 1e3 * found.height,
                "device_file": str(path),
                **{k: {"value": v, "std": s, "believed": b} for k, (v, s, b) in values.items()},
                "damping_model": device.damping_model,
                "evidence_bic": found.evidence,
                "stops_reached": found.stops_reached,
                "shots": found.shots,
                "sweep": [
                    {
                        "driven_hz": p.driven,
                        "heard_hz": p.heard,
                        "heard_hz_std": p.heard_std,
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
