"""Heat of coils from the currents that were commanded: one thermal node each, stepped exactly.

    C dT/dt = I² R (1 + alpha (T - 20)) - (T - T_ambient) / R_th

Copper's resistance rises by 0.4 % per degree. With a constant current the equation is linear, so that a step of any
length is exact; where heating outruns cooling, it grows without bound, as it should.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from smolbot.core.shots import Actuate, Excite, Window

DENSITY = 8960.0
"""Density of copper, in kg/m³."""

HEAT = 385.0
"""Specific heat of copper, in J/(kg K)."""

RESISTIVITY = 1.72e-8
"""Resistivity of copper at the reference temperature, in ohm m."""

ALPHA = 3.93e-3
"""Relative rise of copper's resistance per kelvin, in 1/K, from the reference temperature."""

REFERENCE_TEMPERATURE = 20.0
"""Temperature, in °C, at which copper's constants are given."""

FILM = 10.0
"""Heat transfer from a surface to still air, in W/(m² K): half by convection, half by radiation."""

FILL = 0.8
"""Largest share of a winding's cross-section that is copper, with round wire."""


@dataclass(frozen=True)
class Coil:
    """Thermal constants of one coil.

    Attributes
    ----------
    name : str
        As it is called in messages.
    resistance : float, in ohm
        At 20 degrees Celsius.
    capacity : float, in J/K
    thermal_resistance : float, in K/W
        To the surroundings.
    limit : float, in degrees Celsius
    """

    name: str
    resistance: float
    capacity: float
    thermal_resistance: float
    limit: float


def wound_capacity(resistance: float, turns: float, mean_turn: float, section: float) -> float:
    """Heat capacity of a winding's copper, in J/K.

    A wire of known length and resistance has one cross-section, and so one mass; no more than fits is believed.

    Parameters
    ----------
    resistance : float, in ohm
        At 20 degrees Celsius.
    mean_turn : float, in m
    section : float, in m²
        Of the whole winding.

    Examples
    --------
    >>> mean_turn = math.pi * 0.05  # 200 turns of 50 mm: 31 m of 0.54 mm², 150 g
    >>> round(wound_capacity(1.0, 200, mean_turn, 4e-4), 1)
    58.6
    """
    length = turns * mean_turn
    area = min(RESISTIVITY * length / resistance, FILL * section / turns)
    return HEAT * DENSITY * length * area


def stepped(coil: Coil, temperature: float, mean_square: float, duration: float, ambient: float) -> float:
    """Temperature in degrees Celsius after `duration` s at a mean square current in A², from `temperature` on."""
    # heat balance C dT/dt = R I² (1 + alpha (T - T_ref)) - (T - T_ambient) / R_th, linear in T: solved exactly
    power = mean_square * coil.resistance
    rate = (1.0 / coil.thermal_resistance - ALPHA * power) / coil.capacity
    heating = power * (1.0 + ALPHA * (temperature - REFERENCE_TEMPERATURE))
    slope = (heating - (temperature - ambient) / coil.thermal_resistance) / coil.capacity
    x = rate * duration
    return temperature + slope * duration * (-math.expm1(-x) / x if x else 1.0)


def mean_squares(window: Window, n_coils: int, n_excitation: int) -> Sequence[float]:
    """Mean square currents in A² that a window commands, actuation coils first; empty where it drives nothing."""
    if isinstance(window, Actuate) and any(window.currents):
        return [c * c for c in window.currents] + [0.0] * n_excitation
    if isinstance(window, Excite):
        return [0.0] * n_coils + [0.5 * c * c for c in window.currents[:n_excitation]]
    return ()


class CoilHeat:
    """Temperatures of a rig's coils: actuation coils in the rig's order, then excitation coils.

    They start at the surroundings': what a run before has left in them is not known.

    Attributes
    ----------
    temperatures, peaks : list of float, in degrees Celsius
    """

    def __init__(self, coils: Sequence[Coil | None], ambient: float) -> None:
        self.coils = tuple(coils)
        self.ambient = ambient
        self.temperatures = [ambient] * len(self.coils)
        self.peaks = [ambient] * len(self.coils)

    def advance(self, squares: Sequence[float], duration: float) -> None:
        """Let `duration` s pass at mean square currents `squares` (n_coils,) in A²; without any, coils cool."""
        if duration <= 0.0:
            return
        for i, coil in enumerate(self.coils):
            if coil is None:  # its constants are not known
                continue
            square = squares[i] if squares else 0.0
            after = stepped(coil, self.temperatures[i], square, duration, self.ambient)
            self.temperatures[i] = after
            if after > self.peaks[i]:
                self.peaks[i] = after

    def too_hot(self) -> tuple[Coil, float] | None:
        """The first coil above its limit, and its temperature."""
        for coil, temperature in zip(self.coils, self.temperatures, strict=True):
            if coil is not None and temperature > coil.limit:
                return coil, temperature
        return None
