"""The safety supervisor of a run: it checks every shot and every recording, and can end the run."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass

from smolbot.core.coil_heat import CoilHeat, compute_mean_square_currents
from smolbot.core.limits import Limits
from smolbot.core.pose import Pose
from smolbot.core.sensing import Recording
from smolbot.core.shots import Actuate, Excite, Listen, Rotate, Shot, is_magnet_near_after
from smolbot.errors import SafetyError
from smolbot.flight.safety.duty_cycle import DutyCycle
from smolbot.flight.safety.heat_store import HeatMemory
from smolbot.flight.safety.sensor_monitor import SensorMonitor
from smolbot.flight.safety.stop_latch import Latch

LOST_WINDOWS = "lost_windows"
"""Key of lost listening windows among the faults that a run has recovered from."""

Bounds = tuple[tuple[float, float, float], tuple[float, float, float]]

_LOG = logging.getLogger(__name__)

_MIN_SIGMAS = 3.0  # number of standard deviations by which a pose must lie outside the allowed box
_MAX_EARLY = 0.05  # s: a shot may begin a little early; a recording of another shot is earlier by a complete shot


@dataclass(frozen=True)
class SafetyRules:
    """Rules that end a run, besides limits, duty cycle and heat.

    Attributes
    ----------
    max_duty : float
        Highest duty cycle of a coil, from 0 to 1.
    max_sigma : float, in m
        Highest standard deviation of the tracked position along its worst axis.
    uncertain_shots : int
        Number of shots in a row that drive the robot with a pose beyond `max_sigma` at which the run ends.
    stale_shots : int
        Number of shots in a row, of those that drive the robot, without a recording at which the run ends. Where
        nothing moves the robot a lost window does no harm: such shots in between do not count.
    max_age : float, in s
        A recording that arrives later than this after it was made counts as lost.
    allowed_box : tuple of two tuples, in m, or None
        Lowest and highest corner, in the world frame, of where a steered robot may be; None if nothing is steered.
    """

    max_duty: float = 1.0
    max_sigma: float = math.inf
    uncertain_shots: int = 5
    stale_shots: int = 3
    max_age: float = math.inf
    allowed_box: Bounds | None = None


class Safety:
    """Supervisor that ends a run before harm is done. A stop is final and has a reason.

    Duty cycle and heat are computed from the commanded currents, to the end of each shot before it is played.

    Parameters
    ----------
    limits : Limits
    rules : SafetyRules
    duty : DutyCycle
    heat : CoilHeat
    sensor_monitor : SensorMonitor
        Detects dead and saturated sensors.
    latch : Latch, optional
        Stop latch of the run; a new one unless given.
    heat_memory : HeatMemory, optional
        Coil temperatures at the end of earlier runs; without it, the coils start cold.

    Attributes
    ----------
    recovered : dict
        Number of faults by kind that the run has recovered from.
    """

    def __init__(
        self,
        limits: Limits,
        rules: SafetyRules,
        duty: DutyCycle,
        heat: CoilHeat,
        sensor_monitor: SensorMonitor,
        latch: Latch | None = None,
        heat_memory: HeatMemory | None = None,
    ) -> None:
        self.limits = limits
        self.rules = rules
        self.duty = duty
        self.heat = heat
        self.latch = latch if latch is not None else Latch()
        self.recovered = {LOST_WINDOWS: 0}
        self._memory = heat_memory
        if heat_memory is not None:
            heat_memory.restore(heat)
        self._begin = list(heat.temperatures)
        self._sensor_monitor = sensor_monitor
        self._time = 0.0
        self._magnet_near = False
        self._uncertain = 0
        self._missing = 0
        self._driven_blind = 0

    def check_shot(self, shot: Shot, now: float, pose: Pose | None) -> None:
        """Check a shot before it is played.

        Parameters
        ----------
        shot : Shot
        now : float, in s
            Earliest start of the shot on the rig's clock.
        pose : Pose or None
            The tracked pose.

        Raises
        ------
        SafetyError
            With the reason; nothing of the shot may be played.
        """
        if self.latch.tripped:
            raise SafetyError(self.latch.reason)
        if self.latch.over:
            raise SafetyError("This run is over; nothing was played. Begin a new one.")
        broken = self.limits.broken(shot, magnet_near=self._magnet_near)
        if broken:
            reason = " ".join([*(one.said for one in broken), "Nothing was played."])
            self._trip(reason, broken[0].value, broken[0].limit, broken[0].unit, broken[0].channel)
        self._magnet_near = is_magnet_near_after(shot, near=self._magnet_near)
        self._check_pose(shot, pose)
        self._advance_heat_and_duty(shot, now)

    def check_recording(self, shot: Shot, recording: Recording | None, now: float) -> Recording | None:
        """Check the recording of a shot that was played.

        Parameters
        ----------
        shot : Shot
        recording : Recording or None
            As the rig returned it.
        now : float, in s
            Time on the rig's clock.

        Returns
        -------
        Recording or None
            The recording; None if the window was lost, or if the recording is too old to use.

        Raises
        ------
        SafetyError
            If too many windows in a row were lost, or a sensor is dead or saturated for too long.
        """
        listen = shot.listen
        if listen is None:
            return recording
        late = ""
        if recording is not None:
            late = self._describe_stale(shot, recording, now)
            recording = None if late else recording
        if recording is None:
            self._missing += 1
            self._driven_blind += moves_robot(shot)
            _LOG.warning("%.3f s: a listening window was lost%s", now, f": {late}" if late else "")
            if self._driven_blind >= self.rules.stale_shots:
                why = late or f"the shot at {shot.start:.3f} s listened and gave no recording"
                self._trip(
                    f"Stale data: {self._driven_blind} listening windows in a row were lost (stale_shots = "
                    f"{self.rules.stale_shots}); of the last one, {why}.",
                    self._driven_blind,
                    self.rules.stale_shots,
                    "windows",
                )
            return None
        self.recovered[LOST_WINDOWS] += self._missing
        self._missing = 0
        self._driven_blind *= not moves_robot(shot)
        probes = shot.mode == "quiet" and any(isinstance(w, Actuate | Excite) for w in shot.windows)
        if not probes:  # a probe records the decay of a drive on purpose, which may saturate sensors
            wrong = self._sensor_monitor.check_recording(recording)
            if wrong is not None:
                kind, which, windows = wrong
                sensors = f"Sensor{'s' if len(which) > 1 else ''} {', '.join(map(str, which))}"
                what = "constant (dead, or a broken wire)" if kind == "dead" else "saturated"
                self._trip(
                    f"{sensors} (counted from 0) {'were' if len(which) > 1 else 'was'} {what} in {windows} listening "
                    f"windows in a row (sensor_shots = {self._sensor_monitor.max_windows}).",
                    windows,
                    self._sensor_monitor.max_windows,
                    "windows",
                    ", ".join(map(str, which)),
                )
        return recording

    def end(self) -> None:
        """Mark the run as over: nothing more is played. Coil temperatures are stored for the next run."""
        self.latch.end()
        if self._memory is not None:
            self._memory.keep(self.heat, now=True)

    def summarize(self) -> dict[str, object]:
        """Summarize duty cycles and coil temperatures.

        Returns
        -------
        dict
            By coil: peak duty cycle from 0 to 1 and, where thermal constants are known, temperature at the start,
            peak temperature and limit, in degrees Celsius.
        """
        known = [(i, c) for i, c in enumerate(self.heat.coils) if c is not None]
        return {
            "duty_peak": dict(zip(self.duty.coil_names, self.duty.peaks, strict=True)),
            "coil_temperature_begin_c": {c.name: self._begin[i] for i, c in known},
            "coil_temperature_peak_c": {c.name: self.heat.peaks[i] for i, c in known},
            "coil_temperature_limit_c": {c.name: c.limit for _, c in known},
        }

    def _trip(
        self, reason: str, value: float | None = None, limit: float | None = None, unit: str = "", channel: str = ""
    ) -> None:
        if not self.latch.trip(reason):  # it had tripped before, for another reason
            raise SafetyError(self.latch.reason)
        raise SafetyError(reason, value=value, limit=limit, unit=unit, channel=channel)

    def _check_pose(self, shot: Shot, pose: Pose | None) -> None:
        """Stop if the robot is outside the allowed box, or if it would be driven with too uncertain a pose."""
        rules = self.rules
        if pose is not None and pose.trusted and rules.allowed_box is not None:
            self._check_position(pose, rules.allowed_box)
        if not moves_robot(shot):
            return
        if pose is None:
            self._trip("Lost pose: a shot would drive the robot before it was ever located. Nothing was played.")
            return
        sigma = math.sqrt(max(float(pose.covariance[i, i]) for i in range(3)))
        self._uncertain = self._uncertain + 1 if sigma > rules.max_sigma else 0
        if self._uncertain >= rules.uncertain_shots:
            self._trip(
                f"Uncertain pose: its standard deviation was above {1e3 * rules.max_sigma:g} mm (max_sigma_mm) in "
                f"{self._uncertain} shots in a row that drive the robot; now {1e3 * sigma:.1f} mm. Nothing was played.",
                sigma,
                rules.max_sigma,
                "m",
            )

    def _check_position(self, pose: Pose, allowed_box: Bounds) -> None:
        for axis, low, high in zip(range(3), *allowed_box, strict=True):
            at, margin = float(pose.position[axis]), _MIN_SIGMAS * math.sqrt(float(pose.covariance[axis, axis]))
            if at + margin < low or at - margin > high:
                self._trip(
                    f"Out of reach: the robot's {'xyz'[axis]} is {1e3 * at:.1f} ± {1e3 * margin:.1f} mm; it may be "
                    f"from {1e3 * low:.1f} to {1e3 * high:.1f} mm (container and reach_margin_mm). Nothing was played.",
                    at,
                    high if at > high else low,
                    "m",
                    "xyz"[axis],
                )

    def _advance_heat_and_duty(self, shot: Shot, now: float) -> None:
        """Advance heat and duty cycle to the end of a shot; one that is refused leaves both as they were."""
        kept = list(self.heat.temperatures), list(self.heat.peaks), list(self.duty.peaks)
        try:
            self._add_heat_and_duty(shot, now)
        except SafetyError:
            self.heat.temperatures, self.heat.peaks, self.duty.peaks = kept
            raise
        if self._memory is not None:
            self._memory.keep(self.heat)

    def _add_heat_and_duty(self, shot: Shot, now: float) -> None:
        self.heat.advance((), now - self._time)
        at, n_coils = now, len(self.limits.coils)
        for window in shot.windows:
            end = at + window.duration
            squares = compute_mean_square_currents(window, n_coils, len(self.duty.coil_names) - n_coils)
            self.heat.advance(squares, window.duration)
            for coil, square in enumerate(squares):
                if square:
                    self._check_duty(coil, at, end)
            if squares:
                self._check_heat()
            at = end
        self._time = max(at, self._time)

    def _check_duty(self, coil: int, start: float, end: float) -> None:
        share, name = self.duty.add_span(coil, start, end), self.duty.coil_names[coil]
        if share > self.rules.max_duty:
            self._trip(
                f"Coil '{name}' would be driven for {100 * share:.0f} % of {self.duty.window:g} s; at most "
                f"{100 * self.rules.max_duty:.0f} % (max_duty). Nothing was played.",
                share,
                self.rules.max_duty,
                "",
                name,
            )

    def _check_heat(self) -> None:
        hot = self.heat.find_overheated_coil()
        if hot is not None:
            coil, temperature = hot
            self._trip(
                f"Coil '{coil.name}' would reach {temperature:.1f} °C by the end of the next shot; at most "
                f"{coil.limit:g} °C (max_temperature_c). Nothing was played.",
                temperature,
                coil.limit,
                "°C",
                coil.name,
            )

    def _describe_stale(self, shot: Shot, recording: Recording, now: float) -> str:
        """Explain why a recording does not belong to this shot or is too old; empty if neither."""
        offset = next(at for at, window in shot.timed() if isinstance(window, Listen))
        early = shot.start + offset - recording.clock
        listened = 0.0 if shot.listen is None else shot.listen.duration  # `clock` is the start of the recording
        age = now - recording.clock - listened
        if early > max(_MAX_EARLY, 0.5 * shot.duration):
            return f"the recording began {early:.3f} s before it was requested"
        if age > self.rules.max_age:
            return f"the recording was {age:.2f} s old on arrival (max_age_ms = {1e3 * self.rules.max_age:g})"
        return ""


def moves_robot(shot: Shot) -> bool:
    """Return whether a shot drives the robot; the weak pulls of the learning phase do not.

    Parameters
    ----------
    shot : Shot

    Returns
    -------
    bool
    """
    return shot.mode != "quiet" and any(isinstance(window, Actuate | Rotate) for window in shot.windows)


def make_limits_only_safety(limits: Limits, n_sensors: int) -> Safety:
    """Build a supervisor that checks the rig's limits only.

    Parameters
    ----------
    limits : Limits
    n_sensors : int

    Returns
    -------
    Safety
    """
    names = (*limits.coils, "excitation x", "excitation y")
    monitor = SensorMonitor(n_sensors, max_windows=1 << 62)
    return Safety(limits, SafetyRules(), DutyCycle(names, 1.0), CoilHeat((None,) * len(names), 20.0), monitor)
