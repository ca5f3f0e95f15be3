"""Pilots: they turn the tracked pose into the next command, once a cycle."""

from __future__ import annotations

import math
from dataclasses import replace
from numbers import Real
from typing import Protocol

from lookup_tables.errors import OutsideTableError
from smolbot.core.pose import Pose
from smolbot.core.shots import Actuate, Mechanical, Rotate, Shot
from smolbot.errors import PluginError, report_plugin_errors
from smolbot.flight.tracking.passive_trackers import SingleShotTracker
from smolbot.flight.tracking.tracker import Tracker
from smolbot.motion.controller import Command, Controller, MotionAware, PlaybackAware
from smolbot.paths.curve import Curve


class Pilot(Protocol):
    """Protocol of what decides the next command.

    A command with ``done`` ends the mission; its note gives the reason.
    """

    def command(self, shot: Shot, tracker: Tracker) -> Command:
        """Compute the next command, once a shot was played and the tracker was updated.

        Parameters
        ----------
        shot : Shot
            The shot that was played.
        tracker : Tracker
            Updated with the shot.

        Returns
        -------
        Command
        """


class Follower:
    """Pilot that has a controller follow a path, once two poses have agreed.

    A controller that is `PlaybackAware` is notified if its last command was not played. Where one asks the field table
    for a place that it does not cover, nothing is driven until a pose is inside again.

    Parameters
    ----------
    path : Curve
    controller : Controller
    """

    def __init__(self, path: Curve, controller: Controller) -> None:
        self.path = path
        self.controller = controller
        self._begun = False
        self._waiting: Command | None = None
        self._sent: Command | None = None

    def command(self, shot: Shot, tracker: Tracker) -> Command:
        """Compute the controller's command for the pose that is predicted for the end of the shot.

        A command with mechanical windows is repeated until it was played.

        Parameters
        ----------
        shot : Shot
            The shot that was played.
        tracker : Tracker

        Returns
        -------
        Command
            Without a window until two poses have agreed.
        """
        if tracker.pose is None:
            return Command(None, note="searching for the signal")
        if not tracker.confirmed:
            return Command(None, note="waiting for a second pose to agree")
        if self._waiting is not None and shot.windows != self._waiting.mechanical:
            return self._waiting  # a pause or a search came first, so that the magnet still has to be moved
        pose = tracker.pose_at(shot.end)
        window = None if self._sent is None else self._sent.window
        unplayed = isinstance(window, Actuate) and window not in shot.windows
        if unplayed and isinstance(self.controller, PlaybackAware):
            with report_plugin_errors("Controller", self.controller, "unplayed"):
                self.controller.unplayed()
        if tracker.learned and isinstance(self.controller, MotionAware):
            with report_plugin_errors("Controller", self.controller, "adopt_motion"):
                self.controller.adopt_motion(tracker.gains, tracker.drift)
        try:
            command = self._ask(pose)
        except OutsideTableError as error:
            before = self._sent if self._sent is not None else Command(None, phase="approach")
            command = replace(before, window=None, saturated=False, note=f"nothing is driven: {error}", event="")
        self._sent = command
        self._waiting = command if command.mechanical else None
        return command

    def _ask(self, pose: Pose) -> Command:
        """Ask the controller for its command, once it has begun the path."""
        if not self._begun:
            with report_plugin_errors("Controller", self.controller, "reset"):
                self.controller.reset(self.path, pose)
            self._begun = True
        with report_plugin_errors("Controller", self.controller, "command"):
            return check_command(self.controller.command(pose), self.controller)


def check_command(command: object, controller: object) -> Command:
    """Check that what a controller returned is a command that the loop can carry out and record.

    Parameters
    ----------
    command : object
    controller : Controller
        Named in the message.

    Returns
    -------
    Command
        As given.

    Raises
    ------
    PluginError
        If it is no `Command`, has other windows than a command may have, or a progress that is no finite number.
    """
    law = f"{type(controller).__module__}:{type(controller).__qualname__}"
    if not isinstance(command, Command):
        raise PluginError(f"Controller {law}: command() must return a Command; got {command!r}.")
    window = command.window
    mechanical = isinstance(window, tuple) and all(isinstance(part, Mechanical) for part in window)
    if not (window is None or mechanical or isinstance(window, Actuate | Rotate)):
        allowed = "an Actuate, a Rotate, a tuple of Rotate, MoveMagnet and Rest, or None"
        raise PluginError(f"Controller {law}: the window of a command must be {allowed}; got {window!r}.")
    if not isinstance(command.progress, Real) or not math.isfinite(command.progress):
        raise PluginError(
            f"Controller {law}: the progress of a command must be a length in m; got {command.progress!r}."
        )
    return command


class Watcher:
    """Pilot that steers nothing and ends after a fixed time.

    Parameters
    ----------
    duration : float, in s
        Counted from the first pose on.
    """

    def __init__(self, duration: float) -> None:
        self.duration = duration
        self._begun: float | None = None

    def command(self, shot: Shot, tracker: Tracker) -> Command:
        """Return an empty command; it is done when the time is over.

        Parameters
        ----------
        shot : Shot
            The shot that was played.
        tracker : Tracker

        Returns
        -------
        Command
        """
        if self._begun is None:
            if tracker.pose is None:
                return Command(None, note="searching for the signal")
            self._begun = shot.end
        watched = shot.end - self._begun
        if watched >= self.duration:
            return Command(None, note=f"watched for {watched:.0f} s", done=True)
        return Command(None)


class Measurer:
    """Pilot that steers nothing and ends after a number of independent measurements of a resting device.

    Parameters
    ----------
    tracker : SingleShotTracker
        Tracker that counts the measurements.
    required : int
        Number of measurements to make.
    """

    def __init__(self, tracker: SingleShotTracker, required: int) -> None:
        self.required = required
        self._tracker = tracker

    def command(self, shot: Shot, tracker: Tracker) -> Command:
        """Return an empty command; it is done when there are enough measurements.

        Parameters
        ----------
        shot : Shot
            The shot that was played.
        tracker : Tracker

        Returns
        -------
        Command
        """
        made = self._tracker.measurements
        return Command(None, note=f"{made} of {self.required} measurements", done=made >= self.required)
