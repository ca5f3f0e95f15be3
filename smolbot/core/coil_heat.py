"""Coil temperatures computed from the commanded currents: one thermal node per coil, integrated exactly.

    C dT/dt = I² R (1 + alpha (T - 20)) - (T - T_ambient) / R_th

Copper's resistance rises by 0.4 % per degree. With a constant current the equation is linear, so that a step of any
length is exact; where heating exceeds cooling, the temperature grows without bound, as it should.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from smolbot.core.shots import Actuate, Excite, Window

COPPER_DENSITY = 8960.0
"""Density of copper, in kg/m³."""

COPPER_SPECIFIC_HEAT = 385.0
"""Specific heat of copper, in J/(kg K)."""

COPPER_RESISTIVITY = 1.72e-8
"""Resistivity of copper at the reference temperature, in ohm m."""

COPPER_TEMPERATURE_COEFFICIENT = 3.93e-3
"""Relative rise of copper's resistance per kelvin, in 1/K, from the reference temperature."""

REFERENCE_TEMPERATURE = 20.0
"""Temperature, in °C, at which copper's constants are given."""

STILL_AIR_HEAT_TRANSFER = 10.0
"""Heat transfer from a surface to still air, in W/(m² K): half by convection, half by radiation."""

MAX_FILL_FACTOR = 0.8
"""Largest share of a winding's cross-section that is copper, with round wire."""


@dataclass(frozen=True)
class ThermalCoil:
    """Thermal constants of one coil.

    Attributes
    ----------
    name : str
        Name used in messages.
    resistance : float, in ohm
        At 20 degrees Celsius.
    capacity : float, in J/K
        Heat capacity.
    thermal_resistance : float, in K/W
        To the surroundings.
    limit : float, in degrees Celsius
        Highest allowed temperature.
    """

    name: str
    resistance: float
    capacity: float
    thermal_resistance: float
    limit: float


def compute_winding_heat_capacity(resistance: float, turns: float, mean_turn: float, section: float) -> float:
    """Compute the heat capacity of a winding's copper.

    A wire of known length and resistance has one cross-section, and so one mass; a mass larger than fits into the
    winding's cross-section is reduced to what fits.

    Parameters
    ----------
    resistance : float, in ohm
        At 20 degrees Celsius.
    turns : float
    mean_turn : float, in m
        Mean length of a turn.
    section : float, in m²
        Cross-section of the complete winding.

    Returns
    -------
    float, in J/K

    Examples
    --------
    >>> mean_turn = math.pi * 0.05  # 200 turns of 50 mm: 31 m of 0.54 mm², 150 g
    >>> round(compute_winding_heat_capacity(1.0, 200, mean_turn, 4e-4), 1)
    58.6
    """
    length = turns * mean_turn
    area = min(COPPER_RESISTIVITY * length / resistance, MAX_FILL_FACTOR * section / turns)
    return COPPER_SPECIFIC_HEAT * COPPER_DENSITY * length * area


def advance_temperature(
    coil: ThermalCoil, temperature: float, mean_square: float, duration: float, ambient: float
) -> float:
    """Compute a coil's temperature after a time at a constant mean square current.

    The exact solution of ``C dT/dt = I² R (1 + alpha (T - 20)) - (T - T_ambient) / R_th``.

    Parameters
    ----------
    coil : ThermalCoil
    temperature : float, in degrees Celsius
        At the start.
    mean_square : float, in A²
        Mean square current.
    duration : float, in s
    ambient : float, in degrees Celsius

    Returns
    -------
    float, in degrees Celsius
    """
    # heat balance C dT/dt = R I² (1 + alpha (T - T_ref)) - (T - T_ambient) / R_th, linear in T: solved exactly
    power = mean_square * coil.resistance
    rate = (1.0 / coil.thermal_resistance - COPPER_TEMPERATURE_COEFFICIENT * power) / coil.capacity
    heating = power * (1.0 + COPPER_TEMPERATURE_COEFFICIENT * (temperature - REFERENCE_TEMPERATURE))
    slope = (heating - (temperature - ambient) / coil.thermal_resistance) / coil.capacity
    x = rate * duration
    return temperature + slope * duration * (-math.expm1(-x) / x if x else 1.0)


def compute_mean_square_currents(window: Window, n_coils: int, n_excitation: int) -> Sequence[float]:
    """Compute the mean square current that a window commands in each coil.

    Parameters
    ----------
    window : Window
    n_coils : int
        Number of actuation coils.
    n_excitation : int
        Number of excitation coils.

    Returns
    -------
    sequence of float, in A²
        Actuation coils first, then excitation coils; empty if the window drives nothing.
    """
    if isinstance(window, Actuate) and any(window.currents):
        return [c * c for c in window.currents] + [0.0] * n_excitation
    if isinstance(window, Excite):
        return [0.0] * n_coils + [0.5 * c * c for c in window.currents[:n_excitation]]
    return ()


class CoilHeat:
    """Temperatures of a rig's coils: actuation coils in the rig's order, then excitation coils.

    They start at the temperature of the surroundings, since the heat left by an earlier run is not known.

    Parameters
    ----------
    coils : sequence of ThermalCoil or None
        None for a coil whose thermal constants are not known; its temperature stays at `ambient`.
    ambient : float, in degrees Celsius

    Attributes
    ----------
    temperatures, peaks : list of float, in degrees Celsius
        Present and highest temperature of each coil.
    """

    def __init__(self, coils: Sequence[ThermalCoil | None], ambient: float) -> None:
        self.coils = tuple(coils)
        self.ambient = ambient
        self.temperatures = [ambient] * len(self.coils)
        self.peaks = [ambient] * len(self.coils)

    def advance(self, mean_square_currents: Sequence[float], duration: float) -> None:
        """Advance all temperatures in time at constant mean square currents.

        Parameters
        ----------
        mean_square_currents : sequence of float, length n_coils, in A²
            Mean square currents; an empty one lets all coils cool.
        duration : float, in s
        """
        if duration <= 0.0:
            return
        for i, coil in enumerate(self.coils):
            if coil is None:  # its constants are not known
                continue
            square = mean_square_currents[i] if mean_square_currents else 0.0
            after = advance_temperature(coil, self.temperatures[i], square, duration, self.ambient)
            self.temperatures[i] = after
            if after > self.peaks[i]:
                self.peaks[i] = after

    def find_overheated_coil(self) -> tuple[ThermalCoil, float] | None:
        """Find the first coil above its temperature limit.

        Returns
        -------
        tuple of (ThermalCoil, float) or None
            The coil and its temperature in degrees Celsius; None if no coil is too hot.
        """
        for coil, temperature in zip(self.coils, self.temperatures, strict=True):
            if coil is not None and temperature > coil.limit:
                return coil, temperature
        return None
