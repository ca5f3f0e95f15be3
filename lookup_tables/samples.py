"""What a file of a table holds, in whatever format."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


class Samples(NamedTuple):
    """Axes in m, field (n_coils, nx, ny, nz, 3) in T, coil names, and a fit if there is one."""

    x: FloatArray
    y: FloatArray
    z: FloatArray
    field: FloatArray
    names: tuple[str, ...]
    potential: FloatArray | None = None
