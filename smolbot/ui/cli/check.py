"""``smolbot check``: test of a rig before it is used."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from smolbot.ui.cli.options import JsonOption
from smolbot.ui.cli.show import echo_json, make_console, show_spinner

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from smolbot.bench.check.checkup import Checkup
    from smolbot.config.rig import RigConfig


def register(app: typer.Typer) -> None:
    """Add the command.

    Parameters
    ----------
    app : typer.Typer
    """
    app.command("check")(check)


def check(
    rig: Annotated[str, typer.Argument(help="Rig: a name of ours, or a file.", metavar="RIG")],
    robot: Annotated[
        str | None, typer.Option(help="What is in the container; default: the robot of a mission of this rig.")
    ] = None,
    quiet_s: Annotated[float, typer.Option("--quiet-s", help="How long to listen to nothing, in s.")] = 12.0,
    seed: Annotated[int, typer.Option(min=0, help="Which tank, where it is a simulated one.")] = 1,
    json: JsonOption = False,
) -> None:
    """Check a rig: read back every device, record noise, drive each coil weakly; list what a person must verify."""
    from smolbot.bench.check.checkup import check_rig
    from smolbot.config.plugins import load_world
    from smolbot.config.rig import load_rig
    from smolbot.config.robot import load_robot

    config = load_rig(rig)
    held = load_robot(robot if robot is not None else _find_robot(config))
    world = load_world(config.world, config.document)
    middle = tuple(config.container.center.tolist())
    with show_spinner("opening") as say:
        opened = world.open(config, held, middle, seed)
        try:
            found = check_rig(opened, config, quiet_s, say)
        finally:
            opened.close()
    show(found, config, err=json)
    if json:
        echo_json(make_summary(found, config))
    raise typer.Exit(0 if found.ok else 1)


def _find_robot(config: RigConfig) -> str:
    """Return the robot of the first shipped mission on this rig, or a robot that suits it."""
    from smolbot.config.library import list_shipped, open_file

    missions = [open_file(name, "missions").data for name in list_shipped("missions")]
    for mission in missions:
        if mission.get("rig") == config.name:
            return str(mission.get("robot"))
    return "helical" if config.sections.magnet is not None else "gradient"


def make_summary(found: Checkup, config: RigConfig) -> dict[str, Any]:
    """Build the JSON output of a check.

    Parameters
    ----------
    found : Checkup
    config : RigConfig

    Returns
    -------
    dict
    """
    from smolbot.bench.check import checkup

    expected = found.expected
    return {
        "rig": config.name,
        "world": config.world,
        "ok": found.ok,
        "faults": found.faults,
        "notes": list(found.notes),
        "devices": [
            {"device": d.device, "what": d.what, "found": d.found, "limit": d.limit, "ok": d.ok} for d in found.devices
        ],
        "limits": {
            "offset_nt": 1e9 * checkup.MAX_OFFSET_SHARE * expected.range,
            "range_nt": 1e9 * expected.range,
            "noise_1hz_pt_per_rthz": 1e12 * checkup.MAX_SLOW_RATIO * expected.slow,
            "noise_floor_pt_per_rthz": 1e12 * checkup.MAX_FLOOR_RATIO * expected.floor,
            "mains_nt": 1e9 * checkup.MAX_MAINS_RATIO * expected.mains,
            "harmonics_nt": 1e9 * checkup.MAX_MAINS_RATIO * expected.harmonics,
        },
        "mains_hz": found.mains_frequency,
        "sensors": [
            {
                "sensor": s.name,
                "offset_nt": 1e9 * s.offset,
                "rms_nt": 1e9 * s.rms,
                "noise_1hz_pt_per_rthz": 1e12 * s.slow,
                "noise_floor_pt_per_rthz": 1e12 * s.floor,
                "mains_nt": 1e9 * s.mains,
                "harmonics_nt": 1e9 * s.harmonics,
                "gain": s.gain,
                "faults": list(s.faults),
            }
            for s in found.sensors
        ],
        "coils": [
            {
                "coil": c.name,
                "probe_ma": 1e3 * c.current,
                "gain": c.gain,
                "unexplained": c.unexplained,
                "close_ms": None if c.closes is None else 1e3 * c.closes,
                "open_ms": None if c.opens is None else 1e3 * c.opens,
                "time_constant_ms": None if c.rise is None else 1e3 * c.rise,
                "faults": list(c.faults),
            }
            for c in found.coils
        ],
        "by_hand": list(found.manual_checks),
        "simulated": found.simulated,
    }


def show(found: Checkup, config: RigConfig, *, err: bool = False) -> None:
    """Print the tables: devices, sensors, coils, verdict, and what only a person can verify.

    Parameters
    ----------
    found : Checkup
    config : RigConfig
    err : bool
        Print on standard error, since standard output is kept for JSON.
    """
    from rich.text import Text

    shown = make_console(err=err)
    shown.print(Text.assemble(("check of ", "bold"), (config.name, "bold"), f"  {config.sections.description}"))
    if found.devices:
        shown.print()
        shown.print(_make_device_table(found))
    shown.print()
    shown.print(_make_sensor_table(found))
    if found.coils:
        shown.print()
        shown.print(_make_coil_table(found))
    for note in found.notes:
        shown.print(f"\n{note}")
    _print_verdict(shown, found)
    _print_manual_checks(shown, found)


def _make_grid(title: str, columns: list[tuple[str, str]]) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    grid = Table(
        title=title,
        title_justify="left",
        title_style="bold",
        box=SIMPLE_HEAD,
        pad_edge=False,
        collapse_padding=True,
        header_style="cyan",
    )
    for number, (name, justify) in enumerate(columns):
        right = justify == "right"
        grid.add_column(
            name,
            justify="right" if right else "left",
            no_wrap=right or number in (0, len(columns) - 1),
            overflow="fold",
            vertical="top",
        )
    return grid


def _make_mark(faulty: bool) -> Any:
    """Make the last cell of a row; faults are listed in full below the tables."""
    from rich.text import Text

    return Text("bad", "bold red") if faulty else Text("ok", "green")


def _make_device_table(found: Checkup) -> Table:
    grid = _make_grid("devices", [("device", ""), ("read back", ""), ("found", ""), ("should be", ""), ("", "")])
    last = ""
    for item in found.devices:
        device = "" if item.device == last else item.device
        grid.add_row(device, item.what, item.found, item.limit, _make_mark(not item.ok))
        last = item.device
    return grid


def _make_sensor_table(found: Checkup) -> Table:
    from rich.text import Text

    from smolbot.bench.check import checkup, response_match

    grid = _make_grid(
        f"sensors, nothing driven; range ±{1e6 * found.expected.range:g} µT, mains {found.mains_frequency:.2f} Hz",
        [
            ("sensor", ""), ("offset\nnT", "right"), ("rms\nnT", "right"), ("at 1 Hz\npT/√Hz", "right"),
            ("floor\npT/√Hz", "right"), ("mains\nnT", "right"), ("harmonics\nnT", "right"), ("gain", "right"), ("", ""),
        ],
    )  # fmt: skip
    for s in found.sensors:
        gain = "–" if s.gain is None else f"{round(s.gain, 3) + 0.0:.3f}"
        grid.add_row(
            s.name, f"{1e9 * s.offset:+.0f}", f"{1e9 * s.rms:.2f}", f"{1e12 * s.slow:.1f}", f"{1e12 * s.floor:.2f}",
            f"{1e9 * s.mains:.1f}", f"{1e9 * s.harmonics:.2f}", gain, _make_mark(bool(s.faults)),
        )  # fmt: skip
    e = found.expected
    limits = (
        "limit", f"±{1e9 * checkup.MAX_OFFSET_SHARE * e.range:.0f}", "",
        f"{1e12 * checkup.MAX_SLOW_RATIO * e.slow:.0f}",
        f"{1e12 * checkup.MAX_FLOOR_RATIO * e.floor:.1f}", f"{1e9 * checkup.MAX_MAINS_RATIO * e.mains:.0f}",
        f"{1e9 * checkup.MAX_MAINS_RATIO * e.harmonics:.1f}",
        f"1 ± {response_match.SENSOR_GAIN_TOLERANCE:g}*" if found.coils else "", "",
    )  # fmt: skip
    grid.add_section()
    grid.add_row(*(Text(limit, "dim") for limit in limits))
    if found.coils:
        grid.caption = "* and more where half a millimetre or half a degree changes its signal"
        grid.caption_justify = "left"
    return grid


def _make_coil_table(found: Checkup) -> Table:
    from rich.text import Text

    from smolbot.bench.check import coils, response_match

    grid = _make_grid(
        "coils, each driven faintly and measured by all sensors",
        [
            ("coil", ""), ("probe\nmA", "right"), ("gain", "right"), ("residue\n%", "right"),
            ("closes\nms", "right"), ("opens\nms", "right"), ("time constant\nms", "right"), ("", ""),
        ],
    )  # fmt: skip
    for c in found.coils:
        rise = "–" if c.rise is None else f"{1e3 * c.rise:.2f} of {1e3 * c.time_constant:.2f}"
        grid.add_row(
            c.name, f"{1e3 * c.current:.0f}", f"{c.gain:.3f}", f"{100 * c.unexplained:.1f}",
            _format_milliseconds(c.closes), _format_milliseconds(c.opens), rise, _make_mark(bool(c.faults)),
        )  # fmt: skip
    late, slow = 1e3 * coils.RELAY_TOLERANCE, 100 * coils.TIME_CONSTANT_TOLERANCE
    limits = (
        "limit", "", f"1 ± {response_match.COIL_GAIN_TOLERANCE:g}", f"{100 * response_match.MAX_UNEXPLAINED:.0f}",
        *(f"{1e3 * max(getattr(c, side) for c in found.coils) + late:.1f}" for side in ("close_limit", "open_limit")),
        f"± {slow:.0f} %", "",
    )  # fmt: skip
    grid.add_section()
    grid.add_row(*(Text(limit, "dim") for limit in limits))
    return grid


def _format_milliseconds(time: float | None) -> str:
    return "never" if time is None else f"{abs(1e3 * time) if abs(time) < 5e-6 else 1e3 * time:.2f}"


def _print_verdict(shown: Console, found: Checkup) -> None:
    from rich.text import Text

    faults = found.faults
    shown.print()
    if not faults:
        what = "every device, sensor and coil" if found.coils else "every device and sensor"
        shown.print(Text.assemble(("passed", "bold green"), f": {what} is as the rig file says"))
        return
    count = "1 fault" if len(faults) == 1 else f"{len(faults)} faults"
    shown.print(Text.assemble(("failed", "bold red"), f": {count}"))
    for fault in faults:
        shown.print(Text(f"  {fault}"))


def _print_manual_checks(shown: Console, found: Checkup) -> None:
    from rich.table import Table
    from rich.text import Text

    title = Text("only a person can verify", "bold")
    if found.simulated:
        title.append(" (on a bench; this one is simulated)", "dim")
    shown.print()
    shown.print(title)
    boxes = Table.grid(padding=(0, 1))
    boxes.add_column(width=3, justify="right")
    boxes.add_column()
    for line in found.manual_checks:
        boxes.add_row("☐", Text(line))
    shown.print(boxes)
