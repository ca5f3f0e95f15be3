"""A mission flown on the controller's own model with its real tracker and its real law, cycle by cycle."""

from __future__ import annotations

import copy
import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from smolbot.config.feasibility import covariances_along
from smolbot.config.mission import Mission
from smolbot.config.plugins import load
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.rotations import quaternion_from_axes, quaternion_from_rotation_vector, quaternion_product
from smolbot.core.shots import Actuate, Shot, Window
from smolbot.errors import InputError
from smolbot.flight.tracking.tracker import Tracker
from smolbot.localization.noise.excitation_transients import QUIET_AFTER
from smolbot.motion.controller import Command, Controller, Setup
from smolbot.motion.gradient import advance
from smolbot.motion.robot import Robot

_UP = np.array([0.0, 0.0, 1.0])

MOST_CYCLES = 5000
"""Largest number of cycles of a flight."""

PLACES = 9
"""Points along the path at which the covariance of a pose is computed; elsewhere the nearest is used."""


@dataclass(frozen=True)
class State:
    """Where the robot truly is: rotation centre (3,) in m, heading in rad."""

    position: FloatArray
    heading: float

    def moved(self, along: FloatArray, turn: float) -> State:
        """After a displacement (2,) in m and a turn in rad."""
        return State(self.position + np.array([along[0], along[1], 0.0]), self.heading + turn)

    def orientation(self) -> FloatArray:
        """Quaternion (4,) of a robot that lies level."""
        return quaternion_from_axes(np.array([math.cos(self.heading), math.sin(self.heading), 0.0]), _UP, "zy")


@dataclass(frozen=True)
class Instant:
    """One cycle, as it stood when the law was asked.

    Attributes
    ----------
    number : int
        Of the cycle in its flight.
    tracker, controller
        As they were just before this cycle's `heard` and `pose`; copy them before use. None where not asked for.
    shot, heard
        What the tracker was told.
    state : State
        True.
    pose : Pose
        As handed to the law.
    command : Command
        What it answered.
    cycle, wait : float, in s
        From one command to the next, and from the middle of listening to the end of the shot.
    """

    number: int
    tracker: Tracker | None
    controller: Controller | None
    shot: Shot
    heard: Pose
    state: State
    pose: Pose
    command: Command
    cycle: float
    wait: float


class Model:
    """A mission's beliefs, made once: motion of the robot, timeline of a cycle, covariance of a pose.

    Raises
    ------
    InputError
        For a mission without a law that pulls a robot by coils.
    """

    def __init__(self, mission: Mission) -> None:
        require_loop(mission)
        self.mission = mission
        self.setup: Setup = mission.setup()
        self.ring_down = self.setup.cycle.ring_down
        listening = mission.sections.localization
        if listening.quiet > 0.0 and listening.learns_ring_down:
            constants = [c.time_constant for c in mission.rig.sections.excitation]
            self.ring_down = max(QUIET_AFTER * max(constants), self.setup.limits.min_ring_down)
        cycle = replace(self.setup.cycle, ring_down=self.ring_down)
        self.listening: tuple[Window, ...] = cycle.windows(self.setup.device.frequency)
        self._arc = np.linspace(0.0, mission.path.length, PLACES)
        self._covariances = covariances_along(mission, mission.path, self._arc)

    @property
    def rest(self) -> float:
        """From the end of an actuation to the start of the next, in s."""
        return sum(w.duration for w in self.listening) + self.mission.rig.turnaround

    def controller(self, gains: Mapping[str, float] | None = None) -> Controller:
        """The mission's law, with its gains or others."""
        made: Controller = load("controllers", self.mission.law)(
            self.setup, self.mission.gains if gains is None else gains
        )
        return made

    def motion(self, state: State, window: object) -> tuple[FloatArray, float]:
        """Displacement (2,) in m and turn in rad that a window causes, as believed."""
        if not isinstance(window, Actuate) or not any(window.currents):
            return np.zeros(2), 0.0
        self.require_inside(state.position)
        field, gradient = self.setup.table.field_and_gradient(state.position[None, :])
        robot: Robot = self.setup.robot
        step, after = advance(
            robot, field[:, 0], gradient[:, 0], np.array(window.currents), state.heading, window.duration
        )
        return step, after - state.heading

    def require_inside(self, position: FloatArray) -> None:
        """Raise `InputError` where the field is not known."""
        if not self.setup.table.contains(position[None, :])[0]:
            x, y = position[:2] * 1e3
            raise InputError(f"{self.mission.name}: the robot would leave the field table near ({x:.1f}, {y:.1f}) mm.")

    def covariance(self, progress: float) -> FloatArray:
        """Covariance (6, 6) of a pose heard at arc length `progress` m."""
        found: FloatArray = self._covariances[int(np.argmin(np.abs(self._arc - progress)))]
        return found

    def copied(self, controller: Controller) -> Controller:
        """A controller in the same state, that may be asked without the first one knowing."""
        memo: dict[int, Any] = {id(shared): shared for shared in (self.setup, self.setup.table)}
        try:
            return copy.deepcopy(controller, memo)
        except (TypeError, copy.Error) as error:
            raise InputError(
                f"The law '{self.mission.law}' cannot be copied, so it cannot be probed: {error}."
            ) from error

    def copied_tracker(self, tracker: Tracker) -> Tracker:
        """The same for a tracker."""
        memo: dict[int, Any] = {id(shared): shared for shared in (self.setup.table, self.setup.robot)}
        return copy.deepcopy(tracker, memo)


def fly(
    model: Model,
    controller: Controller,
    *,
    late: int = 0,
    seen: Callable[[State], State] = lambda state: state,
    keep: Callable[[int], bool] = lambda cycle: True,
    most: int = MOST_CYCLES,
) -> Iterator[Instant]:
    """Cycles of a flight, from the first command on, until the law is done or `most` have passed.

    Parameters
    ----------
    model : Model
    controller : Controller
        New; it is flown with.
    late : int
        By how many cycles each pose is late, without the tracker's knowing.
    seen : callable
        What is heard of a state; without it, the truth.
    keep : callable
        Whether to copy tracker and law in the cycle of that number.

    Raises
    ------
    InputError
        If the law arrives and has told no progress on the way; if the robot leaves the field table.
    """
    mission, setup = model.mission, model.setup
    position = np.array([*mission.start, mission.rig.surface_z])
    first = mission.path.points[0] - position
    state = State(position, math.atan2(first[1], first[0]))
    tracker = Tracker(setup.robot, setup.device, setup.table)
    states: deque[State] = deque([state] * (late + 1), late + 1)
    clock, progress, begun = 0.0, 0.0, False
    window: Window | None = None
    for cycle in range(most):
        shot = Shot((window, *model.listening) if window is not None else model.listening, "track", clock)
        state = state.moved(*model.motion(state, window))
        states.append(state)
        wait, there = 0.5 * model.listening[-1].duration, seen(states[0])
        heard = Pose(shot.end - wait, there.position, there.orientation(), model.covariance(progress))
        kept = model.copied_tracker(tracker) if begun and keep(cycle) else None
        tracker.update(shot, heard)
        clock = shot.end + mission.rig.turnaround
        if not tracker.confirmed:
            continue
        pose = tracker.pose_at(shot.end)
        model.require_inside(np.asarray(pose.position))
        if not begun:
            controller.reset(mission.path, pose)
            begun = True
        before = model.copied(controller) if kept is not None else None
        command = controller.command(pose)
        assert not isinstance(command.window, tuple)  # helical robots are refused before
        window, progress = command.window, command.progress
        duration = window.duration if window is not None else 0.0
        yield Instant(cycle, kept, before, shot, heard, state, pose, command, duration + model.rest, wait)
        if command.done and progress == 0.0:
            raise InputError(
                f"The law '{mission.law}' tells no progress in its commands, so its cycles have no place on the path."
            )
        if command.done:
            return


def turned(pose: Pose, across: float, normal: FloatArray, turn: float) -> Pose:
    """The same pose `across` m farther along `normal` (2,), turned by `turn` rad about the vertical."""
    shift = across * np.array([normal[0], normal[1], 0.0])
    rotation = quaternion_from_rotation_vector(np.array([0.0, 0.0, turn]))
    return replace(pose, position=pose.position + shift, orientation=quaternion_product(rotation, pose.orientation))


def require_loop(mission: Mission) -> None:
    """Raise `InputError` if the mission has no law, or one that does not pull by coils."""
    if getattr(getattr(mission, "sections", None), "controller", None) is None:
        raise InputError(f"{mission.name}: has no [controller]: it only localizes: there is no loop to analyse.")
    kind: str = mission.robot.kind
    if kind != "gradient":
        raise InputError(
            f"{mission.name}: margins are computed for robots of kind 'gradient', whose motion the loop models; "
            f"'{mission.robot.name}' is of kind '{kind}'."
        )
