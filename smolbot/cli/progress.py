"""What a person sees while a mission flies: how far, where, how well, how fast, how long still."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from smolbot.loop import CycleRecord
from smolbot.missionfile import Mission


class Progress:
    """Hears every cycle and says so: a bar on a terminal, a line now and then elsewhere."""

    def __init__(self, mission: Mission, every: float = 0.1, quiet_every: float = 10.0) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn
        from rich.progress import Progress as Bar

        self._mission = mission
        self._console = Console(stderr=True, highlight=False)
        self._terminal = self._console.is_terminal
        self._every = every if self._terminal else quiet_every
        self._bar = Bar(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.percentage:>3.0f} %"),
            TextColumn("{task.fields[state]}"),
            console=self._console,
            transient=True,
            auto_refresh=False,
        )
        self._task = self._bar.add_task(mission.name, total=mission.path.length, state="")
        self._shown = time.monotonic()
        self._begun: tuple[float, float] | None = None
        self._cycles = 0

    def start(self) -> None:
        if self._terminal:
            self._bar.start()

    def stop(self) -> None:
        if self._terminal:
            self._bar.stop()

    def __call__(self, record: CycleRecord) -> None:
        self._cycles += 1
        command = record.command
        if self._begun is None and command.phase == "follow" and command.window is not None:
            self._begun = (record.shot.end, command.progress)
        now = time.monotonic()
        if now - self._shown < self._every:
            return
        self._shown = now
        state = self.describe(record)
        if self._terminal:
            self._bar.update(self._task, completed=command.progress, state=state, refresh=True)
        else:
            done = 100.0 * command.progress / self._mission.path.length
            self._console.print(f"{self._mission.name}: {done:.0f} %  {state}")

    def describe(self, record: CycleRecord) -> str:
        """Pose, error to the path as believed, loop rate, time left."""
        parts: list[str] = [record.shot.mode]
        pose = record.tracked
        if pose is not None:
            off = float(self._mission.path.project(pose.position[None, :])[1][0])
            parts.append(f"({pose.position[0] * 1e3:+.1f}, {pose.position[1] * 1e3:+.1f}) mm")
            parts.append(f"{off * 1e3:.2f} mm off" if record.command.phase == "follow" else "approaching")
        end = record.shot.end
        parts.append(f"{self._cycles / end:.1f} Hz")
        left = self._left(record)
        parts.append(f"{end:.0f} s" + (f", {left:.0f} s left" if left is not None else ""))
        return "  ".join(parts)

    def _left(self, record: CycleRecord) -> float | None:
        if self._begun is None:
            return None
        gone, done = record.shot.end - self._begun[0], record.command.progress - self._begun[1]
        if done <= 0.0:
            return None
        return gone / done * (self._mission.path.length - record.command.progress)


@contextmanager
def shown_progress(mission: Mission) -> Iterator[Progress]:
    """Progress that is shown while the block runs."""
    progress = Progress(mission)
    progress.start()
    try:
        yield progress
    finally:
        progress.stop()
