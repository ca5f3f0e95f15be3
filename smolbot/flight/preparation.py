"""What is learned from shots of their own before the first cycle: noise, ring-down, what a pull leaves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import quaternion_from_axes
from smolbot.core.sensing import Recording
from smolbot.core.shots import Shot
from smolbot.errors import InputError, RigError
from smolbot.flight.scheduler import Scheduler
from smolbot.localization.forward import deflection, sensor_field
from smolbot.localization.localizer import Localizer
from smolbot.localization.noise.actuation_tails import CoilTails, Tail, learn_tail
from smolbot.localization.noise.excitation_transients import QUIET_AFTER, learn_time_constant
from smolbot.localization.noise.model import NoiseModel
from smolbot.localization.synthetic import Sightings


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


class Preparation:
    """Learns before the first cycle what a localizer and a scheduler can be told.

    Parameters
    ----------
    localizer, scheduler
        As they begin. The scheduler's cycle is replaced where listening may start earlier.
    quiet : Quiet
        What to learn.
    play : callable
        Plays a shot and returns what was heard.
    now : callable
        Time on the rig's clock, in s.
    happened : callable
        Told of what was learned: time, what, and details.

    Attributes
    ----------
    localizer : Localizer or Sightings
        With what was learned.
    tails : CoilTails
    """

    def __init__(
        self,
        localizer: Localizer | Sightings,
        scheduler: Scheduler,
        quiet: Quiet,
        play: Callable[[Shot], Recording | None],
        now: Callable[[], float],
        happened: Callable[[float, str, dict[str, object]], None],
    ) -> None:
        self.localizer = localizer
        self.scheduler = scheduler
        self.quiet = quiet
        self.tails = CoilTails()
        self._play = play
        self._now = now
        self._happened = happened

    def learn(self) -> None:
        """Play what is to be learned from, and learn."""
        self._learn_noise()
        self._learn_ring_down()
        self._learn_tails()

    def _listened(self, shot: Shot) -> Recording | None:
        """Play one shot; a window that was lost is listened to once more."""
        heard = self._play(shot)
        return heard if heard is not None else self._play(replace(shot, start=self._now()))

    def _learn_noise(self) -> None:
        """Listen to the noise alone, and let the localizer know it."""
        if self.quiet.duration <= 0.0:
            return
        heard = [self._play(shot) for shot in self.scheduler.quiet_shots(self.quiet.duration)]
        if isinstance(self.localizer, Sightings):
            return
        try:
            noise = NoiseModel.learn([recording for recording in heard if recording is not None])
        except InputError as error:
            raise RigError(f"The noise cannot be learned from {len(heard)} quiet shots: {error}") from error
        self.localizer = self.localizer.with_noise(noise)
        lines = [round(float(f), 3) for f in noise.line_frequencies]
        self._happened(self._now(), "noise learned", {"quiet_shots": len(heard), "lines_hz": lines})

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
                self._happened(self._now(), "ring-down not learned", {"lost": len(heard) - len(constants)})
                return
            self.localizer = self.localizer.with_transients(constants)
        ring_down = max(QUIET_AFTER * max(constants), self.scheduler.limits.min_ring_down)
        self.scheduler.cycle = replace(self.scheduler.cycle, ring_down=ring_down)
        detail = {"time_constants_ms": [1e3 * t for t in constants], "ring_down_ms": 1e3 * ring_down}
        self._happened(self._now(), "ring-down learned", detail)

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
            self._happened(self._now(), "coil tails learned", detail)

    def _tail(self, coil: int) -> Tail | None:
        for shot in self.scheduler.tail_shots(coil):
            heard = self._listened(shot)
            if heard is not None and not heard.saturated.any():
                return learn_tail(shot, [heard], self.scheduler.device.frequency)
        return None

    def warm_up(self, frames: FloatArray | None) -> None:
        """Use every compiled kernel once, on a made-up recording, so that the first cycles are as quick as the rest.

        `frames` are those in which an array's tilts are learned, where they are; see `array_filter.tilt_frames`.
        """
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
        if frames is not None:
            swing.of_the_array(frames)
