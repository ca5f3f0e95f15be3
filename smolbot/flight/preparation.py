"""Learning before the first cycle: background noise, and how fast the coil currents decay."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from smolbot.core.arrays import FloatArray
from smolbot.core.sensing import Recording
from smolbot.core.shots import Shot
from smolbot.errors import InputError, RigError
from smolbot.flight.scheduler import Scheduler
from smolbot.localization.estimator import PoseEstimator
from smolbot.localization.noise.actuation_decay import CoilDecay, CoilDecays, identify_decay
from smolbot.localization.noise.excitation_transients import SEPARABLE_AFTER, learn_time_constant
from smolbot.localization.noise.model import NoiseModel


@dataclass(frozen=True)
class PreparationSettings:
    """What to learn before the first cycle.

    Attributes
    ----------
    duration : float, in s
        How long to record background noise; 0 for not at all.
    sample_rate : float, in Hz
    learn_ring_down : bool
        Whether to learn the decay of the excitation coils, so that listening can start before it is over.
    """

    duration: float
    sample_rate: float
    learn_ring_down: bool = False


class Preparation:
    """Learning phase of a flight, before the first cycle.

    Parameters
    ----------
    localizer : PoseEstimator
    scheduler : Scheduler
        Its cycle is replaced if listening may start earlier.
    settings : PreparationSettings
    play : callable
        Plays a shot and returns its recording, or None if the window was lost.
    now : callable
        Time on the rig's clock, in s.
    record_event : callable
        Called with time, name and details of everything that was learned.

    Attributes
    ----------
    localizer : PoseEstimator
        With what was learned.
    tails : CoilDecays
        Decays of the actuation coils' currents.
    """

    def __init__(
        self,
        localizer: PoseEstimator,
        scheduler: Scheduler,
        settings: PreparationSettings,
        play: Callable[[Shot], Recording | None],
        now: Callable[[], float],
        record_event: Callable[[float, str, dict[str, object]], None],
    ) -> None:
        self.localizer = localizer
        self.scheduler = scheduler
        self.settings = settings
        self.tails = CoilDecays()
        self._play = play
        self._now = now
        self._record_event = record_event

    def learn(self) -> None:
        """Play the shots of the learning phase, and learn noise, ring-down and coil decay from them.

        Raises
        ------
        RigError
            If the recordings of background noise do not suffice.
        """
        self._learn_noise()
        self._learn_ring_down()
        self._learn_tails()

    def _play_with_retry(self, shot: Shot) -> Recording | None:
        """Play one shot, and play it once more if its window was lost."""
        recording = self._play(shot)
        return recording if recording is not None else self._play(replace(shot, start=self._now()))

    def _learn_noise(self) -> None:
        """Record background noise and pass the learned noise model to the localizer."""
        if self.settings.duration <= 0.0:
            return
        recordings = [self._play(shot) for shot in self.scheduler.make_noise_shots(self.settings.duration)]
        if "noise" not in self.localizer.learns:
            return
        try:
            noise = NoiseModel.learn([recording for recording in recordings if recording is not None])
        except InputError as error:
            raise RigError(f"The noise cannot be learned from {len(recordings)} quiet shots: {error}") from error
        self.localizer = self.localizer.with_noise(noise)
        lines = [round(float(f), 3) for f in noise.line_frequencies]
        self._record_event(self._now(), "noise learned", {"quiet_shots": len(recordings), "lines_hz": lines})

    def _learn_ring_down(self) -> None:
        """Learn the decay of the excitation coils, and start listening as early as it allows."""
        if not self.settings.learn_ring_down:
            return
        recordings = [self._play_with_retry(shot) for shot in self.scheduler.make_probe_shots()]
        constants = self.localizer.transients
        if "transients" in self.localizer.learns:
            constants, missing = self._identify_ring_downs(recordings)
            if missing:  # the mission's later start of listening is safe for any coil
                self._record_event(self._now(), "ring-down not learned", missing)
                return
            self.localizer = self.localizer.with_transients(constants)
        if not constants:
            return
        ring_down = max(SEPARABLE_AFTER * max(constants), self.scheduler.limits.min_ring_down)
        self.scheduler.cycle = replace(self.scheduler.cycle, ring_down=ring_down)
        detail = {"time_constants_ms": [1e3 * t for t in constants], "ring_down_ms": 1e3 * ring_down}
        self._record_event(self._now(), "ring-down learned", detail)

    def _identify_ring_downs(self, probes: list[Recording | None]) -> tuple[tuple[float, ...], dict[str, object]]:
        """Identify the decay that each probe heard; return the time constants, and what is missing, if anything."""
        heard = [probe for probe in probes if probe is not None]
        if len(heard) < len(probes):
            return (), {"lost": len(probes) - len(heard)}
        frequency = self.localizer.device.frequency
        try:
            return tuple(learn_time_constant([probe], frequency) for probe in heard), {}
        except InputError as error:  # a probe in which nothing decays: a coil that is not connected, sensors that clip
            return (), {"reason": str(error)}

    def _learn_tails(self) -> None:
        """Learn the decay of each actuation coil's current, where listening starts before it is over."""
        if not self.settings.learn_ring_down or "transients" not in self.localizer.learns:
            return
        coils = self.scheduler.limits.coils
        self.tails = CoilDecays(tuple(self._learn_tail(coil) for coil in range(len(coils))))
        missing = [name for name, tail in zip(coils, self.tails.decays, strict=True) if tail is None]
        if missing:
            self._record_event(self._now(), "coil tails not learned", {"coils": missing})
        learned = [tail for tail in self.tails.decays if tail is not None]
        if learned:
            detail: dict[str, object] = {
                "time_constants_ms": [None if t is None else 1e3 * t.time_constant for t in self.tails.decays],
                "sizes_t_per_a": [None if t is None else t.size.tolist() for t in self.tails.decays],
            }
            self._record_event(self._now(), "coil tails learned", detail)

    def _learn_tail(self, coil: int) -> CoilDecay | None:
        for shot in self.scheduler.make_tail_shots(coil):
            recording = self._play_with_retry(shot)
            if recording is not None and not recording.saturated.any():
                return identify_decay(shot, [recording], self.scheduler.device.frequency)
        return None

    def warm_up(self, frames: FloatArray | None) -> None:
        """Run the estimator once on the present cycle, since its first call compiles and is slow.

        Parameters
        ----------
        frames : ndarray, shape (n_sensors, 2, 3), or None
            Axes about which the tilts of sensors are learned, from `compute_tilt_frames`; None if none are learned.
        """
        cycle = self.scheduler.cycle
        self.localizer.warm_up(cycle.half_periods, self.settings.sample_rate, cycle.ring_down, frames)
