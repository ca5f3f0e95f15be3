"""Sensors of a rig: the ``[sensors]`` section, and the file of an array as it was calibrated."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from smolbot.arrays import FloatArray, frozen
from smolbot.config import Document, Fault, FileModel
from smolbot.errors import InputError
from smolbot.sensing import SensorArray

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Vector = tuple[float, float, float]

SAME = ("bandwidth_hz", "sensitivity_v_per_ut")
"""What a calibration takes for granted, so that it holds for no other array."""


def _points_somewhere(value: Vector) -> Vector:
    if not any(value):
        raise ValueError("must have a direction; got three zeros.")
    return value


Direction = Annotated[Vector, AfterValidator(_points_somewhere)]


class SensorsSection(FileModel):
    """Single-axis magnetometers and the converter behind them.

    `gains` are those of the single sensors relative to the sensitivity; `calibrated` names a sensors file
    whose places, axes and gains are believed instead of those that stand here.
    """

    positions_mm: Annotated[list[Vector], Field(min_length=1)]
    axes: list[Literal["x", "y", "z"] | Direction]
    gains: list[Positive] | None = None
    calibrated: str | None = None
    sample_rate_hz: Positive = 50_000.0
    bandwidth_hz: Positive = 1000.0
    range_ut: Positive = 10.0
    sensitivity_v_per_ut: Positive = 1.0
    adc_bits: Annotated[int, Field(ge=8, le=32)] = 16
    adc_range_v: Positive = 10.0

    @model_validator(mode="after")
    def _one_of_each(self) -> SensorsSection:
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
        """The array that stands here, in SI."""
        axes = [np.eye(3)["xyz".index(a)] if isinstance(a, str) else np.array(a) for a in self.axes]
        return SensorArray(np.array(self.positions_mm) * 1e-3, np.array(axes), self.bandwidth_hz)

    @property
    def gain_of_each(self) -> FloatArray:
        """Gains that stand here, shape (n_sensors,); ones if none are given."""
        return np.ones(len(self.positions_mm)) if self.gains is None else np.array(self.gains)


class UncertaintySection(FileModel):
    """One standard deviation of every calibrated value, and what held-out poses said (rms per axis)."""

    positions_mm: list[Vector]
    axes_deg: list[tuple[float, float]]
    gains: list[NotNegative]
    held_out: int
    position_mm: tuple[float, float]
    orientation_deg: tuple[float, float]


class SensorsFile(FileModel):
    """Everything a sensors file says."""

    rig: str
    date: datetime.date
    description: str = ""
    sensors: SensorsSection
    uncertainty: UncertaintySection | None = None


@dataclass(frozen=True, eq=False)
class CalibratedSensors:
    """An array as it was calibrated: places and axes, and the gain of each sensor, shape (n_sensors,)."""

    array: SensorArray
    gains: FloatArray


def load_sensors(path: Path, rig: str, believed: SensorsSection) -> CalibratedSensors:
    """Read a sensors file that must have been made for the rig of that name, with the array `believed`.

    Raises
    ------
    ConfigError
        With ``file:line: key`` for every fault, and if the file is another rig's.
    MissingFileError
        If there is no such file.
    """
    document = Document.read(path)
    sections, faults = document.validate(SensorsFile)
    if sections is None:
        raise document.error(faults)
    found = sections.sensors
    if sections.rig != rig:
        faults.append(Fault(("rig",), f"these sensors were calibrated on rig '{sections.rig}'; asked for is '{rig}'."))
    if len(found.positions_mm) != len(believed.positions_mm):
        counts = f"holds {len(found.positions_mm)} sensors; rig '{rig}' has {len(believed.positions_mm)}."
        faults.append(Fault(("sensors", "positions_mm"), counts))
    if found.calibrated is not None:
        faults.append(Fault(("sensors", "calibrated"), "a sensors file cannot name another one."))
    for key in SAME:
        if getattr(found, key) != getattr(believed, key):
            differ = f"was {getattr(found, key):g} in the calibration; rig '{rig}' has {getattr(believed, key):g}."
            faults.append(Fault(("sensors", key), f"{differ} Calibrate anew."))
    if faults:
        raise document.error(faults)
    return CalibratedSensors(found.array, frozen(found.gain_of_each))


def write_sensors(path: str | Path, config: SensorsFile) -> None:
    """Write a sensors file that `load_sensors` reads back.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    s, u = config.sensors, config.uncertainty
    lines = [
        "# Sensors as calibrated on a known track; smolbot calibrate-array writes such files.",
        '# Believe them: name this file in the [sensors] section of a rig file, calibrated = "this_file.toml",',
        "# or paste the section over a real bench's own. A tank is built around what stands there: only name the file.",
        f"rig = {_text(config.rig)}",
        f"date = {config.date.isoformat()}",
        *([f"description = {_text(config.description)}"] if config.description else []),
        "",
        "[sensors]",
        *_rows("positions_mm", s.positions_mm),
        *_rows("axes", s.axes),
        *([] if s.gains is None else _rows("gains", s.gains)),
        f"sample_rate_hz = {_number(s.sample_rate_hz)}",
        f"bandwidth_hz = {_number(s.bandwidth_hz)}",
        f"range_ut = {_number(s.range_ut)}",
        f"sensitivity_v_per_ut = {_number(s.sensitivity_v_per_ut)}",
        f"adc_bits = {s.adc_bits}",
        f"adc_range_v = {_number(s.adc_range_v)}",
    ]
    if u is not None:
        lines += [
            "",
            "[uncertainty]                     # one standard deviation; axes about two directions across each",
            *_rows("positions_mm", u.positions_mm),
            *_rows("axes_deg", u.axes_deg),
            *_rows("gains", u.gains),
            f"held_out = {u.held_out}  # recordings that took no part; their errors (rms per axis) before and after:",
            f"position_mm = {_cell(u.position_mm)}",
            f"orientation_deg = {_cell(u.orientation_deg)}",
        ]
    try:
        Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error}.") from error


def _rows(key: str, values: Sequence[str | float | tuple[float, ...]]) -> list[str]:
    """A list with an entry per line, so that each sensor has its own."""
    return [f"{key} = [", *(f"    {_cell(value)}," for value in values), "]"]


def _cell(value: str | float | tuple[float, ...]) -> str:
    if isinstance(value, str):
        return _text(value)
    return f"[{', '.join(map(_number, value))}]" if isinstance(value, tuple) else _number(value)


def _number(value: float) -> str:
    """A TOML float of seven digits: a nanometre of a place, a microradian of an axis."""
    text = f"{value:.7g}"
    return text if any(c in text for c in ".e") else f"{text}.0"


def _text(value: str) -> str:
    """A TOML basic string."""
    import json

    return json.dumps(value, ensure_ascii=False)
