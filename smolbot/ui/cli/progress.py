"""Progress of a flying mission on the terminal: share done, position, error, rate and time left."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from smolbot.config.load import AnyMission
from smolbot.config.mission import Mission
from smolbot.config.observation import Observation
from smolbot.runs.run import CycleRecord


class MissionProgress:
    """Shows every cycle: as a bar on a terminal, as a line now and then elsewhere.

    Subclasses define what is counted and what is printed about a cycle.

    Parameters
    ----------
    name : str
        Name of the mission.
    total : float
        What `compute_done` reaches at the end.
    update_interval : float, in s
        Time between two updates on a terminal.
    line_interval : float, in s
        Time between two lines elsewhere.
    """

    def __init__(self, name: str, total: float, update_interval: float = 0.1, line_interval: float = 10.0) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn
        from rich.progress import Progress as Bar

        self._name, self._total = name, total
        self._console = Console(stderr=True, highlight=False)
        self._terminal = self._console.is_terminal
        self._every = update_interval if self._terminal else line_interval
        self._bar = Bar(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.percentage:>3.0f} %"),
            TextColumn("{task.fields[state]}"),
            console=self._console,
            transient=True,
            auto_refresh=False,
        )
        self._task = self._bar.add_task(name, total=total, state="")
        self._shown = time.monotonic()
        self._cycles = 0

    def start(self) -> None:
        """Show the bar, on a terminal."""
        if self._terminal:
            self._bar.start()

    def stop(self) -> None:
        """Remove the bar."""
        if self._terminal:
            self._bar.stop()

    @contextmanager
    def pause(self) -> Iterator[None]:
        """Hide the bar while a ``with`` block prints or asks a question."""
        self.stop()
        try:
            yield
        finally:
            self.start()

    def __call__(self, record: CycleRecord) -> None:
        """Count a cycle, and update what is shown if it is time to.

        Parameters
        ----------
        record : CycleRecord
        """
        self._cycles += 1
        self.note_cycle(record)
        now = time.monotonic()
        if now - self._shown < self._every:
            return
        self._shown = now
        state, done = "  ".join(filter(None, [self.describe(record), record.rig])), self.compute_done(record)
        if self._terminal:
            self._bar.update(self._task, completed=done, state=state, refresh=True)
        else:
            self._console.print(f"{self._name}: {100.0 * done / self._total:.0f} %  {state}")

    def note_cycle(self, record: CycleRecord) -> None:
        """Store what later cycles need; called for every cycle.

        Parameters
        ----------
        record : CycleRecord
        """

    def compute_done(self, record: CycleRecord) -> float:
        """Return how much of the total is done.

        Parameters
        ----------
        record : CycleRecord

        Returns
        -------
        float
        """
        raise NotImplementedError

    def describe(self, record: CycleRecord) -> str:
        """Describe a cycle in one line.

        Parameters
        ----------
        record : CycleRecord

        Returns
        -------
        str
        """
        raise NotImplementedError


class PathProgress(MissionProgress):
    """Progress of a robot on a path.

    Parameters
    ----------
    mission : Mission
    update_interval : float, in s
        Time between two updates on a terminal.
    line_interval : float, in s
        Time between two lines elsewhere.
    """

    def __init__(self, mission: Mission, update_interval: float = 0.1, line_interval: float = 10.0) -> None:
        super().__init__(mission.name, mission.path.length, update_interval, line_interval)
        self._mission = mission
        self._begun: tuple[float, float] | None = None

    def note_cycle(self, record: CycleRecord) -> None:
        """Store when the path was begun.

        Parameters
        ----------
        record : CycleRecord
        """
        command = record.command
        if self._begun is None and command.phase == "follow" and command.window is not None:
            self._begun = (record.shot.end, command.progress)

    def compute_done(self, record: CycleRecord) -> float:
        """Return the arc length that is done.

        Parameters
        ----------
        record : CycleRecord

        Returns
        -------
        float, in m
        """
        return record.command.progress

    def describe(self, record: CycleRecord) -> str:
        """Describe pose, distance of the tracked pose from the path, loop rate and time left.

        Parameters
        ----------
        record : CycleRecord

        Returns
        -------
        str
        """
        parts: list[str] = [record.shot.mode]
        pose = record.tracked
        if pose is not None:
            off = float(self._mission.path.project(pose.position[None, :])[1][0])
            parts.append(f"({pose.position[0] * 1e3:+.1f}, {pose.position[1] * 1e3:+.1f}) mm")
            parts.append(f"{off * 1e3:.2f} mm off" if record.command.phase == "follow" else "approaching")
        end = record.shot.end
        parts.append(f"{self._cycles / end:.1f} Hz")
        left = self._estimate_time_left(record)
        parts.append(f"{end:.0f} s" + (f", {left:.0f} s left" if left is not None else ""))
        return "  ".join(parts)

    def _estimate_time_left(self, record: CycleRecord) -> float | None:
        if self._begun is None:
            return None
        gone, done = record.shot.end - self._begun[0], record.command.progress - self._begun[1]
        if done <= 0.0:
            return None
        return gone / done * (self._mission.path.length - record.command.progress)


class ObservationProgress(MissionProgress):
    """Progress of an observation, in seconds or in measurements.

    Parameters
    ----------
    mission : Observation
    update_interval : float, in s
        Time between two updates on a terminal.
    line_interval : float, in s
        Time between two lines elsewhere.
    """

    def __init__(self, mission: Observation, update_interval: float = 0.1, line_interval: float = 10.0) -> None:
        section = mission.sections.observe
        super().__init__(
            mission.name, section.duration_s or float(section.measurements or 1), update_interval, line_interval
        )
        self._counts = section.measurements is not None
        self._begun: float | None = None
        self._made = 0

    def note_cycle(self, record: CycleRecord) -> None:
        """Store when the device was first located, and count the measurements.

        Parameters
        ----------
        record : CycleRecord
        """
        if record.pose is None or not record.pose.trusted:
            return
        self._begun = record.shot.end if self._begun is None else self._begun
        self._made += record.shot.mode == "hold"

    def compute_done(self, record: CycleRecord) -> float:
        """Return the seconds or the measurements that are done.

        Parameters
        ----------
        record : CycleRecord

        Returns
        -------
        float
        """
        if self._counts:
            return float(self._made)
        return 0.0 if self._begun is None else record.shot.end - self._begun

    def describe(self, record: CycleRecord) -> str:
        """Describe mode, pose and progress.

        Parameters
        ----------
        record : CycleRecord

        Returns
        -------
        str
        """
        parts: list[str] = [record.shot.mode]
        if record.pose is not None:
            x, y, z = 1e3 * record.pose.position
            parts.append(f"({x:+.1f}, {y:+.1f}, {z:.1f}) mm")
        parts.append(f"{self._made} measurements" if self._counts else f"{self._cycles / record.shot.end:.1f} Hz")
        left = (
            ""
            if self._counts or self._begun is None
            else f", {max(self._total - self.compute_done(record), 0.0):.0f} s left"
        )
        parts.append(f"{record.shot.end:.0f} s{left}")
        return "  ".join(parts)


@contextmanager
def show_progress(mission: AnyMission) -> Iterator[MissionProgress]:
    """Show the progress of a mission while a ``with`` block runs.

    Parameters
    ----------
    mission : Mission or Observation

    Yields
    ------
    MissionProgress
        To be called with the record of each cycle.
    """
    progress = ObservationProgress(mission) if isinstance(mission, Observation) else PathProgress(mission)
    progress.start()
    try:
        yield progress
    finally:
        progress.stop()
