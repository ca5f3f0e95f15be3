"""What holds the housing of a device and moves it: a liquid, a gel, a hand. The tank's clock and magnet do not mind."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from smolbot.arrays import FloatArray
from smolbot.errors import InputError
from smolbot.shots import Window

if TYPE_CHECKING:
    from sim.mismatch import Truth
    from sim.settings import TankSettings
    from smolbot.rigfile import RigConfig
    from smolbot.robotfile import RobotConfig

Triple = tuple[float, float, float]
Quadruple = tuple[float, float, float, float]
State = tuple[Triple, Quadruple, Triple, Triple]
"""Position (m), orientation (scalar first), velocity (m/s) and spin (rad/s) of the housing's middle, world frame."""

Magnetic = tuple[float, float, float, float, float, float]
"""Mean force (N) and torque about the housing's middle (N·m) of one step, body frame."""


class Carrier(Protocol):
    """Moves the housing through every physics step of a window."""

    def state(self) -> State:
        """Where the housing is now."""

    def begin(self, window: Window, time: float) -> None:
        """A window begins at `time` s; the coils' part in it is not this one's business."""

    def advance(self, state: State, magnetic: Magnetic, time: float, step: float) -> None:
        """One step of `step` s from `time` s on, from the state just read, under what the fields do to the robot."""

    def close(self) -> None:
        """Let go of everything; harmless when repeated."""


def make_carrier(
    rig: RigConfig, robot: RobotConfig, settings: TankSettings, truth: Truth, start: FloatArray, *, gui: bool
) -> Carrier:
    """The carrier that a kind of robot asks for.

    Raises
    ------
    InputError
        If this tank has none for it.
    """
    if robot.kind == "gradient":
        from sim.floating import Floating

        return Floating(rig, robot, settings, truth, start, gui=gui)
    raise InputError(f"{rig.name}: this tank cannot carry a robot of kind '{robot.kind}' ({robot.name}).")
