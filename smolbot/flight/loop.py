"""The closed loop: plan a shot, play it, locate, track, and compute the next command.

Each part is called from here and calls nothing back in the loop.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from lookup_tables.errors import OutsideTableError
from smolbot.core.blas_threads import limit_to_one_thread
from smolbot.core.pose import Pose
from smolbot.core.rig import RecoveryCounter, Rig, StatusReporter
from smolbot.core.sensing import Recording, SensorArray
from smolbot.core.shots import Shot
from smolbot.errors import InputError, InterlockError, OperatorStopError, PluginError, RigError, report_plugin_errors
from smolbot.flight.pause import Pause
from smolbot.flight.pilots import Pilot
from smolbot.flight.preparation import Preparation, PreparationSettings
from smolbot.flight.safety.stop_signals import CTRL_C_REASON
from smolbot.flight.safety.supervisor import Safety, make_limits_only_safety
from smolbot.flight.scheduler import Scheduler
from smolbot.flight.tracking.channel_watch import ChannelWatch
from smolbot.flight.tracking.noise_monitor import NoiseMonitor
from smolbot.flight.tracking.pose_gate import find_gross_error
from smolbot.flight.tracking.resonance_filter import ResonanceFilter
from smolbot.flight.tracking.tracker import Tracker
from smolbot.localization.array.filter import ArrayFilter
from smolbot.localization.estimator import Oscillation, PoseEstimator
from smolbot.localization.localizer import MIN_R_SQUARED, Swing
from smolbot.localization.noise.actuation_decay import CoilDecays
from smolbot.motion.controller import Command
from smolbot.runs.run import CycleRecord, Event, Listener, RecorderSink, Run, Status

_LOG = logging.getLogger(__name__)
_EXPECTED_ERRORS = (InterlockError, RigError, OutsideTableError, InputError)
"""What may end a flight under way: a limit, a failing rig, the edge of the field table, signals that no model fits."""

LOST_SIGNALS = "lost_signals"
"""Key of losses of the signal among what a run has recovered from."""

NOTED_LOSS, NOTED_MISSES = 1.0, 3
"""Time, in s, and shots in a row without an accepted pose from which the record says that the signal is lost: a few
outliers are none, nor is the minute in which a magnet turns a helix."""

MIN_HEARD = 0.5
"""Share of a signal that a fit must explain for the device to have been heard at all: less is background noise."""

SHOWN_TIME = 0.05
"""Time, in s, below which learning or pauses are not mentioned."""

LEARNING_INTERVAL = 5
"""Number of cycles between two updates of resonance and noise, which change slowly."""


@dataclass(frozen=True)
class StopRules:
    """Limits at which a flight ends without having reached its goal.

    Attributes
    ----------
    max_duration : float, in s
        Counted from the first cycle on, pauses excluded.
    max_lost_shots : int
        Listening shots in a row without an accepted pose.
    max_lost_time : float, in s
        Time without an accepted pose. The signal is given up once both are reached: what takes its time, such as an
        amplifier that restarts, ends nothing, and a slow cycle gets as many attempts as a fast one.
    """

    max_duration: float
    max_lost_shots: int
    max_lost_time: float = 0.0


def as_lists(sensors: SensorArray) -> dict[str, object]:
    """Convert a sensor array to plain lists for the record, without rounding.

    Parameters
    ----------
    sensors : SensorArray

    Returns
    -------
    dict
        ``positions_m`` in m and ``axes``, both (n, 3) in the world frame, and ``gains``, (n,) or None.
    """
    gains = None if sensors.gains is None else sensors.gains.tolist()
    return {"positions_m": sensors.positions.tolist(), "axes": sensors.axes.tolist(), "gains": gains}


class Loop:
    """The closed loop of a flight: it plays shots until the pilot is done or a rule ends the run.

    Cycle by cycle, with every output at zero when the block ends, whatever happened in it::

        with loop:
            while not loop.done:
                record = loop.step()

    Parameters
    ----------
    rig : Rig
    scheduler : Scheduler
    localizer : PoseEstimator
    tracker : Tracker
    pilot : Pilot
        Gives the command for the next cycle, and ends the flight.
    rules : StopRules
    preparation : PreparationSettings
        What to learn before the first cycle.
    listeners : tuple of callable
        Called with the record of every cycle.
    clock : callable
        Returns a time in s, from which computing times are measured.
    independent : bool
        Whether to locate each pose without a prior, and to learn nothing from one pose for the next.
    externally_guided : bool
        Whether the device is moved from outside. Its motion adds to the fit residuals, so that the noise model stays
        as it was learned at the start.
    array_filter : ArrayFilter, optional
        Estimates sensor errors in flight.
    channels : ChannelWatch, optional
        Leaves out sensors that disagree with the others, and rejects poses that cannot be.
    safety : Safety, optional
        Checks every shot and every recording; unless given, only the rig's limits are checked.
    tape : RecorderSink, optional
        Receives every shot and every event.
    pause : Pause, optional
        While it is held, the loop listens but does not move the robot.

    Attributes
    ----------
    run : Run
        What has happened so far; complete once the block has ended, or `fly` has returned or raised.
    """

    resonance: ResonanceFilter  # of the scheduler's belief, from the first step on

    def __init__(
        self,
        rig: Rig,
        scheduler: Scheduler,
        localizer: PoseEstimator,
        tracker: Tracker,
        pilot: Pilot,
        rules: StopRules,
        preparation: PreparationSettings,
        listeners: tuple[Listener, ...] = (),
        clock: Callable[[], float] = time.perf_counter,
        *,
        independent: bool = False,
        externally_guided: bool = False,
        array_filter: ArrayFilter | None = None,
        channels: ChannelWatch | None = None,
        safety: Safety | None = None,
        tape: RecorderSink | None = None,
        pause: Pause | None = None,
    ) -> None:
        self.rig = rig
        self.scheduler = scheduler
        self.localizer = localizer
        self.tracker = tracker
        self.pilot = pilot
        self.rules = rules
        self.preparation = preparation
        self.events: list[Event] = []
        self.tails = CoilDecays()
        self.noise_watch = NoiseMonitor(len(localizer.sensors))
        self.array_filter = array_filter
        self.channels = channels
        self.listeners = listeners
        self.independent = independent
        self.externally_guided = externally_guided
        self.safety = safety if safety is not None else make_limits_only_safety(rig.limits, len(localizer.sensors))
        self.run = Run()
        self.pause = pause if pause is not None else Pause()
        self._tape = tape
        self._clock = clock
        self._flying = False
        self._command: Command | None = None
        self._ending: tuple[Status, str] | None = None
        self._began = self._started = 0.0
        self._paused = 0.0
        self._located = 0
        self._found = 0.0  # end of the last shot with an accepted pose, in s
        self._miss = ""  # why the last window gave no pose, where that is known
        self._lost = ""  # why the signal is lost, once the record says that it is
        self._doubts_device = False  # whether the last window contradicts the assumed device
        self._losses = 0  # losses of the signal that were overcome

    def fly(self) -> Run:
        """Cycle until the path's end, a stop rule, an error or Ctrl-C; every output is at zero afterwards.

        Returns
        -------
        Run
            How it ended, and every cycle.

        Raises
        ------
        Exception
            Only an unexpected error, once the outputs are at zero and `run` is complete. What ends a flight by its
            own rules (a limit, a failing rig, the edge of the field table, Ctrl-C) is reported in the run alone.
        """
        with suppress(KeyboardInterrupt, *_EXPECTED_ERRORS), self:
            while not self.done:
                self.step()
        return self.run

    def __enter__(self) -> Self:
        """Begin a run. Nothing is played before the first `step`."""
        self.run, self._command, self._ending = Run(), None, None
        self._began = self._clock()
        self._linear_algebra = ExitStack()
        self._linear_algebra.enter_context(limit_to_one_thread())
        self._flying = True
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        """End the run: every output goes to zero, nothing more is played, and `run` is completed."""
        self._flying = False
        try:
            self._linear_algebra.close()
            self.safety.end()
        except BaseException as failed:
            error = failed
            raise
        finally:
            self._finish(self.run, error)

    @property
    def done(self) -> bool:
        """True once the pilot is done or a stop rule has ended the run."""
        return self._ending is not None

    def step(self) -> CycleRecord:
        """Play one cycle: shot, recording, pose, track, command. The first call also runs the learning phase.

        Returns
        -------
        CycleRecord
            What happened, and the command for the next cycle.

        Raises
        ------
        InputError
            Outside of a ``with`` block of the loop, and once it is done.
        InterlockError, RigError
            If a shot breaks a limit, or the rig fails. A stop by the safety supervisor is a `RigError`.
        """
        if not self._flying or self.done:
            why = "it is done" if self._flying else "step it in a block 'with loop:', which ends with outputs at zero"
            raise InputError(f"This loop plays no cycle: {why}.")
        if self._command is None:
            self._prepare()
            self._command = Command(None, note="no pose yet")
        record = self._run_cycle(self._command)
        self.run.cycles.append(record)
        for listener in self.listeners:
            listener(record)
        self._command = record.command
        self._ending = self._find_stop_reason(record.command)
        return record

    def _prepare(self) -> None:
        """Run the learning phase before the first cycle."""
        first = Preparation(
            self.localizer, self.scheduler, self.preparation, self._play_checked, self.rig.now, self._record_event
        )
        first.learn()
        self.localizer, self.tails = first.localizer, first.tails
        first.warm_up(None if self.array_filter is None else self.array_filter.prior.frames)
        self.resonance = ResonanceFilter(self.scheduler.belief)
        self.run.begun = self._started = self._found = self.rig.now()

    def _finish(self, run: Run, error: BaseException | None) -> None:
        """Note how the run ended, bring the outputs to zero, and complete its figures."""
        try:
            run.status, run.stop_reason = self._find_outcome(error)
        finally:
            self._zero_outputs(run)
        run.error = error if isinstance(error, _EXPECTED_ERRORS) else None
        run.duration = self.rig.now()
        run.events = self.events
        run.safety = self.safety.summarize()
        run.recovered = self._count_recovered()
        run.wall = self._clock() - self._began

    def _find_outcome(self, error: BaseException | None) -> tuple[Status, str]:
        """Return status and reason of the run, which `error` has ended, if there is one."""
        if error is None:
            return self._ending or ("stopped", "the loop was left before it was done")
        if isinstance(error, KeyboardInterrupt):
            return "stopped", str(error) or CTRL_C_REASON
        if not isinstance(error, Exception):
            return "stopped", type(error).__name__
        if isinstance(error, OperatorStopError):
            return "stopped", str(error)
        if self.safety.latch.tripped:  # the reason is what stopped the rig, not the error that followed
            return self.safety.latch.ending, self.safety.latch.reason
        return "failed", str(error) if isinstance(error, _EXPECTED_ERRORS) else f"{type(error).__name__}: {error}"

    def _zero_outputs(self, run: Run) -> None:
        try:
            self.rig.stop()
        except Exception as error:  # a device that is gone must not cost the record of the run
            run.status = "failed"
            run.stop_reason += f"; the outputs could not be set to zero: {error}"

    def _count_recovered(self) -> dict[str, int]:
        """Count the faults that the flight recovered from. A kind that safety and rig both count enters once."""
        found = dict(self.safety.recovered)
        if self._losses:
            found[LOST_SIGNALS] = self._losses
        counted = self.rig.recovered if isinstance(self.rig, RecoveryCounter) else {}
        for kind, times in counted.items():
            name = kind.replace(" ", "_")
            found[name] = max(found.get(name, 0), times)
        return found

    def _play_checked(self, shot: Shot) -> Recording | None:
        """Play one shot that the safety supervisor has checked, and pass it to the recorder sink."""
        self.safety.check_shot(shot, self.rig.now(), self.tracker.pose)
        recording = self._play(shot)
        ended = self.rig.now()
        if self._tape is not None:
            self._tape.record_shot(shot, recording, ended)
        return self.safety.check_recording(shot, recording, ended)

    def _play(self, shot: Shot) -> Recording | None:
        """Play one shot; an unexpected error of a lab's own rig names the rig and the line."""
        with report_plugin_errors("Rig", self.rig, "play"):
            return self.rig.play(shot)

    def _record_event(self, time: float, what: str, detail: dict[str, object]) -> None:
        event = Event(time, what, detail)
        self.events.append(event)
        _LOG.info("%.3f s: %s %s", time, what, detail)
        if self._tape is not None:
            self._tape.record_event(event)

    def _apply_pause(self) -> None:
        """Begin or end a pause that was requested."""
        if self.pause.held != self.scheduler.paused:
            self.scheduler.paused = self.pause.held
            self._record_event(self.rig.now(), "paused" if self.pause.held else "resumed", {})

    def _run_cycle(self, command: Command) -> CycleRecord:
        begin = self._clock()
        self._apply_pause()
        shot = self.scheduler.next(command, self.tracker)
        self.safety.check_shot(shot, self.rig.now(), self.tracker.pose)
        planned = self._clock()
        recording = self._play(shot)
        received, ended = self._clock(), self.rig.now()
        if self._tape is not None:
            self._tape.record_shot(shot, recording, ended)
        recording = self.safety.check_recording(shot, recording, ended)
        recording = None if recording is None else self.tails.subtract_from(shot, recording)
        if self.channels is not None:
            self.channels.gate.add_shot(shot, None if self.tracker.pose is None else self.tracker.pose.position)
        self.scheduler.blind = shot.listen is not None and recording is None
        pose: Pose | None = None
        self._miss = "its recording was lost" if recording is None else ""
        swing: Oscillation | None = None
        if recording is not None:
            # an outdated prior would only mislead: a lost signal is searched for without one
            lost = self.tracker.pose is None or shot.mode in ("search", "lost") or self.tracker.orientation_uncertain
            prior = None if self.independent or lost else self.tracker.pose_at(recording.middle)
            try:
                with report_plugin_errors("Estimator", self.localizer, "locate"):
                    pose, swing = self._locate(recording, prior)
            except InputError as error:  # too few usable channels: a missed window, counted by the tracker
                pose, swing, self._miss = None, None, str(error)
            if pose is not None and not isinstance(pose, Pose):
                estimator = f"{type(self.localizer).__module__}:{type(self.localizer).__qualname__}"
                raise PluginError(f"Estimator {estimator}: locate() must return a Pose; got {pose!r}.")
            if pose is not None and pose.trusted and not np.isfinite(pose.covariance).all():
                pose, self._miss = replace(pose, trusted=False), "the covariance of the pose is not finite"
            if pose is not None and pose.r_squared >= MIN_R_SQUARED and self._trusts_track:
                pose = self._check_device(pose, swing, recording.clock)
        doubted = self.tracker.learned
        tracked = self.tracker.update(shot, pose, swing)
        if self.tracker.learned and not doubted:
            self._record_motion_model(shot.end)
        if self.tracker.misses == 0:
            self._miss = ""
            if self.channels is not None and pose is not None:
                self.channels.gate.accept()
        elif pose is not None and pose.trusted and tracked is not None and self._trusts_track:
            objection = find_gross_error(pose, tracked, along_cantilever=self.localizer.device.along_cantilever)
            if objection:
                pose, self._miss = replace(pose, trusted=False), objection
        if self.array_filter is not None and self.tracker.motion is not None:
            self.array_filter.predict(*self.tracker.motion)
        learns = not self.independent and tracked is not None and tracked.trusted and not self._doubts_device
        if recording is not None and swing is not None and learns:
            assert tracked is not None
            if self.array_filter is not None and pose is not None:
                self._learn_array(tracked.time, self.array_filter, pose, swing)
            self._located += 1
            if self._located % LEARNING_INTERVAL == 0:
                self._update_resonance(tracked.time, swing)
                self._refresh_noise(tracked.time, swing, recording)
        self._note_loss(shot, ended, pose)
        answer = self.pilot.command(shot, self.tracker)
        if answer.event:
            self._record_event(shot.end, answer.event, {"note": answer.note})
        if self.scheduler.paused:
            self._paused += ended - shot.start
        done = self._clock()
        status = self.rig.status_line if isinstance(self.rig, StatusReporter) else ""
        return CycleRecord(shot, pose, tracked, answer, (planned - begin) + (done - received), ended, status)

    @property
    def _trusts_track(self) -> bool:
        """Whether a pose far from the track is wrong; a hand moves a device as no model predicts, so that it is not."""
        return not self.independent and not self.externally_guided

    def _locate(self, recording: Recording, prior: Pose | None) -> tuple[Pose, Oscillation | None]:
        """Locate in a recording, with the sensors that agree with each other."""
        watch, tracker = self.channels, self.tracker
        if watch is None:
            return self.localizer.locate_swing(recording, prior)
        predicted = tracker.pose_at(recording.middle) if tracker.confirmed and not self.independent else None
        found = watch.locate(self.localizer, recording, prior, predicted)
        self._miss = found.reason
        for what, detail in watch.take_events():
            self._record_event(recording.clock, what, detail)
        return found.pose, found.swing

    def _check_device(self, pose: Pose, swing: Oscillation | None, time: float) -> Pose:
        """Check that the device swings as assumed; if it does not, it is learned anew, and the pose is not trusted."""
        change = swing.estimate_device_change() if isinstance(swing, Swing) and swing.white else None
        if change is None:
            return pose
        assert isinstance(swing, Swing)
        was, device = self.resonance.relearning, self.scheduler.belief.device
        reason = self.resonance.check(change, swing.degrees_of_freedom)
        self._doubts_device = bool(reason)
        if self.scheduler.belief.device is not device:
            device = self.scheduler.belief.device
            self.localizer = self.localizer.with_device(device)
        if self.resonance.relearning and not was:
            self._record_event(time, "device doubted", {"reason": reason})
        elif was and not self.resonance.relearning:
            detail: dict[str, object] = {"frequency_hz": device.frequency, "damping_per_s": device.damping}
            self._record_event(time, "device retuned", detail)
        if not reason:
            return pose
        self._miss = reason
        return replace(pose, trusted=False)

    def _record_motion_model(self, time: float) -> None:
        """Record that the assumed motion model was given up, and what was learned instead."""
        gains, drift = (
            [round(float(v), 4) for v in values] for values in (self.tracker.gains, 1e3 * self.tracker.drift)
        )
        self._record_event(time, "motion model doubted", {"coil_gains": gains, "drift_mm_s": drift})

    def _learn_array(self, time: float, learned: ArrayFilter, pose: Pose, swing: Oscillation) -> None:
        """Update the sensor errors and, if they have changed enough, replace the localizer's sensor array."""
        terms = swing.compute_array_terms(learned.prior.frames)
        if terms is not None and self.channels is not None:
            self.channels.add_terms(terms, learned.applied)
        if terms is None or not learned.update(pose, terms):
            return
        belief = self.scheduler.belief
        belief.learn_magnet(learned.moment, learned.l0)
        self.localizer = self.localizer.with_sensors(learned.sensors).with_device(belief.device)
        detail = {"recordings": learned.recordings, "moment_a_m2": learned.moment, "l0_m": learned.l0}
        self._record_event(time, "array learned", {**detail, **as_lists(learned.sensors)})

    def _update_resonance(self, time: float, swing: Oscillation) -> None:
        error = swing.estimate_resonance_error()
        device = None if error is None else self.resonance.update(time, *error)
        if device is None:
            return
        self.localizer = self.localizer.with_device(device)
        self._record_event(time, "device retuned", {"frequency_hz": device.frequency, "damping_per_s": device.damping})

    def _refresh_noise(self, time: float, swing: Oscillation, recording: Recording) -> None:
        """Update the noise model of sensors whose noise has changed since the start."""
        noise = self.localizer.noise
        if self.externally_guided or noise is None:
            return
        if self.channels is None:
            energies = swing.compute_energies(recording, noise)
        else:
            energies = self.channels.compute_energies(self.localizer, recording, swing, noise)
        ratios = None if energies is None else self.noise_watch.update(*energies)
        if ratios is None:
            return
        self.localizer = self.localizer.with_noise(noise.rescaled(ratios))
        self._record_event(time, "noise refreshed", {"power_ratios": [round(float(r), 2) for r in ratios]})

    def _note_loss(self, shot: Shot, ended: float, pose: Pose | None) -> None:
        """Record when the signal gets lost, with the reason, and when it is back."""
        if shot.listen is None:
            return
        searched = self.independent and pose is not None and pose.trusted  # found again, but not yet a measurement
        if self.tracker.misses and not searched:
            self._miss = self._miss or describe_miss(pose)
            long = ended - self._found >= NOTED_LOSS and self.tracker.misses >= NOTED_MISSES
            if long and not self._lost and self._found > self._started:
                self._lost = self._miss
                self._record_event(ended, "signal lost", {"since_s": round(self._found, 3), "reason": self._lost})
            return
        if self._lost:
            self._losses += 1
            detail = {"after_s": round(ended - self._found, 3), "reason": self._lost}
            self._record_event(ended, "signal back", detail)
        self._found, self._lost = ended, ""

    def _find_stop_reason(self, command: Command) -> tuple[Status, str] | None:
        if command.done:
            return "completed", command.note or "done"
        if command.stuck:
            return "stuck", command.note or "the controller gave up"
        now, rules = self.rig.now(), self.rules
        lost_for = now - self._found
        if self.tracker.misses >= rules.max_lost_shots and lost_for >= rules.max_lost_time:
            why = "the signal was lost" if self._found > self._started else "the signal was never found"
            cause = f"; the last one: {self._miss}" if self._miss else ""
            count = self.tracker.misses
            if self.scheduler.blind:  # the world has failed, not the search
                return "failed", f"Stale data: over {lost_for:.1f} s, {count} shots gave no pose; {cause[2:]}"
            return "lost", f"{why}: {count} shots in a row, over {lost_for:.1f} s, gave no trusted pose{cause}"
        flown = now - self._started - self._paused
        if flown >= rules.max_duration:
            return "timeout", f"max_duration_s reached after {flown:.0f} s{self._describe_uncounted()}"
        return None

    def _describe_uncounted(self) -> str:
        """Describe what lies between the time flown and the run's duration, which counts from its start."""
        parts = [f"{self._started:.1f} s of learning before the first cycle"] if self._started >= SHOWN_TIME else []
        parts += [f"{self._paused:.1f} s of pauses"] if self._paused >= SHOWN_TIME else []
        return f", not counting {' and '.join(parts)}" if parts else ""


def describe_miss(pose: Pose | None) -> str:
    """Describe why a recording gave no pose that could be used.

    Parameters
    ----------
    pose : Pose or None
        As located.

    Returns
    -------
    str

    Examples
    --------
    >>> describe_miss(None)
    'no pose was found in it'
    """
    if pose is None:
        return "no pose was found in it"
    if not pose.trusted:
        share = f"the fit explains {100 * max(pose.r_squared, 0.0):.0f} % of the signal"
        if pose.r_squared < MIN_HEARD:
            return f"the device was not heard ({share}): does it swing, and is it excited?"
        return f"its pose was not trusted ({share})"
    return "its pose contradicts the tracked one"
