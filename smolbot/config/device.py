"""The device file: a calibrated SMOL device, its uncertainties, and the robot that it belongs to."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from smolbot.config.document import Document, Fault, FileModel
from smolbot.config.robot import DeviceSection
from smolbot.config.toml_layers import write_file
from smolbot.config.units import NotNegative
from smolbot.core.sensing import Device
from smolbot.errors import InputError


class CalibratedDeviceSection(DeviceSection):
    """The device section of a robot file, with one standard deviation of each measured value."""

    theta_max_deg_std: NotNegative | None = None
    frequency_hz_std: NotNegative | None = None
    damping_per_s_std: NotNegative | None = None


class DeviceFile(FileModel):
    """All keys and sections of a device file."""

    robot: str
    rig: str
    date: datetime.date
    description: str = ""
    z_mm: float | None = None
    device: CalibratedDeviceSection


@dataclass(frozen=True)
class DeviceUncertainty:
    """Standard deviations of the calibrated values of a device.

    Attributes
    ----------
    theta_max : float, in rad
    frequency : float, in Hz
    damping : float, in 1/s
    """

    theta_max: float
    frequency: float
    damping: float


@dataclass(frozen=True)
class DeviceConfig:
    """A calibrated device and its origin.

    Attributes
    ----------
    robot, rig : str
        Names of the robot that the device belongs to and of the rig that it was calibrated on.
    date : datetime.date
        Day of the calibration.
    device : Device
    std : DeviceUncertainty or None
        None unless the file gives all three standard deviations.
    height : float or None, in m
        Known z of the rotation centre during the calibration, in the world frame.
    description : str
    """

    robot: str
    rig: str
    date: datetime.date
    device: Device
    std: DeviceUncertainty | None = None
    height: float | None = None
    description: str = ""


def load_device(path: str | Path, robot: str | None = None) -> DeviceConfig:
    """Read a device file.

    Parameters
    ----------
    path : str or Path
    robot : str, optional
        Name of the robot that the device must belong to.

    Returns
    -------
    DeviceConfig

    Raises
    ------
    ConfigError
        With ``file:line: key`` for every fault, and if the file belongs to another robot.
    MissingFileError
        If there is no such file.
    """
    document = Document.read(Path(path))
    sections = document.validated(DeviceFile)
    if robot is not None and sections.robot != robot:
        message = f"this device was calibrated for robot '{sections.robot}'; asked for is '{robot}'."
        raise document.error([Fault(("robot",), f"{message} Calibrate that one, or give the file that is its own.")])
    s = sections.device
    try:
        device = s.in_si
    except InputError as error:
        raise document.error([Fault(("device",), str(error))]) from error
    std = None
    if s.theta_max_deg_std is not None and s.frequency_hz_std is not None and s.damping_per_s_std is not None:
        std = DeviceUncertainty(float(np.radians(s.theta_max_deg_std)), s.frequency_hz_std, s.damping_per_s_std)
    height = None if sections.z_mm is None else sections.z_mm * 1e-3
    return DeviceConfig(sections.robot, sections.rig, sections.date, device, std, height, sections.description)


def write_device(path: str | Path, config: DeviceConfig) -> None:
    """Write a device file that `load_device` reads back to nine significant digits.

    Parameters
    ----------
    path : str or Path
    config : DeviceConfig

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    d, std = config.device, config.std
    measured = (
        ("theta_max_deg", np.degrees(d.theta_max), None if std is None else np.degrees(std.theta_max)),
        ("frequency_hz", d.frequency, None if std is None else std.frequency),
        ("damping_per_s", d.damping, None if std is None else std.damping),
    )
    height = None if config.height is None else config.height * 1e3
    begin = [
        ("robot", config.robot, ""),
        ("rig", config.rig, ""),
        ("date", config.date, ""),
        ("description", config.description or None, ""),
        ("z_mm", _rounded(height), "known height of the rotation centre during calibration"),
    ]
    device = [
        ("moment_ma_m2", _rounded(d.moment * 1e3), "as assumed: theta_max is measured as moment times angle"),
        ("moment_in_body", [_rounded(c) for c in d.moment_in_body], ""),
        ("l0_mm", _rounded(d.l0 * 1e3), ""),
        *((name, _rounded(v), "") for key, value, of in measured for name, v in ((key, value), (f"{key}_std", of))),
        ("damping_model", d.damping_model, ""),
    ]
    write_file(path, ["SMOL device as calibrated; smolbot calibrate writes such files."], {"": begin, "device": device})


def _rounded(value: float | None) -> float | None:
    """To ten digits."""
    return None if value is None else float(f"{value:.10g}")
