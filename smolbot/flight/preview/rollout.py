"""A mission flown on the controller's own model: law, scheduler, tracker and safety rules of a flight, no signals."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lookup_tables.errors import OutsideTableError
from smolbot.config.mission import Mission
from smolbot.config.nominal_excitation import NominalExcitation
from smolbot.config.plugins import load_plugin
from smolbot.core.arrays import FloatArray
from smolbot.core.shots import Actuate, Listen, Shot
from smolbot.errors import SafetyError, report_plugin_errors
from smolbot.flight.assembly import make_safety, make_steering_tracker
from smolbot.flight.device_belief import DeviceBelief
from smolbot.flight.pilots import Follower
from smolbot.flight.preparation import expect_ring_down, lengthen_ring_down
from smolbot.flight.preview.model_world import ModelWorld, Perturbation, PoseErrors
from smolbot.flight.safety.heat_store import HeatMemory
from smolbot.flight.scheduler import Scheduler
from smolbot.flight.stall import StallMonitor, describe_stall
from smolbot.flight.tracking.tracker import Tracker
from smolbot.motion.controller import Command, Controller, Cycle, Setup

SEED = 1
"""Of the pose errors in the rollout without mismatch: any would do, and the same gives the same preview."""


@dataclass(frozen=True, eq=False)
class RolloutParts:
    """What all rollouts of one mission share, computed once.

    Attributes
    ----------
    mission : Mission
    setup : Setup
        The controller's model.
    cycle : Cycle
        The localization part of a cycle, with the ring-down that a flight will learn.
    errors : PoseErrors
    excitation : NominalExcitation
    """

    mission: Mission
    setup: Setup
    cycle: Cycle
    errors: PoseErrors
    excitation: NominalExcitation

    @classmethod
    def prepare(cls, mission: Mission) -> RolloutParts:
        """Compute what the rollouts of a mission share.

        Parameters
        ----------
        mission : Mission
            With a robot that is moved by gradient forces.

        Returns
        -------
        RolloutParts
        """
        excitation = NominalExcitation(mission.rig)
        cycle = expect_cycle(mission)
        return cls(mission, mission.setup(), cycle, PoseErrors.expect(mission), excitation)

    def make_controller(self) -> Controller:
        """Make the mission's controller.

        Returns
        -------
        Controller
        """
        make = load_plugin("controllers", self.mission.law)
        with report_plugin_errors("Controller", make, ""):
            controller: Controller = make(self.setup, self.mission.gains)
        return controller


@dataclass(frozen=True, eq=False)
class Outcome:
    """How a rollout ended.

    Attributes
    ----------
    reason : str
        Why the path's end is not reached; empty if it is.
    late : bool
        Whether that is the time limit.
    duration, path_time : float, in s
        In all, with the learning phase; from the path's start on.
    learned_at : float, in s
        End of the learning phase, from which on the time limit counts.
    cycles : int
    energy : float, in J
        Heat in the actuation coils.
    trail : ndarray, shape (n, 3), in m, world frame
    first_on_path : int
        Index in `trail` of the first position after the path's start was reached.
    pose_errors : ndarray, shape (n,), in m
        Distance of each located pose from the robot.
    done : float, in m
        Arc length that was covered.
    shots : list of Shot
        As played, without those of the learning phase.
    peaks : list of float, in degrees Celsius
        Highest temperature of each driven coil, in the order of `RigConfig.driven`.
    """

    reason: str
    late: bool
    duration: float
    path_time: float
    learned_at: float
    cycles: int
    energy: float
    trail: FloatArray
    first_on_path: int
    pose_errors: FloatArray
    done: float
    shots: list[Shot] = field(repr=False)
    peaks: list[float] = field(repr=False)


def expect_cycle(mission: Mission) -> Cycle:
    """Return the localization part of a mission's cycle with the ring-down that its flight will learn.

    Parameters
    ----------
    mission : Mission

    Returns
    -------
    Cycle
    """
    if not mission.sections.localization.learns_ring_down:
        return mission.cycle
    rig, frequency = mission.rig, mission.robot.device.frequency
    constants = [coil.time_constant for coil in rig.sections.excitation]
    cycle = expect_ring_down(mission.cycle, constants, rig.limits)
    sensors = rig.sensors
    sizes = [np.max(np.abs(np.sum(coil.field(sensors.positions) * sensors.axes, axis=1))) for coil in rig.round_coils()]
    decays = [(coil.time_constant, float(size)) for coil, size in zip(rig.sections.coils, sizes, strict=True)]
    return lengthen_ring_down(cycle, mission.cycle.ring_down, frequency, rig.limits.max_current, decays)


class Rollout:
    """One simulated flight of a mission.

    Parameters
    ----------
    parts : RolloutParts
    perturbation : Perturbation, optional
        Of the world; none unless given.
    seed : int
        Of the errors of poses.
    """

    def __init__(self, parts: RolloutParts, perturbation: Perturbation | None = None, seed: int = SEED) -> None:
        mission, setup = parts.mission, parts.setup
        self.mission = mission
        self.controller = parts.make_controller()
        self.clock = 0.0
        self.world = ModelWorld(mission, setup, parts.errors, perturbation or Perturbation(), seed)
        self._turnaround = mission.rig.turnaround
        flows = mission.rig.sections.medium.flow > 0.0  # only then does the motion differ enough to be learned
        self._tracker = make_steering_tracker(setup) if flows else Tracker(setup.robot, setup.device, setup.table)
        self._follower = Follower(mission.path, self.controller)
        self._safety = make_safety(mission.rig, mission)
        HeatMemory.from_rig_name(mission.rig.name).restore(self._safety.heat)  # a simulated rig has none
        self._scheduler = Scheduler(
            mission.cycle, mission.rig.limits, DeviceBelief(setup.device), parts.excitation.compute_field, self._now
        )
        self._learned = parts.cycle
        self._stall = StallMonitor(mission.path)
        self._pose_errors: list[float] = []

    def fly(self) -> Outcome:
        """Run cycles until the path's end, or until something ends the flight.

        Returns
        -------
        Outcome
        """
        self._learn()
        begun = path_begun = self.clock
        limit = self.mission.sections.stop.max_duration_s
        shots: list[Shot] = []
        trail, first = [self.world.position], 0
        command, reason = Command(None, note="no pose yet"), None
        while reason is None and not command.done:
            shot = self._scheduler.next(command, self._tracker)
            reason = self._find_refusal(shot)
            if reason is not None:
                break
            began = self.clock
            self._play(shot)
            shots.append(shot)
            trail.append(self.world.position)
            if not self.world.inside:
                reason = self._describe_edge()
                break
            try:
                command = self._follower.command(shot, self._tracker)
            except OutsideTableError:  # by a pose that errs outward
                reason = self._describe_edge()
                break
            if command.phase == "approach" or shot.mode != "track":
                path_begun, first = self.clock, len(trail)
            reason = self._find_end(shot, command, self.clock - began, self.clock - begun, limit)
        reason = reason or self._find_skip(np.array(trail))
        resistances = self.mission.rig.coil_resistances
        return Outcome(
            reason=reason or "",
            late=reason is not None and self.clock - begun > limit,
            duration=self.clock,
            path_time=self.clock - path_begun,
            learned_at=begun,
            cycles=len(shots),
            energy=compute_heat(shots, resistances),
            trail=np.array(trail),
            first_on_path=first,
            pose_errors=np.array(self._pose_errors),
            done=max(self._stall.arc_length, command.progress),
            shots=shots,
            peaks=list(self._safety.heat.peaks),
        )

    def _now(self) -> float:
        return self.clock

    def _learn(self) -> None:
        """Let the time of the learning phase pass, with its heat."""
        section = self.mission.sections.localization
        self.clock += section.background_noise_duration
        if section.learns_ring_down:
            probes = list(self._scheduler.make_probe_shots())
            tails = [next(self._scheduler.make_tail_shots(coil)) for coil in range(len(self.mission.rig.coil_names))]
            self.clock += sum(shot.duration + self._turnaround for shot in (*probes, *tails))
        self._scheduler.cycle = self._learned

    def _play(self, shot: Shot) -> None:
        self.world.play(shot, self._turnaround)
        at = next(at for at, window in shot.timed() if isinstance(window, Listen))
        assert shot.listen is not None
        pose = self.world.locate(self.clock + at + 0.5 * shot.listen.duration)
        self._tracker.update(shot, pose)
        if pose is not None:
            self._pose_errors.append(float(np.linalg.norm(pose.position - self.world.position)))
        self.clock += shot.duration + self._turnaround

    def _describe_edge(self) -> str:
        return f"the robot would leave the field table near {_format_mm(self.world.position)}."

    def _find_skip(self, trail: FloatArray) -> str | None:
        """Return which part of the path the trail left out; None if it visited enough of it."""
        fault = self.mission.find_skip_fault(self.mission.find_visits(trail)) if len(trail) else None
        return None if fault is None else f"{self.mission.law} would leave out a part: {fault}."

    def _find_refusal(self, shot: Shot) -> str | None:
        """Return why a shot would not be played; None if it would."""
        near = _format_mm(self.world.position)
        broken = self.mission.rig.limits.faults(shot)
        if broken:
            return f"{self.mission.law} would break a limit near {near}: {' '.join(broken)}"
        try:
            self._safety.check_shot(shot, self.clock, self._tracker.pose)
        except SafetyError as error:
            why = str(error).removesuffix(" Nothing was played.")
            return f"the safety rules would end it after {self.clock:.0f} s near {near}: {why}"
        return None

    def _find_end(self, shot: Shot, command: Command, lasted: float, flown: float, limit: float) -> str | None:
        """Return what ends the flight after a cycle; None if nothing does."""
        position = self.world.position
        if command.stuck:
            return f"{self.mission.law} would give up near {_format_mm(position)}: {command.note}"
        stall = self._stall.update(position, command, lasted if shot.mode == "track" else 0.0)
        if stall is not None:
            limits = self.mission.rig.limits
            return describe_stall(stall, self.mission.path, self.mission.law, self.controller, limits, would=True)
        if flown > limit and not command.done:
            done = f"{self._stall.arc_length * 1e3:.1f} of {self.mission.path.length * 1e3:.1f} mm"
            return f"it would not end within max_duration_s = {limit:g} s: {done} would be done."
        return None


def compute_heat(shots: list[Shot], resistances: FloatArray) -> float:
    """Compute the heat in the actuation coils.

    Parameters
    ----------
    shots : list of Shot
    resistances : ndarray, shape (n_coils,), in ohm

    Returns
    -------
    float, in J
    """
    windows = [w for shot in shots for w in shot.windows if isinstance(w, Actuate)]
    return float(sum(w.duration * np.sum(resistances * np.square(w.currents)) for w in windows))


def _format_mm(position: FloatArray) -> str:
    return f"({position[0] * 1e3:.1f}, {position[1] * 1e3:.1f}) mm"
