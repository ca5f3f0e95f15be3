"""What stands where world, scheduler and pilot do, when a record is played to the loop again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.limits import Limits
from smolbot.core.rig import Witness
from smolbot.core.sensing import Device, Recording, SensorArray
from smolbot.core.shots import Actuate, Excite, Listen, Shot
from smolbot.errors import InputError, RigError
from smolbot.flight.device_belief import DeviceBelief
from smolbot.flight.tracking.tracker import Tracker
from smolbot.motion.controller import Command, Cycle
from smolbot.runs.recording.reader import Played, RecordedRun


class PlayedRig:
    """A rig that gives what was heard in flight, shot after shot, and moves nothing.

    Parameters
    ----------
    record : RecordedRun
    sensors, limits
        As the mission believes in them.
    half_periods : int, optional
        How much of each window of a cycle to give; all of it unless given.
    """

    witness: Witness | None = None

    def __init__(
        self, record: RecordedRun, sensors: SensorArray, limits: Limits, half_periods: int | None = None
    ) -> None:
        self.sensors = sensors
        self.limits = limits
        self._record = record
        self._half_periods = half_periods
        self._next = 0
        self._now = record.played[0].shot.start if record.played else 0.0

    def now(self) -> float:
        """When the last shot had been played, in s."""
        return self._now

    def play(self, shot: Shot) -> Recording | None:
        """What was heard in the next recorded shot with these windows.

        Raises
        ------
        RigError
            If there is none: part of the record is missing.
        """
        for index in range(self._next, len(self._record.played)):
            played = self._record.played[index]
            if self.shortened(played.shot).windows == shot.windows:
                self._next, self._now = index + 1, played.ended
                recording = played.recording(self._record.converter)
                return None if recording is None else self._cut(played.shot, recording)
        raise RigError(f"{self._record.path}: holds no more shot like this one, at {shot.start:.3f} s: {shot}.")

    def shortened(self, shot: Shot) -> Shot:
        """The shot as if it had listened for no more than was asked; one of which something is learned, as it is."""
        listen = shot.listen
        if self._half_periods is None or listen is None or shot.mode == "quiet":
            return shot
        brief = Listen(self._half_periods, listen.frequency)
        return replace(shot, windows=tuple(brief if w is listen else w for w in shot.windows))

    def excitation_field(self, position: FloatArray) -> FloatArray:
        """None is driven."""
        return np.zeros((2, 3))

    def stop(self) -> None:
        """Nothing moves."""

    def close(self) -> None:
        """Nothing is held."""

    def _cut(self, shot: Shot, recording: Recording) -> Recording:
        brief = self.shortened(shot).listen
        if brief is None or brief is shot.listen or brief == shot.listen:
            return recording
        n = round(brief.duration * recording.sample_rate)
        return replace(recording, field=recording.field[:, :n])


class PlayedScheduler:
    """Gives the shots that were played, in their order, instead of planning any."""

    def __init__(self, record: RecordedRun, rig: PlayedRig, cycle: Cycle, limits: Limits, belief: DeviceBelief) -> None:
        self.cycle = cycle
        self.limits = limits
        self.belief = belief
        self.paused = False
        cycles = set(record.shot_of_cycle)
        self._learned = [p for p in record.played if p.shot.mode == "quiet" and p.number not in cycles]
        by_number = {p.number: p for p in record.played}
        self._shots = iter([rig.shortened(by_number[number].shot) for number in record.shot_of_cycle])

    @property
    def device(self) -> Device:
        """The device that shots were made for."""
        return self.belief.scheduled

    def quiet_shots(self, duration: float) -> Iterator[Shot]:
        """Those that only listened."""
        yield from (p.shot for p in self._learned if all(isinstance(w, Listen) for w in p.shot.windows))

    def probe_shots(self) -> Iterator[Shot]:
        """Those that drove off resonance."""
        yield from _first_tries([p for p in self._learned if isinstance(p.shot.windows[0], Excite)])

    def tail_shots(self, coil: int) -> Iterator[Shot]:
        """Those in which one actuation coil pulled faintly."""
        yield from _first_tries([p for p in self._learned if _pulled(p.shot) == coil])

    def next(self, command: Command, tracker: object) -> Shot:
        """The shot of the next cycle, whatever was commanded."""
        return next(self._shots)


class PlayedPilot:
    """Says what was said in flight; done at the last cycle."""

    def __init__(self, record: RecordedRun) -> None:
        self._commands = [moment.cycle.command for moment in record.moments]
        self._given = 0

    def command(self, shot: Shot, tracker: Tracker) -> Command:
        """The command of that cycle."""
        command = self._commands[self._given]
        self._given += 1
        over = self._given == len(self._commands)
        return replace(command, done=over, stuck=False)


def require_windows(record: RecordedRun, half_periods: int | None) -> None:
    """Raise ``InputError`` unless there is something to locate in, and as much of it as is wanted."""
    cycles = set(record.shot_of_cycle)
    heard = [p for p in record.played if p.samples is not None and p.number in cycles]
    if not record.moments:
        short = "" if record.whole else "; it was cut short before the first"
        raise InputError(f"{record.path}: holds no cycle, so there is nothing to replay{short}.")
    if not heard:
        raise InputError(
            f"{record.path}: holds no windows of any cycle, so nothing can be located anew; "
            "runs of the reduced plant make no signals."
        )
    least = min(p.shot.listen.half_periods for p in heard if p.shot.listen is not None)
    if half_periods is not None and not 1 <= half_periods <= least:
        raise InputError(
            f"--half-periods must lie within 1 and {least}, which this run listened for; got {half_periods}."
        )


def _pulled(shot: Shot) -> int | None:
    """Which actuation coil a shot of the learning pulls with."""
    first = shot.windows[0]
    if not isinstance(first, Actuate):
        return None
    return int(np.argmax(np.abs(first.currents)))


def _first_tries(played: list[Played]) -> Iterator[Shot]:
    """The shots, those left out that repeat one whose window was lost."""
    before: Played | None = None
    for p in played:
        repeats = before is not None and before.samples is None and before.shot.windows == p.shot.windows
        before = p
        if not repeats:
            yield p.shot
