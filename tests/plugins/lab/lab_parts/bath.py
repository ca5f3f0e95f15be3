"""A world of the lab's own: the simulated tank in a bath that is kept warm, with a section [bath] of its own."""

from __future__ import annotations

import logging
from typing import Any

from sim import TankWorld
from smolbot import Rig
from smolbot.config import Document, Fault, FileModel, RigConfig, RobotConfig

BOILING_C = 100.0


class BathSection(FileModel):
    """[bath]: where its thermostat is, and what it holds."""

    address: str
    temperature_c: float = 22.0


class BathWorld:
    """How a rig file with world = "bath" is checked and opened."""

    @staticmethod
    def check(document: Document) -> list[Fault]:
        """Faults of [bath], and of the [tank] that simulates what is in it."""
        section, faults = document.section("bath", BathSection)
        if section is not None and section.temperature_c >= BOILING_C:
            faults = [
                Fault(("bath", "temperature_c"), f"must stay below {BOILING_C:g}; got {section.temperature_c:g}.")
            ]
        return [*faults, *TankWorld.check(document)]

    @staticmethod
    def unfit(rig: RigConfig, robot: RobotConfig) -> str | None:
        """As for the tank."""
        return TankWorld.unfit(rig, robot)

    @staticmethod
    def open(rig: RigConfig, robot: RobotConfig, start: Any, seed: int, **options: Any) -> Rig:
        """Open the tank once the bath would be warm."""
        section = rig.section_of("bath", BathSection)
        logging.getLogger(__name__).warning("bath at %s: %g degrees Celsius", section.address, section.temperature_c)
        return TankWorld.open(rig, robot, start, seed, **options)
