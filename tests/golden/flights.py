"""The golden flights: records that are played again, flights that are flown again, signals that are located again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from smolbot.config.load import AnyMission, load_mission
from smolbot.config.plugins import load_world
from smolbot.core.shots import Actuate, Shot
from smolbot.flight.loop import Loop
from smolbot.flight.pilots import Pilot
from smolbot.flight.replay import make_replay_loop
from smolbot.flight.scheduler import Scheduler
from smolbot.flight.session import fly
from smolbot.flight.tracking.tracker import Tracker
from smolbot.motion.controller import Command
from smolbot.runs.recording.reader import RecordedRun, read_run
from smolbot.runs.run import Run
from tests.golden.answers import as_answers, compare
from tests.golden.corpus import RECORDS, unpacked
from tests.golden.foreign import locate_all

REPLAYS: dict[str, tuple[str, dict[str, str]]] = {
    "line": ("line", {}),
    "r_path": ("r_path", {}),
    "s_path": ("s_path", {}),
    "endoscope": ("endoscope", {}),
    "brain_marker": ("brain_marker", {}),
    "n_6": ("n_6", {}),
    "paper": ("r_path", {"localization.estimator": "paper"}),
}
"""By name: the record, and settings that were not the flight's own."""

FLIGHTS: dict[str, tuple[str, int, dict[str, str]]] = {
    "tank_line": ("line", 11, {"stop.max_duration_s": "6", "controller.law": "force_pursuit"}),
    "tank_r_path": ("r_path", 12, {"stop.max_duration_s": "6"}),
    "tank_s_path": ("s_path", 13, {"stop.max_duration_s": "120"}),
    "tank_endoscope": ("endoscope", 14, {"observe.duration_s": "3"}),
    "tank_brain_marker": ("brain_marker", 15, {"observe.measurements": "3"}),
}
"""By name: mission, seed, and what makes it short."""


class _AskedScheduler(Scheduler):
    """Plans every shot from what is believed, and gives the one that was played."""

    def __init__(self, real: Scheduler, played: Scheduler, field: Callable[..., Any]) -> None:
        self.__dict__.update(vars(real))
        self._played = played
        self._excitation_field = field
        self.planned: list[Shot] = []

    def next(self, command: Command, tracker: Any) -> Shot:
        self.planned.append(super().next(command, tracker))
        return self._played.next(command, tracker)

    def make_noise_shots(self, duration: float) -> Iterator[Shot]:
        return self._both(super().make_noise_shots(duration), self._played.make_noise_shots(duration))

    def make_probe_shots(self) -> Iterator[Shot]:
        return self._both(super().make_probe_shots(), self._played.make_probe_shots())

    def make_tail_shots(self, coil: int) -> Iterator[Shot]:
        return self._both(super().make_tail_shots(coil), self._played.make_tail_shots(coil))

    def _both(self, planned: Iterator[Shot], played: Iterator[Shot]) -> Iterator[Shot]:
        for plan, shot in zip(planned, played, strict=False):
            self.planned.append(plan)
            yield shot


class _AskedPilot:
    """Asks the pilot of the flight, and says what was said in flight."""

    def __init__(self, real: Pilot, played: Pilot) -> None:
        self._real = real
        self._played = played
        self.answers: list[Command] = []

    def command(self, shot: Shot, tracker: Tracker) -> Command:
        self.answers.append(self._real.command(self._as_asked(shot), tracker))
        return self._played.command(shot, tracker)

    def _as_asked(self, shot: Shot) -> Shot:
        """The shot with what was asked last, where it differs from what was played by no more than another machine's
        last bits: a pilot looks whether its own command was played, to the bit."""
        last = self.answers[-1] if self.answers else Command(None)
        asked = last.mechanical or ((last.window,) if isinstance(last.window, Actuate) else ())
        windows = (*asked, *shot.windows[len(asked) :])
        difference = compare(as_answers(shot.windows), as_answers(windows))
        return shot if difference is None or not difference.small else replace(shot, windows=windows)


@dataclass(frozen=True)
class _Parts:
    scheduler: Scheduler
    pilot: Pilot


def replayed(name: str) -> Any:
    """A record played to the loop again: poses, and what scheduler and controller answer to them, unflown."""
    which, settings = REPLAYS[name]
    with unpacked(RECORDS / f"{which}.mcap.xz") as path:
        return replayed_record(read_run(path), settings)


def replayed_record(record: RecordedRun, settings: dict[str, str]) -> Any:
    """The same of a record that was read."""
    mission = record.mission(settings)
    real = _parts(mission, record)
    loop = make_replay_loop(record, mission, changed=bool(settings))
    scheduler = _AskedScheduler(real.scheduler, loop.scheduler, _believed_field(mission))
    scheduler._clock = loop.rig.now
    pilot = _AskedPilot(real.pilot, loop.pilot)
    loop.scheduler, loop.pilot = scheduler, pilot
    run = loop.fly()
    return as_answers({"planned": scheduler.planned, "commands": pilot.answers, **_summarize(run)})


def _parts(mission: AnyMission, record: RecordedRun) -> _Parts:
    """Scheduler and pilot as the flight had them, made from the mission's files."""
    from smolbot.flight.assembly import make_loop
    from smolbot.flight.playback import ReplayRig

    loop: Loop = make_loop(ReplayRig(record, mission.rig.sensors, mission.rig.limits), mission)
    return _Parts(loop.scheduler, loop.pilot)


def _believed_field(mission: AnyMission) -> Callable[..., Any]:
    """The excitation field in which a flight of the mission believes."""
    return _open(mission, 0).excitation_field


def _open(mission: AnyMission, seed: int) -> Any:
    from smolbot.config.observation import Observation
    from smolbot.core.operator import SilentOperator

    place = mission.start if isinstance(mission, Observation) else mission.start_placement
    world = load_world(mission.rig.world, mission.rig.document)
    return world.open(mission.rig, mission.robot, place, seed, gui=False, operator=SilentOperator())


def fly_golden(name: str) -> Any:
    """A seeded flight in the tank: truth, poses, shots, commands, events."""
    which, seed, settings = FLIGHTS[name]
    run = fly(load_mission(which, None, {"localization.quiet_s": "3", **settings}), seed)
    trail = None if run.true_trail is None else [{"position": place} for place in run.true_trail.tolist()]
    cycles = [{"shot": c.shot, "command": c.command} for c in run.cycles]
    return as_answers({"true": trail, "cycles": cycles, **_summarize(run)})


def _summarize(run: Run) -> dict[str, Any]:
    """What a run found: poses, events, and what safety counted."""
    poses = [{"pose": cycle.pose, "tracked": cycle.tracked, "ended": cycle.ended} for cycle in run.cycles]
    return {
        "poses": poses, "events": run.events, "safety": run.safety, "recovered": run.recovered,
        "status": run.status, "stop_reason": run.stop_reason,
    }  # fmt: skip


MAKERS: dict[str, Callable[[], Any]] = {
    **{name: lambda name=name: replayed(name) for name in REPLAYS},
    **{name: lambda name=name: fly_golden(name) for name in FLIGHTS},
    "foreign_whitened": lambda: as_answers(locate_all("whitened")),
    "foreign_paper": lambda: as_answers(locate_all("paper")),
}
"""How each file of answers is made."""
