"""``smolbot replay``: locates again in the recordings of a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smolbot.errors import InputError
from smolbot.ui.cli.options import JsonOption

if TYPE_CHECKING:
    from smolbot.flight.replay import Replay

FIGURE_SUFFIXES = (".png", ".svg", ".pdf")


def replay(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder, or its run.mcap.", show_default=False)],
    estimator: Annotated[
        str | None, typer.Option("--estimator", help="Locate with this one: whitened, paper or a lab's own.")
    ] = None,
    half_periods: Annotated[
        int | None, typer.Option("--half-periods", help="Use only so many half-periods of each window.")
    ] = None,
    device: Annotated[
        Path | None, typer.Option("--device", help="Believe in this device file, from smolbot calibrate.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Figure to write; default: replay.png in the run folder.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Locate again in the recordings of a run: the same poses bit for bit, or those of other settings, compared."""
    from smolbot.config.plugins import list_plugins
    from smolbot.flight.replay import compute_figures, compute_pose_differences
    from smolbot.flight.replay import replay as play
    from smolbot.runs.pictures.replayed_run import draw_replay

    if estimator is not None and estimator not in list_plugins("estimators"):
        raise InputError(f"--estimator must be one of {', '.join(list_plugins('estimators'))}; got '{estimator}'.")
    if out is not None and out.suffix.lower() not in FIGURE_SUFFIXES:
        raise InputError(f"--out {out}: a figure is one of {', '.join(FIGURE_SUFFIXES)}; got '{out.suffix}'.")
    if out is not None and not out.absolute().parent.is_dir():
        raise InputError(f"--out {out}: there is no folder {out.parent}.")
    played = play(run, estimator=estimator, half_periods=half_periods, device=device)
    difference = played.first_difference()
    found: dict[str, Any] = {
        "run": str(played.record.folder),
        "changed": played.changed,
        "whole": played.record.whole,
        "cycles": len(played.cycles),
        "identical": difference is None,
        "first_difference": difference,
        "apart": compute_pose_differences(played),
        **compute_figures(played),
    }
    if played.changed:
        picture = out or played.record.folder / "replay.png"
        changes = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in played.changed.items())
        moments = played.moments
        draw_replay(picture, played.mission.path, played.record.moments[: len(moments)], moments, changes)
        found["figure"] = str(picture)
    _show(played, found, json=json)
    if not played.changed and difference is not None:
        raise typer.Exit(1)


def _show(played: Replay, found: dict[str, Any], *, json: bool) -> None:
    from smolbot.ui.cli.show import echo_json, print_columns

    if json:
        echo_json(found)
        return
    same = found["identical"]
    lines = ["every pose is the same, bit for bit" if same else f"first difference: {found['first_difference']}"]
    if not played.record.whole:
        lines.append("the record was cut short; what is in it was replayed")
    if played.stop_reason:
        lines.append(f"the replay ended early: {played.stop_reason}")
    title = f"{played.mission.name}: {found['cycles']} cycles replayed"
    rows = [
        (label, _format_figure(found["recorded"], *keys), _format_figure(found["replayed"], *keys))
        for label, keys in _ROWS
    ]
    print_columns(title, ("", "recorded", "replayed"), [row for row in rows if row[1] or row[2]])
    for line in lines:
        typer.echo(line)
    far = found["apart"]
    if played.changed and far:
        typer.echo(
            f"replayed to recorded poses: {far['distance_mm']['mean']:.3f} mm, {far['angle_deg']['mean']:.2f} deg on "
            f"average, {far['distance_mm']['p95']:.3f} mm, {far['angle_deg']['p95']:.2f} deg at the 95th percentile"
        )
    if "figure" in found:
        typer.echo(f"figure: {found['figure']}")


_ROWS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("windows recorded", ("windows",)),
    ("poses trusted", ("poses_trusted",)),
    ("R² (median)", ("r_squared_median",)),
    ("sigma per axis (median, mm)", ("sigma_mm_median",)),
    ("localization error (mean, mm)", ("localization_error_mm", "mean")),
    ("                   (p95, mm)", ("localization_error_mm", "p95")),
    ("tracked error (mean, mm)", ("tracked_error_mm", "mean")),
    ("orientation error (mean, deg)", ("orientation_error_deg", "mean")),
    ("                  (p95, deg)", ("orientation_error_deg", "p95")),
    ("180° orientation flips", ("flips",)),
    ("share of the path visited", ("visited_share",)),
)


def _format_figure(figures: dict[str, Any], *keys: str) -> str:
    value: Any = figures
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    if value is None:
        return ""
    return str(value) if isinstance(value, int) else f"{value:.4f}"
