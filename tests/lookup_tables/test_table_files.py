"""Exports: what comes in is what went out, in every layout and unit, and each fault names its place."""

from __future__ import annotations

import numpy as np
import pytest

from lookup_tables import FieldTable, TableError, build

UNITS = {"T": 1.0, "mT": 1e-3, "µT": 1e-6, "uT": 1e-6, "G": 1e-4, "T/A": 1.0}
LENGTHS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "µm": 1e-6}


@pytest.fixture(scope="module")
def small(coils):
    return build(coils[:2], np.linspace(-0.004, 0.004, 5), np.linspace(-0.003, 0.003, 4), np.linspace(-0.001, 0.001, 3))


def spreadsheet(table, length="mm", units=("mT",) * 3, suffix=lambda c: f" @ {c + 1}: I{c + 1}=1", by_component=False):
    """An export as COMSOL writes it: lines, so that a test can break one."""
    columns = [(c, i) for c in range(table.n_coils) for i in range(3)]
    if by_component:
        columns.sort(key=lambda column: column[1])
    titles = "  ".join(f"mf.B{'xyz'[i]} ({units[i]}){suffix(c)}" for c, i in columns)
    lines = [
        "% Model:              coils.mph",
        "% Version:            COMSOL 5.6.0.280",
        "% Date:               Jan 1 2024, 10:00",
        "% Dimension:          3",
        f"% Nodes:              {table.samples[0, ..., 0].size}",
        f"% Expressions:        {len(columns)}",
        "% Description:        Magnetic flux density, x component, Magnetic flux density, y component",
        f"% Length unit:        {length}",
        f"% X                       Y                        Z                        {titles}",
    ]
    for k, z in enumerate(table.z):
        for j, y in enumerate(table.y):
            for i, x in enumerate(table.x):
                row = [v / LENGTHS[length] for v in (x, y, z)]
                row += [table.samples[c, i, j, k, b] / UNITS[units[b]] for c, b in columns]
                lines.append("  ".join(f"{v:.15g}" for v in row).upper())
    return lines


def grid(table, title="% Data ({})"):
    lines = ["% Model: coils.mph", "% Nodes: 60", "% Length unit: mm", "% Grid"]
    lines += [" ".join(f"{1e3 * v:.12g}" for v in axis) for axis in (table.x, table.y, table.z)]
    for c in range(table.n_coils):
        for b in range(3):
            lines += title.format(f"mf.B{'xyz'[b]} (mT) @ {c + 1}: I{c + 1}=1").split("\n")
            rows = table.samples[c, ..., b].transpose(2, 1, 0).reshape(-1, len(table.x))
            lines += [" ".join(f"{1e3 * v:.15g}" for v in row) for row in rows]
    return lines


def read(tmp_path, lines, encoding="utf-8", **options):
    path = tmp_path / "coil_table.txt"
    path.write_text("\n".join(lines) + "\n", encoding=encoding)
    return FieldTable.read(path, **options)


def assert_same(a, b):
    np.testing.assert_allclose(a.samples, b.samples, rtol=1e-12, atol=1e-16)
    for one, other in zip((a.x, a.y, a.z), (b.x, b.y, b.z), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-14)


@pytest.mark.parametrize("name", ["t.npz", "spreadsheet.txt", "grid.txt"])
def test_what_is_written_is_read_back(table, points, tmp_path, name):
    layout = {"layout": "grid"} if "grid" in name else {}
    table.write(tmp_path / name, **layout)
    back = FieldTable.read(tmp_path / name)
    assert back.names == table.names
    assert_same(back, table)
    np.testing.assert_allclose(back.field(points), table.field(points), rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("units", [("T", "T", "T"), ("mT", "uT", "G"), ("µT", "µT", "µT"), ("T/A", "mT", "T")])
def test_every_unit_means_the_same_field(small, tmp_path, length, units):
    assert_same(read(tmp_path, spreadsheet(small, length, units)), small)


def test_the_order_of_rows_and_of_expressions_does_not_matter(small, tmp_path):
    lines = spreadsheet(small, by_component=True)
    back = read(tmp_path, lines[:9] + lines[:8:-1])
    assert_same(back, small)
    assert back.names == ("I1=1", "I2=1")
    assert_same(read(tmp_path, spreadsheet(small, suffix=lambda c: "")), small)


@pytest.mark.parametrize("separator", [";", ",", "\t"])
def test_separators_and_encodings_of_other_settings_are_read(small, tmp_path, separator):
    lines = spreadsheet(small, "µm", ("µT",) * 3)
    lines[9:] = [line.replace("  ", separator) for line in lines[9:]]
    assert_same(read(tmp_path, lines, encoding="latin-1"), small)


@pytest.mark.parametrize("title", ["% Data ({})", "% Data\n% {}"])
def test_both_forms_of_the_grid_layout_are_read(small, tmp_path, title):
    assert_same(read(tmp_path, grid(small, title)), small)


def test_the_table_holds_field_per_ampere(small, tmp_path):
    np.testing.assert_allclose(read(tmp_path, spreadsheet(small), current=8.0).samples, small.samples / 8, rtol=1e-12)
    assert read(tmp_path, spreadsheet(small), names=["a", "b"]).names == ("a", "b")


def test_a_turned_and_shifted_export_is_the_field_of_the_turned_coils(small, coils, tmp_path):
    turn, origin = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), np.array([0.01, 0.02, 0.06])
    back = read(tmp_path, spreadsheet(small), origin=origin, rotation=turn + 1e-12)
    inside = np.random.default_rng(1).uniform(*small.bounds, (20, 3))
    expected = np.stack([coil.field(inside) @ turn.T for coil in coils[:2]])
    np.testing.assert_allclose(back.field(inside @ turn.T + origin), expected, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize("rotation", [np.diag([1.0, 1, -1]), [[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1.0]], np.eye(2)])
def test_a_rotation_that_breaks_the_mesh_is_refused(small, tmp_path, rotation):
    with pytest.raises(TableError, match="rotation must"):
        read(tmp_path, spreadsheet(small), rotation=rotation)


def cut(lines, row, column, value):
    words = lines[row].split("  ")
    words[column] = value
    return [*lines[:row], "  ".join(words), *lines[row + 1 :]]


def replaced(lines, old, new):
    return [line.replace(old, new) for line in lines]


SPREADSHEET_FAULTS = {
    "nothing": (lambda s: [""], "the file is empty"),
    "no header": (lambda s: s[9:], ":1: there is no header"),
    "no rows": (lambda s: s[:9], "not one row"),
    "no length unit": (lambda s: s[:7] + s[8:], "no '% Length unit:' line; known units: m, dm, cm, mm"),
    "length unit": (lambda s: replaced(s, "   mm", "   furlong"), ":8: unknown length unit 'furlong'; known units: m"),
    "field unit": (lambda s: replaced(s, "(mT)", "(A/m)"), ":9: mf.Bx has the unknown field unit 'A/m'; known units:"),
    "no field unit": (lambda s: replaced(s, " (mT)", ""), ":9: 'mf.Bx' has no unit in parentheses"),
    "two dimensions": (lambda s: replaced(s, "Dimension:          3", "Dimension: 2"), ":4: dimension 2"),
    "no column names": (lambda s: s[:8] + s[9:], ":8: the last line of the header must name the columns"),
    "five expressions": (lambda s: replaced(s, "mf.Bz (mT) @ 2: I2=1", ""), ":9: 5 expressions; a table needs three"),
    "two of one": (lambda s: replaced(s, "mf.By", "mf.Bx"), "4 Bx, 0 By, 2 Bz; a table needs as many of each"),
    "hole": (lambda s: s[:12] + s[13:], "node x = 2, y = -3, z = -1 is missing"),
    "two holes": (lambda s: s[:12] + s[14:], "is missing; the table must cover the whole grid; 1 more like it"),
    "twice": (lambda s: [*s, s[12]], ":70: node x = 2, y = -3, z = -1 occurs twice, first in line 13"),
    "nan": (
        lambda s: cut(s, 20, 8, "NaN"),
        ":21: Bz of coil I2=1 is not a number \\('NaN' at x = -2, y = 1, z = -1\\); the table must cover the whole",
    ),
    "infinite": (lambda s: cut(s, 20, 3, "-Inf"), ":21: Bx of coil I1=1 is not a number"),
    "text": (lambda s: cut(s, 20, 4, "o.1"), ":21: By of coil I1=1 is not a number \\('o.1'"),
    "node": (lambda s: cut(s, 20, 1, "?"), ":21: the node's place must be three numbers; got '-2 \\? -1'"),
    "columns": (lambda s: cut(s, 20, 8, ""), ":21: 8 columns; the header names 9"),
    "all columns": (lambda s: [*s[:9], *(line.rsplit("  ", 1)[0] for line in s[9:])], ":10: 8 columns; .*59 more"),
    "count": (lambda s: replaced(s, ":              60", ":  61"), "the header says 61 nodes; the file has 60"),
    "uneven": (lambda s: ["5" + line[1:] if line.startswith("4 ") else line for line in s],
               "x is not equally spaced: most steps are 2, but 2 is followed by 5, a step of 3 \\(1 such of 4\\)"),
    "one row of nodes": (lambda s: replaced([line for line in s if line[0] in "%2"], "   60", "   12"),
                         "1 x 4 x 3 nodes; a table needs at least 2 along x and y"),
}  # fmt: skip


@pytest.mark.parametrize("fault", SPREADSHEET_FAULTS)
def test_a_fault_in_a_spreadsheet_is_named_with_its_place(small, tmp_path, fault):
    breaks, message = SPREADSHEET_FAULTS[fault]
    with pytest.raises(TableError, match=f"(?s)coil_table.txt.*{message}"):
        read(tmp_path, breaks(spreadsheet(small)))


GRID_FAULTS = {
    "no axes": (lambda g: g[:5], ":6: after '% Grid' .* the line of y is the end of the file"),
    "no data": (lambda g: g[:7], "ends before the first '% Data' line"),
    "unnamed": (lambda g: replaced(g, "% Data (mf.Bx (mT) @ 1: I1=1)", "% Data"), ":8: a '% Data' line must name"),
    "no unit": (lambda g: replaced(g, "% Data (mf.Bx (mT) @ 1: I1=1)", "% Data (mf.Bx)"), ":8: .*has no unit"),
    "truncated": (lambda g: g[:-3], "mf.Bz has 9 rows of values; the grid needs 4 x 3 = 12"),
    "lost block": (lambda g: g[:-13], ":4: 5 expressions; a table needs three"),
    "short row": (lambda g: [*g[:-1], g[-1].rsplit(" ", 1)[0]], ":85: mf.Bz has 4 values in this row; the grid has 5"),
    "nan": (lambda g: [*g[:-1], g[-1].rsplit(" ", 1)[0] + " NaN"], ":85: .*'NaN' at x = 4, y = 3, z = 1"),
    "text": (lambda g: [*g[:-1], g[-1].rsplit(" ", 1)[0] + " x"], ":85: mf.Bz is not a number \\('x'"),
    "uneven": (lambda g: replaced(g, "-4 -2 0 2 4", "-4 -2 0 2 5"), ":5: x is not equally spaced"),
    "falling": (lambda g: replaced(g, "-4 -2 0 2 4", "4 2 0 -2 -4"), ":5: the values of x must ascend"),
    "count": (lambda g: replaced(g, "60", "61"), "the header says 61 nodes; the file has 60"),
}


@pytest.mark.parametrize("fault", GRID_FAULTS)
def test_a_fault_in_a_grid_is_named_with_its_place(small, tmp_path, fault):
    breaks, message = GRID_FAULTS[fault]
    with pytest.raises(TableError, match=f"(?s)coil_table.txt.*{message}"):
        read(tmp_path, breaks(grid(small)))


def test_all_kinds_of_faults_are_reported_at_once(small, tmp_path):
    lines = cut(cut(cut(spreadsheet(small), 20, 8, "NaN"), 30, 8, "NaN"), 25, 4, "?")
    with pytest.raises(TableError) as caught:
        read(tmp_path, lines)
    first, second = str(caught.value).split("\n")
    assert ":21:" in first
    assert first.endswith("; 1 more like it.")
    assert ":26:" in second


def test_files_that_are_not_there_or_not_tables_are_refused(small, tmp_path):
    small.write(tmp_path / "there.txt")
    with pytest.raises(TableError, match=r"no such file; that folder has there\.txt"):
        FieldTable.read(tmp_path / "missing.txt")
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04 not a table")
    with pytest.raises(TableError, match=r"not a table that FieldTable\.write wrote"):
        FieldTable.read(tmp_path / "broken.npz")
    with pytest.raises(TableError, match="has 2 coils; got 3 names"):
        FieldTable.read(tmp_path / "there.txt", names=["a", "b", "c"])
    with pytest.raises(TableError, match="current must be a number other than 0"):
        FieldTable.read(tmp_path / "there.txt", current=0.0)
    with pytest.raises(TableError, match="unknown layout 'sectionwise'; known layouts: spreadsheet, grid"):
        small.write(tmp_path / "t.txt", layout="sectionwise")
    with pytest.raises(TableError, match="cannot be written"):
        small.write(tmp_path / "no" / "folder.txt")
