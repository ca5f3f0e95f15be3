"""The ``[tank]`` section of a rig file: how the simulated tank differs from what the controller believes."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from sim.gel.settings import GelSettings
from smolbot.config import FileModel

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
