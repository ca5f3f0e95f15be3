"""A robot that gets nowhere: told from one that goes on slowly, pauses, or is searched for."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.limits import Limits
from smolbot.core.shots import Shot
from smolbot.errors import report_plugin_errors
from smolbot.flight.pilots import Pilot
from smolbot.flight.tracking.tracker import Tracker
from smolbot.motion.controller import Command, Controller, ForceForecast
from smolbot.paths.curve import Curve

STALL_TIME = 20.0
"""Time, in s, of steering without an advance after which a robot has stalled: a turn takes a tenth of it."""

STALL_ADVANCE = 0.4e-3
"""Advance, in m, that counts: several times what the errors of tracked poses feign in a robot that stands still."""

PACED_STEP = 2e-3
"""Length, in m, whose time at a requested speed is added: a law with goals along the path may go from one to the next,
and wait there."""

SEARCH_AHEAD, SEARCH_SPACING = 4e-3, 0.1e-3
"""Range along the path, in m, in which the place of a robot is searched ahead of its last one, and its spacing: the
strands of a letter cross, and the nearest place of all may lie on another one."""

AHEAD = 1e-3
"""Length of the path ahead, in m, on which a stall is explained by the force of the law."""

MIN_FORCE = 0.5e-6
"""Force, in N, below which a law pulls nowhere: in glycerol it moves a robot by less than its pose errs."""

MAX_DIRECTION_ERROR = float(np.radians(45.0))
"""Angle of a force to its goal beyond which more of it pushes the robot aside than takes it there."""


@dataclass(frozen=True)
class Stall:
    """Where a robot stalled: arc length of the path, in m, and position (3,), in m, world frame."""

    arc_length: float
    position: FloatArray


class StallMonitor:
    """Tells a robot that is steered and does not advance along its path.

    An advance is a growing arc length on the path, as the robot's place or its law tells it, or a shrinking distance to
    the path's start during the approach. Only time in which the law steers counts: no pause, and no search.

    Parameters
    ----------
    path : Curve
    """

    def __init__(self, path: Curve) -> None:
        self._path = path
        self._arc = np.append(np.arange(0.0, path.length, SEARCH_SPACING), path.length)
        self._points = path.at(self._arc)[:, :2]
        self._length = path.length
        self._patience = STALL_TIME
        if path.speed is not None:
            self._patience += PACED_STEP * path.speed.duration / path.length
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next update is the first one."""
        self.arc_length = 0.0
        self._nearest = np.inf
        self._best = 0.0
        self._steered = 0.0

    def update(self, position: FloatArray, command: Command, steered: float) -> Stall | None:
        """Take note of one cycle.

        Parameters
        ----------
        position : ndarray, shape (3,), in m, world frame
            Of the robot after it.
        command : Command
            The law's next one, with its progress and phase.
        steered : float, in s
            Length of the cycle if the law steered the robot in it, else 0.

        Returns
        -------
        Stall or None
            None unless the robot has stalled.
        """
        if command.phase == "approach":
            away = float(np.hypot(*(position[:2] - self._points[0])))
            advanced = away < self._nearest - STALL_ADVANCE
            self._nearest = min(away, self._nearest) if advanced else self._nearest
        else:
            self._locate(position)
            self.arc_length = max(self.arc_length, min(command.progress, self._length))
            advanced = self.arc_length > self._best + STALL_ADVANCE
            self._best = self.arc_length if advanced else self._best
        self._steered = 0.0 if advanced else self._steered + steered
        return Stall(self.arc_length, np.array(position)) if self._steered > self._patience else None

    def _locate(self, position: FloatArray) -> None:
        first = int(np.searchsorted(self._arc, self.arc_length))
        ahead = self._points[first : first + int(SEARCH_AHEAD / SEARCH_SPACING)]
        if len(ahead):
            self.arc_length = float(self._arc[first + int(np.argmin(np.sum((ahead - position[:2]) ** 2, axis=1)))])


def describe_stall(stall: Stall, path: Curve, law: str, controller: Controller, limits: Limits, *, would: bool) -> str:
    """Describe a stall: where, how far along the path, and why, as far as the law computes its force.

    Parameters
    ----------
    stall : Stall
    path : Curve
    law : str
        Name of the law.
    controller : Controller
    limits : Limits
        Of the coils.
    would : bool
        Whether it is predicted (``the robot would stall``).

    Returns
    -------
    str
    """
    x, y = stall.position[:2] * 1e3
    done = f"{stall.arc_length * 1e3:.1f} of {path.length * 1e3:.1f} mm"
    verb, why = "would stall" if would else "stalled", _explain(stall, path, law, controller, limits)
    return f"the robot {verb} near ({x:.1f}, {y:.1f}) mm, {done} along the path: {why}"


def _explain(stall: Stall, path: Curve, law: str, controller: Controller, limits: Limits) -> str:
    """Explain a stall by the law's force there."""
    if not isinstance(controller, ForceForecast):
        return f"{law} does not move it on there."
    goal = path.at(min(stall.arc_length + AHEAD, path.length))
    here = np.array([*stall.position[:2], goal[2]])
    ways = [path.at(np.array([max(min(stall.arc_length, path.length - AHEAD), 0.0), stall.arc_length + AHEAD]))]
    if np.linalg.norm(goal - here) > STALL_ADVANCE:
        ways.append(np.array([here, goal]))
    with report_plugin_errors("Controller", controller, "reach"):
        profiles = [controller.reach(Curve(way)) for way in ways]
    force = min(float(np.min(profile.force)) for profile in profiles)
    error = max(float(np.max(profile.direction_error)) for profile in profiles)
    if force < MIN_FORCE:
        low = 0.0 if limits.unipolar else -limits.max_current
        currents = f"with {low:g} to {limits.max_current:g} A in each of {len(limits.coils)} coils"
        return f"{currents}, {law} finds hardly any force along the path there."
    if error > MAX_DIRECTION_ERROR:
        return f"the force of {law} does not point where it should there, {np.degrees(error):.0f}° off."
    return f"{law} does not get on with its {force * 1e6:.3g} µN there."


class StallWatch:
    """Pilot that ends a flight as stuck once the robot that another pilot steers has stalled.

    Parameters
    ----------
    pilot : Pilot
        The one that steers.
    path : Curve
    law : str
        Name of the law.
    controller : Controller
        Its controller, which explains a stall.
    limits : Limits
        Of the coils.
    """

    def __init__(self, pilot: Pilot, path: Curve, law: str, controller: Controller, limits: Limits) -> None:
        self.pilot = pilot
        self._limits = limits
        self.controller = controller
        self._path = path
        self._law = law
        self._monitor = StallMonitor(path)
        self._ended: float | None = None

    def command(self, shot: Shot, tracker: Tracker) -> Command:
        """Return the other pilot's command, or one that is stuck once the robot has stalled.

        Parameters
        ----------
        shot : Shot
            The shot that was played.
        tracker : Tracker

        Returns
        -------
        Command
        """
        command = self.pilot.command(shot, tracker)
        began, self._ended = self._ended, shot.end
        if tracker.pose is None or tracker.misses or command.done or command.stuck:
            return command
        lasted = shot.end - (shot.start if began is None else began)
        stall = self._monitor.update(tracker.pose.position, command, lasted if shot.mode == "track" else 0.0)
        if stall is None:
            return command
        note = describe_stall(stall, self._path, self._law, self.controller, self._limits, would=False)
        return replace(command, window=None, stuck=True, note=note)
