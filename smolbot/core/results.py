"""Common parts of results: printing in one line, rows as columns, and JSON."""

from __future__ import annotations

import json
import math
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np


class _Brief(reprlib.Repr):
    """Short representations: arrays by their shape, long rows by their first items, figures to six digits."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxstring, self.maxother = 3, 80, 80
        self.maxtuple = self.maxlist = self.maxdict = 4

    def repr_ndarray(self, array: Any, level: int) -> str:
        short = array.ndim == 1 and array.size <= 4
        return f"[{', '.join(self.repr1(v, level) for v in array.tolist())}]" if short else f"<array {array.shape}>"

    def repr_float(self, value: float, level: int) -> str:
        return f"{value:.6g}"


_BRIEF = _Brief()


class Readable:
    """Base class of dataclasses that print in one line, however much they hold; for ``@dataclass(repr=False)``.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True, repr=False)
    ... class Trail(Readable):
    ...     name: str
    ...     points: np.ndarray
    >>> Trail("way there", np.zeros((200, 3)))
    Trail(name='way there', points=<array (200, 3)>)
    """

    def __repr__(self) -> str:
        parts = (f"{f.name}={_BRIEF.repr(getattr(self, f.name))}" for f in fields(self) if f.repr)  # type: ignore[arg-type]
        return f"{type(self).__name__}({', '.join(parts)})"


def as_columns(rows: Iterable[Mapping[str, Any]], names: Sequence[str]) -> dict[str, np.ndarray[Any, Any]]:
    """Convert rows to columns: numbers to arrays of doubles, with nan where a row has none, all else to objects.

    Parameters
    ----------
    rows : iterable of mapping
    names : sequence of str
        Keys to take, in the order of the columns.

    Returns
    -------
    dict of str to ndarray, shape (n_rows,)

    Examples
    --------
    >>> as_columns([{"seed": 1, "verdict": "passed"}, {"seed": 2}], ["seed", "verdict"])
    {'seed': array([1., 2.]), 'verdict': array(['passed', None], dtype=object)}
    """
    held = list(rows)
    columns = {name: [row.get(name) for row in held] for name in names}
    return {
        name: np.array([np.nan if v is None else float(v) for v in values])
        if all(v is None or isinstance(v, int | float) for v in values)
        else np.array(values, dtype=object)
        for name, values in columns.items()
    }


def as_json(value: Any) -> Any:
    """Convert a value to one that JSON can hold: nan and infinity become null, arrays become lists.

    Parameters
    ----------
    value : object

    Returns
    -------
    object
    """
    if isinstance(value, dict):
        return {str(k): as_json(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [as_json(v) for v in value]
    if hasattr(value, "tolist"):
        return as_json(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def format_json(data: Any) -> str:
    """Format data as JSON text, the way commands print and store it.

    Parameters
    ----------
    data : object

    Returns
    -------
    str
    """
    return json.dumps(as_json(data), indent=2, default=str) + "\n"
