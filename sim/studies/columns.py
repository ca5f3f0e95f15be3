"""Rows of a study as columns: joined, selected, and turned into errors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sim.studies.study import Columns
from smolbot.core.arrays import FloatArray


def make_columns(rows: Sequence[Mapping[str, Any]]) -> Columns:
    """Convert rows to columns; every row has the same keys.

    Parameters
    ----------
    rows : sequence of mapping

    Returns
    -------
    Columns
    """
    return {key: np.array([row[key] for row in rows]) for key in rows[0]} if rows else {}


def join_columns(parts: Sequence[Columns]) -> Columns:
    """Concatenate the columns of several chunks; keys with a leading underscore are left out.

    Parameters
    ----------
    parts : sequence of Columns

    Returns
    -------
    Columns
    """
    filled = [p for p in parts if p]
    keys = [k for k in (filled[0] if filled else {}) if not k.startswith("_")]
    return {key: np.concatenate([np.atleast_1d(p[key]) for p in filled]) for key in keys}


def select_rows(columns: Columns, **values: Any) -> Columns:
    """Select the rows in which the named columns have these values.

    Parameters
    ----------
    columns : Columns
    **values
        Value of each named column.

    Returns
    -------
    Columns
    """
    keep = np.ones(len(next(iter(columns.values()))), dtype=np.bool_)
    for key, value in values.items():
        keep &= columns[key] == value
    return {key: column[keep] for key, column in columns.items()}


def stack_position_errors(columns: Columns) -> FloatArray:
    """Return position errors.

    Parameters
    ----------
    columns : Columns

    Returns
    -------
    ndarray, shape (n, 3), in mm
    """
    return np.stack([columns[f"error_{axis}_mm"] for axis in "xyz"], axis=1)


def stack_rotation_errors(columns: Columns) -> FloatArray:
    """Return rotation errors.

    Parameters
    ----------
    columns : Columns

    Returns
    -------
    ndarray, shape (n, 3), in deg
    """
    return np.stack([columns[f"error_r{axis}_deg"] for axis in "xyz"], axis=1)


def compute_rms(values: FloatArray) -> float:
    """Compute the root mean square of all values.

    Parameters
    ----------
    values : ndarray

    Returns
    -------
    float
        nan where there is no value.
    """
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else math.nan
