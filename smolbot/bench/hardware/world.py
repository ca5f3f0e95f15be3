"""The entry point ``bench`` of ``smolbot.rigs``: checks a rig file's ``[bench]`` section and opens the bench."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from smolbot.bench.hardware.wiring import BenchSection, find_wiring_faults
from smolbot.config.document import Document, Fault

if TYPE_CHECKING:
    from smolbot.bench.hardware.rig import BenchRig
    from smolbot.config.rig import RigConfig
    from smolbot.config.robot import RobotConfig
    from smolbot.core.operator import Operator


class BenchWorld:
    """World of the entry point ``bench``: it checks and opens a bench."""

    @staticmethod
    def check(document: Document) -> list[Fault]:
        """Check the ``[bench]`` section: unknown channels, lines and ranges, two loads on one output.

        Parameters
        ----------
        document : Document
            The rig file.

        Returns
        -------
        list of Fault
        """
        if not isinstance(document.data.get("bench"), dict):
            return [Fault(("bench",), 'world = "bench" needs a section, [bench], that says how it is wired.')]
        section, faults = document.section("bench", BenchSection)
        if section is None:
            return faults
        return [Fault(("bench", *key), message) for key, message in find_wiring_faults(section, document.data)]

    @staticmethod
    def unfit(rig: RigConfig, robot: RobotConfig) -> str | None:
        """Return None: the program cannot know which robot a person puts on a bench.

        Parameters
        ----------
        rig : RigConfig
        robot : RobotConfig

        Returns
        -------
        str or None
        """
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
        """Open every device of the bench.

        Parameters
        ----------
        rig : RigConfig
        robot : RobotConfig
            Ignored.
        start : object
            Ignored.
        seed : int
            Ignored.
        operator : Operator, optional
            Whoever sits at the terminal unless given.
        **options : object
            Ignored.

        Returns
        -------
        BenchRig

        Raises
        ------
        RigError
            With a line for every device that failed; nothing was energised.
        """
        from smolbot.bench.hardware.rig import BenchRig
        from smolbot.core.operator import TerminalOperator

        section = rig.section_of("bench", BenchSection)
        return BenchRig(rig, section, operator if operator is not None else TerminalOperator())
