"""Faults of an export: the slow search for their lines, and one message with the first of each kind."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from lookup_tables.comsol_header import Expression, arrange
from lookup_tables.errors import TableError

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
SAME_VALUE = 1e-6
"""Share of an axis below which two values are one: rounding of an export may split a value in two."""
STEP_TOLERANCE = 1e-3
"""Share of a step by which the steps of an axis may differ."""


class Faults:
    """Faults of one file by kind: the first of each kind in words, the others counted."""

    def __init__(self, path: str) -> None:
        self.path = path
        self._first: dict[str, str] = {}
        self._more: dict[str, int] = {}

    def add(self, kind: str, line: int | None, fault: str, count: int = 1) -> None:
        """Note `count` faults of a kind, the first of which is at `line` (None: of the file as a whole)."""
        if kind not in self._first:
            self._first[kind] = f"{self.path}:{line}: {fault}" if line else f"{self.path}: {fault}"
            count -= 1
        self._more[kind] = self._more.get(kind, 0) + count

    def add_unless_number(self, word: str, line: int, what: str, node: Sequence[float]) -> None:
        """Note a value that is nan, infinite or no number."""
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
        """Note the nodes that no row has, and those that two rows have."""
        shape = tuple(len(axis) for axis in axes)
        missing, double = np.flatnonzero(counts == 0), int(counts[counts > 1].sum() - (counts > 1).sum())
        if len(missing):
            where = _spell(axes, shape, int(missing[0]))
            self.add("missing", None, f"node {where} is missing; the table must cover the whole grid", len(missing))
        if double:
            order = np.argsort(nodes, kind="stable")
            repeats = np.sort(order[1:][np.diff(nodes[order]) == 0])
            row, numbers = int(repeats[0]), data_lines(lines, header)
            first = int(np.flatnonzero(nodes == nodes[row])[0])
            where = _spell(axes, shape, int(nodes[row]))
            self.add("double", numbers[row], f"node {where} occurs twice, first in line {numbers[first]}", double)

    def raise_any(self) -> None:
        """Raise a `TableError` with all faults noted, if there are any."""
        if self._first:
            raise self.error()

    def error(self) -> TableError:
        """The error that lists them."""
        rest = ((first, self._more[kind]) for kind, first in self._first.items())
        return TableError("\n".join(f"{first}{f'; {more} more like it' if more else ''}." for first, more in rest))


def locate_rows(lines: list[str], header: int, expressions: list[Expression], path: str) -> TableError:
    """Search the rows of a spreadsheet, one by one, for what the fast reader stumbled over."""
    faults, width = Faults(path), 3 + len(expressions)
    order, names = arrange(expressions, path)
    labels = [f"B{'xyz'[component]} of coil {names[coil]}" for coil, component in order]
    numbers = data_lines(lines, header)
    if not numbers:
        return TableError(f"{path}:{len(lines)}: the file ends after its header; there is not one row of values.")
    for number in numbers:
        line = lines[number - 1].split("%")[0]
        values = numbers_or_none(line)
        if values is not None and len(values) == width and np.isfinite(values).all():
            continue
        words = line.replace(",", " ").replace(";", " ").split()
        if len(words) != width:
            faults.add("columns", number, f"{len(words)} columns; the header names {width}")
            continue
        node = numbers_or_none(" ".join(words[:3]))
        if node is None or not np.isfinite(node).all():
            faults.add("node", number, f"the node's place must be three numbers; got {' '.join(words[:3])!r}")
            continue
        for label, word in zip(labels, words[3:], strict=True):
            faults.add_unless_number(word, number, label, tuple(node))
    return faults.error()


def data_lines(lines: list[str], header: int) -> list[int]:
    """Numbers, from 1, of the lines after the header that hold values."""
    return [i + 1 for i in range(header, len(lines)) if lines[i].strip() and not lines[i].startswith("%")]


def numbers_or_none(text: str) -> FloatArray | None:
    """All numbers of a line, or None if it holds anything else."""
    try:
        return np.array([float(word) for word in text.replace(",", " ").replace(";", " ").split()])
    except ValueError:
        return None


def find_axis(column: FloatArray, name: str, faults: Faults, line: int | None = None) -> tuple[FloatArray, IntArray]:
    """The axis (n,) whose values a column repeats, and the place of each row on it; notes unequal steps."""
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


def _spell(axes: list[FloatArray], shape: tuple[int, ...], node: int) -> str:
    place = np.unravel_index(node, shape)
    return ", ".join(f"{name} = {axis[i]:.6g}" for name, axis, i in zip("xyz", axes, place, strict=True))
