"""The entry point ``bench`` of ``smolbot.rigs``: checks a rig file's ``[bench]`` section and opens the bench."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from smolbot.bench.hardware.wiring import BenchSection, wiring_faults
from smolbot.config.document import Document, Fault

if TYPE_CHECKING:
    from smolbot.bench.hardware.rig import BenchRig
    from smolbot.config.rig import RigConfig
    from smolbot.config.robot import RobotConfig
    from smolbot.core.operator import Operator


class BenchWorld:
    """How a bench is checked and opened."""

    @staticmethod
    def check(document: Document) -> list[Fault]:
        """Faults of the ``[bench]`` section: unknown channels, lines and ranges, two loads on one output."""
        if not isinstance(document.data.get("bench"), dict):
            return [Fault(("bench",), 'world = "bench" needs a section, [bench], that says how it is wired.')]
        section, faults = document.section("bench", BenchSection)
        if section is None:
            return faults
        return [Fault(("bench", *key), message) for key, message in wiring_faults(section, document.data)]

    @staticmethod
    def unfit(rig: RigConfig, robot: RobotConfig) -> str | None:
        """None: what a person puts on a bench is not the program's to know."""
        return None

    @staticmethod
    def open(
        rig: RigConfig,
        robot: RobotConfig,
        start: Any,
        seed: int,
        *,
        operator: Operator | None = None,
        **options: Any,
    ) -> BenchRig:
        """Open every device of the bench; `start` and `seed` mean nothing to it.

        Raises
        ------
        RigError
            With a line for every device that failed; nothing was energised.
        """
        from smolbot.bench.hardware.rig import BenchRig
        from smolbot.core.operator import TerminalOperator

        section = rig.section_of("bench", BenchSection)
        return BenchRig(rig, section, operator if operator is not None else TerminalOperator())
