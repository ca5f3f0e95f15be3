"""The closed loop: shot, recording, pose, track, command. Nothing calls back up."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lookup_tables.errors import OutsideTableError
from smolbot.control import Command
from smolbot.errors import InputError, InterlockError, OperatorStopError, RigError
from smolbot.flown import CycleRecord, Event, Listener, Run, Status, Tape
from smolbot.localization.array_filter import ArrayFilter
from smolbot.localization.forward import deflection, sensor_field
from smolbot.localization.localizer import Localizer, Swing
from smolbot.localization.noise import NoiseModel
from smolbot.localization.tails import CoilTails, Tail, learn_tail
from smolbot.localization.transients import QUIET_AFTER, learn_time_constant
from smolbot.noisewatch import NoiseWatch
from smolbot.pausing import Pause
from smolbot.pilots import Pilot
from smolbot.poses import Pose
from smolbot.resonance import Resonance
from smolbot.rotations import quaternion_from_axes
from smolbot.safety import Safety, unbounded
from smolbot.scheduler import Scheduler
from smolbot.sensing import Recording, SensorArray
from smolbot.shots import Shot
from smolbot.sightings import SightedSwing, Sightings
from smolbot.signals import CTRL_C
from smolbot.tracking import Tracker
from smolbot.worlds import Rig

LEARN_EVERY = 5
"""Cycles between two looks at the resonance and the noise, which change slowly."""


@dataclass(frozen=True)
class StopRules:
    """When to give up: time in s since the noise was learned, and shots in a row without a pose."""

    max_duration: float
    lost_shots: int


@dataclass(frozen=True)
class Quiet:
    """What is learned before the first cycle.

    Attributes
    ----------
    duration : float, in s
        How long to listen to the noise alone; 0: not at all.
    sample_rate : float, in Hz
    learn_ring_down : bool
        Whether to learn the excitation coils' decay, so that listening may start before it is over.
    """

    duration: float
    sample_rate: float
    learn_ring_down: bool = False


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
                self._cycle_on(run)
            finally:
                self.safety.end()
        except KeyboardInterrupt as stop:
            run.status, run.stop_reason = "stopped", str(stop) or CTRL_C
        except (InterlockError, RigError, OutsideTableError) as error:
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
        self._learn_noise()
        self._learn_ring_down()
        self._learn_tails()
        self._warm_up()
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
        """Play one shot of those from which something is learned, as the safety allows it."""
        self.safety.before(shot, self.rig.now(), self.tracker.pose)
        recording = self.rig.play(shot)
        ended = self.rig.now()
        if self._tape is not None:
            self._tape.played(shot, recording, ended)
        return self.safety.after(shot, recording, ended)

    def _happened(self, time: float, what: str, detail: dict[str, object]) -> None:
        event = Event(time, what, detail)
        self.events.append(event)
        if self._tape is not None:
            self._tape.happened(event)

    def _heed_pause(self) -> None:
        """Begin or end a pause that somebody asked for."""
        if self.pause.held != self.scheduler.paused:
            self.scheduler.paused = self.pause.held
            self._happened(self.rig.now(), "paused" if self.pause.held else "resumed", {})

    def _listened(self, shot: Shot) -> Recording | None:
        """The same; a window that was lost is listened to once more."""
        heard = self._played(shot)
        return heard if heard is not None else self._played(replace(shot, start=self.rig.now()))

    def _learn_noise(self) -> None:
        """Listen to the noise alone, and let the localizer know it."""
        if self.quiet.duration <= 0.0:
            return
        heard = [self._played(shot) for shot in self.scheduler.quiet_shots(self.quiet.duration)]
        if isinstance(self.localizer, Sightings):
            return
        try:
            noise = NoiseModel.learn([recording for recording in heard if recording is not None])
        except InputError as error:
            raise RigError(f"The noise cannot be learned from {len(heard)} quiet shots: {error}") from error
        self.localizer = self.localizer.with_noise(noise)
        lines = [round(float(f), 3) for f in noise.line_frequencies]
        self._happened(self.rig.now(), "noise learned", {"quiet_shots": len(heard), "lines_hz": lines})

    def _learn_ring_down(self) -> None:
        """Learn the excitation coils' decay, and listen as soon as it can be told from a signal."""
        if not self.quiet.learn_ring_down:
            return
        heard = [self._listened(shot) for shot in self.scheduler.probe_shots()]
        if isinstance(self.localizer, Sightings):
            constants = self.localizer.time_constants
        else:
            frequency = self.localizer.device.frequency
            constants = tuple(learn_time_constant([r], frequency) for r in heard if r is not None)
            if len(constants) < len(heard):  # listening later, as the mission says, is right for any coil
                self._happened(self.rig.now(), "ring-down not learned", {"lost": len(heard) - len(constants)})
                return
            self.localizer = self.localizer.with_transients(constants)
        ring_down = max(QUIET_AFTER * max(constants), self.scheduler.limits.min_ring_down)
        self.scheduler.cycle = replace(self.scheduler.cycle, ring_down=ring_down)
        detail = {"time_constants_ms": [1e3 * t for t in constants], "ring_down_ms": 1e3 * ring_down}
        self._happened(self.rig.now(), "ring-down learned", detail)

    def _learn_tails(self) -> None:
        """Learn what a pull of each actuation coil leaves, where listening starts before it is over."""
        if not self.quiet.learn_ring_down or isinstance(self.localizer, Sightings):
            return
        self.tails = CoilTails(tuple(self._tail(coil) for coil in range(len(self.scheduler.limits.coils))))
        learned = [tail for tail in self.tails.tails if tail is not None]
        if learned:
            detail: dict[str, object] = {
                "time_constants_ms": [None if t is None else 1e3 * t.time_constant for t in self.tails.tails],
                "sizes_t_per_a": [None if t is None else t.size.tolist() for t in self.tails.tails],
            }
            self._happened(self.rig.now(), "coil tails learned", detail)

    def _tail(self, coil: int) -> Tail | None:
        for shot in self.scheduler.tail_shots(coil):
            heard = self._listened(shot)
            if heard is not None and not heard.saturated.any():
                return learn_tail(shot, [heard], self.scheduler.device.frequency)
        return None

    def _warm_up(self) -> None:
        """Use every compiled kernel once, on a made-up recording, so that the first cycles are as quick as the rest."""
        if isinstance(self.localizer, Sightings):
            return
        device, cycle, rate = self.localizer.device, self.scheduler.cycle, self.quiet.sample_rate
        orientation = quaternion_from_axes(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), "zy")
        samples = round(cycle.half_periods * rate / (2.0 * device.frequency))
        time_ = cycle.ring_down + np.arange(samples) / rate
        theta = deflection(device, time_, 0.5 * device.theta_max, 0.3)
        middle = 0.5 * np.add(self.localizer.volume.low, self.localizer.volume.high)
        heard = sensor_field(self.localizer.sensors, device, middle, orientation, theta)
        recording = Recording(heard, rate, cycle.ring_down)
        _, swing = self.localizer.locate_swing(recording, self.localizer.locate(recording))
        if self.array_filter is not None:
            swing.of_the_array(self.array_filter.belief.frames)

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
