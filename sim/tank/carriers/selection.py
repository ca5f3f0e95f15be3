"""Choose the carrier for a robot."""

from __future__ import annotations

from sim.tank.carriers.carrier import Carrier
from sim.tank.mismatch import TankTruth
from sim.tank.settings import TankSettings
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError


def make_carrier(
    rig: RigConfig, robot: RobotConfig, settings: TankSettings, truth: TankTruth, start: FloatArray, seed: int,
    *, gui: bool, ideal: bool,
) -> Carrier:  # fmt: skip
    """Make the carrier for a kind of robot.

    Parameters
    ----------
    rig : RigConfig
    robot : RobotConfig
    settings : TankSettings
    truth : TankTruth
    start : ndarray, shape (2,), in m
        Requested start position (x, y), world frame.
    seed : int
    gui : bool
        Show Bullet's window.
    ideal : bool
        Sample no mismatch.

    Returns
    -------
    Carrier

    Raises
    ------
    InputError
        If this tank has none for it.
    """
    if robot.kind == "gradient":
        from sim.tank.carriers.floating import Floating

        return Floating(rig, robot, settings, truth, start, gui=gui)
    if robot.kind == "helical":
        from sim.tank.carriers.gel.embedded import Embedded

        return Embedded(rig, robot, settings, truth, start, seed, ideal=ideal)
    if robot.kind == "device":
        from sim.tank.carriers.device_carriers import make_device_carrier

        return make_device_carrier(rig, robot, settings, seed)
    raise InputError(f"{rig.name}: this tank cannot carry a robot of kind '{robot.kind}' ({robot.name}).")
