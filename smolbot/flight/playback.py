"""Stand-ins for rig, scheduler and pilot that feed a recorded run to the loop."""

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
from smolbot.runs.recording.reader import PlayedShot, RecordedRun


class ReplayRig:
    """Rig that returns the recordings of a recorded run, shot after shot, and moves nothing.

    Parameters
    ----------
    record : RecordedRun
    sensors : SensorArray
        As the mission's rig file describes them.
    limits : Limits
    half_periods : int, optional
        Length of each listening window to return; the complete window by default.
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
        """Return when the last shot ended.

        Returns
        -------
        float, in s
            On the clock of the recorded rig.
        """
        return self._now

    def play(self, shot: Shot) -> Recording | None:
        """Return the recording of the next recorded shot with the same windows.

        Parameters
        ----------
        shot : Shot

        Returns
        -------
        Recording or None
            None if the shot did not listen, or if its window was lost in flight.

        Raises
        ------
        RigError
            If no such shot is left: part of the record is missing.
        """
        for index in range(self._next, len(self._record.played)):
            played = self._record.played[index]
            if self.shorten(played.shot).windows == shot.windows:
                self._next, self._now = index + 1, played.ended
                recording = played.recording(self._record.converter)
                return None if recording is None else self._cut_to_length(played.shot, recording)
        raise RigError(f"{self._record.path}: holds no more shot like this one, at {shot.start:.3f} s: {shot}.")

    def shorten(self, shot: Shot) -> Shot:
        """Shorten the listening window of a shot to the requested number of half-periods.

        Parameters
        ----------
        shot : Shot

        Returns
        -------
        Shot
            Unchanged if it belongs to the learning before the first cycle, or if the complete window is used.
        """
        listen = shot.listen
        if self._half_periods is None or listen is None or shot.mode == "quiet":
            return shot
        brief = Listen(self._half_periods, listen.frequency)
        return replace(shot, windows=tuple(brief if w is listen else w for w in shot.windows))

    def excitation_field(self, position: FloatArray) -> FloatArray:
        """Return a field of zero, since no coil is driven in a replay.

        Parameters
        ----------
        position : ndarray, shape (3,), in m
            In the world frame.

        Returns
        -------
        ndarray, shape (2, 3), in T per A
        """
        return np.zeros((2, 3))

    def stop(self) -> None:
        """Do nothing: nothing moves."""

    def close(self) -> None:
        """Do nothing: no device is open."""

    def _cut_to_length(self, shot: Shot, recording: Recording) -> Recording:
        brief = self.shorten(shot).listen
        if brief is None or brief is shot.listen or brief == shot.listen:
            return recording
        n = round(brief.duration * recording.sample_rate)
        return replace(recording, field=recording.field[:, :n])


class ReplayScheduler:
    """Scheduler that returns the recorded shots in order instead of planning any.

    Parameters
    ----------
    record : RecordedRun
    rig : ReplayRig
        Shortens the listening windows.
    cycle : Cycle
    limits : Limits
    belief : DeviceBelief
    """

    def __init__(self, record: RecordedRun, rig: ReplayRig, cycle: Cycle, limits: Limits, belief: DeviceBelief) -> None:
        self.cycle = cycle
        self.limits = limits
        self.belief = belief
        self.paused = False
        cycles = set(record.shot_of_cycle)
        self._learned = [p for p in record.played if p.shot.mode == "quiet" and p.number not in cycles]
        by_number = {p.number: p for p in record.played}
        self._shots = iter([rig.shorten(by_number[number].shot) for number in record.shot_of_cycle])

    @property
    def device(self) -> Device:
        """The device that shots were made for."""
        return self.belief.scheduled

    def make_noise_shots(self, duration: float) -> Iterator[Shot]:
        """Return the recorded shots of background noise.

        Parameters
        ----------
        duration : float, in s
            Ignored; all recorded ones are returned.

        Yields
        ------
        Shot
        """
        yield from (p.shot for p in self._learned if all(isinstance(w, Listen) for w in p.shot.windows))

    def make_probe_shots(self) -> Iterator[Shot]:
        """Return the recorded shots that excite off resonance.

        Yields
        ------
        Shot
        """
        yield from _drop_repeats([p for p in self._learned if isinstance(p.shot.windows[0], Excite)])

    def make_tail_shots(self, coil: int) -> Iterator[Shot]:
        """Return the recorded shots that measure the current decay of one actuation coil.

        Parameters
        ----------
        coil : int
            Index of the coil, from 0.

        Yields
        ------
        Shot
        """
        yield from _drop_repeats([p for p in self._learned if _find_pulling_coil(p.shot) == coil])

    def next(self, command: Command, tracker: object) -> Shot:
        """Return the recorded shot of the next cycle.

        Parameters
        ----------
        command : Command
            Ignored.
        tracker : Tracker
            Ignored.

        Returns
        -------
        Shot
        """
        return next(self._shots)


class ReplayPilot:
    """Pilot that repeats the recorded commands and is done at the last cycle.

    Parameters
    ----------
    record : RecordedRun
    """

    def __init__(self, record: RecordedRun) -> None:
        self._commands = [moment.cycle.command for moment in record.moments]
        self._given = 0

    def command(self, shot: Shot, tracker: Tracker) -> Command:
        """Return the recorded command of the next cycle.

        Parameters
        ----------
        shot : Shot
            Ignored.
        tracker : Tracker
            Ignored.

        Returns
        -------
        Command
        """
        command = self._commands[self._given]
        self._given += 1
        over = self._given == len(self._commands)
        return replace(command, done=over, stuck=False)


def check_windows(record: RecordedRun, half_periods: int | None) -> None:
    """Check that a record holds listening windows, and that they are as long as requested.

    Parameters
    ----------
    record : RecordedRun
    half_periods : int or None
        Requested length of each window; None for the complete windows.

    Raises
    ------
    InputError
        If the record holds no cycle or no listening window, or if its windows are shorter than requested.
    """
    cycles = set(record.shot_of_cycle)
    recorded = [p for p in record.played if p.samples is not None and p.number in cycles]
    if not record.moments:
        short = "" if record.whole else "; it was cut short before the first"
        raise InputError(f"{record.path}: holds no cycle, so there is nothing to replay{short}.")
    if not recorded:
        raise InputError(
            f"{record.path}: holds no listening windows of any cycle, so nothing can be located again; "
            "runs of the reduced plant make no signals."
        )
    least = min(p.shot.listen.half_periods for p in recorded if p.shot.listen is not None)
    if half_periods is not None and not 1 <= half_periods <= least:
        raise InputError(
            f"--half-periods must lie within 1 and {least}, which this run listened for; got {half_periods}."
        )


def _find_pulling_coil(shot: Shot) -> int | None:
    """Find the actuation coil that a shot of the learning phase drives; None if it drives none."""
    first = shot.windows[0]
    if not isinstance(first, Actuate):
        return None
    return int(np.argmax(np.abs(first.currents)))


def _drop_repeats(played: list[PlayedShot]) -> Iterator[Shot]:
    """Drop shots that repeat one whose window was lost."""
    before: PlayedShot | None = None
    for p in played:
        repeats = before is not None and before.samples is None and before.shot.windows == p.shot.windows
        before = p
        if not repeats:
            yield p.shot
