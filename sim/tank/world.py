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
    """How a simulated tank is checked and opened."""

    @staticmethod
    def check(document: Document) -> list[Fault]:
        """Faults of the ``[tank]`` section, if there is one."""
        from sim.tank.carriers.route_checks import holding_faults
        from sim.tank.settings import TankSettings

        settings, faults = document.section("tank", TankSettings)
        return faults if settings is None else holding_faults(settings, document.data.get("container"))

    @staticmethod
    def unfit(rig: RigConfig, robot: RobotConfig) -> str | None:
        """Why this tank cannot hold a bare device: its rig file says of no hand and no place."""
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
        """Open a tank drawn from `seed`, with the robot put down near `start` (x, y in m).

        Parameters
        ----------
        gui : bool
            Show Bullet's own window; needs a display.
        ideal : bool
            Draw no mismatch: results must be labelled ``ideal`` wherever they are shown.
        """
        import numpy as np

        from sim.tank.rig import TankRig
        from sim.tank.settings import TankSettings

        settings = rig.section_of("tank", TankSettings)
        place = np.asarray(start, dtype=np.float64)
        return TankRig(rig, robot, settings, place, seed, gui=gui, ideal=ideal)

    @staticmethod
    def stage(rig: RigConfig, device: Device, seed: int) -> TankStage:
        """The sensors of the tank drawn from `seed`, with the device on a positioning stage instead of in liquid."""
        from sim.tank.positioning_stage import TankStage

        return TankStage(rig, device, seed)
