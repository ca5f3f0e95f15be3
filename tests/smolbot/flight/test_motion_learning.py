"""Robots that do not move as assumed: what the tracker learns of them, and what the law does with it."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from controllers.predictive import Predictive
from smolbot.core.pose import Pose
from smolbot.core.rotations import quaternion_from_axes
from smolbot.core.shots import Actuate, Listen, RingDown, Shot
from smolbot.flight.session import run
from smolbot.flight.tracking.motion_learning import MotionLearningTracker
from smolbot.flight.tracking.multiple_models import MultipleModelTracker
from smolbot.flight.tracking.tracker import Tracker
from smolbot.motion.gradient import advance
from smolbot.paths.curve import Curve
from tests.conftest import setup_of

known = partial(setup_of, "line")
UP = np.array([0.0, 0.0, 1.0])
NOISE = np.array([2e-4] * 3 + [2e-2] * 3)
WINDOW = 0.06
PULLS = [(8.0, 0.0, 2.0, 0.0), (0.0, 0.0, 8.0, 3.0), (0.0, 8.0, 2.0, 0.0), (2.0, 0.0, 0.0, 8.0)]


class TrueRobot:
    """A robot that moves with other coil gains than assumed, in a liquid that flows; its poses are noisy."""

    def __init__(self, gains=(1.0, 1.0, 1.0, 1.0), drift=(0.0, 0.0), seed=1):
        self.gains, self.drift = np.array(gains), np.array([*drift, 0.0])
        self.place, self.heading, self.clock = np.array([-1e-3, -1e-3, 0.06]), 0.3, 0.0
        self.rng = np.random.default_rng(seed)

    def play(self, currents):
        shot = Shot((Actuate(currents, WINDOW), RingDown(0.02), Listen(2, 103.5)), start=self.clock)
        field, gradient = known().table.field_and_gradient(self.place[None, :])
        pulled = self.gains * np.array(currents)
        step, self.heading = advance(known().robot, field[:, 0], gradient[:, 0], pulled, self.heading, WINDOW)
        self.place = self.place + np.append(step, 0.0) + (shot.end - self.clock) * self.drift
        self.clock = shot.end
        off = NOISE * self.rng.standard_normal(6)
        heading = self.heading + off[5]
        q = quaternion_from_axes(np.array([np.cos(heading), np.sin(heading), 0.0]), UP, "zy")
        return shot, Pose(self.clock, self.place + off[:3], q, np.diag(NOISE**2), trusted=True)

    def track(self, *trackers, cycles=120):
        """Errors (cycles, 1 + n) in the plane of located and tracked poses, and the shots until each doubts."""
        errors, doubted = [], [None] * len(trackers)
        for i in range(cycles):
            shot, pose = self.play(PULLS[(i // 6) % len(PULLS)])
            places = [pose.position]
            for n, tracker in enumerate(trackers):
                tracker.update(shot, pose)
                doubted[n] = i if doubted[n] is None and tracker.learned else doubted[n]
                places.append(tracker.pose.position)
            errors.append([np.linalg.norm((place - self.place)[:2]) for place in places])
        return np.array(errors), doubted


def trackers():
    here = known()
    parts = here.robot, here.device, here.table
    return Tracker(*parts), MultipleModelTracker(*parts)


@pytest.mark.parametrize(
    ("gains", "drift"),
    [
        ((2.0, 2.0, 2.0, 2.0), (0.0, 0.0)),  # half the drag
        ((0.5, 0.5, 0.5, 0.5), (0.0, 0.0)),  # twice the drag
        ((1.0, 1.0, 1.0, 1.0), (6e-4, -4e-4)),  # the liquid flows
    ],
)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_robot_that_moves_otherwise_is_soon_tracked_better_than_by_its_poses_alone(gains, drift, seed):
    assuming, models = trackers()
    errors, (_, doubted) = TrueRobot(gains, drift, seed).track(assuming, models)
    assert doubted is not None
    assert doubted < 70  # 6 s: a flow takes longest, since a tracker without gains learns a drift, too
    raw, believing, learning = np.mean(errors[10:], axis=0)
    assert learning < 0.95 * raw
    assert learning < believing
    assert models.gains == pytest.approx(np.array(gains), abs=0.35)
    assert models.drift[:2] == pytest.approx(np.array(drift), abs=2.5e-4)


def test_a_robot_that_moves_as_assumed_is_tracked_as_if_nothing_could_be_learned():
    assuming, models = trackers()
    robot = TrueRobot()
    for i in range(80):
        shot, pose = robot.play(PULLS[(i // 6) % len(PULLS)])
        assuming.update(shot, pose)
        models.update(shot, pose)
        for name in ("position", "orientation", "covariance"):
            assert np.array_equal(getattr(assuming.pose, name), getattr(models.pose, name))
        assert models.pose_at(shot.end + 0.1).position == pytest.approx(
            assuming.pose_at(shot.end + 0.1).position, abs=0
        )
        assert models.misses == assuming.misses
        if i > 0:
            assert np.array_equal(models.motion[0], assuming.motion[0])
    assert not models.learned
    assert np.all(models.gains == 1.0)


@pytest.mark.parametrize("left", [0.4, 0.0])
def test_a_coil_that_loses_its_current_in_flight_is_noticed(left):
    _, models = trackers()
    robot = TrueRobot()
    robot.track(models, cycles=60)
    assert not models.learned
    robot.gains = np.array([left, 1.0, 1.0, 1.0])
    errors, (doubted,) = robot.track(models, cycles=120)
    assert doubted is not None
    raw, learning = np.mean(errors[doubted:], axis=0)
    assert learning < 0.9 * raw
    assert models.gains[0] < 0.8
    assert np.all(models.gains[1:] > 0.75)


def test_what_was_learned_outlives_a_track_that_begins_again():
    here = known()
    learning = MotionLearningTracker(here.robot, here.device, here.table)
    robot = TrueRobot((2.0, 2.0, 2.0, 2.0))
    robot.track(learning, cycles=40)
    before = learning.gains
    for _ in range(5):  # it jumps, and is seen where it is
        shot, pose = robot.play((0.0, 0.0, 0.0, 0.0))
        away = pose.position + np.array([6e-3, 0.0, 0.0])
        learning.update(shot, Pose(pose.time, away, pose.orientation, pose.covariance, trusted=True))
    assert learning.pose.position == pytest.approx(away, abs=1e-3)
    assert learning.gains == pytest.approx(before, abs=0.3)


def test_shots_without_a_trusted_pose_are_no_evidence():
    assuming, _ = trackers()
    robot = TrueRobot()
    robot.track(assuming, cycles=5)
    assert np.isfinite(assuming.compute_log_likelihood())
    shot, _ = robot.play(PULLS[0])
    assuming.update(shot, None)
    assert np.isnan(assuming.compute_log_likelihood())


def test_the_law_plans_with_adopted_gains_and_drift():
    """A coil that is known to be dead is not driven, and a robot that drifts is held against it."""
    here = setup_of("r_path")
    path = Curve(np.array([[-2e-3, 0.0, 0.06], [3e-3, 0.0, 0.06]]))
    start = Pose(0.0, path.points[0], quaternion_from_axes(np.array([1.0, 0, 0]), UP, "zy"), np.zeros((6, 6)))

    def command(gains, drift):
        law = Predictive(here, {})
        law.reset(path, start)
        if gains is not None:
            law.adopt_motion(np.array(gains), np.array([*drift, 0.0]))
        return np.array(law.command(start).window.currents)

    plain = command(None, None)
    assert command([1.0] * 4, (0.0, 0.0)) == pytest.approx(plain, abs=1e-9)
    assert plain[0] > 1.0
    assert command([0.0, 1.0, 1.0, 1.0], (0.0, 0.0))[0] < 0.05
    field, gradient = here.table.field_and_gradient(start.position[None, :])
    aside = [
        advance(here.robot, field[:, 0], gradient[:, 0], currents, 0.0, 0.09)[0][1]
        for currents in (plain, command([1.0] * 4, (0.0, 8e-4)))
    ]
    assert aside[1] < aside[0] - 2e-5


def test_a_flight_in_half_as_viscous_a_liquid_is_tracked_and_says_what_it_has_learned():
    flown = run(
        "r_path",
        seed=3,
        rig__tank__faults=["viscosity=0.5"],
        localization__quiet_s=3.0,
        stop__max_duration_s=6.0,
        force="preview",
    )
    (event,) = [event for event in flown.events if event.what == "motion model doubted"]
    assert event.time < 6.0
    assert np.mean(event.detail["coil_gains"]) > 1.25  # when it is noticed, they are not yet at 2
    assert flown.summary["tracking_error_mm"]["max"] < 1.0
