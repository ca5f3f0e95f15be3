"""Model parameters of a gradient-pulled robot, as its controller assumes them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

REMANENCE = 1.45
"""Of N52, in T: with the moment it gives the magnet's volume."""

MAGNET_DENSITY = 7500.0
"""Of NdFeB, in kg/m³."""

_MU0 = 4e-7 * np.pi


def compute_magnet_inertia(moment: float, l0: float) -> float:
    """Compute the inertia of a magnet about a rotation centre at a distance: I = m_magnet l0².

    The mass follows from the moment: m_magnet = rho mu_0 moment / B_r, with remanence B_r and density rho.

    Parameters
    ----------
    moment : float, in A·m²
    l0 : float, in m
        From the rotation centre to the magnet.

    Returns
    -------
    float, in kg·m²
    """
    return MAGNET_DENSITY * moment * _MU0 / REMANENCE * l0**2


@dataclass(frozen=True)
class Robot:
    """A robot whose drag dominates its inertia (overdamped). SI units.

    Attributes
    ----------
    kind : {"gradient"}
    moment : float, in A·m²
    drag : float, in N·s/m
        Stokes drag of translation, 6 pi mu r.
    rotational_drag : float, in N·m·s
        Stokes drag of rotation, 8 pi mu r³.
    stiffness : float, in N·m/rad
        Of the cantilever between magnet and housing; ``inf`` for a magnet that is fixed.
    theta_max : float, in rad
        Stop of its deflection.
    magnet_ahead, center_ahead : float, in m
        Positions of magnet and centre of drag along the cantilever, from its rotation centre.
    """

    kind: Literal["gradient"]
    moment: float
    drag: float
    rotational_drag: float
    stiffness: float = np.inf
    theta_max: float = 0.0
    magnet_ahead: float = 0.0
    center_ahead: float = 0.0

    @classmethod
    def in_liquid(
        cls,
        moment: float,
        radius: float,
        viscosity: float,
        *,
        frequency: float,
        l0: float,
        theta_max: float,
        center_ahead: float = 0.0,
    ) -> Robot:
        """Make a gradient-pulled robot with the drag of a sphere in a liquid.

        The cantilever's stiffness follows from its resonance: k = I (2 pi f)², I = m_magnet l0².

        Parameters
        ----------
        moment : float, in A·m²
        radius : float, in m
            Of the sphere.
        viscosity : float, in Pa·s
        frequency : float, in Hz
            Resonance of the cantilever.
        l0 : float, in m
            From the rotation centre to the magnet.
        theta_max : float, in rad
            Stop of the deflection.
        center_ahead : float, in m
            Position of the centre of drag along the cantilever, from its rotation centre.

        Returns
        -------
        Robot
        """
        return cls(
            kind="gradient",
            moment=moment,
            drag=6.0 * np.pi * viscosity * radius,
            rotational_drag=8.0 * np.pi * viscosity * radius**3,
            stiffness=compute_magnet_inertia(moment, l0) * (2.0 * np.pi * frequency) ** 2,
            theta_max=theta_max,
            magnet_ahead=l0,
            center_ahead=center_ahead,
        )
