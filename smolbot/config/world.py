"""What a kind of rig promises to those who check and open rigs."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

from smolbot.config.document import Document, Fault
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.core.rig import Rig, Stage
from smolbot.core.sensing import Device


class World(Protocol):
    """What an entry point of ``smolbot.rigs`` names: how one kind of rig is checked and opened."""

    @staticmethod
    def check(document: Document) -> list[Fault]:
        """Faults of the world's own section of a rig file."""

    @staticmethod
    def unfit(rig: RigConfig, robot: RobotConfig) -> str | None:
        """Why this rig cannot hold a bare device; None if it can, or if that is not the world's to know."""

    @staticmethod
    def open(rig: RigConfig, robot: RobotConfig, start: Any, seed: int, **options: Any) -> Rig:
        """Open the rig with the robot at `start` (x, y in m), ready to play shots.

        `options` are `gui` and `operator` (see `smolbot.core.operator`); a world passes over what it has no need of.
        """


@runtime_checkable
class StagedWorld(Protocol):
    """A world that can also bring a device to known places over its sensors, by which these are calibrated."""

    @staticmethod
    def stage(rig: RigConfig, device: Device, seed: int) -> Stage:
        """Open the positioning stage.

        Parameters
        ----------
        rig : RigConfig
        device : Device
            What sits in its holder.
        seed : int
            Of a simulated world.

        Returns
        -------
        Stage
        """
