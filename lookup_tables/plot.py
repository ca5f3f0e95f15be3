"""A figure of a table: the field of each coil in one horizontal plane."""

from __future__ import annotations

import os
from math import ceil

import numpy as np
import numpy.typing as npt

from lookup_tables.errors import TableError
from lookup_tables.table import FieldTable

FloatArray = npt.NDArray[np.float64]
ARROWS_PER_SIDE = 11  # along each side of the plane


def plot_table(table: FieldTable, path: str | os.PathLike[str], z: float | None = None, current: float = 1.0) -> None:
    """Draw |B| of each coil, with arrows for its horizontal direction, side by side on one colour scale.

    Parameters
    ----------
    table : FieldTable
        In the world frame.
    path : path
        The file to write; its suffix names the format, as matplotlib knows them.
    z : float, in m, optional
        Height of the plane; by default the middle of the table.
    current : float, in A
        Current through one coil at a time.

    Raises
    ------
    OutsideTableError
        If the table does not cover the plane.
    TableError
        If the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    low, high = table.bounds
    height = 0.5 * (low[2] + high[2]) if z is None else z
    x, y = (np.linspace(low[i], high[i], 121) for i in range(2))
    strength = 1e3 * current * np.linalg.norm(_evaluate_plane(table, x, y, height), axis=-1)
    margin = 0.07 * (high - low)
    ax, ay = (np.linspace(low[i] + margin[i], high[i] - margin[i], ARROWS_PER_SIDE) for i in range(2))
    arrows = current * _evaluate_plane(table, ax, ay, height)[..., :2]
    lengths = np.linalg.norm(arrows, axis=-1, keepdims=True)
    arrows = arrows / np.where(lengths > 0, lengths, 1.0)  # direction only: the colour shows the strength

    columns = table.n_coils if table.n_coils <= 3 else ceil(table.n_coils**0.5)
    rows = ceil(table.n_coils / columns)
    figure = Figure(figsize=(3.7 * columns + 1.4, 3.6 * rows + 0.9), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    levels = np.linspace(0.0, float(strength.max()) or 1.0, 256)
    for coil, panel in enumerate(panels.ravel()):
        if coil >= table.n_coils:
            panel.set_axis_off()
            continue
        shades = panel.pcolormesh(
            1e3 * x, 1e3 * y, strength[coil].T, cmap="viridis", vmin=0.0, vmax=levels[-1], shading="gouraud",
            rasterized=True,
        )  # fmt: skip
        panel.quiver(
            1e3 * ax, 1e3 * ay, arrows[coil, ..., 0].T, arrows[coil, ..., 1].T, color="white", pivot="mid",
            scale=19, width=0.0075, edgecolor="black", linewidth=0.5,
        )  # fmt: skip
        panel.set_aspect("equal")
        name = table.names[coil].replace("-", "\N{MINUS SIGN}").replace("$", r"\$")  # no formula
        panel.set_title(f"coil {name}", fontsize=13)
        if coil % columns == 0:
            panel.set_ylabel("y (mm)")
        if coil + columns >= table.n_coils:
            panel.set_xlabel("x (mm)")
    figure.colorbar(shades, ax=panels, label="|B| (mT)", aspect=30)
    figure.suptitle(f"Flux density at {current:g} A in one coil, z = {1e3 * height:.4g} mm", fontsize=14)
    try:
        figure.savefig(path, dpi=150)
    except (OSError, ValueError) as error:
        raise TableError(f"{os.fspath(path)}: the figure cannot be written ({error}).") from error


def _evaluate_plane(table: FieldTable, x: FloatArray, y: FloatArray, z: float) -> FloatArray:
    """Evaluate the field (n_coils, nx, ny, 3), in T per A, on a horizontal mesh."""
    points = np.stack(np.meshgrid(x, y, [z], indexing="ij"), axis=-1).reshape(-1, 3)
    return table.field(points).reshape(table.n_coils, len(x), len(y), 3)
