"""Writer of COMSOL's text exports, for tables that COMSOL or another program will read."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from lookup_tables.errors import TableError
from lookup_tables.samples import Samples

LAYOUTS = ("spreadsheet", "grid")


def write_comsol(samples: Samples, path: Path, layout: str) -> None:
    """Write the samples at 1 A in mm and mT; the coils' names are written where COMSOL puts those of a sweep.

    Parameters
    ----------
    samples : Samples
    path : Path
    layout : {"spreadsheet", "grid"}

    Raises
    ------
    TableError
        For an unknown layout, or a coil's name with parentheses, which the header cannot hold.
    """
    if layout not in LAYOUTS:
        raise TableError(f"{path}: unknown layout {layout!r}; known layouts: {', '.join(LAYOUTS)}.")
    for name in samples.names:
        if set(name) & set("()%@\r\n") or name != " ".join(name.split()):
            raise TableError(f"{path}: the text format cannot hold a coil named {name!r}: no ( ) % @ or line breaks.")
    titles = [
        f"mf.B{letter} (mT) @ {coil}: coil={name}" for coil, name in enumerate(samples.names, 1) for letter in "xyz"
    ]
    axes = [axis * 1e3 for axis in (samples.x, samples.y, samples.z)]
    head = [
        "% Model:              lookup_tables",
        "% Version:            smolbot",
        "% Dimension:          3",
        f"% Nodes:              {len(axes[0]) * len(axes[1]) * len(axes[2])}",
        f"% Expressions:        {len(titles)}",
        "% Description:        Magnetic flux density at 1 A, three components for each coil",
        "% Length unit:        mm",
    ]
    columns = np.moveaxis(samples.field * 1e3, 4, 1).reshape(len(titles), *samples.field.shape[1:4])
    columns = columns.transpose(0, 3, 2, 1)  # x runs fastest in both layouts
    out = io.StringIO()
    if layout == "spreadsheet":
        z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
        rows = np.column_stack([x.ravel(), y.ravel(), z.ravel(), columns.reshape(len(titles), -1).T])
        out.write("\n".join([*head, "% x  y  z  " + "  ".join(titles)]) + "\n")
        out.writelines(" ".join(map(repr, row)) + "\n" for row in rows.tolist())
    else:
        out.write("\n".join([*head, "% Grid"]) + "\n")
        out.writelines(" ".join(map(repr, axis.tolist())) + "\n" for axis in axes)
        for title, block in zip(titles, columns, strict=True):
            out.write(f"% Data ({title})\n")
            out.writelines(" ".join(map(repr, row)) + "\n" for row in block.reshape(-1, block.shape[2]).tolist())
    path.write_text(out.getvalue(), encoding="utf-8")
