"""The tracker: believes motion that windows cause, averages noise, gates outliers, survives gaps, begins anew."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from smolbot.core.pose import Pose
from smolbot.core.rotations import (
    compute_rotation_error,
    flip_orientation,
    multiply_quaternions,
    quaternion_from_axes,
    quaternion_from_rotation_vector,
)
from smolbot.core.shots import Actuate, Listen, RingDown, Shot
from smolbot.flight.tracking.tracker import Tracker
from smolbot.motion.gradient import advance
from tests.conftest import setup_of

known = partial(setup_of, "line")
UP = np.array([0.0, 0.0, 1.0])
SIGMA = np.array([2e-4] * 3 + [2e-2] * 3)
LISTEN = (RingDown(0.02), Listen(2, 103.5))


def tracker(*table) -> Tracker:
    """With the field table, or with what is given in its place."""
    here = known()
    return Tracker(here.robot, here.device, *(table or (here.table,)))


def pose(time, place_mm, heading=0.0, sigma=SIGMA, trusted=True) -> Pose:
    q = quaternion_from_axes(np.array([np.cos(heading), np.sin(heading), 0.0]), UP, "zy")
    return Pose(time, np.array([*place_mm, 60.0])[:3] * 1e-3, q, np.diag(sigma**2), trusted=trusted)


def quiet(start=0.0):
    return Shot(LISTEN, start=start)


def settled(count=5, place=(0.0, 0.0), dt=0.1) -> Tracker:
    track = tracker()
    for i in range(count):
        track.update(quiet(i * dt), pose(i * dt + 0.02, place))
    return track


def test_before_the_first_pose_there_is_no_track():
    track = tracker()
    assert track.pose is None
    assert not track.confirmed
    with pytest.raises(ValueError, match="no pose yet"):
        track.pose_at(1.0)
    assert track.update(quiet(), None) is None
    assert track.update(quiet(), pose(0.1, (0, 0), trusted=False)) is None
    assert track.misses == 2


def test_one_pose_begins_a_track_and_a_second_that_agrees_confirms_it():
    track = tracker()
    track.update(quiet(), pose(0.02, (1, 2)))
    assert track.pose.position[:2] == pytest.approx([1e-3, 2e-3])
    assert not track.confirmed
    track.update(quiet(0.1), pose(0.12, (1, 2)))
    assert track.confirmed
    assert track.misses == 0


@pytest.mark.parametrize("heading", [0.0, 0.6])
def test_a_window_moves_the_track_as_the_motion_model_does(heading):
    track = tracker()
    for i in range(6):
        track.update(quiet(0.1 * i), pose(0.1 * i + 0.02, (1.0, 0.5), heading))
    before, currents = track.pose, (8.0, 0.0, 4.0, 0.0)
    pull = Shot((Actuate(currents, 0.08), *LISTEN), start=1.0)
    after = track.update(pull, None)
    field, gradient = known().table.field_and_gradient(before.position[None, :])
    step, turned = advance(known().robot, field[:, 0], gradient[:, 0], np.array(currents), heading, 0.08)
    assert np.linalg.norm(step) > 5e-5
    assert after.position[:2] - before.position[:2] == pytest.approx(step, rel=1e-2, abs=1e-6)
    ahead = after.body_axis("z")
    assert np.arctan2(ahead[1], ahead[0]) == pytest.approx(turned, abs=1e-2)
    assert np.all(np.linalg.eigvalsh(after.covariance - before.covariance) > -1e-15)
    assert after.covariance[0, 0] > before.covariance[0, 0]


def test_a_robot_that_is_pulled_is_followed_more_closely_than_by_its_poses_alone():
    rng, track, errors, raw = np.random.default_rng(1), tracker(), [], []
    place, heading, clock = np.array([-4e-3, 0.0, 0.06]), 0.0, 0.0
    currents = (8.0, 0.0, 2.0, 0.0)
    for i in range(80):
        shot = Shot((Actuate(currents, 0.03), *LISTEN), start=clock)
        if i:
            field, gradient = known().table.field_and_gradient(place[None, :])
            step, heading = advance(known().robot, field[:, 0], gradient[:, 0], np.array(currents), heading, 0.03)
            place = place + 1.1 * np.append(step, 0.0)  # 10 % less drag than assumed
        clock = shot.end
        noisy = pose(clock - 5e-3, (1e3 * place + rng.normal(0, 0.2, 3))[:2], heading + rng.normal(0, 0.02))
        track.update(shot if i else quiet(), noisy)
        if i > 5:
            errors.append(track.pose.position[:2] - place[:2])
            raw.append(noisy.position[:2] - place[:2])
    assert np.std(raw) == pytest.approx(2e-4, rel=0.2)
    assert np.sqrt(np.mean(np.square(errors))) < 0.6 * np.sqrt(np.mean(np.square(raw)))
    assert place[0] > -3e-3  # it did move


def test_averaging_reduces_noise_on_a_resting_robot_as_much_as_the_covariance_does():
    track, rng, errors, claimed = tracker(), np.random.default_rng(2), [], []
    for i in range(400):
        found = pose(0.1 * i + 0.02, rng.normal(0, 0.2, 2))
        track.update(quiet(0.1 * i), found)
        if i > 50:
            errors.append(track.pose.position[:2])
            claimed.append(np.sqrt(track.pose.covariance[0, 0]))
    assert np.sqrt(np.mean(np.square(errors))) < 0.5 * 2e-4
    assert np.sqrt(np.mean(np.square(errors))) < 1.5 * np.mean(claimed)


def test_an_outlier_is_gated_and_moves_nothing():
    track = settled()
    before = track.pose.position.copy()
    track.update(quiet(1.0), pose(1.02, (15.0, -10.0)))
    assert track.pose.position == pytest.approx(before, abs=1e-12)
    assert not track.pose.trusted
    assert track.misses == 1
    track.update(quiet(1.1), pose(1.12, (0, 0)))
    assert track.misses == 0
    assert track.pose.trusted


def test_missed_windows_are_survived_while_uncertainty_grows():
    track = settled()
    before = track.pose
    for i in range(5):
        track.update(quiet(1.0 + 0.1 * i), None)
    assert track.misses == 5
    assert track.pose.position == pytest.approx(before.position, abs=1e-12)
    assert np.all(np.diag(track.pose.covariance) > np.diag(before.covariance))
    track.update(quiet(2.0), pose(2.02, (0.1, 0)))
    assert track.misses == 0


def test_outliers_that_agree_with_each_other_restart_the_track():
    track = settled()
    for i in range(6):
        track.update(quiet(1.0 + 0.1 * i), pose(1.02 + 0.1 * i, (12.0, 9.0)))
        if track.misses == 0:
            break
    assert 2 <= i < 5
    assert track.pose.position[:2] == pytest.approx([12e-3, 9e-3], abs=1e-4)
    assert not track.confirmed  # it has to agree once more before anything is driven
    track.update(quiet(2.0), pose(2.02, (12.0, 9.0)))
    assert track.confirmed


def test_outliers_that_disagree_with_each_other_never_restart_the_track():
    track, rng = settled(), np.random.default_rng(3)
    for i in range(12):
        track.update(quiet(1.0 + 0.1 * i), pose(1.02 + 0.1 * i, rng.choice([-1, 1], 2) * (8 + 3 * (i % 4))))
    assert track.misses == 12
    assert np.linalg.norm(track.pose.position[:2]) < 1e-4


def scattered(track, rng, times, worse) -> tuple[float, int]:
    """Mean squared error of a resting robot's track, in claimed variances, and misses; its poses are `worse` times
    further off than they claim."""
    squares, misses, rest = [], 0, pose(0.0, (0, 0))
    for time in times:
        off = worse * SIGMA * rng.standard_normal(6)
        turned = multiply_quaternions(quaternion_from_rotation_vector(off[3:]), rest.orientation)
        seen = replace(rest, time=time + 0.02, position=rest.position + off[:3], orientation=turned)
        track.update(quiet(time), seen)
        misses += track.misses > 0
        error = [
            *track.pose.position - rest.position,
            *compute_rotation_error(track.pose.orientation, rest.orientation),
        ]
        squares.append(error @ np.linalg.solve(track.pose.covariance, error) / 6.0)
    return float(np.mean(squares[60:])), misses


@pytest.mark.parametrize("worse", [1.0, 2.0, 3.0])
def test_poses_that_are_worse_than_their_covariance_weigh_less_until_they_are_better_again(worse):
    """Noise that a fit cannot see in its own residuals, such as the mains line, is seen in how poses scatter."""
    rng, track = np.random.default_rng(5), tracker()
    error, misses = scattered(track, rng, 0.1 * np.arange(300), worse)
    assert error < 1.5
    assert misses < 0.05 * 300
    scattered(track, rng, 0.1 * np.arange(300, 500), 1.0)
    honest = tracker()
    scattered(honest, rng, 0.1 * np.arange(500), 1.0)
    assert np.diag(track.pose.covariance) == pytest.approx(np.diag(honest.pose.covariance), rel=0.1)


@pytest.mark.parametrize(("degrees", "duration"), [(60.0, 0.03), (90.0, 0.05), (90.0, 0.09)])
@pytest.mark.parametrize("off", [0.3, 0.6, -0.6])
def test_a_robot_that_turns_less_or_more_than_predicted_is_uncertain_by_that_and_no_outlier(degrees, duration, off):
    """Drag and gain are known to three tenths: that much of the predicted turn is one standard deviation."""
    track, heading, currents = tracker(), np.radians(degrees), (8.0, 0.0, 0.0, 0.0)
    for i in range(6):
        track.update(quiet(0.1 * i), pose(0.1 * i + 0.02, (0, 0), heading))
    field, gradient = known().table.field_and_gradient(track.pose.position[None, :])
    step, turned = advance(known().robot, field[:, 0], gradient[:, 0], np.array(currents), heading, duration)
    pull = Shot((Actuate(currents, duration), *LISTEN), start=0.6)
    predicted = track.update(pull, None)
    error = off * (turned - heading)
    assert abs(error) / np.sqrt(predicted.covariance[5, 5]) == pytest.approx(abs(off) / 0.3, rel=0.05)
    seen = pose(pull.end, 1e3 * step, turned + error)
    track.update(Shot(LISTEN, start=pull.end), replace(seen, time=pull.end + 0.02))
    assert track.misses == 0
    assert np.linalg.norm(compute_rotation_error(track.pose.orientation, seen.orientation)) < 0.15 * abs(error)


def test_carrying_a_pose_on_in_time_moves_nothing_and_forgets_a_little():
    track = settled()
    now = track.pose
    later = track.pose_at(now.time + 2.0)
    assert later.time == pytest.approx(now.time + 2.0)
    assert np.array_equal(later.position, now.position)
    assert np.array_equal(later.orientation, now.orientation)
    assert np.all(np.diag(later.covariance) > np.diag(now.covariance))
    assert track.pose.time == now.time  # asking changes nothing


def test_without_a_table_windows_are_assumed_to_cause_no_motion():
    track = tracker(None)
    for i in range(4):
        track.update(quiet(0.1 * i), pose(0.1 * i + 0.02, (1.0, 0.5)))
    before = track.pose.position.copy()
    track.update(Shot((Actuate((8.0, 0, 0, 0), 0.08), *LISTEN), start=1.0), None)
    assert np.array_equal(track.pose.position, before)


def test_the_track_stays_a_valid_pose_whatever_is_measured():
    track, rng = tracker(), np.random.default_rng(4)
    for i in range(300):
        found = pose(0.1 * i + 0.02, rng.normal(0, 3, 2), rng.uniform(-np.pi, np.pi))
        track.update(quiet(0.1 * i), replace(found, trusted=bool(rng.random() < 0.8)) if rng.random() < 0.9 else None)
        if track.pose is not None:
            assert np.linalg.norm(track.pose.orientation) == pytest.approx(1.0)
            assert np.all(np.linalg.eigvalsh(track.pose.covariance) > 0)


def test_a_robot_that_turned_unmeasured_is_tracked_again_although_it_is_found_flipped():
    track = settled()
    for i in range(5, 12):  # found without a prior, either orientation results
        seen = pose(0.1 * i + 0.02, (1.0, 0.5), heading=2.0)
        seen = replace(seen, orientation=flip_orientation(seen.orientation)) if i % 2 else seen
        track.update(quiet(0.1 * i), seen)
    assert track.misses == 0
    assert track.pose.position[:2] == pytest.approx([1e-3, 5e-4], abs=2e-4)


def test_a_robot_that_points_against_the_field_may_turn_either_way():
    window = Actuate((8.0, 0.0, 0.0, 0.0), 0.09)  # field along +x
    spread = {}
    for degrees in (10.0, 179.0):
        track = tracker()
        for i in range(5):
            track.update(quiet(0.1 * i), pose(0.1 * i + 0.02, (0, 0), heading=np.radians(degrees)))
        track.update(Shot((window, *LISTEN), start=0.5), None)
        spread[degrees] = np.degrees(np.sqrt(track.pose.covariance[5, 5]))
        seen = pose(0.65, (0, 0), heading=np.radians(-140.0))  # it went the other way than predicted
        if degrees == 179.0:
            track.update(quiet(0.6), seen)
            assert track.misses == 0
    assert spread[179.0] > 20.0
    assert spread[10.0] < 8.0
