"""Contents of a table's file, in any format."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


class Samples(NamedTuple):
    """Samples of the field on a mesh.

    Attributes
    ----------
    x, y, z : ndarray, shape (nx,), (ny,), (nz,), in m
    field : ndarray, shape (n_coils, nx, ny, nz, 3), in T
    names : tuple of str
        Of the coils.
    potential : ndarray, shape (nx + 4, ny + 4, nz + 4, n_coils), in T m / A, optional
        Fitted coefficients, if there are any.
    """

    x: FloatArray
    y: FloatArray
    z: FloatArray
    field: FloatArray
    names: tuple[str, ...]
    potential: FloatArray | None = None
