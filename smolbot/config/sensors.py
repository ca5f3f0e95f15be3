"""Sensors of a rig: the ``[sensors]`` section, and the file of a calibrated array."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from smolbot.config.alternatives import SINGLE_AXIS
from smolbot.config.document import Document, Fault, FileModel
from smolbot.config.toml_layers import write_file
from smolbot.config.units import SI, NotNegative, Positive, Vector
from smolbot.core.arrays import FloatArray, freeze
from smolbot.core.sensing import SensorArray

DIGITS = 7
"""Of numbers in a sensors file: a nanometre of a place, a microradian of an axis."""

CORRELATION_DECIMALS = 5

WRITTEN_BY = (
    "Sensors as found on a known track (smolbot calibrate-array) or in flight (smolbot run, in its run folder).",
    'Believe them: name this file in the [sensors] section of a rig file, calibrated = "this_file.toml",',
    "or paste the section over a real bench's own. A tank is built around what stands there: only name the file.",
)
"""Comment lines with which a sensors file begins."""

EQUAL_KEYS = ("bandwidth_hz", "sensitivity_v_per_ut")
"""What a calibration takes for granted, so that it holds for no other array."""


def _check_direction(value: Vector) -> Vector:
    if not any(value):
        raise ValueError("must have a direction; got three zeros.")
    return value


Direction = Annotated[Vector, AfterValidator(_check_direction)]


class SensorsSection(FileModel):
    """Single-axis magnetometers and the converter behind them.

    `gains` are those of the single sensors relative to the sensitivity; `calibrated` names a sensors file
    whose places, axes and gains are used instead of those given here. The tolerances state how far
    sensors may deviate from these values, one standard deviation; if they are given, flights learn the deviations.

    Attributes
    ----------
    kind : str
        Entry point of ``smolbot.sensors``. A kind of a lab's own has keys of its own in place of these.
    """

    kind: str = SINGLE_AXIS
    positions_mm: Annotated[list[Vector], Field(min_length=1)]
    axes: list[Literal["x", "y", "z"] | Direction]
    gains: list[Positive] | None = None
    calibrated: str | None = None
    place_tolerance_mm: NotNegative = 0.0
    gain_tolerance_percent: NotNegative = 0.0
    axis_tolerance_deg: NotNegative = 0.0
    sample_rate_hz: Positive = 50_000.0
    bandwidth_hz: Positive = 1000.0
    range_ut: Positive = 10.0
    sensitivity_v_per_ut: Positive = 1.0
    adc_bits: Annotated[int, Field(ge=8, le=32)] = 16
    adc_range_v: Positive = 10.0

    range = SI("range_ut")
    volts_per_tesla = SI("sensitivity_v_per_ut")

    @model_validator(mode="after")
    def _check_counts(self) -> SensorsSection:
        count = len(self.positions_mm)
        if len(self.axes) != count:
            raise ValueError(f"{count} positions_mm but {len(self.axes)} axes; each sensor needs both.")
        if self.gains is not None and len(self.gains) != count:
            raise ValueError(
                f"{count} positions_mm but {len(self.gains)} gains; each sensor needs one, or leave it out."
            )
        return self

    @property
    def array(self) -> SensorArray:
        """The sensor array of this section, in SI units."""
        axes = [np.eye(3)["xyz".index(a)] if isinstance(a, str) else np.array(a) for a in self.axes]
        return SensorArray(np.array(self.positions_mm) * 1e-3, np.array(axes), self.bandwidth_hz)

    @property
    def gain_of_each(self) -> FloatArray:
        """Gains of this section, shape (n_sensors,); ones if none are given."""
        return np.ones(len(self.positions_mm)) if self.gains is None else np.array(self.gains)

    @property
    def covariance(self) -> FloatArray | None:
        """Covariance (6 n, 6 n) of all sensors' deviations from the tolerances; None without tolerances.

        For each sensor: ln gain, two tilts (rad), position (m).
        """
        tilt = np.radians(self.axis_tolerance_deg)
        one = np.array([1e-2 * self.gain_tolerance_percent, tilt, tilt, *[1e-3 * self.place_tolerance_mm] * 3])
        return np.diag(np.tile(one, len(self.positions_mm)) ** 2) if one.any() else None


class SingleAxis:
    """The kind of sensors of a rig file that names none; keeps `smolbot.config.plugin_protocols.SensorKind`."""

    section = SensorsSection

    @staticmethod
    def expand(section: SensorsSection) -> dict[str, Any]:
        """Return the content of the section.

        Parameters
        ----------
        section : SensorsSection

        Returns
        -------
        dict
            The section as it is: its sensors have one axis each.
        """
        return section.model_dump(mode="json", exclude_none=True)


class UncertaintySection(FileModel):
    """One standard deviation of every value, and how it was determined.

    A calibration states the errors on held-out poses (rms per axis, before and after). A flight states how many
    recordings were used, and the `correlations` between all values: a lower triangle, in the order gain, two tilts,
    position of each sensor.
    """

    positions_mm: list[tuple[NotNegative, NotNegative, NotNegative]]
    axes_deg: list[tuple[NotNegative, NotNegative]]
    gains: list[NotNegative]
    held_out: int | None = None
    position_mm: tuple[float, float] | None = None
    orientation_deg: tuple[float, float] | None = None
    recordings: int | None = None
    correlations: list[list[float]] | None = None

    @model_validator(mode="after")
    def _check_triangle(self) -> UncertaintySection:
        n, rows = len(self.positions_mm), self.correlations
        if len(self.axes_deg) != n or len(self.gains) != n:
            counts = f"{n} positions_mm, {len(self.axes_deg)} axes_deg and {len(self.gains)} gains"
            raise ValueError(f"{counts}; each sensor needs all three.")
        if rows is not None and [len(row) for row in rows] != list(range(1, 6 * n + 1)):
            raise ValueError(f"correlations must be {6 * n} rows of 1, 2, … {6 * n} numbers: six values a sensor.")
        return self

    @property
    def covariance(self) -> FloatArray | None:
        """Covariance (6 n, 6 n) of all values; None without correlations.

        For each sensor: ln gain, two tilts (rad), position (m).
        The errors of a calibration are strongly correlated. Without the correlations a covariance would be much too
        wide, and a flight would move the sensors relative to each other.
        """
        if self.correlations is None:
            return None
        tilts, places = np.radians(np.array(self.axes_deg)), 1e-3 * np.array(self.positions_mm)
        deviations = np.column_stack([self.gains, tilts, places]).ravel()
        n = len(deviations)
        full = np.zeros((n, n))
        full[np.tril_indices(n)] = np.concatenate([np.array(row) for row in self.correlations])
        full += np.tril(full, -1).T
        values, vectors = np.linalg.eigh(full)  # rounded numbers need not make a positive matrix
        full = (vectors * np.maximum(values, 0.0)) @ vectors.T
        covariance: FloatArray = full * np.outer(deviations, deviations)
        return covariance

    @classmethod
    def from_covariance(cls, covariance: FloatArray, recordings: int) -> UncertaintySection:
        """Build the section from a covariance that a flight estimated.

        Parameters
        ----------
        covariance : ndarray, shape (6 n, 6 n)
            For each sensor: ln gain, two tilts (rad), position (m).
        recordings : int
            Number of recordings that were used.

        Returns
        -------
        UncertaintySection
        """
        deviations = np.sqrt(np.diag(covariance))
        full = covariance / np.maximum(np.outer(deviations, deviations), 1e-300)
        by_sensor = deviations.reshape(-1, 6)
        return cls(
            positions_mm=[(float(x), float(y), float(z)) for x, y, z in 1e3 * by_sensor[:, 3:]],
            axes_deg=[(float(a), float(b)) for a, b in np.degrees(by_sensor[:, 1:3])],
            gains=by_sensor[:, 0].tolist(),
            recordings=recordings,
            correlations=[full[i, : i + 1].tolist() for i in range(len(full))],
        )


class SensorsFile(FileModel):
    """All keys and sections of a sensors file."""

    rig: str
    date: datetime.date
    description: str = ""
    sensors: SensorsSection
    uncertainty: UncertaintySection | None = None


@dataclass(frozen=True, eq=False)
class CalibratedSensors:
    """A calibrated sensor array.

    Attributes
    ----------
    array : SensorArray
        Positions and axes in the world frame, in m.
    gains : ndarray, shape (n_sensors,)
        Relative to the sensitivity.
    covariance : ndarray, shape (6 n, 6 n), or None
        Of the remaining deviations: ln gain, two tilts (rad) and position (m) of each sensor; None if not known.
    """

    array: SensorArray
    gains: FloatArray
    covariance: FloatArray | None = None


def load_sensors(path: Path, rig: str, section: SensorsSection) -> CalibratedSensors:
    """Read a sensors file and check that it belongs to the rig.

    Parameters
    ----------
    path : Path
    rig : str
        Name of the rig.
    section : SensorsSection
        Sensors section of the rig file.

    Returns
    -------
    CalibratedSensors

    Raises
    ------
    ConfigError
        With ``file:line: key`` for every fault, and if the file belongs to another rig.
    MissingFileError
        If there is no such file.
    """
    document = Document.read(path)
    sections = document.validated(SensorsFile)
    found, faults = sections.sensors, []
    if sections.rig != rig:
        faults.append(Fault(("rig",), f"these sensors were calibrated on rig '{sections.rig}'; asked for is '{rig}'."))
    if len(found.positions_mm) != len(section.positions_mm):
        counts = f"holds {len(found.positions_mm)} sensors; rig '{rig}' has {len(section.positions_mm)}."
        faults.append(Fault(("sensors", "positions_mm"), counts))
    if found.calibrated is not None:
        faults.append(Fault(("sensors", "calibrated"), "a sensors file cannot name another one."))
    for key in EQUAL_KEYS:
        if getattr(found, key) != getattr(section, key):
            differ = f"was {getattr(found, key):g} in the calibration; rig '{rig}' has {getattr(section, key):g}."
            faults.append(Fault(("sensors", key), f"{differ} Calibrate anew."))
    if faults:
        raise document.error(faults)
    uncertainty = sections.uncertainty
    if uncertainty is not None and len(uncertainty.positions_mm) != len(found.positions_mm):
        counts = f"holds {len(uncertainty.positions_mm)} sensors; [sensors] holds {len(found.positions_mm)}."
        raise document.error([Fault(("uncertainty", "positions_mm"), counts)])
    covariance = None if uncertainty is None else uncertainty.covariance
    return CalibratedSensors(found.array, freeze(found.gain_of_each), covariance)


def write_sensors(path: str | Path, config: SensorsFile) -> None:
    """Write a sensors file that `load_sensors` reads back.

    Parameters
    ----------
    path : str or Path
    config : SensorsFile

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    s, u = config.sensors, config.uncertainty
    own = ("positions_mm", "axes", "gains", "sample_rate_hz", "bandwidth_hz", "range_ut", "sensitivity_v_per_ut",
           "adc_bits", "adc_range_v")  # fmt: skip
    tables = {
        "": [("rig", config.rig, ""), ("date", config.date, ""), ("description", config.description or None, "")],
        "sensors": [(key, _rounded(getattr(s, key), DIGITS), "") for key in own],
    }
    if u is not None:
        rows = u.correlations
        correlations = None if rows is None else [[round(value, CORRELATION_DECIMALS) for value in row] for row in rows]
        of_each = "one standard deviation; axes about two directions across each"
        held_out = "recordings that took no part; errors (rms per axis) before and after:"
        tables["uncertainty"] = [
            ("positions_mm", _rounded(u.positions_mm, DIGITS), of_each),
            ("axes_deg", _rounded(u.axes_deg, DIGITS), ""),
            ("gains", _rounded(u.gains, DIGITS), ""),
            ("held_out", u.held_out, held_out),
            ("position_mm", _rounded(u.position_mm, DIGITS), ""),
            ("orientation_deg", _rounded(u.orientation_deg, DIGITS), ""),
            ("recordings", u.recordings, "of one flight, from which this was learned"),
            ("correlations", correlations, "gain, two tilts, place of each sensor"),
        ]
    write_file(path, WRITTEN_BY, tables)


def _rounded(value: Any, digits: int) -> Any:
    """Numbers, in whatever lists, to so many digits."""
    if isinstance(value, list | tuple):
        return [_rounded(each, digits) for each in value]
    return float(f"{value:.{digits}g}") if isinstance(value, float) else value
