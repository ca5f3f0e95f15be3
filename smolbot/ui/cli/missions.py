"""``preview``, ``list`` and ``init``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smolbot.core.results import as_json
from smolbot.errors import ConfigError, InputError, report_write_errors
from smolbot.ui.cli.observations import make_cycle_figures, show_observation_preview, show_verdict
from smolbot.ui.cli.show import echo_json, print_table

if TYPE_CHECKING:
    from smolbot.config.mission import Mission
    from smolbot.flight.preview.gradient import Preview
    from smolbot.flight.preview.helix import HelixPreview
    from smolbot.motion.controller import ForceProfile

from smolbot.ui.cli.options import JsonOption, MissionArgument, RigOption, SetOption, parse_settings

BEGUN = "# A mission of your own. name and description are what reports call it.\n"
"""Comment line with which a mission of `init` begins, in place of the description of the shipped path."""

GROUPS = {
    "controllers": "controllers",
    "estimators": "estimators",
    "worlds": "rigs",
    "path readers": "path_readers",
    "sensor kinds": "sensors",
    "studies": "studies",
}
"""What `list` shows of all that is installed, ours and a lab's, and the group of its entry points."""


def register(app: typer.Typer) -> None:
    """Add the commands of this module.

    Parameters
    ----------
    app : typer.Typer
    """
    for name, function in (("preview", preview), ("list", list_), ("init", init)):
        app.command(name)(function)


def preview(mission: MissionArgument, rig: RigOption = None, set_: SetOption = None, json: JsonOption = False) -> None:
    """Predict a mission, nothing moves: timeline of a cycle, rate, duration, force; go or no-go with reasons."""
    from smolbot.config.load import load_mission
    from smolbot.config.mission import Mission
    from smolbot.flight.preview.helix import HelixPreview
    from smolbot.flight.preview.observation import ObservationPreview
    from smolbot.functions.preview import preview as look

    try:
        loaded = load_mission(mission, rig, parse_settings(set_))
    except ConfigError as error:
        if json:
            echo_json({"mission": mission, "go": False, "reasons": str(error).splitlines()})
        typer.echo("no-go", err=True)
        raise
    previewed = look(loaded)
    if isinstance(previewed, ObservationPreview):
        show_observation_preview(loaded, previewed, json)
        return
    assert isinstance(loaded, Mission)
    if isinstance(previewed, HelixPreview):
        _show_helix_preview(loaded, previewed, json)
    else:
        _show_preview(loaded, previewed, json)


def _show_preview(mission: Mission, found: Preview, json: bool) -> None:
    error, noise = found.localization_error * 1e3, found.noise_error * 1e3
    rows = [
        ("a cycle", found.shot.timeline(mission.rig.coil_names)),
        ("loop rate", f"{found.rate:.2f} Hz (timeline allows {found.rate_limit:.2f} Hz)"),
        ("path", _format_path(found)),
        *[("", remark) for remark in found.remarks],
        ("expected duration", _format_duration(found)),
        *([("along the path", _format_pace(found))] if found.path_time > 0.0 else []),
        *_force_rows(mission, found.force_profile),
        (
            "localization error",
            f"{error.min():.2f} to {error.max():.2f} mm rms in the plane, each pose; noise alone {noise.min():.2f} to "
            f"{noise.max():.2f} mm",
        ),
        ("", f"{found.mean_localization_error * 1e3:.2f} mm in space, mean over the path"),
        ("coil energy", f"{found.coil_energy:.0f} J"),
        *([("in drawn worlds", str(found.worlds))] if found.worlds is not None else []),
        *([("what would do", found.remedy)] if found.remedy else []),
    ]
    figures = {
        **make_cycle_figures(found),
        "path_length_mm": found.length * 1e3,
        "path_corners": found.corners,
        "path_tightest_bend_mm": as_json(found.tightest_radius * 1e3),
        "path_remarks": list(found.remarks),
        "path_time_s": as_json(found.path_time),
        "path_time_wanted_s": found.requested_time,
        "expected_duration_s": as_json(found.duration),
        "expected_cycles": found.cycles,
        **_force_figures(found.force_profile),
        "localization_error_mm": {"min": error.min(), "max": error.max()},
        "localization_noise_mm": {"min": noise.min(), "max": noise.max()},
        "mean_localization_error_mm": found.mean_localization_error * 1e3,
        "coil_energy_j": found.coil_energy,
        "drawn_worlds": None if found.worlds is None else {"flown": found.worlds.flown, "ended": found.worlds.ended},
        "remedy": found.remedy,
    }
    show_verdict(mission, found, rows, figures if json else None)


def _force_rows(mission: Mission, reach: ForceProfile | None) -> list[tuple[str, str]]:
    """Rows of the table on the law's force along the path."""
    import numpy as np

    if reach is None:
        return [("force along the path", f"not known: the law '{mission.law}' has no method reach(path)")]
    worst = int(np.argmax(reach.direction_error))
    x, y = reach.points[worst, :2] * 1e3
    middle, most = np.degrees([np.median(reach.direction_error), reach.direction_error[worst]])
    return [
        ("force along the path", f"{_format_force(reach.force.min())} to {_format_force(reach.force.max())} µN"),
        ("force direction error", f"median {middle:.0f}°, worst {most:.0f}° at ({x:.1f}, {y:.1f}) mm"),
    ]


def _format_force(force: float) -> str:
    """Format a force in N with three significant digits, in µN and never with a power of ten."""
    return f"{force * 1e6:.3g}" if force < 0.999e-3 else f"{force * 1e6:.0f}"


def _force_figures(reach: ForceProfile | None) -> dict[str, Any]:
    """Collect the same for ``--json``; null if the law does not provide it."""
    import numpy as np

    if reach is None:
        return {"force_un": None, "force_direction_error_deg": None}
    error = np.degrees(reach.direction_error)
    return {
        "force_un": {"min": reach.force.min() * 1e6, "max": reach.force.max() * 1e6},
        "force_direction_error_deg": {"median": float(np.median(error)), "max": float(error.max())},
    }


def _show_helix_preview(mission: Mission, found: HelixPreview, json: bool) -> None:
    error, noise, margin = found.localization_error * 1e3, found.noise_error * 1e3, found.torque_margin
    turns = ", ".join(f"{t:g}" for t in found.turns)
    unknown = f"not known for this robot: the law '{mission.law}' has no method tightest_bend()"
    radius = unknown if found.min_radius is None else f"{found.min_radius * 1e3:.1f} mm for this robot"
    rows = [
        ("listening", found.listening.timeline()),
        ("a maneuver", found.maneuver.timeline()),
        ("turns before each pause", f"{turns}: {sum(found.turns):g} in all, {len(found.turns)} pauses"),
        ("path", f"{found.length * 1e3:.1f} mm"),
        ("expected duration", f"{found.duration:.0f} s" if found.go else "does not end"),
        ("tightest bend", f"{found.tightest_radius * 1e3:.1f} mm in the path, {radius}"),
        ("torque to spare", f"{margin.min():.2f} to {margin.max():.2f} times what the gel asks for"),
        (
            "localization error",
            f"{error.min():.2f} to {error.max():.2f} mm rms in the plane, each pose; noise alone {noise.min():.3f} to "
            f"{noise.max():.3f} mm",
        ),
    ]
    figures = {
        "listening": str(found.listening),
        "maneuver": str(found.maneuver),
        "turns": list(found.turns),
        "pauses": len(found.turns),
        "path_length_mm": found.length * 1e3,
        "expected_duration_s": as_json(found.duration),
        "bend_radius_mm": {
            "path": as_json(found.tightest_radius * 1e3),
            "robot": None if found.min_radius is None else as_json(1e3 * found.min_radius),
        },
        "torque_margin": {"min": float(margin.min()), "max": float(margin.max())},
        "localization_error_mm": {"min": float(error.min()), "max": float(error.max())},
        "localization_noise_mm": {"min": float(noise.min()), "max": float(noise.max())},
    }
    show_verdict(mission, found, rows, figures if json else None)


def _format_path(found: Preview) -> str:
    import math

    corners = {0: "no corners", 1: "1 corner"}.get(found.corners, f"{found.corners} corners")
    bend = f"tightest bend {found.tightest_radius * 1e3:.1f} mm" if math.isfinite(found.tightest_radius) else "no bends"
    return f"{found.length * 1e3:.1f} mm, {corners}, {bend}"


def _format_duration(found: Preview) -> str:
    import numpy as np

    if not np.isfinite(found.duration):
        return "does not end"
    if found.worlds is None:
        return f"{found.duration:.0f} s"
    shortest, longest = np.nanmin(found.worlds.durations), np.nanmax(found.worlds.durations)
    return f"{found.duration:.0f} s ({shortest:.0f} to {longest:.0f} s in drawn worlds)"


def _format_pace(found: Preview) -> str:
    got = f"{found.path_time:.0f} s, {found.length * 1e3 / found.path_time:.2f} mm/s on average"
    if found.requested_time is None:
        return got
    requested = f"{found.requested_time:.0f} s, {found.length * 1e3 / found.requested_time:.2f} mm/s"
    late = found.path_time > 1.1 * found.requested_time
    return f"{got}; wanted {requested}{': more than the law can do' if late else ''}"


def list_(json: JsonOption = False) -> None:
    """List shipped missions, rigs and robots, and what is installed: controllers, worlds, readers, studies."""
    from smolbot.config.library import KINDS, list_shipped, open_file
    from smolbot.config.plugins import list_plugins
    from smolbot.paths.drawing.font import KNOWN_CHARACTERS

    found = {
        kind: {name: str(open_file(name, kind).data.get("description", "")) for name in list_shipped(kind)}
        for kind in KINDS
    }
    for kind, entries in found.items():
        print_table(kind, list(entries.items()), err=json)
    installed = {title: list_plugins(group) for title, group in GROUPS.items()}
    print_table("controllers", [(name, "") for name in installed["controllers"]], err=json)
    others = [(title, ", ".join(of_it)) for title, of_it in installed.items() if title != "controllers"]
    print_table("other parts", others, err=json)
    print_table("glyphs", [('glyph = "S"', KNOWN_CHARACTERS)], err=json)
    if json:
        echo_json(
            {
                **found,
                **{title.replace(" ", "_"): of_it for title, of_it in installed.items()},
                "glyphs": KNOWN_CHARACTERS,
            }
        )


def init(
    folder: Annotated[Path, typer.Argument(help="Folder to make.", metavar="DIR")],
    mission: Annotated[str, typer.Option(help="Shipped mission to start from.")] = "r_small",
) -> None:
    """Copy a mission with its rig, robot and path file into a folder, to edit and fly as your own."""
    from smolbot.config.document import Fault
    from smolbot.config.library import open_file
    from smolbot.config.toml_layers import set_values

    document = open_file(mission, "missions")
    own = folder / document.path.name
    files: dict[str, bytes] = {}
    values: dict[tuple[str, ...], str] = {
        ("name",): folder.absolute().name,
        ("description",): f"{folder.absolute().name}, begun as {document.data.get('name', own.stem)}",
    }
    for key in ("rig", "robot"):
        part = open_file(str(document.data.get(key)), f"{key}s", document.folder((key,)))
        files[part.path.name] = part.text.encode()
        values[key,] = part.path.name
    if "file" in document.data.get("path", {}):
        drawing = document.folder(("path", "file")) / str(document.data["path"]["file"])
        if not drawing.is_file():
            raise document.error([Fault(("path", "file"), f"{drawing}: no such file.")])
        files[drawing.name] = drawing.read_bytes()
        values["path", "file"] = drawing.name
    files = {own.name: set_values(document.text, values, begin=BEGUN).encode(), **files}
    existing = [name for name in files if (folder / name).exists()]
    if existing:
        raise InputError(f"{folder}: {', '.join(existing)} stand there already; nothing was written.")
    with report_write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            (folder / name).write_bytes(content)
    print_table(f"{folder}", [(name, "copied") for name in files])
    typer.echo(f"Edit them, then: smolbot preview {own}  and  smolbot run {own}")
