"""The ``[tank.gel]`` section of a rig file: gel, plates and magnet stage as the controller does not know them."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from smolbot.config.document import FileModel
from smolbot.config.units import SI, NotNegative, Point, Positive, SIVector


class Inclusion(FileModel):
    """A round piece of stiffer gel, from floor to plate, that the controller does not know of."""

    center_mm: Point
    radius_mm: Positive
    factor: Annotated[float, Field(ge=1)]

    center, radius = SIVector("center_mm"), SI("radius_mm")


class GelMismatch(FileModel):
    """Standard deviations of the gel's mismatches, scaled by ``[tank.mismatch] scale`` like all others."""

    yield_percent: NotNegative = 5.0
    viscosity_percent: NotNegative = 8.0
    anisotropy_percent: NotNegative = 5.0
    pitch_percent: NotNegative = 2.0
    cutting_percent: NotNegative = 20.0
    friction_percent: NotNegative = 20.0
    remanence_percent: NotNegative = 1.5
    magnet_place_mm: NotNegative = 1.0
    magnet_axis_deg: NotNegative = 1.0
    steering_deg: NotNegative = 1.5
    home_deg: NotNegative = 3.0
    lateness_percent: NotNegative = 20.0

    strength, viscosity, anisotropy = SI("yield_percent"), SI("viscosity_percent"), SI("anisotropy_percent")
    pitch, cutting, friction = SI("pitch_percent"), SI("cutting_percent"), SI("friction_percent")
    remanence, magnet_place, magnet_axis = SI("remanence_percent"), SI("magnet_place_mm"), SI("magnet_axis_deg")
    steering, home = SI("steering_deg"), SI("home_deg")


class GelSettings(FileModel):
    """All keys of the ``[tank.gel]`` section; each has a default."""

    thread_hold: Positive = 4.0
    bearing: Positive = 7.0
    nose_bearing: Positive = 9.0
    way_back: NotNegative = 0.3
    plate_stiffness_n_per_m: Positive = 1000.0
    plate_friction: NotNegative = 0.1
    step_ms: Annotated[float, Field(gt=0, le=5)] = 2.0
    start_heading_deg: NotNegative = 3.0
    inclusions: list[Inclusion] = Field(default_factory=list)
    mismatch: GelMismatch = GelMismatch()

    step, start_heading = SI("step_ms"), SI("start_heading_deg")
