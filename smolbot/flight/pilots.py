"""Who decides between two shots: a pilot turns what the tracker believes into the next command."""

from __future__ import annotations

from typing import Protocol

from smolbot.core.shots import Actuate, Shot
from smolbot.flight.tracking.passive_trackers import Glimpse
from smolbot.flight.tracking.tracker import Tracker
from smolbot.motion.controller import Command, Controller, PlaybackAware
from smolbot.paths.curve import Curve


class Pilot(Protocol):
    """Asked once a cycle. A command that is done ends the mission; its note says why."""

    def command(self, shot: Shot, tracker: Tracker) -> Command:
        """What to do next, after `shot` was played and the tracker has heard of it."""


class Follower:
    """Lets a controller follow a path from the moment that two poses have agreed.

    One that is `PlaybackAware` is told when its last command was not played.
    """

    def __init__(self, path: Curve, controller: Controller) -> None:
        self.path = path
        self.controller = controller
        self._begun = False
        self._waiting: Command | None = None
        self._sent: Command | None = None

    def command(self, shot: Shot, tracker: Tracker) -> Command:
        """The controller's command for the pose that is expected at the end of the shot."""
        if tracker.pose is None:
            return Command(None, note="searching for the signal")
        if not tracker.confirmed:
            return Command(None, note="waiting for a second pose to agree")
        held_back = self._waiting is not None and shot.windows != self._waiting.mechanical
        if self._waiting is not None and held_back:
            return self._waiting  # the magnet was not moved while the loop was held, or searched: it still has to be
        pose = tracker.pose_at(shot.end)
        if not self._begun:
            self.controller.reset(self.path, pose)
            self._begun = True
        window = None if self._sent is None else self._sent.window
        unplayed = isinstance(window, Actuate) and window not in shot.windows
        if unplayed and isinstance(self.controller, PlaybackAware):
            self.controller.unplayed()
        command = self._sent = self.controller.command(pose)
        self._waiting = command if command.mechanical else None
        return command


class Watcher:
    """Steers nothing: watches for `duration` s from the first pose on."""

    def __init__(self, duration: float) -> None:
        self.duration = duration
        self._begun: float | None = None

    def command(self, shot: Shot, tracker: Tracker) -> Command:
        """Nothing, until the time is over."""
        if self._begun is None:
            if tracker.pose is None:
                return Command(None, note="searching for the signal")
            self._begun = shot.end
        watched = shot.end - self._begun
        if watched >= self.duration:
            return Command(None, note=f"watched for {watched:.0f} s", done=True)
        return Command(None)


class Measurer:
    """Steers nothing: has a resting device measured `wanted` times."""

    def __init__(self, glimpse: Glimpse, wanted: int) -> None:
        self.wanted = wanted
        self._glimpse = glimpse

    def command(self, shot: Shot, tracker: Tracker) -> Command:
        """Nothing, until there are enough measurements."""
        made = self._glimpse.measured
        return Command(None, note=f"{made} of {self.wanted} measurements", done=made >= self.wanted)
