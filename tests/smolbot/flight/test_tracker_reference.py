"""The tracker against a textbook's filter in plain matrices, and its doubts against worlds drawn as it believes."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from smolbot.core.pose import Pose
from smolbot.core.rotations import quaternion_from_axes
from smolbot.core.sensing import Device
from smolbot.core.shots import Actuate, Listen, MoveMagnet, RingDown, Rotate, Shot
from smolbot.flight.tracking import tracker as tracker_module
from smolbot.flight.tracking.tracker import Tracker
from smolbot.localization.synthetic import SyntheticSwing
from smolbot.motion.helix import Helix

UP = np.array([0.0, 0.0, 1.0])
DEVICE = Device(0.89e-3, np.array([1.0, 0.0, 0.0]), 1.5e-3, 0.31, 103.5, 31.7, "exponential")
SIGMA = np.array([2e-4, 1e-4, 3e-4, 2e-2, 1e-2, 3e-2])
JOINT = np.array([*SIGMA, 0.05 * DEVICE.theta_max])
LISTENING = Shot((RingDown(0.02), Listen(2, 103.5)))
FIRST = (2e-4, 2e-2)  # m and rad that a first pose may be off by, beyond twice of what it claims


def scalar_first(turn: Rotation) -> np.ndarray:
    return turn.as_quat(scalar_first=True)


def a_pose(time, position, turn, sigma=SIGMA, **more):
    return Pose(time, np.asarray(position), scalar_first(turn), np.diag(np.square(sigma)), **more)


class Textbook:
    """x = (position, rotation, amplitude, drift), P' = F P F^T + Q, K = P H^T (H P H^T + R)^-1."""

    def __init__(self, first: Pose) -> None:
        self.time, self.position = first.time, first.position
        self.turn = Rotation.from_quat(first.orientation, scalar_first=True)
        self.amplitude, self.drift, self.surprise = 0.75, np.zeros(3), 1.0
        self.P = np.zeros((10, 10))
        self.P[:6, :6] = 4.0 * first.covariance + np.diag(np.repeat(FIRST, 3) ** 2)
        self.P[6, 6], self.P[7:, 7:] = 0.3**2, tracker_module.DRIFT_START_STD**2 * np.eye(3)

    def predict(self, time: float) -> None:
        wait, F = time - self.time, np.eye(10)
        F[:3, 7:] = wait * np.eye(3)
        Q = np.zeros(10)
        Q[:6], Q[6], Q[7:] = (
            tracker_module.PROCESS_NOISE_DENSITY**2 * wait,
            tracker_module.AMPLITUDE_STD**2,
            tracker_module.DRIFT_NOISE_DENSITY**2 * wait,
        )
        self.P, self.time = F @ self.P @ F.T + np.diag(Q), time
        self.position = self.position + wait * self.drift

    def correct(self, position, turn, amplitude, R) -> float:
        m = 6 if amplitude is None else 7
        H, floor = np.eye(10)[:m], np.diag(tracker_module.MODEL_FLOOR[:m] ** 2)
        scale = np.diag([1.0] * 6 + [1.0 / DEVICE.theta_max])[:m, :m]
        z = [*position - self.position, *(turn * self.turn.inv()).as_rotvec()]
        z += [] if amplitude is None else [amplitude / DEVICE.theta_max - self.amplitude]
        S = H @ self.P @ H.T + self.surprise * scale @ R @ scale + floor
        distance = float(np.array(z) @ np.linalg.solve(S, z))
        if distance > chi2.isf(1e-5, m):
            return distance
        change = self.P @ H.T @ np.linalg.solve(S, z)
        self.P = self.P - self.P @ H.T @ np.linalg.solve(S, H @ self.P)
        self.position, self.amplitude = self.position + change[:3], self.amplitude + change[6]
        self.turn, self.drift = Rotation.from_rotvec(change[3:6]) * self.turn, self.drift + change[7:]
        self.surprise = min(max(self.surprise * (0.95 + 0.05 * distance / m), 1.0), 25.0)
        return distance


@pytest.mark.parametrize("worse", [0.7, 2.0, 3.0])
@pytest.mark.parametrize("joint", [False, True])
def test_a_track_is_that_of_a_textbooks_filter(joint, worse):
    rng, turn = np.random.default_rng(3), Rotation.from_rotvec([0.3, -0.8, 1.9])
    mixing = 0.2 * rng.standard_normal((7, 7)) + np.eye(7)
    R = np.diag(JOINT) @ mixing @ mixing.T @ np.diag(JOINT)
    first = replace(a_pose(0.1, [1e-3, -2e-3, 0.06], turn), covariance=R[:6, :6])
    track, book = Tracker(None, DEVICE, None), Textbook(first)
    track.update(LISTENING, first)
    assert track.pose.covariance == pytest.approx(book.P[:6, :6])
    assert track.amplitude == pytest.approx((0.75 * DEVICE.theta_max, 0.3 * DEVICE.theta_max))
    missed, time = 0, 0.1
    for _ in range(40):
        time += rng.uniform(0.03, 1.0)
        off = worse * np.linalg.cholesky(R) @ rng.standard_normal(7)
        place, seen = first.position + off[:3], Rotation.from_rotvec(off[3:6]) * turn
        amplitude = 0.8 * DEVICE.theta_max + off[6] if joint else None
        pose = replace(a_pose(time, place, seen), covariance=R[:6, :6], r_squared=0.9, flip_margin=3.0)
        tracked = track.update(LISTENING, pose, SyntheticSwing(amplitude, R.copy()) if joint else None)
        book.predict(time)
        size = 7 if joint else 6
        far = book.correct(place, seen, amplitude, R[:size, :size]) > chi2.isf(1e-5, size)
        missed += far
        assert tracked.trusted == (not far)
        assert (tracked.time, tracked.r_squared, tracked.flip_margin) == (time, 0.9, 3.0)
        assert tracked.position == pytest.approx(book.position, abs=1e-9)
        assert abs(tracked.orientation @ scalar_first(book.turn)) == pytest.approx(1.0, abs=1e-12)
        assert tracked.covariance == pytest.approx(book.P[:6, :6], rel=1e-6, abs=1e-15)
        assert track.drift == pytest.approx(book.drift, abs=1e-9)
        assert track.amplitude[0] == pytest.approx(book.amplitude * DEVICE.theta_max, rel=1e-6)
        assert track.amplitude[1] == pytest.approx(np.sqrt(book.P[6, 6]) * DEVICE.theta_max, rel=1e-6)
    assert missed < 20
    ahead = track.pose_at(time + 0.7)
    assert ahead.position == pytest.approx(book.position + 0.7 * book.drift, abs=1e-9)
    assert ahead.covariance == pytest.approx(
        book.P[:6, :6] + np.diag(tracker_module.PROCESS_NOISE_DENSITY**2 * 0.7), rel=1e-6, abs=1e-15
    )
    assert track.pose_at(time - 5.0).position == pytest.approx(book.position, abs=1e-9)  # there is no way back


def test_poses_that_are_far_worse_than_they_claim_are_never_doubted_more_than_25_fold():
    """Fed with poses just short of an outlier, on alternating sides."""
    turn = Rotation.from_rotvec([0.3, -0.8, 1.9])
    first = a_pose(0.0, [0.0, 0.0, 0.06], turn)
    track, book = Tracker(None, DEVICE, None), Textbook(first)
    track.update(LISTENING, first)
    for i in range(60):
        S = book.P[:6, :6] + book.surprise * first.covariance + np.diag(tracker_module.MODEL_FLOOR[:6] ** 2)
        off = (-1) ** i * np.sqrt(0.95 * chi2.isf(1e-5, 6)) * np.linalg.cholesky(S)[:, i % 3]
        place, seen = book.position + off[:3], Rotation.from_rotvec(off[3:]) * book.turn
        track.update(LISTENING, a_pose(0.0, place, seen))
        book.predict(0.0)
        book.correct(place, seen, None, first.covariance)
        assert track.misses == 0
        assert track.pose.covariance == pytest.approx(book.P[:6, :6], rel=1e-6, abs=1e-15)
    assert book.surprise == 25.0


@pytest.mark.parametrize("joint", [False, True])
@pytest.mark.parametrize(("share", "outlier"), [(0.98, False), (1.02, True)])
def test_one_good_pose_in_a_hundred_thousand_is_rejected_as_an_outlier(joint, share, outlier):
    turn, size = Rotation.from_rotvec([0.3, -0.8, 1.9]), 7 if joint else 6
    first = a_pose(0.0, [0.0, 0.0, 0.06], turn)
    for direction in range(size):
        track, book = Tracker(None, DEVICE, None), Textbook(first)
        track.update(LISTENING, first)
        book.predict(0.0)
        scale = np.array([1.0] * 6 + [DEVICE.theta_max])[:size]
        S = book.P[:size, :size] + np.diag((JOINT[:size] / scale) ** 2 + tracker_module.MODEL_FLOOR[:size] ** 2)
        off = np.sqrt(share * chi2.isf(1e-5, size)) * np.linalg.cholesky(S)[:, direction]
        seen = a_pose(0.0, first.position + off[:3], Rotation.from_rotvec(off[3:6]) * turn)
        swing = SyntheticSwing((0.75 + off[-1]) * DEVICE.theta_max, np.diag(JOINT**2)) if joint else None
        track.update(LISTENING, seen, swing)
        assert track.misses == outlier
        assert track.pose.trusted != outlier
        assert track.confirmed != outlier


@dataclass(frozen=True)
class Nature:
    """How a robot at rest at a surface behaves, and what is left in its poses: per axis, in m, rad and shares."""

    wander: tuple[float, ...] = (5e-5, 5e-5, 3e-5, 2e-2, 2e-2, 2e-2)  # in the square root of a second
    misplaced: tuple[float, ...] = (5e-5, 5e-5, 5e-5, 4e-3, 4e-3, 4e-3, 2e-3)  # by sensors slightly out of place
    drift: float = 3e-5  # m/s at the start
    drift_change: float = 1e-5  # m/s in the square root of a second
    drive_change: float = 0.02  # share of the amplitude, from one shot to the next


def misses(pose, place, turn):
    """Squared errors of a pose over its claimed variances."""
    error = Rotation.from_quat(pose.orientation, scalar_first=True) * turn.inv()
    return np.square([*pose.position - place, *error.as_rotvec()]) / np.diag(pose.covariance)


def test_errors_of_tracks_are_as_large_as_claimed_in_every_entry():
    """Mean squares of errors over claimed variances are one, where rest, drift, drive and sensors are as believed."""
    rng, nature, sharp = np.random.default_rng(11), Nature(), JOINT / 10.0
    squares = {"early": [], "late": [], "foreseen": []}
    for _ in range(60):
        turn, place, drift = Rotation.random(rng=rng), np.array([0.0, 0.0, 0.06]), nature.drift * rng.standard_normal(3)
        share, track = 0.75 + 0.1 * rng.standard_normal(), Tracker(None, DEVICE, None)
        for i in range(25):
            wait = 0.25
            drift = drift + nature.drift_change * np.sqrt(wait) * rng.standard_normal(3)
            walk = np.array(nature.heading_noise) * np.sqrt(wait) * rng.standard_normal(6)
            place, turn = place + wait * drift + walk[:3], Rotation.from_rotvec(walk[3:]) * turn
            if i > 10:  # before it is heard
                squares["foreseen"].append([*misses(track.pose_at(wait * i), place, turn), 1.0])
            share += nature.drive_change * rng.standard_normal()
            off = np.hypot(sharp, np.array(nature.misplaced) * [1, 1, 1, 1, 1, 1, DEVICE.theta_max])
            off = off * rng.standard_normal(7)
            pose = a_pose(wait * i, place + off[:3], Rotation.from_rotvec(off[3:6]) * turn, sharp[:6])
            track.update(LISTENING, pose, SyntheticSwing(share * DEVICE.theta_max + off[6], np.diag(sharp**2)))
            if i in (2, 5, 16, 24):
                amplitude, sigma = track.amplitude
                squares["early" if i < 10 else "late"].append(
                    [*misses(track.pose, place, turn), ((amplitude - share * DEVICE.theta_max) / sigma) ** 2]
                )
    for when in squares.values():
        assert np.mean(when, axis=0) == pytest.approx([1.0] * 7, abs=0.35)


def test_amplitudes_are_those_of_the_swing_where_it_is_measured_well():
    track = Tracker(None, DEVICE, None)
    assert track.amplitude is None
    rest = a_pose(0.0, [0.0, 0.0, 0.06], Rotation.identity())
    for i in range(5):
        track.update(LISTENING, replace(rest, time=0.1 * i), SyntheticSwing(0.2, np.diag((JOINT / 100.0) ** 2)))
    value, sigma = track.amplitude
    assert value == pytest.approx(0.2, rel=0.01)
    assert sigma < 0.03 * 0.2


def outliers_at(places, turns=None):
    """A track of a robot that was found at rest, after poses elsewhere; turns in rad about the vertical."""
    track, rest = Tracker(None, DEVICE, None), Rotation.identity()
    for i in range(5):
        track.update(LISTENING, a_pose(0.1 * i, [0.0, 0.0, 0.06], rest))
    for i, place in enumerate(places):
        seen = Rotation.from_rotvec([0.0, 0.0, turns[i]]) if turns else rest
        track.update(LISTENING, a_pose(1.0 + 0.1 * i, [*place, 0.06], seen))
    return track


@pytest.mark.parametrize(("apart", "agree"), [(1.8e-3, True), (2.2e-3, False)])
def test_outliers_agree_within_two_millimetres(apart, agree):
    track = outliers_at([(0.012, 0.009), (0.012, -0.009), (0.012, -0.009 + apart)])
    assert (track.misses == 0) == agree
    assert not track.pose.trusted  # it has to agree once more


@pytest.mark.parametrize(("degrees", "agree"), [(24.0, True), (27.0, False)])
def test_outliers_agree_within_a_quarter_of_a_right_angle(degrees, agree):
    track = outliers_at([(0.012, 0.0)] * 3, [1.0, 2.0, 2.0 + np.radians(degrees)])
    assert (track.misses == 0) == agree


def test_two_outliers_are_too_few_and_one_between_poses_is_forgotten():
    assert outliers_at([(0.012, 0.0)] * 2).misses == 2
    assert outliers_at([(0.012, 0.0)] * 3).misses == 0
    track = outliers_at([(0.012, 0.0)])
    track.update(LISTENING, a_pose(1.2, [0.0, 0.0, 0.06], Rotation.identity()))
    assert track.misses == 0
    for _ in range(2):
        track.update(LISTENING, None)
        assert track.pose.r_squared == 0.0
        assert track.pose.flip_margin == 1.0
    track.update(LISTENING, a_pose(1.6, [0.012, 0.0, 0.06], Rotation.identity()))
    assert track.misses == 3  # the one before was too long ago to agree with
    track.update(LISTENING, a_pose(1.7, [0.012, 0.0, 0.06], Rotation.identity()))
    assert track.misses == 0
    assert not track.confirmed


def test_poses_that_are_not_trusted_never_agree():
    track = outliers_at([])
    for i in range(6):
        track.update(LISTENING, a_pose(1.0 + 0.1 * i, [0.012, 0.0, 0.06], Rotation.identity(), trusted=False))
    assert track.misses == 6


def test_a_track_is_confirmed_by_the_second_pose_and_anew_after_a_new_beginning():
    track = Tracker(None, DEVICE, None)
    assert track.drift == pytest.approx(np.zeros(3))
    assert track.motion is None
    for i in range(3):
        track.update(LISTENING, a_pose(0.1 * i, [0.0, 0.0, 0.06], Rotation.identity()))
        assert track.pose.trusted
        assert track.confirmed == (i >= 1)
    assert not outliers_at([(0.012, 0.0)] * 3).confirmed


def test_a_pose_that_is_found_flipped_is_turned_back_to_the_track(along_device):
    """A moment along the cantilever sounds alike after half a turn about it."""
    turn, track = Rotation.from_rotvec([0.3, -0.8, 1.9]), Tracker(None, along_device, None)
    flipped = turn * Rotation.from_rotvec([0.0, 0.0, np.pi])
    for i in range(8):
        track.update(LISTENING, a_pose(0.1 * i, [0.0, 0.0, 0.06], flipped if i in (2, 3, 6) else turn))
        assert track.misses == 0
        assert abs(track.pose.orientation @ scalar_first(turn)) == pytest.approx(1.0, abs=1e-6)


def test_a_published_pose_does_not_change_later():
    state = tracker_module.State(0.0, UP, np.array([1.0, 0, 0, 0]), 0.7, np.zeros(3), np.eye(10))
    with pytest.raises(FrozenInstanceError):
        state.drift = UP  # type: ignore[misc]


def test_a_shot_that_does_not_listen_is_no_miss_and_keeps_trust():
    silent = Shot((MoveMagnet("near", 3.0), MoveMagnet("away", 4.0)), start=1.0)
    track = Tracker(None, DEVICE, None)
    assert track.update(silent, None) is None
    assert track.misses == 0
    for i in range(3):
        track.update(LISTENING, a_pose(0.1 * i, [0.0, 0.0, 0.06], Rotation.identity(), r_squared=0.8, flip_margin=2.0))
    after = track.update(silent, None)
    assert after.time == silent.end == 8.0
    assert (after.trusted, after.r_squared, after.flip_margin, track.misses) == (True, 0.8, 2.0, 0)
    track.update(Shot(LISTENING.windows, start=8.0), None)
    assert track.pose.time == pytest.approx(8.0 + LISTENING.duration)
    assert not track.update(replace(silent, start=9.0), None).trusted


@pytest.fixture(scope="module")
def helix() -> Helix:
    from smolbot.config.mission import load_steering_mission

    return load_steering_mission("s_path", settings={"cycle.half_periods": "4"}).helix_setup().helix  # quicker to check


def maneuver(turns, degrees, *, rotates=True):
    """The magnet comes, turns about a robot's axis, or for a heading above 100 degrees 72 degrees aside, and goes."""
    course = np.radians(degrees + 72.0 * (degrees > 100.0))
    moves = (Rotate((-np.cos(course), -np.sin(course), 0.0), 0.25, turns),) if rotates else ()
    return Shot((MoveMagnet("near", 10.0), *moves, MoveMagnet("away", 10.0)), start=1.0)


def screwed(helix, turns, degrees, *, rotates=True):
    """Covariance before and after a maneuver, in axes along, left of and above a helix that lies across the gel."""
    heading = np.radians(degrees)
    ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
    lying = Rotation.from_quat(quaternion_from_axes(ahead, UP, "zx"), scalar_first=True)
    track = Tracker(helix, DEVICE, None)
    for i in range(4):
        track.update(LISTENING, a_pose(0.1 * i, [-3e-3, 1e-3, 0.0495], lying, 0.1 * SIGMA))
    old = track.pose
    assert not track.orientation_uncertain
    new = track.update(maneuver(turns, degrees, rotates=rotates), None)
    seen = new.body_axis("z")
    left = np.array([-seen[1], seen[0], 0.0]) / np.hypot(seen[0], seen[1])
    axes = np.column_stack([seen, left, np.cross(seen, left)])
    grown = new.covariance - old.covariance
    return track, old, new, axes.T @ grown[:3, :3] @ axes, axes.T @ grown[3:, 3:] @ axes


@pytest.mark.parametrize("degrees", [0.0, 35.0, 160.0])
@pytest.mark.parametrize("turns", [2.0, 6.0])
def test_a_helix_that_was_turned_is_in_doubt_along_its_axis_aside_and_about_it(helix, turns, degrees):
    """It slips by a third, drifts aside by a tenth, may be seated half a pitch off; its roll is anything."""
    track, old, new, places, turning = screwed(helix, turns, degrees)
    way = turns * helix.advance
    there, lying, _, turned = helix.carry(maneuver(turns, degrees).windows, old.position, old.orientation)
    assert new.position == pytest.approx(there, abs=0.0)
    assert new.orientation == pytest.approx(lying, abs=1e-12)
    assert 0.7 * way < np.linalg.norm(there - old.position) < 1.01 * way
    assert np.sqrt(np.diag(places)) == pytest.approx([np.hypot(0.35 * way, 1e-3), 0.1 * way, 0.1 * way], rel=1e-3)
    assert places == pytest.approx(np.diag(np.diag(places)), abs=1e-3 * places.max())
    spread = np.degrees(np.sqrt(np.diag(turning)))
    assert spread[:2] == pytest.approx([180.0, 6.0], rel=1e-3)
    assert spread[2] == pytest.approx(np.hypot(5.0, 0.3 * np.degrees(turned)), rel=1e-3)
    assert track.orientation_uncertain
    assert new.time == 1.0 + 20.0 + turns / 0.25


def test_the_orientation_of_a_helix_may_be_uncertain_and_of_no_other_robot(helix):
    for sigma, uncertain in ((0.25, False), (0.35, True)):  # a first pose is in twice the doubt; the bound is 0.6 rad
        doubtful = np.array([1e-4] * 3 + [1e-2, sigma, 1e-2])
        for robot in (helix, None):
            track = Tracker(robot, DEVICE, None)
            assert not track.orientation_uncertain
            track.update(LISTENING, a_pose(0.0, [0.0, 0.0, 0.05], Rotation.identity(), doubtful))
            assert track.orientation_uncertain == (uncertain and robot is helix)


def test_a_gel_holds_a_helix_whose_magnet_only_came_and_went(helix):
    track, old, new, places, turning = screwed(helix, 0.0, 20.0, rotates=False)
    assert new.position == pytest.approx(old.position, abs=0.0)
    assert new.orientation == pytest.approx(old.orientation, abs=1e-15)
    assert np.abs(places).max() == np.abs(turning).max() == 0.0
    assert track.drift == pytest.approx(np.zeros(3), abs=0.0)
    sigma = track.amplitude[1]
    for i in range(4):
        track.update(replace(LISTENING, start=40.0 + i), None)
    assert track.amplitude[1] == pytest.approx(np.hypot(sigma, 2.0 * 0.02 * DEVICE.theta_max))
    assert track.pose_at(1e4).covariance == pytest.approx(old.covariance, abs=0.0)


def test_windows_that_pull_nothing_or_beyond_the_table_move_nothing(line):
    setup = line.setup()
    idle = Actuate((0.0, 0.0, 0.0, 0.0), 0.08)
    pulls = Actuate((8.0, 0.0, 0.0, 0.0), 0.08)
    facing = Rotation.from_quat(quaternion_from_axes(np.array([0.0, 1.0, 0.0]), UP, "zy"), scalar_first=True)
    for place, windows, moved in (
        ((0.0, 0.0, 0.06), (idle,), False),
        ((0.0, 0.0, 0.06), (idle, pulls), True),  # one that does nothing hides none that does
        ((0.0, 0.0, 0.06), (RingDown(0.01), pulls), True),
        ((0.5, 0.0, 0.06), (pulls,), False),
    ):
        track = Tracker(setup.robot, setup.device, setup.table)
        for i in range(3):
            track.update(LISTENING, a_pose(0.1 * i, place, facing))
        track.update(Shot((*windows, *LISTENING.windows), start=0.3), None)
        step, turn, noise = track.motion
        assert (np.linalg.norm(step[:2]) > 1e-5) == (np.linalg.norm(turn) > 0.1) == moved
        assert step[2] == pytest.approx(0.0, abs=1e-12)
        wait = 0.3 + sum(w.duration for w in windows) + LISTENING.duration - 0.2
        assert noise[[2, 3, 4]] == pytest.approx(tracker_module.PROCESS_NOISE_DENSITY[[2, 3, 4]] ** 2 * wait)
        along = (0.3**2) * (step[:2] @ step[:2])
        assert noise[:2] == pytest.approx(tracker_module.PROCESS_NOISE_DENSITY[:2] ** 2 * wait + along, rel=1e-6)
