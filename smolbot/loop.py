"""The closed loop: shot, recording, pose, track, command. Nothing calls back up."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, Protocol

from lookup_tables.errors import OutsideTableError
from smolbot.arrays import FloatArray
from smolbot.control import Command, Controller
from smolbot.errors import InputError, InterlockError, RigError
from smolbot.localization.localizer import Localizer
from smolbot.paths import Curve
from smolbot.poses import Pose
from smolbot.scheduler import Scheduler
from smolbot.shots import Shot
from smolbot.tracking import Tracker
from smolbot.worlds import Rig

Status = Literal["completed", "stopped", "lost", "timeout", "failed"]


@dataclass(frozen=True)
class CycleRecord:
    """What happened in one cycle. `pose` is as located, `tracked` as believed; `compute` in s."""

    shot: Shot
    pose: Pose | None
    tracked: Pose | None
    command: Command
    compute: float


@dataclass
class Run:
    """A flown mission: how it ended, every cycle, and (once summarised) its figures and folder.

    `true_trail` (n, 3), in m, is where the robot truly went, known with a witness only.
    """

    status: Status = "stopped"
    stop_reason: str = ""
    duration: float = 0.0
    wall: float = 0.0
    cycles: list[CycleRecord] = field(default_factory=list)
    summary: dict[str, object] = field(default_factory=dict)
    folder: str | None = None
    true_trail: FloatArray | None = None


class Listener(Protocol):
    """Hears of every cycle as it ends: recorder, progress."""

    def __call__(self, record: CycleRecord) -> None: ...


@dataclass(frozen=True)
class StopRules:
    """When to give up: mission time in s, and shots in a row without a pose."""

    max_duration: float
    lost_shots: int


class Loop:
    """Flies one path with a rig, a localizer, a tracker and a controller."""

    def __init__(
        self,
        rig: Rig,
        path: Curve,
        scheduler: Scheduler,
        localizer: Localizer,
        tracker: Tracker,
        controller: Controller,
        rules: StopRules,
        listeners: tuple[Listener, ...] = (),
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.rig = rig
        self.path = path
        self.scheduler = scheduler
        self.localizer = localizer
        self.tracker = tracker
        self.controller = controller
        self.rules = rules
        self.listeners = listeners
        self._clock = clock
        self._begun = False

    def fly(self) -> Run:
        """Cycle until the path's end, a stop rule, an error or Ctrl-C; every output is at zero afterwards."""
        run = Run()
        begin, command = self._clock(), Command(None, note="no pose yet")
        try:
            while True:
                record = self._cycle(command)
                run.cycles.append(record)
                for listener in self.listeners:
                    listener(record)
                command = record.command
                reason = self._ended(command)
                if reason:
                    run.status, run.stop_reason = reason
                    break
        except KeyboardInterrupt:
            run.status, run.stop_reason = "stopped", "stopped by the operator (Ctrl-C)"
        except (InterlockError, RigError, OutsideTableError) as error:
            run.status, run.stop_reason = "failed", str(error)
        finally:
            self.rig.stop()
        run.duration = self.rig.now()
        run.wall = self._clock() - begin
        return run

    def _cycle(self, command: Command) -> CycleRecord:
        begin = self._clock()
        shot = self.scheduler.next(command, self.tracker)
        planned = self._clock()
        recording = self.rig.play(shot)
        heard = self._clock()
        pose = None
        if recording is not None:
            # a prior that has gone stale would only mislead: a lost signal is searched for from nothing
            prior = None if shot.mode in ("search", "lost") else self.tracker.pose
            try:
                pose = self.localizer.locate(recording, prior)
            except InputError:  # too few usable channels: a missed window, counted by the tracker
                pose = None
        tracked = self.tracker.update(shot, pose)
        answer = self._command(shot)
        done = self._clock()
        return CycleRecord(shot, pose, tracked, answer, (planned - begin) + (done - heard))

    def _command(self, shot: Shot) -> Command:
        if self.tracker.pose is None:
            return Command(None, note="searching for the signal")
        if not self.tracker.confirmed:
            return Command(None, note="waiting for a second pose to agree")
        pose = self.tracker.pose_at(shot.end)
        if not self._begun:
            self.controller.reset(self.path, pose)
            self._begun = True
        return self.controller.command(pose)

    def _ended(self, command: Command) -> tuple[Status, str] | None:
        if command.done:
            return "completed", "path's end reached"
        if self.tracker.misses >= self.rules.lost_shots:
            seen = "the signal was never found" if self.tracker.pose is None else "the signal was lost"
            return "lost", f"{seen}: {self.tracker.misses} shots in a row gave no pose that can be believed"
        if self.rig.now() >= self.rules.max_duration:
            return "timeout", f"max_duration_s reached after {self.rig.now():.0f} s"
        return None
