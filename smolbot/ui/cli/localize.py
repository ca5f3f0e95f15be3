"""``smolbot localize``: poses from a lab's own samples."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from smolbot.core.text_table import write_table
from smolbot.errors import InputError, report_write_errors
from smolbot.ui.cli.options import DeviceOption, JsonOption, RobotOption

Row = dict[str, Any]


def localize(
    samples: Annotated[Path, typer.Argument(help="Samples in V: .npz, .mat, .h5 or .csv.", metavar="SAMPLES")],
    rig: Annotated[str, typer.Option("--rig", help="Rig whose sensors recorded them, by name or path.")],
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
    from smolbot.functions.localize import localize as find_poses

    if out is not None and out.suffix.lower() not in (".csv", ".json"):
        raise InputError(f"--out writes .csv or .json; got '{out}'.")
    found = find_poses(
        samples, rig, robot=robot, device=device, half_periods=half_periods, superfast=superfast, estimator=estimator,
        quiet=quiet,
    )  # fmt: skip
    head = {key: getattr(found, key) for key in ("rig", "robot", "device", "quiet", "estimator", "shots")}
    head = {"samples": str(samples), **head, "sample_rate_hz": found.sample_rate, "trusted": found.trusted}
    rows = [pose.row() for pose in found.poses]
    if out is not None:
        _write(out, head, rows)
    _show(head, rows, out, json)
    raise typer.Exit(0 if found.trusted else 1)


def _write(out: Path, head: dict[str, Any], rows: list[Row]) -> None:
    from smolbot.core.results import format_json

    with report_write_errors(out):
        if out.suffix.lower() == ".json":
            out.write_text(format_json({**head, "poses": rows}), encoding="utf-8")
            return
        cells = (["" if isinstance(v, float) and math.isnan(v) else v for v in row.values()] for row in rows)
        write_table(out, list(rows[0]), cells)


def _show(head: dict[str, Any], rows: list[Row], out: Path | None, json: bool) -> None:
    from rich.table import Table

    from smolbot.ui.cli.show import echo_json, make_console, print_table

    facts = [(key.replace("_", " "), str(value)) for key, value in head.items() if value is not None]
    if out is not None:
        facts.append(("written", str(out)))
    print_table("localize", facts, err=json)
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
    make_console(err=json, width=160).print(shown)
    if json:
        echo_json({**head, "poses": rows})
