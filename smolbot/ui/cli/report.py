"""``report``: the page of a run, a comparison of several, a short animation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from smolbot.core.results import as_json
from smolbot.errors import InputError
from smolbot.ui.cli.options import JsonOption
from smolbot.ui.cli.show import echo_json, print_columns, print_table

RunsArgument = Annotated[
    list[Path], typer.Argument(help="Run folder, or its record; several are compared.", metavar="RUN …")
]
OutOption = Annotated[
    Path | None,
    typer.Option(help="Page to write; default: report.html in the run's folder, for several comparison.html here."),
]
ANIMATION_SECONDS, ANIMATION_RATE = 10.0, 12
AnimationOption = Annotated[
    Path | None,
    typer.Option("--animate", help="Animation to make of one run: .gif, or .mp4 where ffmpeg is."),
]
SecondsOption = Annotated[
    float | None, typer.Option(min=1.0, max=120.0, help=f"Length of the animation; default: {ANIMATION_SECONDS:g}.")
]
RateOption = Annotated[
    int | None, typer.Option(min=1, max=60, help=f"Its pictures a second; default: {ANIMATION_RATE}.")
]


def report(
    runs: RunsArgument,
    out: OutOption = None,
    animate: AnimationOption = None,
    seconds: SecondsOption = None,
    fps: RateOption = None,
    json: JsonOption = False,
) -> None:
    """Write the report of a run, or compare several: one page that needs no other file and no network."""
    if animate is None and (seconds is not None or fps is not None):
        raise InputError("--seconds and --fps are of an animation: name its file with --animate.")
    if len(runs) > 1:
        if animate is not None:
            raise InputError(f"--animate shows one run; got {len(runs)}.")
        _compare(runs, out, json)
    elif animate is not None:
        _animate(runs[0], animate, seconds or ANIMATION_SECONDS, fps or ANIMATION_RATE, json)
    else:
        _write_report(runs[0], out, json)


def _write_report(run: Path, out: Path | None, json: bool) -> None:
    from smolbot.runs.report.page import save_report
    from smolbot.runs.report.recorded_flight import RecordedFlight

    flight = RecordedFlight.read(run)
    path = save_report(flight, out)
    summary = flight.summary
    rows = [
        ("status", f"{summary['status']}: {summary['stop_reason']}"),
        ("verdict", "; ".join([summary["verdict"], *summary["verdict_reasons"]])),
        ("report", f"{path}, {path.stat().st_size / 1e6:.2f} MB"),
    ]
    if not flight.record.whole:
        rows.insert(0, ("record", "cut short: figures are of what is in it"))
    print_table(flight.title, rows, err=json)
    if json:
        echo_json({**summary, "report": str(path), "whole": flight.record.whole})


def _compare(runs: list[Path], out: Path | None, json: bool) -> None:
    from smolbot.runs.report.comparison import compare
    from smolbot.runs.report.comparison_page import format_estimate, write_comparison
    from smolbot.runs.report.figures_of_merit import get_unit

    found = compare(runs)
    path = write_comparison(found, out if out is not None else Path("comparison.html"))
    rows = [
        [one.name, *(format_estimate(estimate, get_unit(one.key)) for estimate in one.values)] for one in found.figures
    ]
    print_columns("Value (95 % interval)", ("", *found.labels), rows, err=json)
    typer.echo(f"page: {path}", err=json)
    if json:
        echo_json(as_json({**found.as_dict(), "page": str(path)}))


def _animate(run: Path, path: Path, seconds: float, fps: int, json: bool) -> None:
    from smolbot.runs.report.animation import make_animation

    made = make_animation(run, path, seconds, fps)
    text = f"{made.seconds:.1f} s at {made.fps} pictures a second, {made.speed:.1f} times real time"
    print_table(str(path), [("animation", text), ("size", f"{made.size / 1e6:.2f} MB")], err=json)
    if json:
        echo_json({"animation": str(path), **made.as_dict()})
