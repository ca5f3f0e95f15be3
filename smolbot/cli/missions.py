"""``run``, ``preview``, ``list`` and ``init``."""

from __future__ import annotations

import re
import shutil
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smolbot.cli.show import as_json, echo_json, table
from smolbot.errors import ConfigError, InputError

if TYPE_CHECKING:
    from smolbot.anymission import AnyMission
    from smolbot.flown import Listener, Run
    from smolbot.helixpreview import HelixPreview
    from smolbot.missionfile import Mission
    from smolbot.preview import Preview

MissionArgument = Annotated[
    str, typer.Argument(help="Shipped mission by name, or your own by path.", metavar="MISSION")
]
RigOption = Annotated[
    str | None, typer.Option("--rig", help="Rig to use instead of the mission's own, by name or path.")
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="key=value laid over the mission file; rig.key=value over the rig file; @FILE: all of a TOML file.",
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output.")]


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    for name, function in (("run", run), ("preview", preview), ("list", list_), ("init", init)):
        app.command(name)(function)


def settings_from(pairs: list[str] | None) -> dict[str, str]:
    """``key=value`` options as a dictionary; ``@gains.toml`` stands for all that the file holds.

    Raises
    ------
    InputError
        For an option without ``=``, or a file that cannot be read.
    """
    found: dict[str, str] = {}
    for pair in pairs or []:
        if pair.startswith("@"):
            found |= _settings_of(Path(pair[1:]))
            continue
        key, equals, value = pair.partition("=")
        if not equals or not key.strip():
            raise InputError(f"--set needs key=value, such as controller.tolerance_mm=0.5; got '{pair}'.")
        found[key.strip()] = value.strip()
    return found


def _settings_of(path: Path) -> dict[str, str]:
    """What a TOML file holds, as settings."""
    import json
    import tomllib

    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"--set @{path}: cannot be read as TOML: {error}.") from error
    found: dict[str, str] = {}

    def lay(prefix: str, values: dict[str, Any]) -> None:
        for key, value in values.items():
            if isinstance(value, dict):
                lay(f"{prefix}{key}.", value)
            else:
                found[f"{prefix}{key}"] = json.dumps(value, default=str)

    lay("", data)
    return found


def run(
    mission: MissionArgument,
    rig: RigOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same run, bit for bit.")] = 1,
    out: Annotated[Path | None, typer.Option(help="Run folder to make; default: a new one in runs/.")] = None,
    set_: SetOption = None,
    gui: Annotated[bool, typer.Option("--gui", help="Show the simulated world in a window.")] = False,
    live: Annotated[
        bool, typer.Option("--live", help="Show it on a console, from which it can be stopped too.")
    ] = False,
    report: Annotated[bool, typer.Option(help="Write report.html into the run folder at the end.")] = True,
    json: JsonOption = False,
) -> None:
    """Fly a mission, closed loop, or watch a device; leave a run folder with figures and picture."""
    from smolbot.anymission import load_mission
    from smolbot.cli.live import watched
    from smolbot.cli.progress import shown_progress
    from smolbot.flying import fly, new_folder
    from smolbot.keyboard import KEY, Keyboard
    from smolbot.latch import Latch
    from smolbot.operator import TerminalOperator
    from smolbot.records.folder import RunFolder
    from smolbot.signals import stop_signals

    settings = settings_from(set_)
    loaded = load_mission(mission, rig, settings)
    folder = RunFolder(out) if out is not None else new_folder(loaded, seed)
    latch, operator = Latch(), TerminalOperator()
    keyboard = Keyboard(partial(latch.shut, KEY, "stopped"))
    with stop_signals(latch), shown_progress(loaded) as progress, keyboard:
        operator.pauses += [progress.paused, keyboard.paused]
        if keyboard.active:
            operator.say("q, Esc or Ctrl-C stops the run")

        def listeners(_: AnyMission) -> tuple[Listener, ...]:
            return (progress,)

        with watched(loaded, seed, latch, operator.say) if live else nullcontext((None, None)) as (pause, pump):
            flown = fly(
                loaded, seed, folder=folder, settings=settings, gui=gui, listeners=listeners, operator=operator,
                latch=latch, report=report, pause=pause, live=pump,
            )  # fmt: skip
    _show_run(loaded, flown, json)
    raise typer.Exit(_exit_code(flown))


def _exit_code(run: Run) -> int:
    if run.status in ("stopped", "failed"):
        return 3
    return 0 if run.summary["verdict"] == "passed" else 1


def _show_run(mission: AnyMission, run: Run, json: bool) -> None:
    from smolbot.cli.observations import observation_rows
    from smolbot.records.summary import label_of

    s = run.summary
    rows = [
        ("status", f"{s['status']}: {s['stop_reason']}"),
        ("verdict", "; ".join([str(s["verdict"]), *_texts(s["verdict_reasons"])])),
        ("robot time" if "path_length_mm" in s else "time", f"{s['duration_s']:.1f} s, {s['cycles']} cycles"),
        ("loop rate", f"{s['loop_rate_hz']:.2f} Hz (timeline allows {s['timeline_limit_hz']:.2f} Hz)"),
        ("computing", _compute(s)),
    ]
    for key, label in (
        ("localization_error_mm", "localization error"),
        ("tracked_error_mm", "tracked pose error"),
        ("orientation_error_deg", "orientation error"),
        ("axis_error_deg", "axis error"),
        ("axis_error_tracked_deg", "axis error, tracked"),
        ("axis_to_path_deg", "axis against path"),
        ("tracking_error_mm", "tracking error"),
    ):
        if key in s:
            unit = key.rsplit("_", 1)[1]
            rows.append((label, ", ".join(f"{name} {value:.2f}" for name, value in s[key].items()) + f" {unit}"))  # type: ignore[attr-defined]
    rows += observation_rows(s)
    if s["r_squared_median"] is not None:
        rows.append(("R² (median)", f"{s['r_squared_median']:.4f}"))
    if "turns" in s:
        rows.append(("magnet", f"{s['turns']:g} turns, {s['pauses']} pauses, {s['step_outs']} step-outs"))
    elif "coil_energy_j" in s:
        rows.append(("coil energy", f"{s['coil_energy_j']:.0f} J"))
    if s.get("duty_peak"):
        rows.append(("coils", _coils(s)))
    if told := _recovered(s):
        rows.append(("recovered", told))
    if told := _not_recorded(s.get("recording", {})):
        rows.append(("not recorded", told))
    rows.append(("wall time", f"{s['wall_s']:.1f} s, {s['realtime_factor']:.0f} times real time"))
    rows.append(("picture", f"{run.folder}/path.png"))
    if run.report:
        rows.append(("report", run.report))
    table(f"{mission.name} on {mission.rig.name}{label_of(s)}", rows, err=json)
    if json:
        echo_json(s)


def _coils(summary: dict[str, Any]) -> str:
    """How long and how hot: of all coils, the one that came nearest to its limit from 20 °C."""
    duty: dict[str, float] = summary["duty_peak"]
    busiest = max(duty, key=lambda name: duty[name])
    told = f"driven for at most {100 * duty[busiest]:.0f} % of the time ({busiest})"
    peaks, limits = summary["coil_temperature_peak_c"], summary["coil_temperature_limit_c"]
    if not peaks:
        return told
    hottest = max(peaks, key=lambda name: (peaks[name] - 20.0) / (limits[name] - 20.0))
    return f"{told}, {peaks[hottest]:.0f} °C at most ({hottest}; limit {limits[hottest]:g} °C)"


def _recovered(summary: dict[str, Any]) -> str:
    return ", ".join(f"{kind.replace('_', ' ')}: {times}" for kind, times in summary["recovered"].items() if times)


def _not_recorded(recording: Any) -> str:
    """What the record lacks, and why; nothing where it lacks nothing.

    Examples
    --------
    >>> _not_recorded({"dropped": 3, "error": "OSError: the disk is full"})
    '3 messages: OSError: the disk is full'
    """
    dropped = recording.get("dropped")
    parts = [f"{dropped} messages" if dropped else "", str(recording.get("error") or "")]
    return ": ".join(part for part in parts if part)


def _texts(value: Any) -> list[str]:
    return [str(v) for v in value]


def _compute(summary: dict[str, Any]) -> str:
    times = summary["compute_ms"]
    if times["median"] is None:
        return "no cycle was played"
    return f"median {times['median']:.2f} ms, p99 {times['p99']:.2f} ms (turnaround {summary['turnaround_ms']:g} ms)"


def preview(mission: MissionArgument, rig: RigOption = None, set_: SetOption = None, json: JsonOption = False) -> None:
    """Time a mission on paper: a cycle's timeline, rate, duration, reach of force; go or no-go with reasons."""
    from smolbot.anymission import load_mission
    from smolbot.cli.observations import show_observation_preview
    from smolbot.observation_preview import preview_observation
    from smolbot.observationfile import Observation
    from smolbot.preview import preview as look

    try:
        loaded = load_mission(mission, rig, settings_from(set_))
    except ConfigError as error:
        if json:
            echo_json({"mission": mission, "go": False, "reasons": str(error).splitlines()})
        typer.echo("no-go", err=True)
        raise
    if isinstance(loaded, Observation):
        show_observation_preview(loaded, preview_observation(loaded), json)
    elif loaded.robot.kind == "helical":
        from smolbot.helixpreview import preview_helix

        _show_helix_preview(loaded, preview_helix(loaded), json)
    else:
        _show_preview(loaded, look(loaded), json)


def _show_preview(mission: Mission, seen: Preview, json: bool) -> None:
    import numpy as np

    reach, worst = seen.reach, int(np.argmax(seen.reach.direction_error))
    where = f"at ({reach.points[worst, 0] * 1e3:.1f}, {reach.points[worst, 1] * 1e3:.1f}) mm"
    error = seen.localization_error * 1e3
    rows = [
        ("a cycle", seen.shot.timeline(mission.rig.coil_names)),
        ("loop rate", f"{seen.rate:.2f} Hz (timeline allows {seen.rate_limit:.2f} Hz)"),
        ("path", _path(seen)),
        *[("", remark) for remark in seen.remarks],
        ("expected duration", f"{seen.duration:.0f} s" if seen.go else "does not end"),
        ("along the path", _pace(seen)),
        ("force along the path", f"{reach.force.min() * 1e6:.0f} to {reach.force.max() * 1e6:.0f} µN"),
        (
            "force direction error",
            f"median {np.degrees(np.median(reach.direction_error)):.0f}°, "
            f"worst {np.degrees(reach.direction_error[worst]):.0f}° {where}",
        ),
        ("localization error", f"{error.min():.2f} to {error.max():.2f} mm rms in the plane, each pose"),
        ("coil energy", f"{seen.coil_energy:.0f} J"),
        ("verdict", "go" if seen.go else "no-go: " + " ".join(seen.reasons)),
    ]
    table(f"preview of {mission.name} on {mission.rig.name}", rows, err=json)
    if json:
        echo_json(
            {
                "mission": mission.name,
                "rig": mission.rig.name,
                "go": seen.go,
                "reasons": seen.reasons,
                "cycle": str(seen.shot),
                "cycle_ms": seen.shot.duration * 1e3,
                "timeline_limit_hz": seen.rate_limit,
                "loop_rate_hz": seen.rate,
                "path_length_mm": seen.length * 1e3,
                "path_corners": seen.corners,
                "path_tightest_bend_mm": as_json(seen.tightest * 1e3),
                "path_remarks": list(seen.remarks),
                "path_time_s": as_json(seen.path_time),
                "path_time_wanted_s": seen.wanted_time,
                "expected_duration_s": as_json(seen.duration),
                "expected_cycles": seen.cycles,
                "force_un": {"min": reach.force.min() * 1e6, "max": reach.force.max() * 1e6},
                "force_direction_error_deg": {
                    "median": float(np.degrees(np.median(reach.direction_error))),
                    "max": float(np.degrees(reach.direction_error.max())),
                },
                "localization_error_mm": {"min": error.min(), "max": error.max()},
                "coil_energy_j": seen.coil_energy,
            }
        )
    raise typer.Exit(0 if seen.go else 1)


def _show_helix_preview(mission: Mission, seen: HelixPreview, json: bool) -> None:
    error, margin = seen.localization_error * 1e3, seen.torque_margin
    turns = ", ".join(f"{t:g}" for t in seen.turns)
    rows = [
        ("listening", seen.listening.timeline()),
        ("a maneuver", seen.maneuver.timeline()),
        ("turns before each pause", f"{turns}: {sum(seen.turns):g} in all, {len(seen.turns)} pauses"),
        ("path", f"{seen.length * 1e3:.1f} mm"),
        ("expected duration", f"{seen.duration:.0f} s" if seen.go else "does not end"),
        ("tightest bend", f"{seen.bend * 1e3:.1f} mm in the path, {seen.radius * 1e3:.1f} mm for this robot"),
        ("torque to spare", f"{margin.min():.2f} to {margin.max():.2f} times what the gel asks for"),
        ("localization error", f"{error.min():.3f} to {error.max():.3f} mm rms in the plane, each pose"),
        ("verdict", "go" if seen.go else "no-go: " + " ".join(seen.reasons)),
    ]
    table(f"preview of {mission.name} on {mission.rig.name}", rows, err=json)
    if json:
        echo_json(
            {
                "mission": mission.name,
                "rig": mission.rig.name,
                "go": seen.go,
                "reasons": seen.reasons,
                "listening": str(seen.listening),
                "maneuver": str(seen.maneuver),
                "turns": list(seen.turns),
                "pauses": len(seen.turns),
                "path_length_mm": seen.length * 1e3,
                "expected_duration_s": as_json(seen.duration),
                "bend_radius_mm": {"path": as_json(seen.bend * 1e3), "robot": as_json(seen.radius * 1e3)},
                "torque_margin": {"min": float(margin.min()), "max": float(margin.max())},
                "localization_error_mm": {"min": float(error.min()), "max": float(error.max())},
            }
        )
    raise typer.Exit(0 if seen.go else 1)


def _path(seen: Preview) -> str:
    import math

    corners = {0: "no corners", 1: "1 corner"}.get(seen.corners, f"{seen.corners} corners")
    bend = f"tightest bend {seen.tightest * 1e3:.1f} mm" if math.isfinite(seen.tightest) else "no bends"
    return f"{seen.length * 1e3:.1f} mm, {corners}, {bend}"


def _pace(seen: Preview) -> str:
    if not seen.go:
        return "does not end"
    got = f"{seen.path_time:.0f} s, {seen.length * 1e3 / seen.path_time:.2f} mm/s on average"
    if seen.wanted_time is None:
        return got
    wanted = f"{seen.wanted_time:.0f} s, {seen.length * 1e3 / seen.wanted_time:.2f} mm/s"
    late = seen.path_time > 1.1 * seen.wanted_time
    return f"{got}; wanted {wanted}{': more than the law can do' if late else ''}"


def list_(json: JsonOption = False) -> None:
    """List shipped missions, rigs and robots, and the installed controllers."""
    from smolbot.config import Document
    from smolbot.drawing.font import KNOWN
    from smolbot.library import KINDS, shipped
    from smolbot.plugins import names

    found = {
        kind: {name: str(Document.read(path).data.get("description", "")) for name, path in shipped(kind).items()}
        for kind in KINDS
    }
    for kind, entries in found.items():
        table(kind, list(entries.items()), err=json)
    laws = names("controllers")
    table("controllers", [(name, "") for name in laws], err=json)
    table("glyphs", [('glyph = "S"', KNOWN)], err=json)
    if json:
        echo_json({**found, "controllers": laws, "glyphs": KNOWN})


def init(
    folder: Annotated[Path, typer.Argument(help="Folder to make.", metavar="DIR")],
    mission: Annotated[str, typer.Option(help="Shipped mission to start from.")] = "r_small",
) -> None:
    """Copy a mission with its rig, robot and path file into a folder, to edit and fly as your own."""
    from smolbot.config import Document, Fault
    from smolbot.library import find_file

    source = find_file(mission, "missions")
    document = Document.read(source)
    data, beside = document.data, source.parent
    copies = {key: find_file(str(data.get(key)), f"{key}s", beside) for key in ("rig", "robot")}
    section = data.get("path", {})
    if "file" in section:
        copies["file"] = beside / str(section["file"])
        if not copies["file"].is_file():
            raise document.error([Fault(("path", "file"), f"{copies['file']}: no such file.")])
    files = {source.name: source, **{path.name: path for path in copies.values()}}
    existing = [name for name in files if (folder / name).exists()]
    if existing:
        raise InputError(f"{folder}: {', '.join(existing)} stand there already; nothing was written.")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, path in files.items():
            shutil.copyfile(path, folder / name)
        own = folder / source.name
        text = own.read_text(encoding="utf-8")
        for key, path in copies.items():
            given = re.escape(str(section["file"] if key == "file" else data[key]))
            text = re.sub(rf"""(?m)(\b{key}\s*=\s*)["']{given}["']""", rf'\g<1>"{path.name}"', text, count=1)
        own.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error}.") from error
    table(f"{folder}", [(name, "copied") for name in files])
    typer.echo(f"Edit them, then: smolbot preview {own}  and  smolbot run {own}")
