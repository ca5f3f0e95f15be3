"""Two trackers side by side: one trusts the assumed motion model, the other learns it; the likelier one is used."""

from __future__ import annotations

import math

from lookup_tables import FieldTable
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.sensing import Device
from smolbot.core.shots import Shot
from smolbot.flight.tracking.motion_learning import MotionLearningTracker
from smolbot.flight.tracking.tracker import Tracker
from smolbot.localization.estimator import Oscillation
from smolbot.motion.robot import Robot

EVIDENCE_KEPT = 0.95
"""Share of the evidence that is kept from one pose to the next: about twenty poses count."""

MAX_EVIDENCE_PER_POSE = 6.0
"""Largest log-likelihood ratio of one pose, so that no outlier decides alone."""

SWITCH_EVIDENCE = 14.0
"""Log-likelihood ratio at which the assumed model is given up: odds of a million to 1. No more than this ever counts in
favour of the assumed model, so that a change is noticed soon after a long flight without one."""


class MultipleModelTracker(Tracker):
    """A tracker with two motion models (static multiple-model estimation).

    Both predict every pose before it is used. The evidence is the sum of their log-likelihood ratios, in which old
    poses count less and less::

        e <- kept e + (l_learning - l_assuming),   l = -(d^2 + ln |S|) / 2

    with the squared Mahalanobis distance d^2 of a pose and the covariance S of the innovation. A robot that moves as
    assumed is tracked by the assumed model. Where its drag, a coil or the liquid's flow differ, the learning tracker
    predicts better within some poses, or has learned surely that they do; it is then used until the end, since it can
    learn to move as assumed, too.

    Parameters
    ----------
    robot : Robot
    device : Device
    table : FieldTable
    """

    def __init__(self, robot: Robot, device: Device, table: FieldTable) -> None:
        self._assuming, self._learning = Tracker(robot, device, table), MotionLearningTracker(robot, device, table)
        self._used: Tracker = self._assuming
        self._evidence = 0.0
        self.motion, self.misses = None, 0

    def update(self, shot: Shot, pose: Pose | None, swing: Oscillation | None = None) -> Pose | None:
        """Update both trackers while the assumed model holds, and choose the one to use.

        Parameters
        ----------
        shot : Shot
            The shot that was played.
        pose : Pose or None
            As located in the shot's recording.
        swing : Oscillation, optional
            Amplitude that was estimated with the pose.

        Returns
        -------
        Pose or None
            As `Tracker.update` returns it.
        """
        self._learning.update(shot, pose, swing)
        if not self.learned:
            self._assuming.update(shot, pose, swing)
            self._weigh()
        self.motion, self.misses = self._used.motion, self._used.misses
        return self._used.pose

    def _weigh(self) -> None:
        """Add the evidence of the last pose, and give the assumed model up if it does not hold."""
        ratio = self._learning.compute_log_likelihood() - self._assuming.compute_log_likelihood()
        if math.isfinite(ratio):
            ratio = min(max(ratio, -MAX_EVIDENCE_PER_POSE), MAX_EVIDENCE_PER_POSE)
            self._evidence = max(EVIDENCE_KEPT * self._evidence + ratio, -SWITCH_EVIDENCE)
        if self._evidence > SWITCH_EVIDENCE or self._learning.deviates:
            self._used = self._learning

    def pose_at(self, time: float) -> Pose:
        """Predict the tracked pose at a time, with nothing driven in between.

        Parameters
        ----------
        time : float, in s
            On the rig's clock.

        Returns
        -------
        Pose

        Raises
        ------
        ValueError
            Before the first pose.
        """
        return self._used.pose_at(time)

    @property
    def pose(self) -> Pose | None:
        """The tracked pose as of the last update; None before the first."""
        return self._used.pose

    @property
    def orientation_uncertain(self) -> bool:
        """True if the orientation is too uncertain to start a fit from."""
        return self._used.orientation_uncertain

    @property
    def confirmed(self) -> bool:
        """True once two poses have agreed."""
        return self._used.confirmed

    @property
    def amplitude(self) -> tuple[float, float] | None:
        """Amplitude at the end of a drive and its standard deviation, in rad; None before it was measured."""
        return self._used.amplitude

    @property
    def drift(self) -> FloatArray:
        """Steady velocity (3,), in m/s, in the world frame, that is not caused by windows."""
        return self._used.drift

    @property
    def gains(self) -> FloatArray:
        """Factors (n_coils,) on the currents, as learned; 1 while the assumed model is used."""
        return self._used.gains

    @property
    def learned(self) -> bool:
        """True once the assumed model was given up."""
        return self._used.learned
