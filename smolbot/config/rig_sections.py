"""The sections of a rig file."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from smolbot.config.document import FileModel
from smolbot.config.safety_section import SafetySection
from smolbot.config.sensors import Direction, SensorsSection
from smolbot.config.units import SI, NotNegative, Positive, SIVector, Vector
from smolbot.core.arrays import FloatArray
from smolbot.core.coil_heat import STILL_AIR_HEAT_TRANSFER, ThermalCoil, compute_winding_heat_capacity

Range = tuple[float, float]


class CoilSection(FileModel):
    """A round actuation coil with an air core; `axis` is the field direction at its centre for positive current."""

    name: str
    center_mm: Vector
    axis: Direction
    inner_radius_mm: Positive
    outer_radius_mm: Positive
    length_mm: Positive
    turns: Positive
    time_constant_ms: NotNegative
    resistance_ohm: Positive

    center = SIVector("center_mm")
    inner_radius = SI("inner_radius_mm")
    outer_radius = SI("outer_radius_mm")
    length = SI("length_mm")
    time_constant = SI("time_constant_ms")

    @model_validator(mode="after")
    def _check_radii(self) -> CoilSection:
        if self.outer_radius_mm <= self.inner_radius_mm:
            raise ValueError("outer_radius_mm must exceed inner_radius_mm.")
        return self

    def compute_thermal_coil(self, safety: SafetySection) -> ThermalCoil:
        """Compute the thermal constants of the coil.

        Those that the file does not state follow from the copper of the winding and its surface in still air.

        Parameters
        ----------
        safety : SafetySection

        Returns
        -------
        ThermalCoil
        """
        stated, inner, outer = safety.coils, self.inner_radius, self.outer_radius
        length, across = self.length, math.pi * (inner + outer)
        surface = 2.0 * across * (length + outer - inner)
        return ThermalCoil(
            self.name,
            self.resistance_ohm,
            stated.heat_capacity_j_per_k
            or compute_winding_heat_capacity(self.resistance_ohm, self.turns, across, (outer - inner) * length),
            stated.thermal_resistance_k_per_w or 1.0 / (STILL_AIR_HEAT_TRANSFER * surface),
            stated.max_temperature_c,
        )


class ExcitationSection(FileModel):
    """A flat excitation coil, wound around `axis` on a bobbin of `width_mm` x `height_mm`."""

    name: Literal["x", "y"]
    center_mm: Vector
    axis: Direction
    length_mm: Positive
    width_mm: Positive
    height_mm: Positive
    turns: Positive
    time_constant_ms: NotNegative

    center = SIVector("center_mm")
    length = SI("length_mm")
    width = SI("width_mm")
    height = SI("height_mm")
    time_constant = SI("time_constant_ms")


class TableSection(FileModel):
    """Field of the actuation coils: built on a mesh, or read from a COMSOL export."""

    x_mm: Range | None = None
    y_mm: Range | None = None
    z_mm: Range | None = None
    mesh_mm: Positive = 0.5
    file: str | None = None
    current_a: Positive = 1.0
    origin_mm: Vector = (0.0, 0.0, 0.0)
    rotation_deg: float = 0.0

    @model_validator(mode="after")
    def _check_region_or_file(self) -> TableSection:
        region = [self.x_mm, self.y_mm, self.z_mm]
        if self.file is None and None in region:
            raise ValueError("give either file, or all of x_mm, y_mm and z_mm to build the table.")
        if self.file is not None and region != [None, None, None]:
            raise ValueError("give either file, or x_mm, y_mm and z_mm, not both.")
        for name in ("x_mm", "y_mm", "z_mm"):
            span = getattr(self, name)
            if span is not None and span[1] - span[0] < self.mesh_mm:
                raise ValueError(f"{name} must run from low to high over at least one mesh_mm; got {list(span)}.")
        return self


class ContainerSection(FileModel):
    """The vessel: inner walls, floor, and surface of the liquid, in the world frame.

    In m: `center` and `size` (x, y), `low` and `high` (3,): the corners of the inner space, from floor to surface.
    """

    center_mm: Range
    size_mm: tuple[Positive, Positive]
    floor_z_mm: float
    surface_z_mm: float
    wall_height_mm: Positive = 20.0

    center = SIVector("center_mm")
    size = SIVector("size_mm")
    floor_z = SI("floor_z_mm")
    surface_z = SI("surface_z_mm")
    wall_height = SI("wall_height_mm")

    @model_validator(mode="after")
    def _check_surface(self) -> ContainerSection:
        if self.surface_z_mm <= self.floor_z_mm:
            raise ValueError("surface_z_mm must lie above floor_z_mm.")
        return self

    @property
    def low(self) -> FloatArray:
        """Lowest corner (3,) of the inner space in the world frame, in m."""
        return np.array([*(self.center - 0.5 * self.size), self.floor_z])

    @property
    def high(self) -> FloatArray:
        """Highest corner (3,) of the inner space in the world frame, in m."""
        return np.array([*(self.center + 0.5 * self.size), self.surface_z])


class MediumSection(FileModel):
    """Assumed properties of the liquid; a gel where it has a yield stress. It flows at up to `flow_mm_s`."""

    name: str
    viscosity_pa_s: Positive
    density_kg_m3: Positive
    yield_stress_pa: NotNegative = 0.0
    flow_mm_s: NotNegative = 0.0

    flow = SI("flow_mm_s")

    @model_validator(mode="after")
    def _check_flow(self) -> MediumSection:
        if self.flow_mm_s > 0.0 and self.yield_stress_pa > 0.0:
            raise ValueError(f"a gel with a yield stress does not flow; got flow_mm_s = {self.flow_mm_s:g}.")
        return self


class MagnetSection(FileModel):
    """A cube magnet on a motor whose axis is steered about the vertical, near the sample or away from it.

    At angle zero its pole faces straight down. `field_mt` is the mean flux density over a turn, `distance_mm` below
    it.
    """

    side_mm: Positive
    remanence_t: Positive
    field_mt: Positive
    distance_mm: Positive
    center_mm: Vector
    max_rotation_hz: Positive
    max_steering_deg_per_s: Positive
    move_s: Positive

    side = SI("side_mm")
    distance = SI("distance_mm")
    center = SIVector("center_mm")
    max_steering_rate = SI("max_steering_deg_per_s")


class NoiseSection(FileModel):
    """The expected magnetic noise; mains amplitudes are peak values."""

    floor_pt_per_rthz: NotNegative
    at_1hz_pt_per_rthz: NotNegative
    mains_hz: Positive = 50.0
    mains_nt: NotNegative
    mains_gradient_nt_per_m: NotNegative
    harmonics: dict[str, NotNegative] = Field(default_factory=dict)
    drift_nt_per_s: NotNegative = 0.0
    constant_nt: NotNegative = 50.0

    floor, at_1hz = SI("floor_pt_per_rthz"), SI("at_1hz_pt_per_rthz")
    mains, mains_gradient = SI("mains_nt"), SI("mains_gradient_nt_per_m")
    drift, constant = SI("drift_nt_per_s"), SI("constant_nt")

    @field_validator("harmonics")
    @classmethod
    def _check_harmonics(cls, value: dict[str, float]) -> dict[str, float]:
        for key in value:
            if not key.isdigit() or int(key) < 2:
                raise ValueError(
                    f"keys are harmonic orders from 2 up, with their size relative to the first; got '{key}'."
                )
        return value


class LimitsSection(FileModel):
    """Limits of what may be commanded; each has its reason beside it in the file."""

    max_current_a: Positive
    unipolar: bool = True
    max_actuation_ms: Positive
    max_excitation_current_a: Positive
    max_excitation_ms: Positive
    min_ring_down_ms: NotNegative
    max_listen_ms: Positive


class RigFile(FileModel):
    """Content of a rig file.

    The section with the name of the file's world, such as ``[bench]``, is that world's own, which alone
    checks it. ``[tank]`` may stand in any rig file: it is what a simulation of the rig is made of.

    Attributes
    ----------
    extends : str
        A shipped rig by name, or a file by path: all that does not stand here is as there.
    world : str
        Entry point of ``smolbot.rigs`` that opens this rig.
    """

    extends: str | None = None
    name: str
    world: str
    description: str = ""
    turnaround_ms: NotNegative = 2.0
    sensors: SensorsSection
    coils: list[CoilSection] = Field(default_factory=list)
    excitation: Annotated[list[ExcitationSection], Field(min_length=1, max_length=2)]
    table: TableSection | None = None
    magnet: MagnetSection | None = None
    container: ContainerSection
    medium: MediumSection
    noise: NoiseSection
    limits: LimitsSection
    safety: SafetySection = SafetySection()
    tank: dict[str, Any] = Field(default_factory=dict)
