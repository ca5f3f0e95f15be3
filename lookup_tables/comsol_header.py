"""Header of a COMSOL export (its ``%`` lines): units, and the coil and component of each expression."""

from __future__ import annotations

import re
from collections import Counter
from typing import NamedTuple

from lookup_tables.errors import TableError

LENGTH_UNITS = {"m": 1.0, "dm": 0.1, "cm": 1e-2, "mm": 1e-3, "µm": 1e-6, "um": 1e-6, "in": 0.0254}
FIELD_UNITS = {"T": 1.0, "mT": 1e-3, "µT": 1e-6, "uT": 1e-6, "nT": 1e-9, "G": 1e-4, "Wb/m^2": 1.0}
_EXPRESSION = re.compile(r"(\S+)\s*\(([^()]*)\)\s*(?:@\s*(.*?))?(?=\s+\S+\s*\([^()]*\)|\s*$)")


class Expression(NamedTuple):
    """One column or data block.

    Attributes
    ----------
    name : str
    component : str
        ``x``, ``y``, ``z`` or empty.
    scale : float
        To T.
    suffix : str
        Text after ``@``.
    """

    name: str
    component: str
    scale: float
    suffix: str


class Header(NamedTuple):
    """The lines before the data.

    Attributes
    ----------
    nodes : int or None
        Number of nodes, if the header states it.
    length_scale : float
        To m.
    last_line : str
        Last line of the header.
    last_number : int
        Its line number, from 1.
    """

    nodes: int | None
    length_scale: float
    last_line: str
    last_number: int


def parse_header(lines: list[str], place: str) -> Header:
    """Parse the leading ``%`` lines.

    Parameters
    ----------
    lines : list of str
        Of the whole file.
    place : str
        The file's name, for errors.

    Returns
    -------
    Header

    Raises
    ------
    TableError
        If there is no header, its length unit is missing or unknown, or the table is not three-dimensional.
    """
    leading: list[str] = []
    for line in lines:
        if line.strip() and not line.startswith("%"):
            break
        leading.append(line)
    keys: dict[str, tuple[int, str]] = {}
    for number, line in enumerate(leading, 1):
        key, colon, value = line[1:].partition(":")
        if colon and key.strip().lower() not in keys:
            keys[key.strip().lower()] = (number, value.strip())
    comments = [(number, line) for number, line in enumerate(leading, 1) if line.startswith("%")]
    if not comments:
        raise TableError(
            f"{place}:1: there is no header; a COMSOL export begins with lines such as '% Length unit: mm' and "
            "'% x  y  z  mf.Bx (mT)  mf.By (mT)  mf.Bz (mT)'."
        )
    number, unit = keys.get("length unit", (comments[-1][0], ""))
    unit = unit.replace("\u03bc", "µ")
    if unit not in LENGTH_UNITS:
        got = f"unknown length unit {unit!r}" if unit else "the header has no '% Length unit:' line"
        raise TableError(f"{place}:{number}: {got}; known units: {', '.join(LENGTH_UNITS)}.")
    number, dimension = keys.get("dimension", (0, "3"))
    if dimension != "3":
        raise TableError(f"{place}:{number}: dimension {dimension}; a table needs x, y and z, so dimension 3.")
    nodes = keys.get("nodes", (0, ""))[1]
    return Header(int(nodes) if nodes.isdigit() else None, LENGTH_UNITS[unit], comments[-1][1], comments[-1][0])


def parse_expressions(text: str, place: str) -> list[Expression]:
    """Parse expressions such as ``mf.Bx (mT) @ 1: I1=1`` that follow each other on a line.

    Parameters
    ----------
    text : str
    place : str
        File and line, for errors.

    Returns
    -------
    list of Expression

    Raises
    ------
    TableError
        If an expression has no unit, or an unknown one.
    """
    found, faults, end = [], [], 0
    for match in _EXPRESSION.finditer(text):
        name, unit, suffix = match[1], match[2].strip().replace("\u03bc", "µ"), (match[3] or "").strip()
        if text[end : match.start()].strip():
            faults.append(f"{place}: {text[end : match.start()].split()[0]!r} has no unit in parentheses")
        end = match.end()
        if unit.removesuffix("/A") not in FIELD_UNITS:
            known = ", ".join(FIELD_UNITS)
            faults.append(f"{place}: {name} has the unknown field unit {unit!r}; known units: {known}, each also per A")
            continue
        letter = name.rstrip(")")[-1].lower()
        component = letter if letter in "xyz" else ""
        found.append(Expression(name, component, FIELD_UNITS[unit.removesuffix("/A")], suffix))
    if text[end:].strip():
        faults.append(f"{place}: {text[end:].split()[0]!r} has no unit in parentheses, as in 'mf.Bx (mT)'")
    if faults:
        more = f"\n{place}: {len(faults) - 1} more like it" if len(faults) > 1 else ""
        raise TableError(f"{faults[0]}.{more}")
    return found


def arrange_expressions(expressions: list[Expression], place: str) -> tuple[list[tuple[int, int]], tuple[str, ...]]:
    """Assign each expression to a coil and a component.

    The k-th expression that ends in x is B_x of coil k, so that exports by coil and by component both work. Without
    such letters the order is x, y, z of the first coil, then of the second.

    Parameters
    ----------
    expressions : list of Expression
    place : str
        File and line, for errors.

    Returns
    -------
    order : list of tuple of 2 int
        Coil and component (0, 1, 2) of each expression.
    names : tuple of str
        Of the coils.

    Raises
    ------
    TableError
        If there are not three expressions for each coil.
    """
    if not expressions or len(expressions) % 3:
        raise TableError(
            f"{place}: {len(expressions)} expressions; a table needs three for each coil: Bx, By and Bz, with units."
        )
    n_coils = len(expressions) // 3
    letters = Counter(e.component for e in expressions)
    if letters[""] or set(letters.values()) != {n_coils} or len(letters) != 3:
        if not letters[""]:
            counts = ", ".join(f"{letters[c]} B{c}" for c in "xyz")
            raise TableError(f"{place}: {counts}; a table needs as many of each.")
        order = [divmod(i, 3) for i in range(len(expressions))]
    else:
        seen: Counter[str] = Counter()
        order = []
        for e in expressions:
            order.append((seen[e.component], "xyz".index(e.component)))
            seen[e.component] += 1
    names = [""] * n_coils
    for e, (coil, component) in zip(expressions, order, strict=True):
        if component == 0:
            names[coil] = re.sub(r"^\d+:\s*", "", e.suffix).removeprefix("coil=") or str(coil + 1)
    if len(set(names)) < n_coils:
        names = [str(i + 1) for i in range(n_coils)]
    return order, tuple(names)
