"""Finding the device: from a recording to a pose, cold and warm, with flipped poses, noise and bad channels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from smolbot.core.pose import Pose
from smolbot.core.rotations import (
    compute_rotation_error,
    matrix_from_quaternion,
    multiply_quaternions,
    quaternion_from_matrix,
    quaternion_from_rotation_vector,
)
from smolbot.core.sensing import Recording
from smolbot.errors import InputError
from smolbot.localization import kernels
from smolbot.localization.basis import REFERENCE_ANGLE
from smolbot.localization.localizer import Localizer
from smolbot.localization.noise.model import NoiseModel
from smolbot.localization.problem import prepare_paper

RATE = 50_000.0
HALF_TURN_ABOUT_Z = np.array([0.0, 0.0, 0.0, 1.0])


@pytest.fixture(params=["paper", "whitened"])
def estimator(request) -> str:
    return request.param


def at_the_truth(found: Pose, truth: Pose, estimator: str, within: float = 1e-5) -> bool:
    """The paper's fit of clean data is exact; the prior biases the whitened one by less than its standard deviation."""
    error = found.position - truth.position
    if estimator == "paper":
        return bool(np.linalg.norm(error) < within)
    return bool(error @ np.linalg.solve(found.covariance[:3, :3], error) < 1.0)


def nearby(pose: Pose, away=(1.5e-3, -1e-3, 0.8e-3), turn=(0.1, -0.08, 0.12)) -> Pose:
    q = multiply_quaternions(quaternion_from_rotation_vector(np.array(turn)), pose.orientation)
    return Pose(pose.time, pose.position + np.array(away), q, pose.covariance)


def turned_about_moment(pose: Pose, device) -> Pose:
    """The flipped pose: a half turn about the moment, with the magnet in the same place."""
    moment = pose.rotation @ device.moment_in_body
    rotation = (2 * np.outer(moment, moment) - np.eye(3)) @ pose.rotation
    magnet = pose.position + device.l0 * pose.rotation[:, 2]
    return replace(pose, position=magnet - device.l0 * rotation[:, 2], orientation=quaternion_from_matrix(rotation))


def angle(pose: Pose, truth: Pose, *, along=False) -> float:
    error = np.linalg.norm(compute_rotation_error(pose.orientation, truth.orientation))
    if not along:
        return error
    other = multiply_quaternions(pose.orientation, HALF_TURN_ABOUT_Z)
    return min(error, np.linalg.norm(compute_rotation_error(other, truth.orientation)))


@pytest.mark.parametrize("name", ["along", "across"])
@pytest.mark.parametrize(("place", "heading"), [((4, -6, 80), 35), ((-8, 5, 60), 160), ((0, 0, 70), -80)])
def test_a_noise_free_pose_is_found_cold_and_warm(array, devices, pose_at, hear, name, place, heading, estimator):
    device, truth = devices[name], pose_at(place, heading)
    quiet_room = NoiseModel.assumed(array, mains=2e-9, mains_gradient=6e-9)
    recording, localizer = hear(array, device, truth), Localizer(array, device, quiet_room, estimator)
    for found in (localizer.locate(recording), localizer.locate(recording, nearby(truth))):
        assert found.trusted
        assert at_the_truth(found, truth, estimator, within=5e-6)
        assert angle(found, truth, along=name == "along") < 1e-3
        assert found.r_squared > 1 - 1e-5


def test_locate_depends_on_its_arguments_alone(array, along_device, pose_at, hear, estimator):
    truth, other = pose_at((4, -6, 80), 35), pose_at((-9, 3, 66), 200)
    localizer = Localizer(array, along_device, estimator=estimator)
    noise = 1e-10 * np.random.default_rng(0).normal(size=(len(array), 483))
    first = localizer.locate(hear(array, along_device, truth, noise=noise), nearby(truth))
    localizer.locate(hear(array, along_device, other), None)
    again = localizer.locate(hear(array, along_device, truth, noise=noise), nearby(truth))
    assert np.array_equal(first.position, again.position)
    assert np.array_equal(first.covariance, again.covariance)


def test_a_pose_carries_the_time_of_the_middle_of_its_window(array, along_device, pose_at, hear, estimator):
    truth = pose_at((0, 0, 80))
    recording = replace(hear(array, along_device, truth, 6), clock=12.0)
    found = Localizer(array, along_device, estimator=estimator).locate(recording, truth)
    assert found.time == pytest.approx(12.0 + 0.5 * recording.field.shape[1] / RATE)


@pytest.mark.parametrize("name", ["along", "across"])
def test_the_fit_ends_where_scipy_ends_on_the_same_noisy_data(array, devices, pose_at, hear, name):
    device, truth = devices[name], pose_at((4, -6, 80), 35)
    noise = 2e-10 * np.random.default_rng(1).normal(size=(len(array), 2000))
    recording = hear(array, device, truth, 6)
    recording = replace(recording, field=recording.field + noise[:, : recording.field.shape[1]])
    problem = prepare_paper(recording, array, device)
    scale = np.array([1e-3] * 3 + [0.1] * 3 + [0.1, 0.1])

    def residual(x):
        move = x * scale
        rotation = matrix_from_quaternion(quaternion_from_rotation_vector(move[3:6])) @ truth.rotation
        size = 0.8 * device.theta_max / REFERENCE_ANGLE + move[7]
        out, _ = problem.model.compute_response(truth.position + move[:3], rotation, 0.4 + move[6], size)
        return (out - problem.data).ravel() * 1e5

    scipys = least_squares(residual, np.zeros(8), method="lm", xtol=1e-12, ftol=1e-12, gtol=1e-12)
    found = Localizer(array, device, estimator="paper").locate(recording, truth)
    assert found.position == pytest.approx(truth.position + 1e-3 * scipys.x[:3], abs=2e-7)
    turn = multiply_quaternions(quaternion_from_rotation_vector(0.1 * scipys.x[3:6]), truth.orientation)
    assert np.linalg.norm(compute_rotation_error(found.orientation, turn)) < 2e-4
    assert np.linalg.norm(found.position - truth.position) > 1e-5  # the noise moved it, and both alike


@pytest.mark.parametrize("channel", range(10))
def test_a_constant_of_a_microtesla_on_a_channel_changes_nothing(
    array, along_device, pose_at, hear, channel, estimator
):
    truth = pose_at((4, -6, 80), 35)
    noise = 1e-10 * np.random.default_rng(2).normal(size=(len(array), 483))
    recording = hear(array, along_device, truth, noise=noise)
    shifted = recording.field.copy()
    shifted[channel] += 1e-6
    localizer = Localizer(array, along_device, estimator=estimator)
    plain = localizer.locate(recording, truth)
    moved = localizer.locate(replace(recording, field=shifted), truth)
    assert moved.position == pytest.approx(plain.position, abs=1e-9)
    assert angle(moved, plain) < 1e-6


def test_r_squared_is_one_minus_the_unexplained_share(array, along_device, pose_at, hear):
    truth = pose_at((4, -6, 80), 35)
    noise = 3e-9 * np.random.default_rng(4).normal(size=(len(array), 483))
    recording = hear(array, along_device, truth, noise=noise)
    problem = prepare_paper(recording, array, along_device)
    best = problem.fit(truth.position, truth.rotation, 0.4, 0.8 * along_device.theta_max / REFERENCE_ANGLE)
    out, _ = problem.model.compute_response(best.position, best.rotation, best.phase, best.amplitude)
    unexplained = np.sum((problem.data - out) ** 2) / np.sum((problem.data - np.mean(problem.data)) ** 2)
    found = Localizer(array, along_device, estimator="paper").locate(recording, truth)
    assert unexplained > 1e-4
    assert found.r_squared == pytest.approx(1 - unexplained, abs=1e-5)


@pytest.mark.parametrize(("place", "heading"), [((4, -6, 80), 35), ((-5, 8, 70), 120)])
def test_of_two_orientations_with_the_moment_across_the_right_one_is_kept(
    array, across_device, pose_at, hear, place, heading, estimator
):
    truth = pose_at(place, heading)
    flipped = turned_about_moment(truth, across_device)
    assert angle(flipped, truth) == pytest.approx(np.pi)
    assert np.linalg.norm(flipped.position - truth.position) > 2 * across_device.l0 - 1e-9
    recording = hear(array, across_device, truth, 6)
    for prior in (None, truth, flipped):
        found = Localizer(array, across_device, estimator=estimator).locate(recording, prior)
        assert at_the_truth(found, truth, estimator)
        assert angle(found, truth) < 1e-2
        assert found.flip_margin > 2.0


def test_with_the_moment_along_the_cantilever_the_orientation_nearest_to_the_prior_is_returned(
    array, along_device, pose_at, hear, estimator
):
    truth = pose_at((4, -6, 80), 35)
    flipped = replace(truth, orientation=multiply_quaternions(truth.orientation, HALF_TURN_ABOUT_Z))
    recording = hear(array, along_device, truth)
    assert np.allclose(recording.field, hear(array, along_device, flipped, phase=0.4 + np.pi).field, rtol=0, atol=1e-18)
    for prior in (truth, flipped):
        found = Localizer(array, along_device, estimator=estimator).locate(recording, nearby(prior))
        assert angle(found, prior) < 1e-3
        assert found.flip_margin == 1.0


def test_covariance_of_a_fit_is_the_scatter_that_white_noise_causes(array, along_device, pose_at):
    """White noise at the chain's output: there the fit's own residuals tell all."""
    truth = pose_at((4, -6, 70), 35)
    n, size = 483, 0.8 * along_device.theta_max / REFERENCE_ANGLE
    any_samples = Recording(np.random.default_rng(1).standard_normal((len(array), n)), RATE, 0.02)
    problem = prepare_paper(any_samples, array, along_device)
    clean, _ = problem.model.compute_response(truth.position, truth.rotation, 0.4, size)
    rng, level = np.random.default_rng(5), 2e-3 * np.abs(clean).max()
    errors, claimed = [], []
    for _ in range(300):
        noisy = replace(problem, data=clean + level * rng.normal(size=clean.shape))
        fit = noisy.fit(truth.position, truth.rotation, 0.4, size)
        turn = compute_rotation_error(quaternion_from_matrix(fit.rotation), truth.orientation)
        errors.append([*(fit.position - truth.position), *turn])
        claimed.append(kernels.compute_covariance(fit.normal, fit.sse / (noisy.data.size - 8))[:6, :6])
    scatter = np.std(errors, axis=0)
    expected = np.sqrt(np.diag(np.mean(claimed, axis=0)))
    assert scatter == pytest.approx(expected, rel=0.25)


def test_a_silent_channel_is_left_out_by_both_estimators(array, along_device, pose_at, hear, estimator):
    truth = pose_at((4, -6, 80), 35)
    recording = hear(array, along_device, truth)
    recording.field[3] = 2.5e-8
    found = Localizer(array, along_device, estimator=estimator).locate(recording, nearby(truth))
    assert at_the_truth(found, truth, estimator)


def test_segments_of_a_long_recording_are_poses_in_a_row(array, along_device, pose_at, hear, estimator):
    truth, count = pose_at((4, -6, 80), 35), 6 if estimator == "paper" else 2
    recording = replace(hear(array, along_device, truth, 2 * count), clock=3.0)
    localizer = Localizer(array, along_device, estimator=estimator)
    poses = localizer.locate_segments(recording, 2)
    period = 1 / along_device.frequency
    assert [p.time for p in poses] == pytest.approx(3.0 + period * (0.5 + np.arange(count)), abs=0.01 * period)
    for pose in poses:
        assert at_the_truth(pose, truth, estimator, within=2e-5)
    assert len(localizer.locate_segments(recording, 2 * count - 1)) == 1
    for wrong in (0, 2 * count + 1):
        with pytest.raises(InputError, match=f"1 to {2 * count}"):
            localizer.locate_segments(recording, wrong)


def test_a_saturated_channel_is_left_out_and_the_pose_stays_good(array, along_device, pose_at, hear, estimator):
    truth = pose_at((4, -6, 80), 35)
    recording = hear(array, along_device, truth)
    field, saturated = recording.field.copy(), np.zeros(len(array), dtype=bool)
    field[4], saturated[4] = np.sign(np.sin(np.arange(field.shape[1]))) * 1e-5, True
    spoilt = replace(recording, field=field, saturated=saturated)
    found = Localizer(array, along_device, estimator=estimator).locate(spoilt, nearby(truth))
    assert at_the_truth(found, truth, estimator)
    unflagged = Localizer(array, along_device, estimator=estimator).locate(
        replace(spoilt, saturated=~saturated & False), nearby(truth)
    )
    assert not unflagged.trusted or np.linalg.norm(unflagged.position - truth.position) > 1e-3


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_channel_that_is_not_finite_is_left_out(array, along_device, pose_at, hear, value, estimator):
    truth = pose_at((4, -6, 80), 35)
    recording = hear(array, along_device, truth)
    field = recording.field.copy()
    field[2, 100] = value
    with np.errstate(invalid="ignore"):
        found = Localizer(array, along_device, estimator=estimator).locate(
            replace(recording, field=field), nearby(truth)
        )
    assert at_the_truth(found, truth, estimator)


def test_what_cannot_be_located_is_refused_and_named(array, along_device, pose_at, hear, estimator):
    localizer = Localizer(array, along_device, estimator=estimator)
    good = hear(array, along_device, pose_at((0, 0, 80)))
    with pytest.raises(InputError, match=r"9 channels.*10 sensors"):
        localizer.locate(Recording(good.field[:9], RATE, 0.02))
    with pytest.raises(InputError, match=r"0, 1, 2, 3, 4$|0, 1, 2, 3, 4\."):
        localizer.locate(replace(good, saturated=np.arange(10) < 5))
    with pytest.raises(InputError, match=r"half-period of 103\.5 Hz"):
        localizer.locate(replace(good, field=good.field[:, :200]))
    for never in (np.inf, np.nan, -0.1):
        with pytest.raises(InputError, match="time_since_drive"):
            localizer.locate(replace(good, time_since_drive=never))
    with pytest.raises(InputError, match=r"'paper'.*'best'"):
        Localizer(array, along_device, estimator="best")


def test_with_every_channel_saturated_there_is_no_pose(array, along_device, pose_at, hear, estimator):
    good = hear(array, along_device, pose_at((0, 0, 80)))
    with pytest.raises(InputError, match="0, 1, 2, 3, 4, 5, 6, 7, 8, 9"):
        Localizer(array, along_device, estimator=estimator).locate(replace(good, saturated=np.ones(10, dtype=bool)))


def test_noise_alone_gives_no_pose_to_act_on(array, along_device, estimator):
    rng = np.random.default_rng(6)
    for _ in range(4):
        recording = Recording(1e-9 * rng.normal(size=(10, 483)), RATE, 0.02)
        assert not Localizer(array, along_device, estimator=estimator).locate(recording).trusted


def test_the_amplitude_is_found_though_it_is_not_known(array, along_device, pose_at, hear):
    truth = pose_at((4, -6, 80), 35)
    for share in (0.15, 0.5, 1.0):
        recording = hear(array, along_device, truth, amplitude=share * along_device.theta_max, phase=2.0)
        found = Localizer(array, along_device, estimator="paper").locate(recording, nearby(truth))
        assert np.linalg.norm(found.position - truth.position) < 1e-5
