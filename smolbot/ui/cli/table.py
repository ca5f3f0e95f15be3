"""`smolbot table`: builds, describes, converts and draws field tables."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from lookup_tables.table import FieldTable

app = typer.Typer(name="table", help="Field tables: build, look at, convert and draw them.", no_args_is_help=True)

Out = Annotated[Path, typer.Option("--out", help="File to write: .npz, or any other suffix for COMSOL's text.")]
Layout = Annotated[str, typer.Option(help="Layout of COMSOL's text: spreadsheet or grid.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of a table.")]


@app.command("build")
def build_command(
    rig: Annotated[str, typer.Argument(help="Rig: a name of ours, or a file.")],
    out: Out,
    layout: Layout = "spreadsheet",
    as_json: Json = False,
) -> None:
    """Compute the field table of a rig's coils from its rig file, and write it."""
    with _exit_on_bad_input():
        table = _load(rig, is_rig=True)
        table.write(out, layout)
        _print_summary(table, {"source": rig, "out": str(out)}, as_json)


@app.command("info")
def info_command(
    file: Annotated[str, typer.Argument(help="Table: COMSOL's text, or .npz.")],
    as_json: Json = False,
) -> None:
    """Print the coils, mesh, field strengths and accuracy of a table."""
    with _exit_on_bad_input():
        _print_summary(_load(file, is_rig=False), {"source": file}, as_json)


@app.command("import")
def import_command(
    file: Annotated[str, typer.Argument(help="Table: COMSOL's text, or .npz.")],
    out: Out,
    current: Annotated[float, typer.Option("--current", help="Current of each coil in the export, in A.")] = 1.0,
    origin_mm: Annotated[str, typer.Option(help="The file's origin in the world frame: x,y,z in mm.")] = "0,0,0",
    names: Annotated[str, typer.Option(help="Names of the coils, with commas between; else the file's.")] = "",
    layout: Layout = "spreadsheet",
    as_json: Json = False,
) -> None:
    """Check an export, convert it to the world frame and to 1 A, and write it."""
    with _exit_on_bad_input():
        from lookup_tables import FieldTable

        origin = _parse_millimetres(origin_mm)
        chosen = [name.strip() for name in names.split(",")] if names else None
        table = FieldTable.read(file, current=current, names=chosen, origin=origin)
        table.write(out, layout)
        _print_summary(table, {"source": file, "out": str(out)}, as_json)


@app.command("plot")
def plot_command(
    source: Annotated[str, typer.Argument(metavar="FILE|RIG", help="A table (COMSOL's text or .npz) or a rig.")],
    out: Annotated[Path, typer.Option("--out", help="Figure to write: .png, .pdf or .svg.")],
    z_mm: Annotated[float | None, typer.Option("--z-mm", help="Height of the plane; else the table's middle.")] = None,
    current: Annotated[float, typer.Option("--current", help="Current through one coil at a time, in A.")] = 1.0,
    as_json: Json = False,
) -> None:
    """Draw the field of each coil in a horizontal plane."""
    with _exit_on_bad_input():
        from lookup_tables.plot import plot_table

        table = _load(source, is_rig=Path(source).suffix in ("", ".toml"))
        plot_table(table, out, None if z_mm is None else 1e-3 * z_mm, current)
        if as_json:
            typer.echo(json.dumps({"source": source, "out": str(out)}))
        else:
            typer.echo(f"Wrote {out}")


@contextmanager
def _exit_on_bad_input() -> Iterator[None]:
    """Print the message of one of our errors and exit with code 2."""
    from lookup_tables.errors import OutsideTableError, TableError
    from smolbot.errors import SmolbotError

    try:
        yield
    except (TableError, OutsideTableError, SmolbotError) as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(2) from error


def _load(source: str, *, is_rig: bool) -> FieldTable:
    if is_rig:
        from smolbot.config.rig import load_rig

        return load_rig(source).table()
    from lookup_tables import FieldTable

    return FieldTable.read(source)


def _parse_millimetres(text: str) -> tuple[float, float, float]:
    """Parse three comma-separated numbers in mm; return them in m."""
    from lookup_tables import TableError

    try:
        x, y, z = (1e-3 * float(word) for word in text.split(","))
    except ValueError as error:
        raise TableError(f"--origin-mm must be three numbers with commas between, as 0,0,60; got {text!r}.") from error
    return x, y, z


def make_summary(table: FieldTable) -> dict[str, Any]:
    """Build the JSON output of ``smolbot table info``.

    ``curl_residual`` is the largest part of the samples that no field without curl can have, relative to the coil's
    largest field; ``divergence_residual`` the largest ``|div B|`` between the nodes, relative to the largest
    gradient.

    Parameters
    ----------
    table : FieldTable

    Returns
    -------
    dict
    """
    import numpy as np

    axes = (table.x, table.y, table.z)
    low, high = table.bounds
    inner = [np.linspace(a[0], a[-1], min(2 * len(a), 24) + 1)[1::2] if len(a) > 1 else a for a in axes]
    points = np.stack(np.meshgrid(*inner, indexing="ij"), axis=-1).reshape(-1, 3)
    gradient = table.gradient(points)
    divergence = np.abs(np.trace(gradient, axis1=2, axis2=3)).max(axis=1)
    steepest = np.linalg.norm(gradient, axis=(2, 3)).max(axis=1)
    center = np.linalg.norm(table.field(0.5 * (low + high)[None, :])[:, 0], axis=1)
    largest = np.linalg.norm(table.samples, axis=-1).reshape(table.n_coils, -1).max(axis=1)
    coils = [
        {
            "name": name,
            "center_mt_per_a": 1e3 * float(center[i]),
            "max_mt_per_a": 1e3 * float(largest[i]),
            "curl_residual": float(table.residual[i]),
            "divergence_residual": float(divergence[i] / steepest[i]) if steepest[i] else 0.0,
        }
        for i, name in enumerate(table.names)
    ]
    mesh = {
        name: {
            "low_mm": round(1e3 * float(axis[0]), 9),
            "high_mm": round(1e3 * float(axis[-1]), 9),
            "nodes": len(axis),
            "step_mm": round(1e3 * float(axis[-1] - axis[0]) / (len(axis) - 1), 9) if len(axis) > 1 else None,
        }
        for name, axis in zip("xyz", axes, strict=True)
    }
    return {"n_coils": table.n_coils, "mesh": mesh, "coils": coils}


def _print_summary(table: FieldTable, head: dict[str, str], as_json: bool) -> None:
    found = make_summary(table)
    if as_json:
        typer.echo(json.dumps({**head, **found}))
        return
    from rich.console import Console
    from rich.table import Table

    mesh = "; ".join(
        f"{name} {a['low_mm']:g} to {a['high_mm']:g} mm" + (f" in steps of {a['step_mm']:g}" if a["step_mm"] else "")
        for name, a in found["mesh"].items()
    )
    nodes = " x ".join(str(a["nodes"]) for a in found["mesh"].values())
    grid = Table(title=head["source"], caption=f"{nodes} nodes: {mesh}", caption_justify="left")
    grid.add_column("coil")
    for title in ("|B| at the middle\n(mT per A)", "largest |B|\n(mT per A)", "curl\nresidual", "divergence\nresidual"):
        grid.add_column(title, justify="right")
    for coil in found["coils"]:
        strengths = (f"{coil[key]:.4f}" for key in ("center_mt_per_a", "max_mt_per_a"))
        residuals = (f"{coil[key]:.1e}" for key in ("curl_residual", "divergence_residual"))
        grid.add_row(coil["name"], *strengths, *residuals)
    console = Console()
    console.print(grid)
    if "out" in head:
        console.print(f"Wrote {head['out']}", highlight=False)
