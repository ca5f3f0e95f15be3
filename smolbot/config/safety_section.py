"""The section ``[safety]`` of a rig file: conditions that end a run, and thermal constants of coils."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from smolbot.config.document import FileModel
from smolbot.config.units import SI, NotNegative, Positive
from smolbot.core.coil_heat import ThermalCoil


class CoilSafety(FileModel):
    """Thermal constants, the same for all coils of one kind."""

    heat_capacity_j_per_k: Positive | None = None
    thermal_resistance_k_per_w: Positive | None = None
    max_temperature_c: Positive = 90.0


class ExcitationSafety(CoilSafety):
    """Thermal constants of excitation coils; their heat is computed only where all of them are given."""

    resistance_ohm: Positive | None = None

    def make_thermal_coil(self, name: str) -> ThermalCoil | None:
        """Build the thermal constants of one excitation coil.

        Parameters
        ----------
        name : str
            Name of the coil in messages.

        Returns
        -------
        Coil or None
            None if a constant is not given.
        """
        ohm, capacity, resistance = self.resistance_ohm, self.heat_capacity_j_per_k, self.thermal_resistance_k_per_w
        if ohm is None or capacity is None or resistance is None:
            return None
        return ThermalCoil(name, ohm, capacity, resistance, self.max_temperature_c)


class SafetySection(FileModel):
    """Conditions that end a run. Every key has a default, so that a rig file may leave all of it out.

    Without given constants, an actuation coil's heat is computed from its geometry and resistance, see
    `heat.compute_winding_heat_capacity`, and from its bare surface in still air.

    Attributes
    ----------
    may_leave_out_sensors : bool or None
        Whether a flight goes on without a sensor that fails; None for yes in a tank, and no in any other world.
    """

    ambient_c: float = 25.0
    max_duty: Annotated[float, Field(gt=0, le=1)] = 0.9
    duty_window_s: Positive = 10.0
    max_sigma_mm: Positive = 5.0
    uncertain_shots: Annotated[int, Field(ge=1)] = 5
    reach_margin_mm: NotNegative = 3.0
    stale_shots: Annotated[int, Field(ge=2)] = 3
    max_age_ms: Positive = 1000.0
    sensor_shots: Annotated[int, Field(ge=1)] = 5
    broken_sensors: list[Annotated[int, Field(ge=0)]] = Field(default_factory=list)
    may_leave_out_sensors: bool | None = None
    coils: CoilSafety = CoilSafety()
    excitation: ExcitationSafety = ExcitationSafety()

    max_sigma = SI("max_sigma_mm")
    reach_margin = SI("reach_margin_mm")
    max_age = SI("max_age_ms")
