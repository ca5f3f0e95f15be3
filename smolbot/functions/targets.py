"""Resolve a name or a path that a user gives: a rig with a robot, a device, a file to write."""

from __future__ import annotations

from pathlib import Path

from smolbot.config.device import load_device
from smolbot.config.library import holds_rig, list_shipped
from smolbot.config.mission import load_steering_mission
from smolbot.config.rig import RigConfig, load_rig
from smolbot.config.robot import RobotConfig, load_robot
from smolbot.core.sensing import Device
from smolbot.errors import InputError
from smolbot.functions.settings import DEFAULT_ROBOT
from smolbot.localization.device.thinning import Hum


def check_writable(path: Path) -> None:
    """Refuse a file that cannot be written, before its content is computed.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        If `path` is a folder, or its folder does not exist.
    """
    if path.is_dir():
        raise InputError(f"--out {path}: is a folder; name a file.")
    if not path.parent.is_dir():
        raise InputError(f"--out {path}: there is no folder {path.parent}.")


def find_target(
    target: str, robot: str | None, settings: dict[str, str] | None = None
) -> tuple[RigConfig, RobotConfig, tuple[float, float]]:
    """Find rig, robot and its start position (x, y), in m: the container's middle, or a mission's start.

    Parameters
    ----------
    target : str
        A rig or a mission, by name or path.
    robot : str or None
        By name or path; None for the mission's, or `DEFAULT_ROBOT`.
    settings : dict, optional
        Override the mission file, or the rig file with or without ``rig.``.

    Returns
    -------
    tuple of RigConfig, RobotConfig, (x, y)

    Raises
    ------
    InputError
        If a name is neither a rig nor a mission; the message lists both.
    """
    settings = settings or {}
    rigs, missions = list_shipped("rigs"), list_shipped("missions")
    is_path = target.endswith(".toml") or "/" in target or "\\" in target
    if not is_path and target not in rigs and target not in missions:
        raise InputError(
            f"No rig or mission is named '{target}'. Rigs: {', '.join(rigs)}. Missions: {', '.join(missions)}. "
            f"Your own is given by its path, such as ./{target}.toml."
        )
    is_rig = holds_rig(Path(target)) if is_path else target in rigs
    if is_rig:
        config = load_rig(target, {key.removeprefix("rig."): value for key, value in settings.items()} or None)
        x, y = config.container.center.tolist()
        return config, load_robot(robot or DEFAULT_ROBOT), (x, y)
    mission = load_steering_mission(target, None, settings)
    chosen = mission.robot if robot is None else load_robot(robot, beside=mission.document.path.parent)
    return mission.rig, chosen, mission.start


def find_device(robot: str | None, device: str | Path | None) -> tuple[str, Device]:
    """Find the robot's name and device: from the device file if one is given, else from the robot file.

    Parameters
    ----------
    robot : str or None
        By name or path; None for the device file's, or `DEFAULT_ROBOT`.
    device : path or None
        Device file, as `smolbot.calibrate` writes it.

    Returns
    -------
    tuple of str, Device

    Raises
    ------
    ConfigError
        If the device file belongs to another robot.
    """
    if device is None:
        config = load_robot(robot or DEFAULT_ROBOT)
        return config.name, config.device
    found = load_device(device, load_robot(robot).name if robot is not None else None)
    return found.robot, found.device


def expected_hum(rig: RigConfig) -> Hum:
    """Return the mains lines that the rig file states.

    Parameters
    ----------
    rig : RigConfig

    Returns
    -------
    Hum
    """
    noise = rig.sections.noise
    first = max(noise.mains, 1e-10)
    sizes = {1: first} | {int(order): max(first * size, 1e-10) for order, size in noise.harmonics.items()}
    return Hum(noise.mains_hz, sizes)
