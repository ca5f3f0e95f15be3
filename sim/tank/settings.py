"""The ``[tank]`` section of a rig file: how the simulated tank differs from what the controller believes."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated

from pydantic import Field, field_validator

from sim.tank.gel_settings import GelSettings
from smolbot.config.document import FileModel

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Vector = tuple[float, float, float]


class MismatchSection(FileModel):
    """Standard deviations from which one tank is drawn; draws beyond three of them are drawn in."""

    scale: NotNegative = 1.0
    coil_place_mm: NotNegative = 0.3
    coil_axis_deg: NotNegative = 0.5
    coil_gain_percent: NotNegative = 2.0
    time_constant_percent: NotNegative = 5.0
    drag_percent: NotNegative = 5.0
    rotation_drag_percent: NotNegative = 5.0
    drag_anisotropy_percent: NotNegative = 5.0
    density_percent: NotNegative = 1.0
    moment_percent: NotNegative = 2.0
    l0_percent: NotNegative = 3.0
    theta_max_percent: NotNegative = 3.0
    damping_percent: NotNegative = 5.0
    frequency_percent: NotNegative = 0.1
    sensor_place_mm: NotNegative = 0.2
    sensor_gain_percent: NotNegative = 0.5
    sensor_axis_deg: NotNegative = 0.3
    noise_percent: NotNegative = 10.0
    mains_frequency_percent: NotNegative = 0.02


class EarthSection(FileModel):
    """The earth's field and the external coil that roughly cancels it in the working volume."""

    field_ut: Vector = (20.0, 0.0, -44.0)
    compensated: bool = True
    coil_distance_mm: Positive = 150.0
    coil_radius_mm: Positive = 105.0
    compensation_gain_percent: NotNegative = 3.0
    compensation_axis_deg: NotNegative = 3.0


class SurfaceSection(FileModel):
    """The liquid's skin, which holds the floating robot level and at its height."""

    meniscus_n_per_m2: NotNegative = 28.0


class RouteSection(FileModel):
    """A way in for the tip of a flexible endoscope; it comes back the same way."""

    points_mm: Annotated[list[Vector], Field(min_length=3)]
    dwell_s: NotNegative = 2.0

    @field_validator("points_mm")
    @classmethod
    def _apart(cls, value: list[Vector]) -> list[Vector]:
        for number, (a, b) in enumerate(pairwise(value), 1):
            if math.dist(a, b) < 1.0:
                raise ValueError(f"points {number} and {number + 1} must lie at least 1 mm apart.")
        return value


class ShaftSection(FileModel):
    """Magnetism of the endoscope behind the tip."""

    tip_ut: NotNegative = 45.0
    surface_ut: NotNegative = 120.0
    radius_mm: Positive = 1.5
    length_mm: Positive = 80.0
    piece_mm: Positive = 10.0


class HandSection(FileModel):
    """A hand that leads the device along routes, one after the other, all from one place."""

    routes: Annotated[list[RouteSection], Field(min_length=1)]
    rest_s: NotNegative = 12.0
    speed_mm_s: Positive = 12.0
    turn_deg_s: Positive = 90.0
    torsion_deg: NotNegative = 20.0
    tremor_mm: NotNegative = 0.15
    tremor_deg: NotNegative = 0.5
    tremor_hz: Positive = 9.0
    scatter_mm: NotNegative = 1.0
    pace_percent: NotNegative = 15.0
    roll_scatter_deg: NotNegative = 15.0
    shaft: ShaftSection | None = None

    @field_validator("routes")
    @classmethod
    def _one_start(cls, value: list[RouteSection]) -> list[RouteSection]:
        first = value[0].points_mm[0]
        for number, route in enumerate(value[1:], 2):
            if route.points_mm[0] != first:
                raise ValueError(
                    f"all routes begin at one point; the first at {list(first)}, "
                    f"number {number} at {list(route.points_mm[0])}."
                )
        return value


class PlaceSection(FileModel):
    """A fixed place for a device, such as a marker in tissue; what a surgeon's hand makes of it is drawn."""

    position_mm: Vector
    scatter_mm: NotNegative = 2.0
    heading_deg: float | None = None
    pitch_scatter_deg: NotNegative = 20.0
    roll_scatter_deg: NotNegative = 30.0


class TankSettings(FileModel):
    """Everything the ``[tank]`` section says; every key has a default."""

    physics_step_ms: Annotated[float, Field(gt=0, le=5)] = 1.0
    start_scatter_mm: NotNegative = 0.5
    stop_restitution: Annotated[float, Field(ge=0, lt=1)] = 0.2
    wall_friction: NotNegative = 0.1
    earth: EarthSection = EarthSection()
    surface: SurfaceSection = SurfaceSection()
    gel: GelSettings = GelSettings()
    mismatch: MismatchSection = MismatchSection()
    hand: HandSection | None = None
    place: PlaceSection | None = None
