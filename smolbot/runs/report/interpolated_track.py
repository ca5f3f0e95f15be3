"""Where a robot was at any time: poses joined by lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.shots import Rotate
from smolbot.runs.trace import Moment


@dataclass(frozen=True)
class Track:
    """Places (n, 3) in m and headings (n, 2) at times (n,) in s."""

    times: FloatArray
    places: FloatArray
    headings: FloatArray

    @classmethod
    def of(cls, poses: list[Pose], body_axis: FloatArray) -> Track:
        """Of poses in order; a heading is the horizontal part of a direction in the body."""
        ordered = sorted(poses, key=lambda pose: pose.time)
        ahead = np.array([(p.rotation @ body_axis)[:2] for p in ordered]).reshape(-1, 2)
        places = np.array([p.position for p in ordered]).reshape(-1, 3)
        return cls(np.array([p.time for p in ordered]), places, ahead)

    def through(self, times: FloatArray, places: FloatArray) -> Track:
        """The same, through further places (n, 3) at `times` (n,), headings between those that are known."""
        if not len(times) or not len(self.times):
            return self
        headings = np.column_stack([np.interp(times, self.times, column) for column in self.headings.T])
        order = np.argsort(np.concatenate([self.times, times]), kind="stable")
        return Track(
            np.concatenate([self.times, times])[order],
            np.vstack([self.places, places])[order],
            np.vstack([self.headings, headings])[order],
        )

    def at(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Place and heading at `time` s, between poses joined by lines; both nan without any pose."""
        if not len(self.times):
            return np.full(3, np.nan), np.full(2, np.nan)
        values = np.column_stack([self.places, self.headings])
        found = np.array([np.interp(time, self.times, column) for column in values.T])
        return found[:3], found[3:]


def ways(moments: list[Moment]) -> tuple[FloatArray, FloatArray]:
    """Times (n,) and places (n, 3) on the way while a magnet turns, spread evenly: only where it moved is recorded."""
    times, places = [np.zeros(0)], [np.zeros((0, 3))]
    for moment in moments:
        shot = moment.cycle.shot
        turns = [(at, at + w.duration) for at, w in shot.timed() if isinstance(w, Rotate)]
        if turns and len(moment.way):
            times.append(shot.start + np.linspace(turns[0][0], turns[-1][1], len(moment.way)))
            places.append(moment.way)
    return np.concatenate(times), np.vstack(places)
