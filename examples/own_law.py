"""A law of one's own, flown: it pulls toward a point ahead on the path, along the true force of the coils."""

from contextlib import closing
from typing import ClassVar

import numpy as np

import smolbot
from controllers import ForceAllocator, UnreachableForceError
from smolbot import Actuate, Command, Gain
from smolbot.flight import make_loop, open_rig


class Tug:
    """Pull toward a point ahead, with a force of 100 µN."""

    gains: ClassVar = {"ahead_mm": Gain(1.0, 0.3, 6.0, meaning="how far ahead the point lies")}

    def __init__(self, setup, gains):
        self.setup, self.ahead = setup, 1e-3 * gains.get("ahead_mm", self.gains["ahead_mm"].default)
        self.coils = ForceAllocator(setup.table, setup.limits.max_current, setup.robot.moment, least_field=1.5e-3)

    def reset(self, path, pose):
        """Start a path."""
        self.path, self.phase, self.arc = path, "approach", 0.0  # first to the path's start

    def command(self, pose):
        """Compute the currents of the next window."""
        # search for the nearest place no farther ahead than it can have come in one cycle: a path may cross itself
        places = np.linspace(self.arc, min(self.arc + 1e-3, self.path.length), 21)
        off = np.linalg.norm((self.path.at(places) - pose.position)[:, :2], axis=1)
        if off.min() < self.setup.tolerance:
            self.phase = "follow"
        if self.phase == "follow":
            self.arc = float(places[np.argmin(off)])
        if self.path.length - self.arc < self.setup.tolerance:
            return Command(None, note="path's end reached", progress=self.path.length, done=True)
        goal = self.path.at(self.arc + self.ahead if self.phase == "follow" else 0.0)
        way = (goal - pose.position) * [1.0, 1.0, 0.0]
        try:
            currents = self.coils.currents(pose.position, way, 100e-6)  # N
        except UnreachableForceError as error:  # nothing pulls there: report it, and only record in this cycle
            return Command(None, saturated=True, note=str(error), progress=self.arc, phase=self.phase)
        return Command(Actuate(tuple(currents), 0.06), progress=self.arc, phase=self.phase)


mission = smolbot.load_mission("line")
law = Tug(mission.setup(), {"ahead_mm": 1.5})
with closing(open_rig(mission, seed=3)) as rig, make_loop(rig, mission, controller=law) as loop:
    while not loop.done:
        record = loop.step()
run = loop.run
print(f"{run.status}: {run.stop_reason}, {1e3 * record.command.progress:.1f} mm in {len(run.cycles)} cycles")
