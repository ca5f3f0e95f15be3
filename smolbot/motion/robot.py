"""A robot as its controller believes it to be."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np


@dataclass(frozen=True)
class Robot:
    """An overdamped swimmer. SI units.

    Attributes
    ----------
    kind : {"gradient"}
    moment : float, in A·m²
    drag : float, in N·s/m
        Stokes drag of translation, 6 pi mu r.
    rotational_drag : float, in N·m·s
        Stokes drag of rotation, 8 pi mu r³.
    floats : bool
        True where the liquid's surface holds its height, pitch and roll.
    """

    kind: Literal["gradient"]
    moment: float
    drag: float
    rotational_drag: float
    floats: bool = True

    @classmethod
    def in_liquid(cls, moment: float, radius: float, viscosity: float) -> Robot:
        """A gradient-pulled robot with the drag of a sphere of `radius` m in a liquid of `viscosity` Pa·s."""
        return cls(
            kind="gradient",
            moment=moment,
            drag=6.0 * np.pi * viscosity * radius,
            rotational_drag=8.0 * np.pi * viscosity * radius**3,
        )
