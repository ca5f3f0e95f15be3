"""Flies on the twin again and again in one process: what starting a process costs is no part of what is measured.

Reads a line of JSON for each flight from standard input and writes one when it is over; see `main`.
"""

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
from smolbot.ui.cli.live import watched


class TimedLatch(Latch):
    """Notes when it was shut first, and when what it halts was at rest; s on the monotonic clock."""

    def __init__(self) -> None:
        super().__init__()
        self.heard = self.rested = float("nan")

    def shut(self, reason: str, ending: Ending = "failed", *, halt: bool = True) -> bool:
        heard = time.monotonic()
        first = super().shut(reason, ending, halt=halt)
        if first:
            self.heard, self.rested = heard, time.monotonic()
        return first


def lateness(cycles: Sequence[CycleRecord]) -> list[float]:
    """By how much each cycle took longer than its windows, in s: computing, and waiting for the machine."""
    ended = np.array([cycle.ended for cycle in cycles])
    lasted = np.array([cycle.shot.duration for cycle in cycles])
    found: list[float] = (np.diff(ended) - lasted[1:]).tolist()
    return found


def main() -> None:
    """``{"live": true, "out": "runs/x", "seconds": 20}`` flies so; the answer has status, reason, stamps, lateness."""
    mission_name, rig = sys.argv[1:3]
    for line in sys.stdin:
        asked: dict[str, Any] = json.loads(line)
        settings = {"localization.quiet_s": "1", "stop.max_duration_s": str(asked["seconds"])}
        mission, latch = load_mission(mission_name, rig, settings), TimedLatch()
        folder = RunFolder(Path(asked["out"])) if asked.get("out") else None
        link = watched(mission, 1, latch, lambda _: None) if asked.get("live") else nullcontext((None, None))
        with link as (pause, pump):
            run = fly(mission, 1, folder=folder, settings=settings, latch=latch, pause=pause, live=pump)
        told = {
            "status": run.status, "reason": run.stop_reason, "cycles": len(run.cycles), "heard": latch.heard,
            "rested": latch.rested, "lateness": lateness(run.cycles),
            "compute": [cycle.compute for cycle in run.cycles],
        }  # fmt: skip
        print(json.dumps(told), flush=True)


if __name__ == "__main__":
    main()
