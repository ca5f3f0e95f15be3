"""``preview``, ``list`` and ``init``."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from smolbot.core.results import as_json
from smolbot.errors import ConfigError, InputError, writing
from smolbot.ui.cli.observations import cycle_figures, show_observation_preview, show_verdict
from smolbot.ui.cli.show import echo_json, table

if TYPE_CHECKING:
    from smolbot.config.load import AnyMission
    from smolbot.flight.preview.gradient import Preview
    from smolbot.flight.preview.helix import HelixPreview

from smolbot.ui.cli.options import JsonOption, MissionArgument, RigOption, SetOption, settings_from


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    for name, function in (("preview", preview), ("list", list_), ("init", init)):
        app.command(name)(function)


def preview(mission: MissionArgument, rig: RigOption = None, set_: SetOption = None, json: JsonOption = False) -> None:
    """Time a mission on paper: a cycle's timeline, rate, duration, reach of force; go or no-go with reasons."""
    from smolbot.config.load import load_mission
    from smolbot.flight.preview.helix import HelixPreview
    from smolbot.flight.preview.observation import ObservationPreview
    from smolbot.functions.preview import preview as look

    try:
        loaded = load_mission(mission, rig, settings_from(set_))
    except ConfigError as error:
        if json:
            echo_json({"mission": mission, "go": False, "reasons": str(error).splitlines()})
        typer.echo("no-go", err=True)
        raise
    seen = look(loaded)
    if isinstance(seen, ObservationPreview):
        show_observation_preview(loaded, seen, json)
    elif isinstance(seen, HelixPreview):
        _show_helix_preview(loaded, seen, json)
    else:
        _show_preview(loaded, seen, json)


def _show_preview(mission: AnyMission, seen: Preview, json: bool) -> None:
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
    ]
    figures = {
        **cycle_figures(seen),
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
    show_verdict(mission, seen, rows, figures if json else None)


def _show_helix_preview(mission: AnyMission, seen: HelixPreview, json: bool) -> None:
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
    ]
    figures = {
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
    show_verdict(mission, seen, rows, figures if json else None)


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
    from smolbot.config.document import Document
    from smolbot.config.library import KINDS, shipped
    from smolbot.config.plugins import names
    from smolbot.paths.drawing.font import KNOWN

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
    from smolbot.config.document import Document, Fault
    from smolbot.config.library import find_file

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
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for name, path in files.items():
            shutil.copyfile(path, folder / name)
        own = folder / source.name
        text = own.read_text(encoding="utf-8")
        for key, path in copies.items():
            given = re.escape(str(section["file"] if key == "file" else data[key]))
            text = re.sub(rf"""(?m)(\b{key}\s*=\s*)["']{given}["']""", rf'\g<1>"{path.name}"', text, count=1)
        own.write_text(text, encoding="utf-8")
    table(f"{folder}", [(name, "copied") for name in files])
    typer.echo(f"Edit them, then: smolbot preview {own}  and  smolbot run {own}")
