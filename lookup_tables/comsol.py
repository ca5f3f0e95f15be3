"""Reader of COMSOL's text exports of the flux density, in the spreadsheet and in the grid layout.

Spreadsheet: one row for each node, ``x y z`` and then the expressions, which the last ``%`` line names. Grid: after
``% Grid`` one line of values for each axis; then for each expression a ``% Data`` line, which names it (or the line
after it does), and rows of values along x, y growing from row to row and then z. Both as in COMSOL's reference
manual, "Spreadsheet Data Format" and "Grid Data Format".
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from lookup_tables.comsol_faults import Faults, find_axis, find_row_faults, parse_numbers
from lookup_tables.comsol_header import Expression, Header, arrange_expressions, parse_expressions, parse_header
from lookup_tables.errors import TableError
from lookup_tables.samples import FloatArray, Samples


def read_comsol(path: Path) -> Samples:
    """Read a COMSOL export.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Samples

    Raises
    ------
    TableError
        With one ``file:line: fault`` for the first fault of each kind, and how many more of it there are.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise TableError(f"{path}: the file cannot be read ({error.strerror or error}).") from error
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")  # as COMSOL writes on Windows; differs only in a µ
    lines = text.splitlines()
    if not text.strip():
        raise TableError(f"{path}: the file is empty; a COMSOL export has a header and at least 2 x 2 nodes.")
    header = parse_header(lines, str(path))
    grid = [i for i, line in enumerate(lines) if line.startswith("%") and line[1:].strip().lower() == "grid"]
    if grid:
        axes, values, expressions, place = _read_grid(lines, grid[0], str(path))
    else:
        axes, values, expressions, place = _read_spreadsheet(lines, header, str(path))
    order, names = arrange_expressions(expressions, place)
    nx, ny, nz = (len(axis) for axis in axes)
    if min(nx, ny) < 2:
        raise TableError(f"{path}: the mesh has {nx} x {ny} x {nz} nodes; a table needs at least 2 along x and y.")
    if header.nodes is not None and header.nodes != nx * ny * nz:
        raise TableError(f"{path}: the header says {header.nodes} nodes; the file has {nx * ny * nz}.")
    field = np.empty((len(names), nx, ny, nz, 3))
    for (coil, component), expression, value in zip(order, expressions, values, strict=True):
        field[coil, ..., component] = value * expression.scale
    x, y, z = (axis * header.length_scale for axis in axes)
    return Samples(x, y, z, field, names)


_Parts = tuple[list[FloatArray], FloatArray, list[Expression], str]


def _read_spreadsheet(lines: list[str], header: Header, path: str) -> _Parts:
    """Read axes in the file's unit, values (n_expressions, nx, ny, nz), expressions, and their line."""
    place = f"{path}:{header.last_number}"
    words = header.last_line[1:].replace(",", " ").replace(";", " ").split(maxsplit=3)
    if [word.lower() for word in words[:3]] != ["x", "y", "z"]:
        raise TableError(
            f"{place}: the last line of the header must name the columns, as in '% x  y  z  mf.Bx (mT)  mf.By (mT)  "
            f"mf.Bz (mT)'; got {header.last_line.strip()!r}."
        )
    expressions = parse_expressions(words[3] if len(words) > 3 else "", place)
    arrange_expressions(expressions, place)
    width = 3 + len(expressions)
    body = "\n".join(lines[header.last_number :]).replace(";", " ").replace(",", " ")
    try:
        rows = np.loadtxt(io.StringIO(body), comments="%", ndmin=2) if body.strip() else np.empty((0, width))
    except ValueError:
        rows = np.empty((0, 0))
    if rows.shape[1] != width or not np.isfinite(rows).all() or not len(rows):
        raise find_row_faults(lines, header.last_number, expressions, path)
    faults = Faults(path)
    axes, index = [], []
    for column, name in enumerate("xyz"):
        axis, places = find_axis(rows[:, column], name, faults)
        axes.append(axis)
        index.append(places)
    faults.raise_any()
    shape = tuple(len(axis) for axis in axes)
    nodes = np.ravel_multi_index(tuple(index), shape)
    counts = np.bincount(nodes, minlength=int(np.prod(shape)))
    if header.nodes is not None and header.nodes != len(rows):
        faults.add("count", None, f"the header says {header.nodes} nodes; the file has {len(rows)} rows")
    faults.report_nodes(axes, nodes, counts, lines, header.last_number)
    faults.raise_any()
    values = np.empty((len(expressions), nodes.size))
    values[:, nodes] = rows[:, 3:].T
    return axes, values.reshape(-1, *shape), expressions, place


def _read_grid(lines: list[str], start: int, path: str) -> _Parts:
    """Read the same as `_read_spreadsheet`; `start` is the index of the ``% Grid`` line."""
    faults, at = Faults(path), start + 1
    axes: list[FloatArray] = []
    for name in "xyz":
        values = parse_numbers(lines[at]) if at < len(lines) and not lines[at].startswith("%") else None
        if values is None or not len(values):
            got = repr(lines[at][:40]) if at < len(lines) else "the end of the file"
            raise TableError(f"{path}:{at + 1}: after '% Grid' come the values of x, of y and of z, a line each; "
                             f"the line of {name} is {got}.")  # fmt: skip
        axis, places = find_axis(values, name, faults, at + 1)
        if len(axis) == len(values) and (np.diff(places) < 0).any():
            faults.add("order", at + 1, f"the values of {name} must ascend")
        axes.append(axis)
        if len(axis) < len(values):
            faults.add("repeated", at + 1, f"{len(values) - len(axis)} values of {name} occur twice")
        at += 1
    faults.raise_any()
    expressions: list[Expression] = []
    blocks: list[FloatArray] = []
    nx, ny, nz = (len(axis) for axis in axes)
    while at < len(lines):
        if not lines[at].strip():
            at += 1
            continue
        title, first = "", at
        while at < len(lines) and lines[at].startswith("%"):
            title += " " + lines[at][1:].strip().removeprefix("Data")
            at += 1
        title = title.strip()
        title = title[1:-1] if title.startswith("(") and title.endswith(")") else title
        expressions += parse_expressions(title, f"{path}:{first + 1}")
        if len(expressions) != len(blocks) + 1:
            raise TableError(f"{path}:{first + 1}: a '% Data' line must name one expression and its unit, as in "
                             f"'% Data (mf.Bx (mT))'; got {lines[first].strip()!r}.")  # fmt: skip
        end = at
        while end < len(lines) and not lines[end].startswith("%"):
            end += 1
        rows = [(i + 1, lines[i]) for i in range(at, end) if lines[i].strip()]
        blocks.append(_read_grid_block(rows, (nx, ny, nz), expressions[-1].name, axes, faults, first + 1))
        at = end
    if not blocks:
        raise TableError(f"{path}:{len(lines)}: the file ends before the first '% Data' line.")
    faults.raise_any()
    return axes, np.stack(blocks), expressions, f"{path}:{start + 1}"


def _read_grid_block(
    rows: list[tuple[int, str]], shape: tuple[int, int, int], name: str, axes: list[FloatArray], faults: Faults, at: int
) -> FloatArray:
    """Read the values (nx, ny, nz) of one expression; zeros, and faults, where they cannot be read."""
    nx, ny, nz = shape
    if len(rows) != ny * nz:
        line = rows[-1][0] if rows else at
        faults.add("rows", line, f"{name} has {len(rows)} rows of values; the grid needs {ny} x {nz} = {ny * nz}")
        return np.zeros(shape)
    out = np.zeros((nz * ny, nx))
    for i, (line, text) in enumerate(rows):
        values = parse_numbers(text)
        if values is not None and len(values) == nx and np.isfinite(values).all():
            out[i] = values
            continue
        words = text.replace(",", " ").replace(";", " ").split()
        if len(words) != nx:
            faults.add("columns", line, f"{name} has {len(words)} values in this row; the grid has {nx} along x")
            continue
        for x, word in zip(axes[0], words, strict=True):
            faults.add_unless_number(word, line, name, (x, axes[1][i % ny], axes[2][i // ny]))
    return np.ascontiguousarray(out.reshape(nz, ny, nx).transpose(2, 1, 0))
