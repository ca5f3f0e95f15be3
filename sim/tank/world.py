"""The entry point ``tank`` of ``smolbot.rigs``: checks a rig file's ``[tank]`` section and opens the tank."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from smolbot.config.document import Document, Fault

if TYPE_CHECKING:
    from sim.tank.positioning_stage import TankStage
    from sim.tank.rig import TankRig
    from smolbot.config.rig import RigConfig
    from smolbot.config.robot import RobotConfig
    from smolbot.core.sensing import Device


class TankWorld:
    """Checks and opens a simulated tank."""

    @staticmethod
    def check(document: Document) -> list[Fault]:
        """Check the ``[tank]`` section, if there is one.

        Parameters
        ----------
        document : Document
            The rig file.

        Returns
        -------
        list of Fault
        """
        from sim.tank.carriers.route_checks import check_routes_and_place
        from sim.tank.settings import TankSettings

        settings, faults = document.section("tank", TankSettings)
        return faults if settings is None else check_routes_and_place(settings, document.data.get("container"))

    @staticmethod
    def unfit(rig: RigConfig, robot: RobotConfig) -> str | None:
        """Explain why this tank cannot hold a robot: its rig file has neither ``[tank.hand]`` nor ``[tank.place]``.

        Parameters
        ----------
        rig : RigConfig
        robot : RobotConfig

        Returns
        -------
        str or None
            None if it can.
        """
        if "hand" in rig.sections.tank or "place" in rig.sections.tank:
            return None
        return (
            f"'{rig.name}' does not define what holds a bare device such as '{robot.name}'; "
            "its rig file needs [tank.hand] or [tank.place]."
        )

    @staticmethod
    def open(
        rig: RigConfig,
        robot: RobotConfig,
        start: Any,
        seed: int,
        *,
        gui: bool = False,
        ideal: bool = False,
        **options: Any,
    ) -> TankRig:
        """Open a tank that is sampled from `seed`, with the robot near `start`.

        Parameters
        ----------
        rig : RigConfig
        robot : RobotConfig
        start : array_like, shape (2,), in m
            Requested start position (x, y), world frame.
        seed : int
        gui : bool
            Show Bullet's own window; needs a display.
        ideal : bool
            Sample no mismatch: results must be labelled ``ideal`` wherever they are shown.
        **options : Any
            Options of other worlds, which this one does not use.

        Returns
        -------
        TankRig
        """
        import numpy as np

        from sim.tank.rig import TankRig
        from sim.tank.settings import TankSettings

        settings = rig.section_of("tank", TankSettings)
        place = np.asarray(start, dtype=np.float64)
        return TankRig(rig, robot, settings, place, seed, gui=gui, ideal=ideal)

    @staticmethod
    def stage(rig: RigConfig, device: Device, seed: int) -> TankStage:
        """Return the sensors of a sampled tank with the device on a positioning stage instead of in liquid.

        Parameters
        ----------
        rig : RigConfig
        device : Device
            As assumed.
        seed : int

        Returns
        -------
        TankStage
        """
        from sim.tank.positioning_stage import TankStage

        return TankStage(rig, device, seed)
