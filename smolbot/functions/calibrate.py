"""``calibrate``: open a rig and measure a device on it."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from smolbot.bench.calibration.device import Calibration, CalibrationPlan
from smolbot.bench.calibration.device import calibrate as calibrate_device
from smolbot.config.device import DeviceConfig, write_device
from smolbot.config.plugins import load_world
from smolbot.config.rig import RigConfig
from smolbot.config.world import World
from smolbot.errors import InputError
from smolbot.functions.settings import merge_settings
from smolbot.functions.targets import check_writable, expected_hum, find_target


def calibrate(
    target: str,
    height: float,
    *,
    robot: str | None = None,
    plan: CalibrationPlan | None = None,
    seed: int = 1,
    out: str | Path | None = None,
    settings: Mapping[str, str] | None = None,
    progress: Callable[[str], None] | None = None,
    **overrides: Any,
) -> Calibration:
    """Measure a device at a known height on a rig: resonance, damping, largest amplitude.

    Parameters
    ----------
    target : str
        A rig, or a mission that names rig and robot; by name or path.
    height : float, in m
        Known z of the cantilever's rotation centre above the sensors.
    robot : str, optional
        By name or path; by default the mission's, or ``gradient``.
    plan : CalibrationPlan, optional
        Length and number of bursts.
    seed : int
        Of a simulated tank.
    out : path, optional
        Device file to write; none is written without it. ``{robot}`` in it is replaced by the robot's name.
    settings : mapping of str to str, optional
        Override the files; keys with dots.
    progress : callable, optional
        Called with a sentence at each step.
    **overrides
        Settings with ``__`` for the dot.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError, ConfigError
        For every fault of what was given, before the rig is opened.
    SignalLostError, InterlockError, RigError
        If the signal of the device is not detected; as the rig raises them.

    Examples
    --------
    >>> import smolbot
    >>> smolbot.calibrate("tank", height=0.5)
    Traceback (most recent call last):
    smolbot.errors.InputError: height (--z-mm) must lie within the container of rig 'tank', ...
    """
    config, held, start = find_target(target, robot, merge_settings(settings, overrides))
    _check_height(1e3 * height, config)
    path = None if out is None else Path(str(out).format(robot=held.name))
    if path is not None:
        check_writable(path)
    world: World = load_world(config.world, config.document)
    rig = world.open(config, held, start, seed)
    try:
        found = calibrate_device(rig, held.device, height, plan=plan, hum=expected_hum(config), progress=progress)
    finally:
        rig.close()
    if path is not None:
        today = datetime.date.today()
        write_device(path, DeviceConfig(held.name, config.name, today, found.device, found.std, found.height))
    return replace(found, robot=held.name, rig=config.name, file=path)


def _check_height(z_mm: float, rig: RigConfig) -> None:
    box = rig.sections.container
    low, high = box.floor_z_mm, box.surface_z_mm + box.wall_height_mm
    if not low <= z_mm <= high:
        raise InputError(
            f"height (--z-mm) must lie within the container of rig '{rig.name}', {low:g} to {high:g} mm above the "
            f"sensors (liquid's surface at {box.surface_z_mm:g}); got {z_mm:g}."
        )
