"""The rig file: sensors, coils, container and limits of one setup, simulated or real."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.config.alternatives import SINGLE_AXIS
from smolbot.config.document import Document, Fault, FileModel, Model, validate
from smolbot.config.library import open_file
from smolbot.config.mismatch import MismatchSection
from smolbot.config.plugins import list_plugins, load_plugin, load_world
from smolbot.config.rig_geometry import find_geometry_faults
from smolbot.config.rig_sections import MagnetSection, Range, RigFile
from smolbot.config.sensors import CalibratedSensors, load_sensors
from smolbot.core.arrays import FloatArray, freeze
from smolbot.core.coil_heat import ThermalCoil
from smolbot.core.limits import Limits
from smolbot.core.sensing import SensorArray
from smolbot.errors import ConfigError, InputError, PluginError, report_plugin_errors, suggest_name

if TYPE_CHECKING:
    from lookup_tables import FieldTable, FlatCoil, RoundCoil
    from smolbot.config.plugin_protocols import SensorKind


class RigConfig:
    """A checked rig file: its sections in SI units, and the field table that it describes.

    Parameters
    ----------
    document : Document
        The rig file.
    sections : RigFile
    """

    def __init__(self, document: Document, sections: RigFile) -> None:
        self.document = document
        self.sections = sections
        self.name = sections.name
        self.world = sections.world
        self.container = sections.container
        self.turnaround = sections.turnaround_ms * 1e-3

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names of the actuation coils, in the order of the rig file."""
        return tuple(coil.name for coil in self.sections.coils)

    @cached_property
    def calibrated(self) -> CalibratedSensors:
        """The assumed array and gains, from the sensors file if the rig file names one."""
        section, path = self.sections.sensors, self.sensors_file
        if path is None:
            return CalibratedSensors(section.array, freeze(section.gain_of_each), section.covariance)
        return load_sensors(path, self.name, section)

    @property
    def sensors_file(self) -> Path | None:
        """Path of the sensors file, relative to the rig file or else to the working directory; None without one."""
        name = self.sections.sensors.calibrated
        if name is None:
            return None
        beside = self.document.folder(("sensors", "calibrated")) / name
        return beside if beside.is_file() else Path(name)

    @property
    def sensors(self) -> SensorArray:
        """The assumed sensor array, in the world frame."""
        return self.calibrated.array

    @property
    def sensor_gains(self) -> FloatArray:
        """Assumed gains relative to the sensitivity, shape (n_sensors,); a recording in T is divided by them."""
        return self.calibrated.gains

    @property
    def sensor_covariance(self) -> FloatArray | None:
        """Covariance (6 n, 6 n) of the sensors' deviations from what is assumed, see `array_filter.ArrayPrior`.

        It comes from the sensors file, if the rig file names one; else from the tolerances of the rig file. None
        where neither states any, and for a sensors file without correlations, as a stage calibration writes it.
        """
        section = self.sections.sensors
        return self.calibrated.covariance if section.calibrated is not None else section.covariance

    @property
    def may_leave_out_sensors(self) -> bool:
        """Whether a flight goes on without a sensor that fails: a tank unless its rig file says otherwise."""
        said = self.sections.safety.may_leave_out_sensors
        return self.world == "tank" if said is None else said

    @property
    def sample_rate(self) -> float:
        """Samples per second of each sensor, in Hz."""
        return self.sections.sensors.sample_rate_hz

    @property
    def sensor_range(self) -> float:
        """Largest field that a sensor measures, and its converter takes, in T."""
        section = self.sections.sensors
        return min(section.range, section.adc_range_v / section.volts_per_tesla)

    @property
    def converter_step(self) -> float:
        """Smallest step of the analog-to-digital converter, in T."""
        section = self.sections.sensors
        return 2.0 * section.adc_range_v / section.volts_per_tesla / 2**section.adc_bits

    @cached_property
    def limits(self) -> Limits:
        """Limits of coils, timing and magnet, in SI units."""
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

    def raw_section(self, world: str) -> dict[str, Any]:
        """Look up the section that a world keeps to itself, such as ``[bench]``.

        Parameters
        ----------
        world : str
            Its name.

        Returns
        -------
        dict
            As written in the file, unchecked; empty without one.
        """
        section = self.document.data.get(world)
        return section if isinstance(section, dict) else {}

    def section_of(self, world: str, model: type[Model]) -> Model:
        """Validate the section that only one world uses, such as ``[tank]`` or ``[bench]``.

        Parameters
        ----------
        world : str
            Name of the world and of its section.
        model : type of FileModel

        Returns
        -------
        FileModel
            The section as `model`.

        Raises
        ------
        ConfigError
            With every fault of the section.
        """
        section, faults = self.document.section(world, model)
        if section is None:
            raise self.document.error(faults)
        return section

    @cached_property
    def mismatch(self) -> MismatchSection:
        """By how much the rig may differ from its file; the defaults where ``[tank.mismatch]`` does not stand there.

        Raises
        ------
        ConfigError
            With every fault of the section.
        """
        section, faults = validate(MismatchSection, self.sections.tank.get("mismatch", {}), ("tank", "mismatch"))
        if section is None:
            raise self.document.error(faults)
        return section

    @property
    def driven(self) -> tuple[str, ...]:
        """Names of all driven coils as used in messages: actuation coils, then ``excitation x``."""
        return (*self.coil_names, *(f"excitation {coil.name}" for coil in self.sections.excitation))

    @property
    def time_constants(self) -> list[float]:
        """Time constants of all driven coils, in s."""
        return [c.time_constant for c in self.sections.coils] + [c.time_constant for c in self.sections.excitation]

    @property
    def coil_resistances(self) -> FloatArray:
        """Resistances of the actuation coils, shape (n_coils,), in ohm."""
        return np.array([coil.resistance_ohm for coil in self.sections.coils])

    @property
    def thermal(self) -> tuple[ThermalCoil | None, ...]:
        """Thermal constants of actuation, then excitation coils; None for coils where they are not known."""
        safety = self.sections.safety
        own = tuple(coil.compute_thermal_coil(safety) for coil in self.sections.coils)
        return (*own, *(safety.excitation.make_thermal_coil(f"excitation {c.name}") for c in self.sections.excitation))

    @property
    def surface_z(self) -> float:
        """Height of the liquid's surface in the world frame, in m."""
        return self.container.surface_z

    def round_coils(self) -> tuple[RoundCoil, ...]:
        """Build the actuation coils with their nominal geometry.

        Returns
        -------
        tuple of RoundCoil
        """
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
        """Build the excitation coils with their nominal geometry; widths lie in the horizontal plane.

        Returns
        -------
        tuple of FlatCoil
        """
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
            path = self.document.folder(("table", "file")) / section.file
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
        axes = [make_mesh_axis(span, section.mesh_mm) for span in spans]
        try:
            return cached_table(self.round_coils(), *axes)
        except TableError as error:
            raise self.document.error([Fault(("table",), str(error))]) from error

    def table(self) -> FieldTable:
        """Return the field table of the actuation coils: read from a file, or built once and cached.

        Returns
        -------
        FieldTable
            In the world frame.

        Raises
        ------
        ConfigError
            If the rig has no ``[table]``, or the table cannot be read or built.
        """
        return self._table


def make_mesh_axis(span_mm: Range, mesh_mm: float) -> FloatArray:
    """Make equally spaced points that cover a span.

    Parameters
    ----------
    span_mm : tuple of float, in mm
        Lowest and highest point.
    mesh_mm : float, in mm
        Largest distance of two points.

    Returns
    -------
    ndarray, shape (n,), in m
    """
    count = int(np.ceil((span_mm[1] - span_mm[0]) / mesh_mm - 1e-9)) + 1
    return np.linspace(span_mm[0], span_mm[1], count) * 1e-3


def load_rig(name: str, settings: dict[str, str] | None = None) -> RigConfig:
    """Read a shipped rig by name, or a user's by path. Every fault of the file is reported at once.

    Parameters
    ----------
    name : str
        A shipped rig, or the path of a file.
    settings : dict, optional
        Settings that override the file: ``{"turnaround_ms": "5.0"}``.

    Returns
    -------
    RigConfig

    Examples
    --------
    >>> import smolbot
    >>> rig = smolbot.load_rig("tank", {"turnaround_ms": "5.0"})
    >>> len(rig.sensors), rig.turnaround
    (10, 0.005)
    """
    document = open_file(name, "rigs")
    if settings:
        document = document.override(settings, "rig.")
    faults = _expand_sensors(document)
    sections, of_file = validate(RigFile, _without_own_section(document))
    known = {fault.key for fault in faults}
    faults += [_of_world(document, fault) for fault in of_file if fault.key not in known] + _find_world_faults(document)
    if sections is not None and not faults:
        faults = find_geometry_faults(sections)
    if sections is None or faults:
        raise document.error(faults)
    config = RigConfig(document, sections)
    if sections.sensors.calibrated is not None:
        _ = config.calibrated  # its faults are reported before anything opens
    return config


def _expand_sensors(document: Document) -> list[Fault]:
    """Put the single-axis sensors that a lab's own kind amounts to in the place of its section; faults of that."""
    section = document.data.get("sensors")
    kind = section.get("kind", SINGLE_AXIS) if isinstance(section, dict) else SINGLE_AXIS
    if kind == SINGLE_AXIS or not isinstance(section, dict):
        return []
    known = list_plugins("sensors")
    if kind not in known:
        message = f"no kind of sensor is named '{kind}'; installed: {', '.join(known)}."
        return [Fault(("sensors", "kind"), message + suggest_name(str(kind), known))]
    plugin: SensorKind = load_plugin("sensors", kind)
    given, faults = validate(plugin.section, {k: v for k, v in section.items() if k != "kind"}, ("sensors",))
    if given is None:
        return faults
    try:
        with report_plugin_errors("Kind of sensors", plugin, "expand"):
            document.data["sensors"] = _expand(plugin, given)
    except ValueError as error:
        return [Fault(("sensors",), str(error))]
    return []


def _expand(plugin: SensorKind, section: FileModel) -> dict[str, Any]:
    """Let a kind of sensors expand its section; what is wrong with its values is a fault of the file."""
    try:
        found = plugin.expand(section)
    except ValueError as error:
        raise InputError(str(error)) from error
    return dict(found)


def _without_own_section(document: Document) -> dict[str, Any]:
    """Content of the file without its world's own section."""
    world = document.data.get("world")
    return {key: value for key, value in document.data.items() if key != world or key in RigFile.model_fields}


def _of_world(document: Document, fault: Fault) -> Fault:
    """Explain an unknown section that has the name of another world."""
    name, world = str(fault.key[0]) if fault.key else "", document.data.get("world")
    if len(fault.key) != 1 or name in RigFile.model_fields or name not in list_plugins("rigs"):
        return fault
    return Fault(
        fault.key, f"[{name}] is of world '{name}', and this rig is of world '{world}': leave one of them out."
    )


def _find_world_faults(document: Document) -> list[Fault]:
    """Find faults of the section that only its own world can check."""
    world = document.data.get("world")
    if not isinstance(world, str):
        return []
    plugin = load_world(world, document)
    with report_plugin_errors("World", plugin, "check"):
        faults = list(plugin.check(document))
    strange = [fault for fault in faults if not isinstance(fault, Fault)]
    if strange:
        raise PluginError(f"World '{world}': check() must return a list of Fault; got {strange[0]!r} in it.")
    return faults
