"""Keep a robot to the path's requested speed: limits how far the next window may move it."""

from __future__ import annotations

from smolbot.paths.speed_profile import SpeedProfile

MAX_CATCH_UP = 1.5
"""Greatest speed requested of a late robot, as a multiple of the planned speed."""

MAX_DELAY = 5.0
"""Greatest delay, in s: the set-point waits for a robot that is further behind; time lost before is not made up for."""

MIN_STRIDE = 0.1e-3
"""Steps of less than this, in m, drown in the noise of poses; slow robots stand still for a cycle instead."""


class Pace:
    """Moving set-point along the path, and the distance from the robot to it.

    The set-point moves with time, so that windows and listening, turns at corners and failed windows are
    included.

    Parameters
    ----------
    profile : SpeedProfile
    period : float, in s
        Of a cycle: one window, and listening.
    """

    def __init__(self, profile: SpeedProfile, period: float) -> None:
        self._profile = profile
        self._period = period
        self._set_point = 0.0
        self._time: float | None = None

    def compute_stride(self, time: float, s: float) -> float:
        """Compute the arc length by which the next window should move the robot.

        Parameters
        ----------
        time : float, in s
            When the window begins.
        s : float, in m
            Present arc length of the robot.

        Returns
        -------
        float, in m
            0 where the robot is ahead of the requested speed.
        """
        profile = self._profile
        since = 0.0 if self._time is None else max(time - self._time, 0.0)
        self._time = time
        self._set_point = profile.after(self._set_point, since)
        self._set_point = min(self._set_point, profile.after(s, MAX_DELAY))
        missing = profile.after(self._set_point, self._period) - s
        if missing < MIN_STRIDE and s + MIN_STRIDE < profile.arc[-1]:
            return 0.0
        longest = min(max(self._period, since), 2.0 * self._period)
        return max(min(missing, profile.after(s, MAX_CATCH_UP * longest) - s), MIN_STRIDE)
