"""Numbers of files, with the unit in the key, and their values in SI units."""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from smolbot.core.arrays import FloatArray

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Point = tuple[float, float]
Vector = tuple[float, float, float]

FACTORS = {
    "_mm": 1e-3, "_mm_s": 1e-3, "_ms": 1e-3, "_percent": 0.01,
    "_deg": math.pi / 180, "_deg_s": math.pi / 180, "_deg_per_s": math.pi / 180,
    "_ut": 1e-6, "_v_per_ut": 1e6, "_nt": 1e-9, "_nt_per_m": 1e-9, "_nt_per_s": 1e-9, "_pt_per_rthz": 1e-12,
}  # fmt: skip
"""What a number is multiplied by, for each unit at the end of a key."""


class SI:
    """A number of a section in SI units: with ``pitch = SI("pitch_mm")``, `pitch` is the value of the file in m.

    Parameters
    ----------
    key : str
        Key of the number in the file, with the unit at its end.
    """

    def __init__(self, key: str) -> None:
        self._key = key
        self._factor = FACTORS[max((unit for unit in FACTORS if key.endswith(unit)), key=len)]

    def __get__(self, section: Any, owner: object = None) -> float:
        value: float = self._factor * getattr(section, self._key)
        return value


class SIVector(SI):
    """A list of numbers of a section in SI units, as an array."""

    def __get__(self, section: Any, owner: object = None) -> FloatArray:  # type: ignore[override]
        value: FloatArray = self._factor * np.array(getattr(section, self._key), dtype=np.float64)
        return value
