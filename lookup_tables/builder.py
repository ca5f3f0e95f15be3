"""Tables computed from coils."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from lookup_tables.coils import Coil
from lookup_tables.errors import TableError

if TYPE_CHECKING:
    from lookup_tables.table import FieldTable

FloatArray = npt.NDArray[np.float64]
ROUNDING = 1e-9
"""Share of a number of steps that is rounding, not one more step."""


def mesh_axis(low: float, high: float, spacing: float) -> FloatArray:
    """Make equally spaced samples, both ends included.

    Parameters
    ----------
    low, high : float, in m
        Ends; equal ends give one sample.
    spacing : float, in m
        Largest distance between samples.

    Returns
    -------
    ndarray, shape (n,), in m

    Raises
    ------
    TableError
        If `low` is above `high`, or `spacing` is not positive.

    Examples
    --------
    >>> print(mesh_axis(-0.001, 0.001, 0.0005))
    [-0.001  -0.0005  0.      0.0005  0.001 ]
    """
    if not (low <= high and spacing > 0.0):
        raise TableError(
            f"A mesh axis needs low <= high and a positive spacing; got {1e3 * low:g} to {1e3 * high:g} mm "
            f"in steps of {1e3 * spacing:g} mm."
        )
    steps = int(np.ceil((high - low) / spacing * (1.0 - ROUNDING)))
    return np.linspace(low, high, steps + 1)


def build(coils: Sequence[Coil], x: FloatArray, y: FloatArray, z: FloatArray) -> FieldTable:
    """Compute the table of some coils on a mesh.

    Parameters
    ----------
    coils : sequence of RoundCoil or FlatCoil
        In the order of the table.
    x, y, z : ndarray, shape (nx,), (ny,), (nz,), in m
        Equally spaced, world frame. The mesh must not extend into a winding.

    Returns
    -------
    FieldTable

    Raises
    ------
    TableError
        Without coils, or if the field on the mesh is not that of free space.
    """
    from lookup_tables.table import FieldTable

    if not coils:
        raise TableError("A table needs at least one coil; got none.")
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    shape = (len(x), len(y), len(z), 3)
    field = np.stack([coil.field(points).reshape(shape) for coil in coils])
    return FieldTable(x, y, z, field, [coil.name for coil in coils])
