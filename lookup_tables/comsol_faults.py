"""Faults of an export: a slow search for their lines, and one message with the first of each kind."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from lookup_tables.comsol_header import Expression, arrange_expressions
from lookup_tables.errors import TableError

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
SAME_VALUE = 1e-6
"""Share of an axis below which two values are one: rounding of an export may split a value in two."""
STEP_TOLERANCE = 1e-3
"""Share of a step by which the steps of an axis may differ."""


class Faults:
    """Faults of one file by kind: the first of each kind in words, the others counted.

    Parameters
    ----------
    path : str
        Of the file, for messages.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self._first: dict[str, str] = {}
        self._more: dict[str, int] = {}

    def add(self, kind: str, line: int | None, fault: str, count: int = 1) -> None:
        """Add faults of one kind.

        Parameters
        ----------
        kind : str
        line : int or None
            Line of the first one; None for a fault of the whole file.
        fault : str
            Message, used if it is the first of its kind.
        count : int
            Number of faults.
        """
        if kind not in self._first:
            self._first[kind] = f"{self.path}:{line}: {fault}" if line else f"{self.path}: {fault}"
            count -= 1
        self._more[kind] = self._more.get(kind, 0) + count

    def add_unless_number(self, word: str, line: int, what: str, node: Sequence[float]) -> None:
        """Add a fault if a value is nan, infinite or no number.

        Parameters
        ----------
        word : str
            The value.
        line : int
        what : str
            Name of the value.
        node : sequence of float
            Coordinates of its node.
        """
        try:
            fine = bool(np.isfinite(float(word)))
        except ValueError:
            fine = False
        if not fine:
            where = ", ".join(f"{axis} = {value:g}" for axis, value in zip("xyz", node, strict=True))
            kind = "nan" if word.lower().lstrip("+-") in ("nan", "inf", "infinity") else "text"
            fault = f"{what} is not a number ({word!r} at {where}); the table must cover the whole grid"
            self.add(kind, line, fault)

    def report_nodes(
        self, axes: list[FloatArray], nodes: IntArray, counts: IntArray, lines: list[str], header: int
    ) -> None:
        """Add the nodes without a row, and those with two rows.

        Parameters
        ----------
        axes : list of ndarray
            Coordinates along x, y and z.
        nodes : ndarray of int, shape (n_rows,)
            Flat index of each row's node.
        counts : ndarray of int, shape (n_nodes,)
            Rows per node.
        lines : list of str
            Of the file.
        header : int
            Number of lines of the header.
        """
        shape = tuple(len(axis) for axis in axes)
        missing, double = np.flatnonzero(counts == 0), int(counts[counts > 1].sum() - (counts > 1).sum())
        if len(missing):
            where = _format_node(axes, shape, int(missing[0]))
            self.add("missing", None, f"node {where} is missing; the table must cover the whole grid", len(missing))
        if double:
            order = np.argsort(nodes, kind="stable")
            repeats = np.sort(order[1:][np.diff(nodes[order]) == 0])
            row, numbers = int(repeats[0]), find_data_lines(lines, header)
            first = int(np.flatnonzero(nodes == nodes[row])[0])
            where = _format_node(axes, shape, int(nodes[row]))
            self.add("double", numbers[row], f"node {where} occurs twice, first in line {numbers[first]}", double)

    def raise_any(self) -> None:
        """Raise an error with all faults, if there are any.

        Raises
        ------
        TableError
            If a fault was added.
        """
        if self._first:
            raise self.make_error()

    def make_error(self) -> TableError:
        """Make the error that lists all faults.

        Returns
        -------
        TableError
        """
        rest = ((first, self._more[kind]) for kind, first in self._first.items())
        return TableError("\n".join(f"{first}{f'; {more} more like it' if more else ''}." for first, more in rest))


def find_row_faults(lines: list[str], header: int, expressions: list[Expression], path: str) -> TableError:
    """Find the faulty rows of a spreadsheet that the fast reader refused, one by one.

    Parameters
    ----------
    lines : list of str
        Of the file.
    header : int
        Number of lines of the header.
    expressions : list of Expression
        Of the columns.
    path : str
        Of the file, for messages.

    Returns
    -------
    TableError
    """
    faults, width = Faults(path), 3 + len(expressions)
    order, names = arrange_expressions(expressions, path)
    labels = [f"B{'xyz'[component]} of coil {names[coil]}" for coil, component in order]
    numbers = find_data_lines(lines, header)
    if not numbers:
        return TableError(f"{path}:{len(lines)}: the file ends after its header; there is not one row of values.")
    for number in numbers:
        line = lines[number - 1].split("%")[0]
        values = parse_numbers(line)
        if values is not None and len(values) == width and np.isfinite(values).all():
            continue
        words = line.replace(",", " ").replace(";", " ").split()
        if len(words) != width:
            faults.add("columns", number, f"{len(words)} columns; the header names {width}")
            continue
        node = parse_numbers(" ".join(words[:3]))
        if node is None or not np.isfinite(node).all():
            faults.add("node", number, f"the node's place must be three numbers; got {' '.join(words[:3])!r}")
            continue
        for label, word in zip(labels, words[3:], strict=True):
            faults.add_unless_number(word, number, label, tuple(node))
    return faults.make_error()


def find_data_lines(lines: list[str], header: int) -> list[int]:
    """Find the lines after the header that hold values.

    Parameters
    ----------
    lines : list of str
        Of the file.
    header : int
        Number of lines of the header.

    Returns
    -------
    list of int
        Line numbers, from 1.
    """
    return [i + 1 for i in range(header, len(lines)) if lines[i].strip() and not lines[i].startswith("%")]


def parse_numbers(text: str) -> FloatArray | None:
    """Parse all numbers of a line.

    Parameters
    ----------
    text : str

    Returns
    -------
    ndarray, shape (n,), or None
        None if the line holds anything else.
    """
    try:
        return np.array([float(word) for word in text.replace(",", " ").replace(";", " ").split()])
    except ValueError:
        return None


def find_axis(column: FloatArray, name: str, faults: Faults, line: int | None = None) -> tuple[FloatArray, IntArray]:
    """Find the axis whose values a column repeats; unequal steps are added to the faults.

    Parameters
    ----------
    column : ndarray, shape (n_rows,)
    name : str
        Of the axis, for messages.
    faults : Faults
    line : int, optional
        Line of the axis in the file, for messages.

    Returns
    -------
    axis : ndarray, shape (n,)
    index : ndarray of int, shape (n_rows,)
        Index of each row on the axis.
    """
    distinct, back = np.unique(column, return_inverse=True)
    width = float(distinct[-1] - distinct[0])
    new = np.concatenate([[True], np.diff(distinct) > SAME_VALUE * width])
    axis = distinct[new]
    steps = np.diff(axis)
    if len(steps) and np.abs(steps - np.median(steps)).max() > STEP_TOLERANCE * np.median(steps):
        usual = float(np.median(steps))
        odd = np.abs(steps - usual) > STEP_TOLERANCE * usual
        at = int(np.flatnonzero(odd)[0])
        faults.add(
            f"steps {name}",
            line,
            f"{name} is not equally spaced: most steps are {usual:.6g}, but {axis[at]:.6g} is followed by "
            f"{axis[at + 1]:.6g}, a step of {steps[at]:.6g} ({int(odd.sum())} such of {len(steps)})",
        )
    return axis, (np.cumsum(new) - 1)[back.ravel()]


def _format_node(axes: list[FloatArray], shape: tuple[int, ...], node: int) -> str:
    place = np.unravel_index(node, shape)
    return ", ".join(f"{name} = {axis[i]:.6g}" for name, axis, i in zip("xyz", axes, place, strict=True))
