"""Text tables with commas, semicolons or tabs, with comments, and with or without a line of names."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError


@dataclass(frozen=True)
class Row:
    """One line of a table.

    Attributes
    ----------
    path : Path
        The table's file, for messages.
    line : int
        Line number in the file.
    text : str
        The complete line.
    cells : tuple of str
    names : tuple of str
        Names of the columns; empty if the table has none.
    """

    path: Path
    line: int
    text: str
    cells: tuple[str, ...] = ()
    names: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> str:
        return self.cells[self.names.index(name)]

    def make_error(self, message: str) -> InputError:
        """Make the error to raise for this row, with ``file:line``.

        Parameters
        ----------
        message : str

        Returns
        -------
        InputError
        """
        return InputError(f"{self.path}:{self.line}: {message}")

    def parse_number(self, cell: str, name: str) -> float:
        """Parse the number in a cell.

        Parameters
        ----------
        cell : str
        name : str
            Name of the cell, for messages.

        Returns
        -------
        float

        Raises
        ------
        InputError
            If the cell is not a number.
        """
        try:
            return float(cell)
        except ValueError:
            if "," in self.text and ";" in self.text:
                raise self.make_error("has both ',' and ';'. Write decimals with a point, 0.5 and not 0,5.") from None
            raise self.make_error(f"{name} is not a number ('{cell.strip()}').") from None

    def parse_finite(self, names: Sequence[str]) -> FloatArray:
        """Parse the numbers in some columns.

        Parameters
        ----------
        names : sequence of str
            Names of the n columns.

        Returns
        -------
        ndarray, shape (n,)

        Raises
        ------
        InputError
            For the first cell that is not a number, infinite or nan.
        """
        values = [self.parse_number(self[name], name) for name in names]
        for name, value in zip(names, values, strict=True):
            if not math.isfinite(value):
                raise self.make_error(f"{name} is not a number ('{self[name]}').")
        return np.array(values)


@dataclass(frozen=True)
class Table:
    """The lines of a file; blank ones are left out, and a ``#`` begins a comment.

    Attributes
    ----------
    names : tuple of str
        Names of the columns; empty if the table has none.
    rows : tuple of Row
    comments : tuple of Row
    """

    names: tuple[str, ...]
    rows: tuple[Row, ...]
    comments: tuple[Row, ...]


def read_table(path: Path, *, named: bool = False) -> Table:
    """Read a text table.

    Parameters
    ----------
    path : Path
    named : bool
        True if the first line holds names; otherwise it is taken for names if it has no number.

    Returns
    -------
    Table

    Raises
    ------
    InputError
        If the file cannot be read, and with `named` for a row that has more or fewer cells than there are names.
    """
    names: tuple[str, ...] = ()
    rows: list[Row] = []
    comments: list[Row] = []
    try:
        for number, line in enumerate(path.read_text(encoding="utf-8-sig").splitlines(), 1):
            if line.lstrip().startswith("#"):
                comments.append(Row(path, number, line))
            elif line.strip():
                separator = max(",;\t", key=line.count)
                cells = tuple(cell.strip() for cell in next(csv.reader([line], delimiter=separator)))
                if not names and not rows and (named or not any(map(_is_number, cells))):
                    names = cells
                else:
                    rows.append(Row(path, number, line.strip(), cells, names))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as text: {error}.") from error
    for row in rows if named else ():
        if len(row.cells) != len(names):
            raise row.make_error(f"has {len(row.cells)} columns; the line of names has {len(names)}.")
    return Table(names, tuple(rows), tuple(comments))


def write_table(path: Path, header: Iterable[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write a comma-separated table.

    Parameters
    ----------
    path : Path
    header : iterable of str
        Names of the columns.
    rows : iterable of iterables
    """
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(rows)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
