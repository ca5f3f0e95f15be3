"""The protocol that every kind of rig implements, for checking and opening rigs."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

from smolbot.config.document import Document, Fault
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.core.rig import CalibrationStage, Rig
from smolbot.core.sensing import Device


class World(Protocol):
    """A kind of rig: what an entry point of ``smolbot.rigs`` refers to."""

    @staticmethod
    def check(document: Document) -> list[Fault]:
        """Find faults of the world's own section of a rig file.

        Parameters
        ----------
        document : Document
            The rig file.

        Returns
        -------
        list of Fault
        """

    @staticmethod
    def unfit(rig: RigConfig, robot: RobotConfig) -> str | None:
        """Explain why this rig cannot hold a bare device.

        Parameters
        ----------
        rig : RigConfig
        robot : RobotConfig

        Returns
        -------
        str or None
            None if it can, or if that is unknown.
        """

    @staticmethod
    def open(rig: RigConfig, robot: RobotConfig, start: Any, seed: int, **options: Any) -> Rig:
        """Open the rig with the robot at its start position, ready to play shots.

        Parameters
        ----------
        rig : RigConfig
        robot : RobotConfig
        start : tuple of float
            Start position (x, y) in m; for a helical robot also its heading in rad.
        seed : int
        **options : object
            `gui` and `operator` (see `smolbot.core.operator`); a world ignores those that it does not use.

        Returns
        -------
        Rig
        """


@runtime_checkable
class StagedWorld(Protocol):
    """A world that can also move a device to known poses above its sensors, to calibrate these."""

    @staticmethod
    def stage(rig: RigConfig, device: Device, seed: int) -> CalibrationStage:
        """Open the positioning stage.

        Parameters
        ----------
        rig : RigConfig
        device : Device
            The device in its holder.
        seed : int
            Of a simulated world.

        Returns
        -------
        CalibrationStage
        """
