"""The ``[tank]`` section of a rig file: how the simulated tank differs from the model that the controller uses."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated

import numpy as np
from pydantic import Field, field_validator

from sim.tank.gel_settings import GelSettings
from sim.tank.tank_faults import parse_tank_faults
from smolbot.config.document import FileModel
from smolbot.config.mismatch import MismatchSection
from smolbot.config.units import SI, NotNegative, Positive, SIVector, Vector
from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError

MIN_DISTANCE_MM = 1.0
"""Between two points of a route: closer ones make a spline loop."""


class EarthSection(FileModel):
    """The earth's field, and the external coil that roughly cancels it in the working volume."""

    field_ut: Vector = (20.0, 0.0, -44.0)
    compensated: bool = True
    coil_distance_mm: Positive = 150.0
    coil_radius_mm: Positive = 105.0
    compensation_gain_percent: NotNegative = 3.0
    compensation_axis_deg: NotNegative = 3.0

    field = SIVector("field_ut")
    coil_distance, coil_radius = SI("coil_distance_mm"), SI("coil_radius_mm")
    compensation_gain, compensation_axis = SI("compensation_gain_percent"), SI("compensation_axis_deg")


class SurfaceSection(FileModel):
    """The liquid's surface, which holds the floating robot level and at its height."""

    meniscus_n_per_m2: NotNegative = 28.0


class FlowSection(FileModel):
    """How the liquid flows that the rig file's ``[medium]`` section gives a speed, `flow_mm_s`."""

    direction_deg: float | None = None
    rotating_percent: Annotated[float, Field(ge=0, le=100)] = 0.0

    @property
    def direction(self) -> float | None:
        """Direction of the current in rad, from world x toward y, or None if it is sampled."""
        return None if self.direction_deg is None else math.radians(self.direction_deg)


class RouteSection(FileModel):
    """A route into the container for the tip of a flexible endoscope; it returns along the same route."""

    points_mm: Annotated[list[Vector], Field(min_length=3)]
    dwell_s: NotNegative = 2.0

    points = SIVector("points_mm")

    @field_validator("points_mm")
    @classmethod
    def _check_spacing(cls, value: list[Vector]) -> list[Vector]:
        for number, (a, b) in enumerate(pairwise(value), 1):
            if math.dist(a, b) < MIN_DISTANCE_MM:
                raise ValueError(f"points {number} and {number + 1} must lie at least {MIN_DISTANCE_MM:g} mm apart.")
        return value


MIN_PIECES = 2
"""Of a shaft: each is magnetised at random."""


class ShaftSection(FileModel):
    """Magnetisation of the endoscope's shaft behind the tip."""

    tip_ut: NotNegative = 45.0
    surface_ut: NotNegative = 120.0
    radius_mm: Positive = 1.5
    length_mm: Positive = 80.0
    piece_mm: Positive = 10.0

    radius, piece = SI("radius_mm"), SI("piece_mm")

    @property
    def pieces(self) -> int:
        """Number of magnetised pieces."""
        return max(round(self.length_mm / self.piece_mm), MIN_PIECES)

    def compute_fields(self, size: float) -> tuple[float, float]:
        """Return the shaft's flux density at two places.

        Parameters
        ----------
        size : float
            Factor on the strength given in the rig file.

        Returns
        -------
        at_magnet : float, in T
        at_surface : float, in T
            At the shaft's surface.
        """
        return size * self.tip_ut * 1e-6, size * self.surface_ut * 1e-6


class OperatorSection(FileModel):
    """An operator who guides the device along routes, one after the other, all from one start point."""

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

    speed, turn_rate, torsion = SI("speed_mm_s"), SI("turn_deg_s"), SI("torsion_deg")
    tremor, tremor_turn = SI("tremor_mm"), SI("tremor_deg")
    scatter, pace_scatter, roll_scatter = SI("scatter_mm"), SI("pace_percent"), SI("roll_scatter_deg")

    @field_validator("routes")
    @classmethod
    def _check_common_start(cls, value: list[RouteSection]) -> list[RouteSection]:
        first = value[0].points_mm[0]
        for number, route in enumerate(value[1:], 2):
            if route.points_mm[0] != first:
                raise ValueError(
                    f"all routes begin at one point; the first at {list(first)}, "
                    f"number {number} at {list(route.points_mm[0])}."
                )
        return value


class PlaceSection(FileModel):
    """A fixed position for a device, such as a marker in tissue; its placement error is sampled."""

    position_mm: Vector
    scatter_mm: NotNegative = 2.0
    heading_deg: float | None = None
    pitch_scatter_deg: NotNegative = 20.0
    roll_scatter_deg: NotNegative = 30.0

    @property
    def heading(self) -> float | None:
        """Nominal heading in rad, or None if it is sampled."""
        return None if self.heading_deg is None else math.radians(self.heading_deg)

    def compute_placement(self, deviations: FloatArray) -> tuple[FloatArray, float, float]:
        """Compute a sampled placement from standard-normal samples.

        Parameters
        ----------
        deviations : ndarray, shape (4,)
            Deviations in x, y, pitch and roll, in standard deviations.

        Returns
        -------
        position : ndarray, shape (3,), in m
            World frame.
        pitch, roll : float, in rad
        """
        place = 1e-3 * (np.array(self.position_mm) + self.scatter_mm * np.array([*deviations[:2], 0.0]))
        return (
            place,
            math.radians(self.pitch_scatter_deg * deviations[2]),
            math.radians(self.roll_scatter_deg * deviations[3]),
        )


class TankSettings(FileModel):
    """All keys of the ``[tank]`` section; each has a default."""

    physics_step_ms: Annotated[float, Field(gt=0, le=5)] = 1.0
    start_scatter_mm: NotNegative = 0.5
    stop_restitution: Annotated[float, Field(ge=0, lt=1)] = 0.2
    wall_friction: NotNegative = 0.1
    earth: EarthSection = EarthSection()
    surface: SurfaceSection = SurfaceSection()
    flow: FlowSection = FlowSection()
    gel: GelSettings = GelSettings()
    mismatch: MismatchSection = MismatchSection()
    hand: OperatorSection | None = None
    place: PlaceSection | None = None
    faults: Annotated[list[str], Field(default_factory=list)]  # as `--fault` takes them

    physics_step, start_scatter = SI("physics_step_ms"), SI("start_scatter_mm")

    @field_validator("faults")
    @classmethod
    def _check_faults(cls, value: list[str]) -> list[str]:
        try:
            parse_tank_faults(value)
        except InputError as error:
            raise ValueError(str(error)) from error
        return value

    @property
    def lateness(self) -> float:
        """Standard deviation of the delay of a manual magnet move, as a fraction of its expected duration."""
        return 0.01 * self.mismatch.scale * self.gel.mismatch.lateness_percent
