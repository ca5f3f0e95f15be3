"""Fly on the twin repeatedly in one process, so that starting a process is not measured."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from smolbot.config.load import load_mission
from smolbot.flight.safety.stop_latch import Ending, Latch
from smolbot.flight.session import fly
from smolbot.runs.folder import RunFolder
from smolbot.runs.run import CycleRecord
from smolbot.ui.cli.live import connect_console


class TimedLatch(Latch):
    """Stores when what it halts was at rest, in s on the monotonic clock."""

    def __init__(self) -> None:
        super().__init__()
        self.rested = float("nan")

    def trip(self, reason: str, ending: Ending = "failed", *, halt: bool = True) -> bool:
        """Trip the latch, and store when the first call returned.

        Parameters
        ----------
        reason : str
        ending : {"failed", "stopped"}
        halt : bool

        Returns
        -------
        bool
            Whether it was the first.
        """
        first = super().trip(reason, ending, halt=halt)
        if first:
            self.rested = time.monotonic()
        return first


def compute_lateness(cycles: Sequence[CycleRecord]) -> list[float]:
    """Compute how much longer each cycle took than its windows: computing, and waiting for the machine.

    Parameters
    ----------
    cycles : sequence of CycleRecord

    Returns
    -------
    list of float, in s
    """
    ended = np.array([cycle.ended for cycle in cycles])
    lasted = np.array([cycle.shot.duration for cycle in cycles])
    found: list[float] = (np.diff(ended) - lasted[1:]).tolist()
    return found


def main() -> None:
    """``{"live": true, "out": "runs/x", "seconds": 20}`` flies so; the answer has status, reason, stamps, lateness."""
    mission_name, rig = sys.argv[1:3]
    for line in sys.stdin:
        request: dict[str, Any] = json.loads(line)
        settings = {"localization.quiet_s": "1", "stop.max_duration_s": str(request["seconds"])}
        mission, latch = load_mission(mission_name, rig, settings), TimedLatch()
        folder = RunFolder(Path(request["out"])) if request.get("out") else None
        link = connect_console(mission, 1, latch, lambda _: None) if request.get("live") else nullcontext((None, None))
        with link as (pause, pump):
            run = fly(mission, 1, folder=folder, settings=settings, latch=latch, pause=pause, make_live_sink=pump)
        report = {
            "status": run.status, "reason": run.stop_reason, "cycles": len(run.cycles),
            "rested": latch.rested, "lateness": compute_lateness(run.cycles),
            "compute": [cycle.compute for cycle in run.cycles],
        }  # fmt: skip
        print(json.dumps(report), flush=True)


if __name__ == "__main__":
    main()
