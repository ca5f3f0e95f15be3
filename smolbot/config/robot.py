"""The robot file: assumed body and resonant device of one robot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from smolbot.config.document import Document, Fault, FileModel
from smolbot.config.library import open_file
from smolbot.config.units import SI, NotNegative, Positive, Vector
from smolbot.core.sensing import Device


class BodySection(FileModel):
    """The housing: a box with sides along the body axes."""

    size_mm: tuple[Positive, Positive, Positive]
    center_mm: Vector = (0.0, 0.0, 0.0)
    mass_mg: Positive
    drag_radius_mm: Positive | None = None
    urdf: str | None = None


class HelixSection(FileModel):
    """The right-handed thread on a helical robot's housing, and its measured motion through this gel.

    `slip` is a fraction of the pitch. `steering` is the measured turn of the axis in a bend divided by the
    theoretical one. `drift_mm` is the displacement to the left with each turn.
    """

    pitch_mm: Positive
    core_diameter_mm: Positive
    slip: Annotated[float, Field(ge=0, lt=1)]
    steering: Positive = 1.0
    drift_mm: float = 0.0

    pitch = SI("pitch_mm")
    core_diameter = SI("core_diameter_mm")
    drift = SI("drift_mm")


class DeviceSection(FileModel):
    """The SMOL device, as calibrated in the medium that the robot swims in.

    The tolerances are one standard deviation. They are used where a flight learns the sensors: errors that they
    explain are not attributed to the sensors.
    """

    moment_tolerance_percent: NotNegative = 0.0
    l0_tolerance_percent: NotNegative = 0.0
    moment_ma_m2: Positive
    moment_in_body: Vector
    l0_mm: Positive
    theta_max_deg: Annotated[float, Field(gt=0, le=60)]
    frequency_hz: Positive
    damping_per_s: NotNegative
    damping_model: Literal["linear", "exponential"]

    @field_validator("moment_in_body")
    @classmethod
    def _check_moment_in_plane(cls, value: Vector) -> Vector:
        if value[1] != 0 or not any(value):
            raise ValueError(f"must point somewhere in the plane of oscillation (body x, z); got {list(value)}.")
        return value

    @property
    def in_si(self) -> Device:
        """The device in SI units; raises InputError for inconsistent values."""
        return Device(
            moment=self.moment_ma_m2 * 1e-3,
            moment_in_body=np.array(self.moment_in_body),
            l0=self.l0_mm * 1e-3,
            theta_max=float(np.radians(self.theta_max_deg)),
            frequency=self.frequency_hz,
            damping=self.damping_per_s,
            damping_model=self.damping_model,
        )


class RobotFile(FileModel):
    """Content of a robot file.

    Attributes
    ----------
    extends : str
        A shipped robot by name, or a file by path: all that does not stand here is as there.
    """

    extends: str | None = None
    name: str
    kind: Literal["gradient", "helical", "device"]
    description: str = ""
    body: BodySection | None = None
    helix: HelixSection | None = None
    device: DeviceSection

    @model_validator(mode="after")
    def _check_sections(self) -> RobotFile:
        if self.kind != "device" and self.body is None:
            raise ValueError(f"a robot of kind '{self.kind}' needs a [body] section.")
        if self.kind == "gradient" and self.body is not None:
            missing = [key for key in ("drag_radius_mm", "urdf") if getattr(self.body, key) is None]
            if missing:
                raise ValueError(f"a robot of kind 'gradient' needs {' and '.join(missing)} in [body].")
        if (self.kind == "helical") != (self.helix is not None):
            raise ValueError("a [helix] section belongs to a robot of kind 'helical', which needs one.")
        if self.kind == "helical" and self.device.moment_in_body[2] != 0:
            raise ValueError("the moment of a helical robot lies across its axis: moment_in_body along body x.")
        if self.kind == "device" and self.body is not None:
            raise ValueError("kind 'device' is a bare device in a tool or tissue: leave [body] away.")
        return self


class RobotConfig:
    """A checked robot file, in SI units.

    Parameters
    ----------
    document : Document
        The robot file.
    sections : RobotFile

    Attributes
    ----------
    calibrated : Device or None
        Used in place of the file's own device, where it is given.
    """

    def __init__(self, document: Document, sections: RobotFile) -> None:
        self.document = document
        self.sections = sections
        self.name = sections.name
        self.kind = sections.kind
        self.calibrated: Device | None = None

    @property
    def device_tolerances(self) -> tuple[float, float]:
        """Standard deviations of the moment (relative) and of l0 (in m)."""
        section = self.sections.device
        return 1e-2 * section.moment_tolerance_percent, 1e-5 * section.l0_tolerance_percent * section.l0_mm

    @property
    def device(self) -> Device:
        """The assumed device, in SI units."""
        if self.calibrated is not None:
            return self.calibrated
        return self.sections.device.in_si

    @property
    def body(self) -> BodySection:
        """The housing of a robot that moves by itself.

        Raises
        ------
        ConfigError
            If the robot has no housing.
        """
        if self.sections.body is None:
            raise self.document.error([Fault(("body",), f"kind '{self.kind}' has no housing, and one is needed here.")])
        return self.sections.body

    @property
    def mass(self) -> float:
        """Mass in kg."""
        return self.body.mass_mg * 1e-6

    @property
    def size(self) -> tuple[float, float, float]:
        """Sides along the body axes, in m."""
        x, y, z = self.body.size_mm
        return x * 1e-3, y * 1e-3, z * 1e-3

    @property
    def center(self) -> tuple[float, float, float]:
        """Centre of the housing relative to the cantilever's rotation centre, in the body frame, in m."""
        x, y, z = (0.0, 0.0, 0.0) if self.sections.body is None else self.body.center_mm
        return x * 1e-3, y * 1e-3, z * 1e-3

    @property
    def drag_radius(self) -> float:
        """Radius of the sphere with the same Stokes drag, in m."""
        if self.body.drag_radius_mm is None:
            raise self.document.error([Fault(("body", "drag_radius_mm"), "is needed here, and not given.")])
        return self.body.drag_radius_mm * 1e-3

    @property
    def helix(self) -> HelixSection:
        """The thread of a helical robot.

        Raises
        ------
        ConfigError
            If the robot has no thread.
        """
        if self.sections.helix is None:
            raise self.document.error([Fault(("helix",), f"kind '{self.kind}' has no thread, and one is needed here.")])
        return self.sections.helix


def load_robot(name: str, beside: Path | None = None) -> RobotConfig:
    """Read a shipped robot by name, or a user's by path.

    Parameters
    ----------
    name : str
        A shipped robot, or the path of a file.
    beside : Path, optional
        A relative path is relative to the folder of this file.

    Returns
    -------
    RobotConfig

    Examples
    --------
    >>> import smolbot
    >>> smolbot.load_robot("gradient").device.frequency
    103.5
    """
    document = open_file(name, "robots", beside)
    return RobotConfig(document, document.validated(RobotFile))
