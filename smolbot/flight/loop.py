"""The closed loop: shot, recording, pose, track, command. Nothing calls back up."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from lookup_tables.errors import OutsideTableError
from smolbot.core.blas_threads import one_thread
from smolbot.core.pose import Pose
from smolbot.core.rig import Rig
from smolbot.core.sensing import Recording, SensorArray
from smolbot.core.shots import Shot
from smolbot.errors import InputError, InterlockError, OperatorStopError, RigError
from smolbot.flight.pause import Pause
from smolbot.flight.pilots import Pilot
from smolbot.flight.preparation import Preparation, Quiet
from smolbot.flight.safety.stop_signals import CTRL_C
from smolbot.flight.safety.supervisor import Safety, unbounded
from smolbot.flight.scheduler import Scheduler
from smolbot.flight.tracking.noise_monitor import NoiseWatch
from smolbot.flight.tracking.resonance_filter import Resonance
from smolbot.flight.tracking.tracker import Tracker
from smolbot.localization.array.filter import ArrayFilter
from smolbot.localization.localizer import Localizer, Swing
from smolbot.localization.noise.actuation_tails import CoilTails
from smolbot.localization.synthetic import SightedSwing, Sightings
from smolbot.motion.controller import Command
from smolbot.runs.run import CycleRecord, Event, Listener, Run, Status, Tape

_LOG = logging.getLogger(__name__)

LEARN_EVERY = 5
"""Cycles between two looks at the resonance and the noise, which change slowly."""


@dataclass(frozen=True)
class StopRules:
    """When to give up: time in s since the noise was learned, and shots in a row without a pose."""

    max_duration: float
    lost_shots: int


def as_lists(sensors: SensorArray) -> dict[str, object]:
    """An array for the record, bit for bit."""
    gains = None if sensors.gains is None else sensors.gains.tolist()
    return {"positions_m": sensors.positions.tolist(), "axes": sensors.axes.tolist(), "gains": gains}


class Loop:
    """Plays shot after shot with a rig, a localizer and a tracker, as a pilot says, until the pilot is done.

    In a world that makes no signals, `Sightings` take the localizer's place, and there is nothing to learn from.
    Where poses are to be `independent`, each is found from nothing, and nothing is learned from one for the next.
    A device that is `led` leaves residuals that are not noise: the noise stays as it was learned at the start.
    The `safety` is asked before every shot and told of every recording; without one, only the rig's limits count.
    The `tape` hears of all that is played and happens; while the `pause` holds, the robot is listened to and not moved.

    Attributes
    ----------
    run : Run
        What has happened so far; whole once `fly` returned or raised.
    """

    def __init__(
        self,
        rig: Rig,
        scheduler: Scheduler,
        localizer: Localizer | Sightings,
        tracker: Tracker,
        pilot: Pilot,
        rules: StopRules,
        quiet: Quiet,
        listeners: tuple[Listener, ...] = (),
        clock: Callable[[], float] = time.perf_counter,
        *,
        independent: bool = False,
        led: bool = False,
        array_filter: ArrayFilter | None = None,
        safety: Safety | None = None,
        tape: Tape | None = None,
        pause: Pause | None = None,
    ) -> None:
        self.rig = rig
        self.scheduler = scheduler
        self.localizer: Localizer | Sightings = localizer
        self.tracker = tracker
        self.pilot = pilot
        self.rules = rules
        self.quiet = quiet
        self.events: list[Event] = []
        self.resonance = Resonance(localizer.device)
        self.tails = CoilTails()
        self.noise_watch = NoiseWatch(len(localizer.sensors))
        self.array_filter = array_filter
        self.listeners = listeners
        self.independent = independent
        self.led = led
        self.safety = safety if safety is not None else unbounded(rig.limits, len(localizer.sensors))
        self.run = Run()
        self.pause = pause if pause is not None else Pause()
        self._tape = tape
        self._clock = clock
        self._started = 0.0
        self._paused = 0.0
        self._heard = 0

    def fly(self) -> Run:
        """Cycle until the path's end, a stop rule, an error or Ctrl-C; every output is at zero afterwards.

        An error that nobody foresaw is raised once the outputs are at zero and `run` says what happened.
        """
        self.run, begin = Run(), self._clock()
        run = self.run
        try:
            try:
                with one_thread():
                    self._cycle_on(run)
            finally:
                self.safety.end()
        except KeyboardInterrupt as stop:
            run.status, run.stop_reason = "stopped", str(stop) or CTRL_C
        except (InterlockError, RigError, OutsideTableError) as error:
            run.error = error
            run.status, run.stop_reason = "stopped" if isinstance(error, OperatorStopError) else "failed", str(error)
        except Exception as error:
            run.status, run.stop_reason = "failed", f"{type(error).__name__}: {error}"
            raise
        finally:
            if (
                run.status == "failed" and self.safety.latch.is_shut
            ):  # what stopped the rig matters, not what it said then
                run.status, run.stop_reason = self.safety.latch.ending, self.safety.latch.reason
            self._silence(run)
            run.duration = self.rig.now()
            run.events = self.events
            run.safety = self.safety.figures()
            run.recovered = self._recovered()
            run.wall = self._clock() - begin
        return run

    def _cycle_on(self, run: Run) -> None:
        """Learn what is to be learned, then cycle until there is a reason to end."""
        first = Preparation(self.localizer, self.scheduler, self.quiet, self._played, self.rig.now, self._happened)
        first.learn()
        self.localizer, self.tails = first.localizer, first.tails
        first.warm_up(None if self.array_filter is None else self.array_filter.belief.frames)
        run.begun = self._started = self.rig.now()
        command, reason = Command(None, note="no pose yet"), None
        while reason is None:
            record = self._cycle(command)
            run.cycles.append(record)
            for listener in self.listeners:
                listener(record)
            command = record.command
            reason = self._ended(command)
        run.status, run.stop_reason = reason

    def _silence(self, run: Run) -> None:
        try:
            self.rig.stop()
        except Exception as error:  # a device that is gone must not cost the record of the run
            run.status = "failed"
            run.stop_reason += f"; the outputs could not be set to zero: {error}"

    def _recovered(self) -> dict[str, int]:
        """What was borne, by the safety and by the rig; what both counted, once."""
        found = dict(self.safety.recovered)
        for kind, times in getattr(self.rig, "recovered", {}).items():
            name = kind.replace(" ", "_")
            found[name] = max(found.get(name, 0), times)
        return found

    def _played(self, shot: Shot) -> Recording | None:
        """Play one shot as the safety allows it, and let the tape hear of it."""
        self.safety.before(shot, self.rig.now(), self.tracker.pose)
        recording = self.rig.play(shot)
        ended = self.rig.now()
        if self._tape is not None:
            self._tape.played(shot, recording, ended)
        return self.safety.after(shot, recording, ended)

    def _happened(self, time: float, what: str, detail: dict[str, object]) -> None:
        event = Event(time, what, detail)
        self.events.append(event)
        _LOG.info("%.3f s: %s %s", time, what, detail)
        if self._tape is not None:
            self._tape.happened(event)

    def _heed_pause(self) -> None:
        """Begin or end a pause that somebody asked for."""
        if self.pause.held != self.scheduler.paused:
            self.scheduler.paused = self.pause.held
            self._happened(self.rig.now(), "paused" if self.pause.held else "resumed", {})

    def _cycle(self, command: Command) -> CycleRecord:
        begin = self._clock()
        self._heed_pause()
        shot = self.scheduler.next(command, self.tracker)
        self.safety.before(shot, self.rig.now(), self.tracker.pose)
        planned = self._clock()
        recording = self.rig.play(shot)
        heard, ended = self._clock(), self.rig.now()
        if self._tape is not None:
            self._tape.played(shot, recording, ended)
        recording = self.safety.after(shot, recording, ended)
        recording = None if recording is None else self.tails.removed(shot, recording)
        pose: Pose | None = None
        swing: Swing | SightedSwing | None = None
        if recording is not None:
            # a prior that has gone stale would only mislead: a lost signal is searched for from nothing
            lost = self.tracker.pose is None or shot.mode in ("search", "lost") or self.tracker.vague
            prior = None if self.independent or lost else self.tracker.pose_at(recording.middle)
            try:
                pose, swing = self.localizer.locate_swing(recording, prior)
            except InputError:  # too few usable channels: a missed window, counted by the tracker
                pose = swing = None
        tracked = self.tracker.update(shot, pose, swing)
        if self.array_filter is not None and self.tracker.motion is not None:
            self.array_filter.moved(*self.tracker.motion)
        learns = not self.independent and tracked is not None and tracked.trusted
        if recording is not None and isinstance(swing, Swing) and learns:
            assert tracked is not None
            if self.array_filter is not None and pose is not None:
                self._learn_array(tracked.time, self.array_filter, pose, swing)
            self._heard += 1
            if self._heard % LEARN_EVERY == 0:
                self._follow_resonance(tracked.time, swing)
                self._refresh_noise(tracked.time, swing, recording)
        answer = self.pilot.command(shot, self.tracker)
        if answer.event:
            self._happened(shot.end, answer.event, {"note": answer.note})
        if self.scheduler.paused:
            self._paused += ended - shot.start
        done = self._clock()
        says = str(getattr(self.rig, "status_line", ""))
        return CycleRecord(shot, pose, tracked, answer, (planned - begin) + (done - heard), ended, says)

    def _learn_array(self, time: float, learned: ArrayFilter, pose: Pose, swing: Swing) -> None:
        """Let the localizer know of sensors that do not stand where they were thought to."""
        terms = swing.of_the_array(learned.belief.frames)
        if terms is None or isinstance(self.localizer, Sightings):
            return
        if not learned.update(pose, terms):
            return
        device = replace(self.localizer.device, moment=learned.moment, l0=learned.l0)
        self.localizer = self.localizer.with_sensors(learned.sensors).with_device(device)
        self.resonance.device = replace(self.resonance.device, moment=learned.moment, l0=learned.l0)
        found = {"recordings": learned.recordings, "moment_a_m2": learned.moment, "l0_m": learned.l0}
        self._happened(time, "array learned", {**found, **as_lists(learned.sensors)})

    def _follow_resonance(self, time: float, swing: Swing) -> None:
        device = self.resonance.update(time, *swing.resonance())
        if device is None or isinstance(self.localizer, Sightings):
            return
        self.localizer = self.localizer.with_device(device)
        self.scheduler.device = device
        self._happened(time, "device retuned", {"frequency_hz": device.frequency, "damping_per_s": device.damping})

    def _refresh_noise(self, time: float, swing: Swing, recording: Recording) -> None:
        """Let the localizer know of sensors that have become noisier, or quieter, than they were at the start."""
        if self.led or isinstance(self.localizer, Sightings) or self.localizer.estimator != "whitened":
            return
        ratios = self.noise_watch.update(*swing.energies(recording, self.localizer.noise))
        if ratios is None:
            return
        self.localizer = self.localizer.with_noise(self.localizer.noise.rescaled(ratios))
        self._happened(time, "noise refreshed", {"power_ratios": [round(float(r), 2) for r in ratios]})

    def _ended(self, command: Command) -> tuple[Status, str] | None:
        if command.done:
            return "completed", command.note or "done"
        if command.stuck:
            return "stuck", command.note or "the controller gave up"
        if self.tracker.misses >= self.rules.lost_shots:
            seen = "the signal was never found" if self.tracker.pose is None else "the signal was lost"
            return "lost", f"{seen}: {self.tracker.misses} shots in a row gave no pose that can be believed"
        flown = self.rig.now() - self._started - self._paused
        if flown >= self.rules.max_duration:
            return "timeout", f"max_duration_s reached after {flown:.0f} s"
        return None
