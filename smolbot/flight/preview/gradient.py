"""Preview of a mission with gradient forces: a typical cycle, the duration, and where the robot would stall."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from smolbot.config.feasibility import compute_expected_errors
from smolbot.config.mission import Mission
from smolbot.config.plugins import load_plugin
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.results import Readable
from smolbot.core.rotations import quaternion_from_axes
from smolbot.core.shots import Actuate, Shot
from smolbot.errors import report_plugin_errors
from smolbot.flight.pilots import check_command
from smolbot.motion.controller import Controller, ForceForecast, ForceProfile
from smolbot.motion.gradient import advance
from smolbot.paths.corners import compute_curvature, find_corners

_UP = np.array([0.0, 0.0, 1.0])
STALL_CYCLES = 150
"""Number of cycles without progress after which a simulated mission counts as stalled."""


@dataclass(frozen=True, repr=False)
class Preview(Readable):
    """Prediction for a mission before it is flown. SI units.

    Attributes
    ----------
    shot : Shot
        A typical cycle.
    rate_limit : float, in Hz
        Cycle rate of the timeline alone.
    rate : float, in Hz
        Cycle rate with the turnaround time included.
    length : float, in m
        Of the path.
    corners : int
        Number of corners that are kept in the path.
    tightest_radius : float, in m
        Radius of the tightest bend between corners; infinite where all is straight.
    remarks : tuple of str
        On how the path was made.
    duration : float, in s
        Expected, search and approach included; nan where the end is not reached.
    path_time : float, in s
        From the path's start to its end alone.
    requested_time : float, in s, or None
        The same at the speed that the path requests; None if it requests none.
    cycles : int
        Number of cycles.
    trail : ndarray, shape (n, 3), in m
        Where the robot is expected to go.
    localization_error : ndarray, shape (n,), in m
        Horizontal rms error of one pose, along the path.
    force_profile : ForceProfile or None
        The controller's force along the path; None if the controller does not compute it.
    coil_energy : float, in J
    reasons : list of str
        Why not to fly; empty means go.
    """

    shot: Shot
    rate_limit: float
    rate: float
    length: float
    corners: int
    tightest_radius: float
    remarks: tuple[str, ...]
    duration: float
    path_time: float
    requested_time: float | None
    cycles: int
    trail: FloatArray
    force_profile: ForceProfile | None
    localization_error: FloatArray
    coil_energy: float
    reasons: list[str] = field(default_factory=list)

    @property
    def go(self) -> bool:
        """True if there is no reason not to fly."""
        return not self.reasons


class _Rollout:
    """Simulation of a mission on the controller's own model, without noise."""

    def __init__(self, mission: Mission) -> None:
        self.mission = mission
        self.setup = mission.setup()
        make = load_plugin("controllers", mission.law)
        with report_plugin_errors("Controller", make, ""):
            self.controller: Controller = make(self.setup, mission.gains)
        self.rest = self.setup.cycle.duration(self.setup.device.frequency) + mission.rig.turnaround
        self.position = np.array([*mission.start, mission.rig.surface_z])
        first = mission.path.points[0] - self.position
        self.heading = float(np.arctan2(first[1], first[0]))
        self.quiet = mission.sections.localization.background_noise_duration
        self.clock = self.quiet + 2.0 * self.rest  # one shot to find the signal, one to confirm it
        self.path_begun = self.clock
        self.cycles = 2
        self.windows: list[Actuate] = []
        self.trail = [self.position.copy()]
        self.energy = 0.0

    def fly(self) -> str | None:
        """Run cycles until the end of the path; return the reason if it is not reached, else None."""
        with report_plugin_errors("Controller", self.controller, "reset"):
            self.controller.reset(self.mission.path, self._make_pose())
        best, nearest, farthest, since = 0.0, np.inf, 0.0, 0
        while True:
            if not self.setup.table.contains(self.position[None, :])[0]:
                return f"the robot would leave the field table near {_format_mm(self.position)}."
            with report_plugin_errors("Controller", self.controller, "command"):
                command = check_command(self.controller.command(self._make_pose()), self.controller)
            if command.done:
                return self._find_skip_reason()
            windows = command.mechanical or ((command.window,) if isinstance(command.window, Actuate) else ())
            broken = self.setup.limits.faults(Shot(windows)) if windows else []
            if broken:
                return f"{self.mission.law} would break a limit near {_format_mm(self.position)}: {' '.join(broken)}"
            self._advance(command.window)
            if command.phase == "approach":
                self.path_begun = self.clock
            goal = self.mission.path.at(command.progress)
            away = float(np.linalg.norm(goal[:2] - self.position[:2]))
            approached = command.phase == "approach" and away < nearest - 1e-5
            passed = float(self.mission.path.project(self.position[None, :])[0][0])
            unreported = best == 0.0 and command.phase == "follow" and passed > farthest + 1e-5  # progress is optional
            if command.progress > best + 1e-6 or approached or unreported:
                best, nearest, since = max(best, command.progress), away, 0
                farthest = max(farthest, passed)
            else:
                since += 1
            done = f"{best * 1e3:.1f} of {self.mission.path.length * 1e3:.1f} mm"
            if since > STALL_CYCLES:
                return (
                    f"the robot would stall near {_format_mm(self.position)}, {done} along the path: "
                    f"the force of {self.mission.law} does not point where it should there."
                )
            limit = self.mission.sections.stop.max_duration_s
            if self.clock - self.quiet > limit:
                return f"it would not end within max_duration_s = {limit:g} s: {done} would be done."

    def _find_skip_reason(self) -> str | None:
        fault = self.mission.find_skip_fault(self.mission.find_visits(np.array(self.trail)))
        return None if fault is None else f"{self.mission.law} would leave out a part: {fault}."

    def _advance(self, window: object) -> None:
        if isinstance(window, Actuate) and any(window.currents):
            field_, gradient = self.setup.table.field_and_gradient(self.position[None, :])
            currents = np.array(window.currents)
            step, self.heading = advance(
                self.setup.robot, field_[:, 0], gradient[:, 0], currents, self.heading, window.duration
            )
            self.position = self.position + np.array([step[0], step[1], 0.0])
            self.energy += float(np.sum(self.mission.rig.coil_resistances * currents**2)) * window.duration
            self.clock += window.duration
            self.windows.append(window)
        self.clock += self.rest
        self.cycles += 1
        self.trail.append(self.position.copy())

    def _make_pose(self) -> Pose:
        ahead = np.array([np.cos(self.heading), np.sin(self.heading), 0.0])
        return Pose(self.clock, self.position, quaternion_from_axes(ahead, _UP, "zy"), np.zeros((6, 6)))

    def pick_typical_shot(self) -> Shot:
        """Build a cycle whose actuation window has the median length."""
        windows = sorted(self.windows, key=lambda w: w.duration)
        listening = self.setup.cycle.windows(self.setup.device.frequency)
        return Shot((windows[len(windows) // 2], *listening) if windows else listening)


def preview(mission: Mission) -> Preview:
    """Time a mission and simulate it once on the controller's own model, without noise.

    Parameters
    ----------
    mission : Mission
        With a robot that is moved by gradient forces.

    Returns
    -------
    Preview
    """
    rollout = _Rollout(mission)
    reason = rollout.fly()
    cycling = rollout.clock - rollout.quiet
    played = cycling - rollout.cycles * mission.rig.turnaround
    bend = np.max(compute_curvature(mission.path.points))
    with report_plugin_errors("Controller", rollout.controller, "reach"):
        forecast = rollout.controller.reach(mission.path) if isinstance(rollout.controller, ForceForecast) else None
    return Preview(
        shot=rollout.pick_typical_shot(),
        rate_limit=rollout.cycles / played,
        rate=rollout.cycles / cycling,
        length=mission.path.length,
        corners=len(find_corners(mission.path.points)),
        tightest_radius=float(1.0 / bend) if bend > 0.0 else float("inf"),
        remarks=mission.path_remarks,
        duration=float("nan") if reason else rollout.clock,
        path_time=float("nan") if reason else rollout.clock - rollout.path_begun,
        requested_time=None if mission.path.speed is None else mission.path.speed.duration,
        cycles=rollout.cycles,
        trail=np.array(rollout.trail),
        force_profile=forecast,
        localization_error=compute_expected_errors(mission, mission.path, np.linspace(0.0, mission.path.length, 9)),
        coil_energy=rollout.energy,
        reasons=[reason] if reason else [],
    )


def _format_mm(position: FloatArray) -> str:
    return f"({position[0] * 1e3:.1f}, {position[1] * 1e3:.1f}) mm"
