"""The rig file: sensors, coils, container and limits of one setup, simulated or real."""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from smolbot.config.document import Document, Fault, FileModel, Model, validate
from smolbot.config.library import find_file
from smolbot.config.plugins import load_world
from smolbot.config.safety_section import SafetySection
from smolbot.config.sensors import CalibratedSensors, Direction, SensorsSection, load_sensors
from smolbot.config.units import SI, NotNegative, Positive, SIVector, Vector
from smolbot.core.arrays import FloatArray, frozen
from smolbot.core.coil_heat import FILM, Coil, wound_capacity
from smolbot.core.limits import Limits
from smolbot.core.sensing import SensorArray
from smolbot.errors import ConfigError

if TYPE_CHECKING:
    from lookup_tables import FieldTable, FlatCoil, RoundCoil

Range = tuple[float, float]


class CoilSection(FileModel):
    """A round actuation coil with an air core; `axis` is its field's direction at its centre for positive current."""

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
    def _radii_in_order(self) -> CoilSection:
        if self.outer_radius_mm <= self.inner_radius_mm:
            raise ValueError("outer_radius_mm must exceed inner_radius_mm.")
        return self

    def thermal(self, safety: SafetySection) -> Coil:
        """Its thermal constants: as stated, else of its copper and of its surface in still air."""
        stated, inner, outer = safety.coils, self.inner_radius, self.outer_radius
        length, across = self.length, math.pi * (inner + outer)
        surface = 2.0 * across * (length + outer - inner)
        return Coil(
            self.name,
            self.resistance_ohm,
            stated.heat_capacity_j_per_k
            or wound_capacity(self.resistance_ohm, self.turns, across, (outer - inner) * length),
            stated.thermal_resistance_k_per_w or 1.0 / (FILM * surface),
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
    def _region_or_file(self) -> TableSection:
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
    """The vessel: inner walls, floor, and the liquid's surface, in the world frame.

    In m: `center` and `size` (x, y), `low` and `high` (3,): the corners of what is inside, from floor to surface.
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
    def _surface_above_floor(self) -> ContainerSection:
        if self.surface_z_mm <= self.floor_z_mm:
            raise ValueError("surface_z_mm must lie above floor_z_mm.")
        return self

    @property
    def low(self) -> FloatArray:
        return np.array([*(self.center - 0.5 * self.size), self.floor_z])

    @property
    def high(self) -> FloatArray:
        return np.array([*(self.center + 0.5 * self.size), self.surface_z])


class MediumSection(FileModel):
    """The liquid, as it is believed to be; a gel where it has a yield stress."""

    name: str
    viscosity_pa_s: Positive
    density_kg_m3: Positive
    yield_stress_pa: NotNegative = 0.0


class MagnetSection(FileModel):
    """A cube magnet on a motor whose axis is steered about the vertical, near the sample or away from it.

    At a turn of zero its pole looks straight down. `field_mt` is its mean size over a turn, `distance_mm` below.
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
    """The magnetic noise that is expected; sizes at 50 Hz are peak."""

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
    def _orders(cls, value: dict[str, float]) -> dict[str, float]:
        for key in value:
            if not key.isdigit() or int(key) < 2:
                raise ValueError(
                    f"keys are harmonic orders from 2 up, with their size relative to the first; got '{key}'."
                )
        return value


class LimitsSection(FileModel):
    """What may be asked of the hardware; each limit has its reason beside it in the file."""

    max_current_a: Positive
    unipolar: bool = True
    max_actuation_ms: Positive
    max_excitation_current_a: Positive
    max_excitation_ms: Positive
    min_ring_down_ms: NotNegative
    max_listen_ms: Positive


class RigFile(FileModel):
    """Everything a rig file says. World-specific sections (such as ``[tank]``) are checked by that world."""

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
    bench: dict[str, Any] = Field(default_factory=dict)


class RigConfig:
    """A rig file that holds together: its sections in SI, and the field tables it describes."""

    def __init__(self, document: Document, sections: RigFile) -> None:
        self.document = document
        self.sections = sections
        self.name = sections.name
        self.world = sections.world
        self.container = sections.container
        self.turnaround = sections.turnaround_ms * 1e-3

    @property
    def coil_names(self) -> tuple[str, ...]:
        return tuple(coil.name for coil in self.sections.coils)

    @cached_property
    def calibrated(self) -> CalibratedSensors:
        """The array and its gains as they are believed: of the sensors file, if the rig file names one."""
        section, path = self.sections.sensors, self.sensors_file
        if path is None:
            return CalibratedSensors(section.array, frozen(section.gain_of_each), section.covariance)
        return load_sensors(path, self.name, section)

    @property
    def sensors_file(self) -> Path | None:
        """The sensors file that the rig file names, beside it or from where we are."""
        name = self.sections.sensors.calibrated
        if name is None:
            return None
        beside = self.document.path.parent / name
        return beside if beside.is_file() else Path(name)

    @property
    def sensors(self) -> SensorArray:
        """The array as it is believed to stand."""
        return self.calibrated.array

    @property
    def sensor_gains(self) -> FloatArray:
        """Believed gains relative to the sensitivity, shape (n_sensors,); a recording in T is divided by them."""
        return self.calibrated.gains

    @property
    def sensor_covariance(self) -> FloatArray | None:
        """How far the sensors may be off what is believed: covariance (6 n, 6 n), see `array_filter.ArrayBelief`.

        Of the sensors file, if the rig file names one; else by the tolerances that stand in the rig file. None where
        neither says anything, and for a file without correlations, as a stage calibration writes it.
        """
        section = self.sections.sensors
        return self.calibrated.covariance if section.calibrated is not None else section.covariance

    @property
    def sample_rate(self) -> float:
        return self.sections.sensors.sample_rate_hz

    @cached_property
    def limits(self) -> Limits:
        section, magnet = self.sections.limits, self.sections.magnet
        return Limits(
            coils=self.coil_names,
            max_current=section.max_current_a,
            unipolar=section.unipolar,
            max_actuation=section.max_actuation_ms * 1e-3,
            max_excitation_current=section.max_excitation_current_a,
            max_excitation=section.max_excitation_ms * 1e-3,
            min_ring_down=section.min_ring_down_ms * 1e-3,
            max_listen=section.max_listen_ms * 1e-3,
            max_rotation_frequency=0.0 if magnet is None else magnet.max_rotation_hz,
            max_steering_rate=0.0 if magnet is None else magnet.max_steering_rate,
        )

    @property
    def magnet(self) -> MagnetSection:
        """The rotating magnet.

        Raises
        ------
        ConfigError
            If this rig has none.
        """
        if self.sections.magnet is None:
            raise self.document.error([Fault(("magnet",), "this rig has no [magnet]; a helical robot needs one.")])
        return self.sections.magnet

    def section_of(self, world: str, model: type[Model]) -> Model:
        """The section that a world keeps to itself, ``[tank]`` or ``[bench]``, as `model`.

        Raises
        ------
        ConfigError
            With every fault of it.
        """
        section, faults = validate(model, getattr(self.sections, world), (world,))
        if section is None:
            raise self.document.error(faults)
        return section

    @property
    def driven(self) -> tuple[str, ...]:
        """Names of all coils as messages call them: actuation, then ``excitation x``."""
        return (*self.coil_names, *(f"excitation {coil.name}" for coil in self.sections.excitation))

    @property
    def time_constants(self) -> list[float]:
        """Of all coils that are driven, in s."""
        return [c.time_constant for c in self.sections.coils] + [c.time_constant for c in self.sections.excitation]

    @property
    def coil_resistances(self) -> FloatArray:
        """Of the actuation coils, shape (n_coils,), in ohm."""
        return np.array([coil.resistance_ohm for coil in self.sections.coils])

    @property
    def thermal(self) -> tuple[Coil | None, ...]:
        """Thermal constants of actuation and excitation coils, in the rig's order; None where they are not known."""
        safety = self.sections.safety
        own = tuple(coil.thermal(safety) for coil in self.sections.coils)
        return (*own, *(safety.excitation.thermal(f"excitation {c.name}") for c in self.sections.excitation))

    @property
    def surface_z(self) -> float:
        """Height of the liquid's surface in the world frame, in m."""
        return self.container.surface_z

    def round_coils(self) -> tuple[RoundCoil, ...]:
        """The actuation coils, nominal."""
        from lookup_tables import RoundCoil

        return tuple(
            RoundCoil(
                name=c.name,
                center=c.center,
                axis=np.array(c.axis, dtype=float),
                inner_radius=c.inner_radius,
                outer_radius=c.outer_radius,
                length=c.length,
                turns=c.turns,
            )
            for c in self.sections.coils
        )

    def flat_coils(self) -> tuple[FlatCoil, ...]:
        """The excitation coils, nominal; widths lie in the horizontal plane."""
        from lookup_tables import FlatCoil

        return tuple(
            FlatCoil(
                name=c.name,
                center=c.center,
                axis=np.array(c.axis, dtype=float),
                length=c.length,
                width=c.width,
                height=c.height,
                width_direction=np.cross([0.0, 0.0, 1.0], c.axis),
                turns=c.turns,
            )
            for c in self.sections.excitation
        )

    @cached_property
    def _table(self) -> FieldTable:
        from lookup_tables import FieldTable, TableError, cached_table

        section = self.sections.table
        if section is None:
            raise self.document.error([Fault(("table",), "this rig has no [table]; a gradient mission needs one.")])
        if section.file is not None:
            path = self.document.path.parent / section.file
            turn = np.radians(section.rotation_deg)
            rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
            try:
                table = FieldTable.read(
                    path,
                    current=section.current_a,
                    origin=np.array(section.origin_mm) * 1e-3,
                    rotation=rotation,
                )
            except TableError as error:
                raise ConfigError(str(error)) from error
            if self.coil_names and table.n_coils != len(self.coil_names):
                ours = f"{len(self.coil_names)} ({', '.join(self.coil_names)})"
                message = f"{path.name} holds {table.n_coils} coils; this rig file lists {ours}."
                raise self.document.error([Fault(("table", "file"), message)])
            return table
        spans = [span for span in (section.x_mm, section.y_mm, section.z_mm) if span is not None]
        axes = [mesh_axis(span, section.mesh_mm) for span in spans]
        try:
            return cached_table(self.round_coils(), *axes)
        except TableError as error:
            raise self.document.error([Fault(("table",), str(error))]) from error

    def table(self) -> FieldTable:
        """Field table of the actuation coils: read, or built once and cached."""
        return self._table


def mesh_axis(span_mm: Range, mesh_mm: float) -> FloatArray:
    """Equally spaced points in m that cover `span_mm`, at most `mesh_mm` apart."""
    count = int(np.ceil((span_mm[1] - span_mm[0]) / mesh_mm - 1e-9)) + 1
    return np.linspace(span_mm[0], span_mm[1], count) * 1e-3


def load_rig(name: str, settings: dict[str, str] | None = None) -> RigConfig:
    """Read a shipped rig by name, or a user's by path. Every fault of the file is reported at once."""
    document = Document.read(find_file(name, "rigs"))
    if settings:
        document = document.override(settings, "rig.")
    sections, faults = document.validate(RigFile)
    faults += _world_faults(document)
    if sections is None or faults:
        raise document.error(faults)
    config = RigConfig(document, sections)
    if sections.sensors.calibrated is not None:
        _ = config.calibrated  # its faults are told before anything opens
    return config


def _world_faults(document: Document) -> list[Fault]:
    """Faults of the section that only its own world can check."""
    world = document.data.get("world")
    if not isinstance(world, str):
        return []
    faults: list[Fault] = load_world(world, document).check(document)
    return faults
