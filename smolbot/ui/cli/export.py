"""``smolbot export``: a recorded run for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from smolbot.ui.cli.options import JsonOption


def export(
    run: Annotated[Path, typer.Argument(help="Run folder, or the record in it.", metavar="RUN")],
    kind: Annotated[str, typer.Option("--format", help="h5 (HDF5), mat (MATLAB) or csv (a folder of tables).")],
    out: Annotated[
        Path | None, typer.Option("--out", help="File or folder to write; default: beside the record.")
    ] = None,
    shots: Annotated[
        str | None,
        typer.Option(help="Only the samples of these shots (12,20-40), in V, as smolbot localize reads them."),
    ] = None,
    samples: Annotated[bool, typer.Option("--samples/--no-samples", help="Whether to write raw samples.")] = True,
    force: Annotated[bool, typer.Option("--force", help="Write over what stands there.")] = False,
    json: JsonOption = False,
) -> None:
    """Write a run's cycles, poses, commands, currents, events and raw samples as HDF5, MATLAB or CSV."""
    from smolbot.runs.recording.exporting import export_run as write
    from smolbot.runs.recording.reader import read_run
    from smolbot.runs.recording.sample_export import export_samples, parse_shots
    from smolbot.ui.cli.show import echo_json, print_table

    found = read_run(run)
    stem = "run" if shots is None else "samples"
    target = (
        out
        if out is not None
        else found.folder / (f"{stem}_csv" if (kind, shots) == ("csv", None) else f"{stem}.{kind}")
    )
    if shots is not None:
        export_samples(found, kind, target, parse_shots(shots), force=force)
    else:
        write(found, kind, target, force=force, with_samples=samples)
    size = sum(p.stat().st_size for p in ([target] if target.is_file() else target.rglob("*")))
    contents = f"{len(found.moments)} cycles, {len(found.played)} shots, {len(found.events)} events"
    rows = [("run", contents if shots is None else f"shots {shots}"), ("written", f"{target}, {size / 1e6:.1f} MB")]
    if not found.whole:
        rows.append(("not whole", "the record is torn or damaged: this is what can be read. See smolbot recover."))
    print_table(f"export {run}", rows, err=json)
    if json:
        echo_json({"run": str(found.path), "format": kind, "out": str(target), "bytes": size, "whole": found.whole})
