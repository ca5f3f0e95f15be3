"""A mission timed and flown on paper: what a cycle looks like, how long it takes, where it would stall."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from smolbot.arrays import FloatArray
from smolbot.control import Reach
from smolbot.fitness import expected_errors
from smolbot.missionfile import Mission
from smolbot.motion.gradient import advance
from smolbot.plugins import load
from smolbot.poses import Pose
from smolbot.rotations import quaternion_from_axes
from smolbot.shots import Actuate, Excite, Listen, RingDown, Shot

_UP = np.array([0.0, 0.0, 1.0])
STALL_CYCLES = 150
"""Cycles without progress after which a rolled-out mission counts as stalled."""


@dataclass(frozen=True)
class Preview:
    """What can be said of a mission before it is flown. SI units.

    Attributes
    ----------
    shot : Shot
        A typical cycle.
    rate_limit : float, in Hz
        Of the timeline alone; `rate` has the turnaround in it.
    duration : float, in s
        Expected, search and approach included; nan where the end is not reached.
    trail : ndarray, shape (n, 3), in m
        Where the robot is expected to go.
    localization_error : ndarray, shape (n,), in m
        Horizontal rms error of one pose, along the path.
    coil_energy : float, in J
    reasons : list of str
        Why not to fly; empty means go.
    """

    shot: Shot
    rate_limit: float
    rate: float
    length: float
    duration: float
    cycles: int
    trail: FloatArray
    reach: Reach
    localization_error: FloatArray
    coil_energy: float
    reasons: list[str] = field(default_factory=list)

    @property
    def go(self) -> bool:
        return not self.reasons


def preview(mission: Mission) -> Preview:
    """Time a mission on paper and fly it once on the controller's own model, without noise."""
    setup = mission.setup()
    controller = load("controllers", mission.law)(setup, mission.gains)
    device, robot, cycle = setup.device, setup.robot, setup.cycle
    position = np.array([*mission.start, mission.rig.surface_z])
    first = mission.path.points[0] - position
    heading = float(np.arctan2(first[1], first[0]))
    rest = cycle.duration(device.frequency) + mission.rig.turnaround
    clock = 2.0 * rest  # one shot to find the signal, one to confirm it
    controller.reset(mission.path, _pose(clock, position, heading))
    trail, energy, played, shots = [position.copy()], 0.0, 0.0, []
    best, since, reasons, count, command = 0.0, 0, [], 2, None
    goal_distance = np.inf
    while True:
        command = controller.command(_pose(clock, position, heading))
        if command.done:
            break
        window = command.window
        if isinstance(window, Actuate) and any(window.currents):
            if not setup.table.contains(position[None, :])[0]:
                reasons.append(f"the robot would leave the field table near {_mm(position)}.")
                break
            field_, gradient = setup.table.field_and_gradient(position[None, :])
            currents = np.array(window.currents)
            step, heading = advance(robot, field_[:, 0], gradient[:, 0], currents, heading, window.duration)
            position = position + np.array([*step, 0.0])
            energy += float(np.sum(mission.rig.coil_resistances * currents**2)) * window.duration
            clock += window.duration
            shots.append(window)
        clock += rest
        count += 1
        trail.append(position.copy())
        away = float(np.linalg.norm(mission.path.at(command.progress)[:2] - position[:2]))
        if command.progress > best + 1e-6 or (best == 0.0 and away < goal_distance - 1e-5):
            best, since, goal_distance = max(best, command.progress), 0, away
        else:
            since += 1
        if since > STALL_CYCLES:
            reasons.append(
                f"the robot would stall near {_mm(position)}, {best * 1e3:.1f} of {mission.path.length * 1e3:.1f} mm along "
                f"the path: the force of {mission.law} does not point where it should there."
            )
            break
        if clock > mission.sections.stop.max_duration_s:
            reasons.append(
                f"it would not end within max_duration_s = {mission.sections.stop.max_duration_s:g} s: "
                f"{best * 1e3:.1f} of {mission.path.length * 1e3:.1f} mm would be done."
            )
            break
    typical = Actuate(shots[-1].currents, float(np.median([w.duration for w in shots]))) if shots else None
    excite = Excite((cycle.excite_current, 0.0), device.frequency, cycle.excite_cycles)
    parts = (excite, RingDown(cycle.ring_down), Listen(cycle.half_periods, device.frequency))
    shot = Shot((typical, *parts) if typical else parts)
    played = clock - count * mission.rig.turnaround
    return Preview(
        shot=shot,
        rate_limit=count / played,
        rate=count / clock,
        length=mission.path.length,
        duration=float("nan") if reasons else clock,
        cycles=count,
        trail=np.array(trail),
        reach=controller.reach(mission.path),
        localization_error=expected_errors(mission, np.linspace(0.0, mission.path.length, 9)),
        coil_energy=energy,
        reasons=reasons,
    )


def _pose(time: float, position: FloatArray, heading: float) -> Pose:
    ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
    return Pose(time, position, quaternion_from_axes(ahead, _UP, "zy"), np.zeros((6, 6)))


def _mm(position: FloatArray) -> str:
    return f"({position[0] * 1e3:.1f}, {position[1] * 1e3:.1f}) mm"
