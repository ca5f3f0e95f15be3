"""Simulate a mission on the controller's own motion model, with the real tracker and the real law, cycle by cycle."""

from __future__ import annotations

import copy
import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from smolbot.config.feasibility import compute_covariances_along
from smolbot.config.mission import Mission
from smolbot.config.plugins import load_plugin
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.rotations import multiply_quaternions, quaternion_from_axes, quaternion_from_rotation_vector
from smolbot.core.shots import Actuate, Shot, Window
from smolbot.errors import InputError
from smolbot.flight.tracking.tracker import Tracker
from smolbot.localization.noise.excitation_transients import SEPARABLE_AFTER
from smolbot.motion.controller import Command, Controller, Setup
from smolbot.motion.gradient import advance
from smolbot.motion.robot import Robot

_UP = np.array([0.0, 0.0, 1.0])

MAX_CYCLES = 5000
"""Largest number of cycles of a flight."""

COVARIANCE_POINTS = 9
"""Points along the path at which the covariance of a pose is computed; elsewhere the nearest is used."""


@dataclass(frozen=True)
class State:
    """True pose of the robot.

    Attributes
    ----------
    position : ndarray, shape (3,), in m, world frame
        Rotation centre.
    heading : float, in rad
    """

    position: FloatArray
    heading: float

    def move(self, displacement: FloatArray, turn: float) -> State:
        """Return the state after a displacement and a turn.

        Parameters
        ----------
        displacement : ndarray, shape (2,), in m, world frame
        turn : float, in rad
            About the vertical.

        Returns
        -------
        State
        """
        return State(self.position + np.array([displacement[0], displacement[1], 0.0]), self.heading + turn)

    def compute_orientation(self) -> FloatArray:
        """Return the orientation of a robot that lies level.

        Returns
        -------
        ndarray, shape (4,)
            Unit quaternion, scalar first, body to world.
        """
        return quaternion_from_axes(np.array([math.cos(self.heading), math.sin(self.heading), 0.0]), _UP, "zy")


@dataclass(frozen=True)
class Instant:
    """One cycle of a simulated flight, at the moment when the law computes its command.

    Attributes
    ----------
    number : int
        Of the cycle in its flight.
    tracker, controller
        Copies from just before this cycle's update; copy them again before use. None where no copy was requested.
    shot, measured
        The tracker's input: the shot played and the measured pose.
    state : State
        Ground truth.
    pose : Pose
        Tracked pose, the law's input.
    command : Command
        The law's output.
    cycle, wait : float, in s
        From one command to the next, and from the middle of listening to the end of the shot.
    """

    number: int
    tracker: Tracker | None
    controller: Controller | None
    shot: Shot
    measured: Pose
    state: State
    pose: Pose
    command: Command
    cycle: float
    wait: float


class Model:
    """Model that a mission's controller assumes: motion of the robot, timeline of a cycle, covariance of a pose.

    Parameters
    ----------
    mission : Mission

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
        if listening.background_noise_duration > 0.0 and listening.learns_ring_down:
            constants = [c.time_constant for c in mission.rig.sections.excitation]
            self.ring_down = max(SEPARABLE_AFTER * max(constants), self.setup.limits.min_ring_down)
        cycle = replace(self.setup.cycle, ring_down=self.ring_down)
        self.listening: tuple[Window, ...] = cycle.windows(self.setup.device.frequency)
        self._arc = np.linspace(0.0, mission.path.length, COVARIANCE_POINTS)
        self._covariances = compute_covariances_along(mission, mission.path, self._arc)

    @property
    def rest(self) -> float:
        """From the end of an actuation to the start of the next, in s."""
        return sum(w.duration for w in self.listening) + self.mission.rig.turnaround

    def make_controller(self, gains: Mapping[str, float] | None = None) -> Controller:
        """Build the mission's law.

        Parameters
        ----------
        gains : mapping of str to float, optional
            Instead of the mission's gains.

        Returns
        -------
        Controller
        """
        made: Controller = load_plugin("controllers", self.mission.law)(
            self.setup, self.mission.gains if gains is None else gains
        )
        return made

    def compute_motion(self, state: State, window: object) -> tuple[FloatArray, float]:
        """Compute the motion that a window causes, by the controller's own model.

        Parameters
        ----------
        state : State
        window : Window
            Only an `Actuate` with a current moves the robot.

        Returns
        -------
        displacement : ndarray, shape (2,), in m, world frame
        turn : float, in rad

        Raises
        ------
        InputError
            Where the field is not known.
        """
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
        """Check that a position lies in the field table.

        Parameters
        ----------
        position : ndarray, shape (3,), in m, world frame

        Raises
        ------
        InputError
            If it does not.
        """
        if not self.setup.table.contains(position[None, :])[0]:
            x, y = position[:2] * 1e3
            raise InputError(f"{self.mission.name}: the robot would leave the field table near ({x:.1f}, {y:.1f}) mm.")

    def find_covariance(self, progress: float) -> FloatArray:
        """Return the covariance of a pose measured at a place on the path.

        Parameters
        ----------
        progress : float, in m
            Arc length.

        Returns
        -------
        ndarray, shape (6, 6), in m and rad
        """
        found: FloatArray = self._covariances[int(np.argmin(np.abs(self._arc - progress)))]
        return found

    def copy_controller(self, controller: Controller) -> Controller:
        """Copy a controller, so that the copy can be queried without changing the original.

        Parameters
        ----------
        controller : Controller

        Returns
        -------
        Controller

        Raises
        ------
        InputError
            If the law cannot be copied.
        """
        memo: dict[int, Any] = {id(shared): shared for shared in (self.setup, self.setup.table)}
        try:
            return copy.deepcopy(controller, memo)
        except (TypeError, copy.Error) as error:
            raise InputError(
                f"The law '{self.mission.law}' cannot be copied, so it cannot be probed: {error}."
            ) from error

    def copy_tracker(self, tracker: Tracker) -> Tracker:
        """Copy a tracker; the field table and the robot are shared.

        Parameters
        ----------
        tracker : Tracker

        Returns
        -------
        Tracker
        """
        memo: dict[int, Any] = {id(shared): shared for shared in (self.setup.table, self.setup.robot)}
        return copy.deepcopy(tracker, memo)


def simulate_flight(
    model: Model,
    controller: Controller,
    *,
    delay_cycles: int = 0,
    measure: Callable[[State], State] = lambda state: state,
    keep: Callable[[int], bool] = lambda cycle: True,
    max_cycles: int = MAX_CYCLES,
) -> Iterator[Instant]:
    """Simulate the cycles of a flight, from the first command until the law is done.

    Parameters
    ----------
    model : Model
    controller : Controller
        New; it is flown with.
    delay_cycles : int
        By how many cycles each pose is late; the tracker does not know it.
    measure : callable
        Returns the measured for the true state; by default they are the same.
    keep : callable
        Whether to copy tracker and law in the cycle of that number.
    max_cycles : int
        After which the flight ends.

    Yields
    ------
    Instant

    Raises
    ------
    InputError
        If the law is done and has reported no progress, or the robot leaves the field table.
    """
    mission, setup = model.mission, model.setup
    position = np.array([*mission.start, mission.rig.surface_z])
    first = mission.path.points[0] - position
    state = State(position, math.atan2(first[1], first[0]))
    tracker = Tracker(setup.robot, setup.device, setup.table)
    states: deque[State] = deque([state] * (delay_cycles + 1), delay_cycles + 1)
    clock, progress, begun = 0.0, 0.0, False
    window: Window | None = None
    for cycle in range(max_cycles):
        shot = Shot((window, *model.listening) if window is not None else model.listening, "track", clock)
        state = state.move(*model.compute_motion(state, window))
        states.append(state)
        wait, there = 0.5 * model.listening[-1].duration, measure(states[0])
        measured = Pose(shot.end - wait, there.position, there.compute_orientation(), model.find_covariance(progress))
        kept = model.copy_tracker(tracker) if begun and keep(cycle) else None
        tracker.update(shot, measured)
        clock = shot.end + mission.rig.turnaround
        if not tracker.confirmed:
            continue
        pose = tracker.pose_at(shot.end)
        model.require_inside(np.asarray(pose.position))
        if not begun:
            controller.reset(mission.path, pose)
            begun = True
        before = model.copy_controller(controller) if kept is not None else None
        command = controller.command(pose)
        assert not isinstance(command.window, tuple)  # helical robots are refused before
        window, progress = command.window, command.progress
        duration = window.duration if window is not None else 0.0
        yield Instant(cycle, kept, before, shot, measured, state, pose, command, duration + model.rest, wait)
        if command.done and progress == 0.0:
            raise InputError(
                f"The law '{mission.law}' reports no progress in its commands, so its cycles have no place on the path."
            )
        if command.done:
            return


def displace_pose(pose: Pose, across: float, normal: FloatArray, turn: float) -> Pose:
    """Return a pose that is displaced across the path and turned about the vertical.

    Parameters
    ----------
    pose : Pose
    across : float, in m
        Displacement along `normal`.
    normal : ndarray, shape (2,)
        Unit vector across the path, world frame.
    turn : float, in rad

    Returns
    -------
    Pose
    """
    shift = across * np.array([normal[0], normal[1], 0.0])
    rotation = quaternion_from_rotation_vector(np.array([0.0, 0.0, turn]))
    return replace(pose, position=pose.position + shift, orientation=multiply_quaternions(rotation, pose.orientation))


def require_loop(mission: Mission) -> None:
    """Check that a mission has a law that pulls a robot by coils.

    Parameters
    ----------
    mission : Mission

    Raises
    ------
    InputError
        If it has none.
    """
    if getattr(getattr(mission, "sections", None), "controller", None) is None:
        raise InputError(f"{mission.name}: has no [controller]: it only localizes: there is no loop to analyse.")
    kind: str = mission.robot.kind
    if kind != "gradient":
        raise InputError(
            f"{mission.name}: margins are computed for robots of kind 'gradient', whose motion the loop models; "
            f"'{mission.robot.name}' is of kind '{kind}'."
        )
