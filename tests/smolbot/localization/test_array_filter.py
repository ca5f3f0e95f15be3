"""Sensors that stand a little wrong are found from a robot's own flight, nobody knowing where it was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smolbot.core.sensing import Recording, SensorArray
from smolbot.errors import InputError
from smolbot.localization.array.filter import ArrayFilter, ArrayPrior, compute_tilt_frames, is_significant
from smolbot.localization.array.terms import DEVIATIONS_OF_DEVICE, DEVIATIONS_PER_SENSOR
from smolbot.localization.forward import compute_deflection, compute_sensor_field
from smolbot.localization.localizer import Localizer
from smolbot.localization.noise.model import NoiseModel
from smolbot.localization.noise.whitening import prepare_whitened

RATE = 50_000.0
NOISE = 2e-9  # T, white: about the tank's floor in a window of ten milliseconds
DEVIATIONS = np.array([5e-3, *np.radians([0.3, 0.3]), 2e-4, 2e-4, 2e-4])


def belief_of(array, device):
    deviations = np.concatenate([np.tile(DEVIATIONS, len(array)), [0.02, 4.5e-5]])
    return ArrayPrior(array, device, np.diag(deviations**2), compute_tilt_frames(array))


def drawn(belief, seed, size=1.0):
    """Deviations drawn as the belief says, and the array and device that have them."""
    rng = np.random.default_rng(seed)
    q = size * np.sqrt(np.diag(belief.covariance)) * np.clip(rng.standard_normal(len(belief.covariance)), -2, 2)
    moment, l0 = belief.compute_moment_and_l0(q)
    return q, belief.make_array(q), replace(belief.device, moment=moment, l0=l0)


@pytest.fixture(scope="module")
def noise(array):
    rng = np.random.default_rng(99)
    return NoiseModel.learn(
        [Recording(NOISE * rng.standard_normal((len(array), 25_000)), RATE, np.inf) for _ in range(4)]
    )


def record(array, device, pose, rng, noise, constant=5e-8):
    time = 0.008 + np.arange(483) / RATE
    theta = compute_deflection(device, time, 0.8 * device.theta_max, rng.uniform(-3, 3))
    field = compute_sensor_field(array, device, pose.position, pose.orientation, theta)
    field = field + noise * rng.standard_normal(field.shape) + constant * rng.standard_normal((len(array), 1))
    return Recording(field, RATE, 0.008)


@pytest.mark.parametrize("kind", ["along", "across"])
def test_sensor_deviations_bias_a_fit_as_its_terms_predict(array, devices, pose_at, kind):
    belief = belief_of(array, devices[kind])
    localizer = Localizer(array, belief.device)
    q, true, device = drawn(belief, 3, 0.3)
    pose = pose_at((7.0, -4.0, 60.0), 35.0, "zy" if kind == "along" else "xz")
    recording = record(true, device, pose, np.random.default_rng(0), 0.0)
    found, swing = localizer.locate_swing(recording, pose)
    terms = swing.compute_array_terms(belief.frames)
    off = found.position - pose.position
    corrected = off + terms.pose[:3] + terms.sensitivity[:3] @ q
    assert np.linalg.norm(off) > 5e-5
    assert np.linalg.norm(corrected) < 0.1 * np.linalg.norm(off)


def test_residuals_that_no_pose_explains_agree_with_the_information(array, along_device, pose_at):
    belief = belief_of(array, along_device)
    q, true, device = drawn(belief, 4, 0.2)
    pose = pose_at((-5.0, 9.0, 60.0), 140.0)
    recording = record(true, device, pose, np.random.default_rng(0), 0.0)
    _, swing = Localizer(array, along_device).locate_swing(recording, pose)
    terms = swing.compute_array_terms(belief.frames)
    expected = terms.information @ q
    assert np.linalg.norm(terms.right - expected) < 0.1 * np.linalg.norm(expected)


def flight(array, device, pose_at, rng, n):
    """Recordings along a zigzag with its turns, the true poses, and what the robot is thought to have moved."""
    place, heading = np.array([-8.0, -8.0]), 0.0
    for _ in range(n):
        turn = rng.choice([0.0, 0.0, 40.0, -70.0])
        heading += turn
        ahead = np.array([np.cos(np.radians(heading)), np.sin(np.radians(heading))])
        if np.abs(place + 0.8 * ahead).max() > 11.0:
            heading, ahead = heading + 180.0, -ahead
        place = place + 0.8 * ahead
        pose = pose_at((*place, 59.6), heading)
        yield record(array, device, pose, rng, NOISE), pose


def fly(noise, true, device, belief, pose_at, seed, learn=True, n=150):
    rng = np.random.default_rng(seed)
    localizer, learned = Localizer(belief.sensors, belief.device, noise), ArrayFilter(belief)
    prior, before, errors = None, None, []
    for recording, truth in flight(true, device, pose_at, rng, n):
        pose, swing = localizer.locate_swing(recording, prior or truth)
        if before is not None:
            step = truth.position - before.position
            turn = np.array([0.0, 0.0, np.arctan2(*(before.rotation.T @ truth.rotation)[[0, 2], 2])])
            slip = 0.3 * np.linalg.norm(step)
            moved = step + np.append(slip * rng.standard_normal(2), 0.0)
            variance = np.array([slip**2, slip**2, 1e-10, 1e-4, 1e-4, 1e-4 + (0.3 * turn[2]) ** 2])
            learned.predict(moved, turn, variance)
        terms = swing.compute_array_terms(belief.frames)
        if learn and terms is not None and learned.update(pose, terms):
            anew = replace(localizer.device, moment=learned.moment, l0=learned.l0)
            localizer = localizer.with_sensors(learned.sensors).with_device(anew)
        prior, before = pose, truth
        errors.append(pose.position - truth.position)
    return np.array(errors), learned


def rms(errors):
    return float(np.sqrt(np.mean(errors**2)))


def test_a_flight_learns_what_its_sensors_are_off(array, noise, along_device, pose_at):
    belief = belief_of(array, along_device)
    ratios, surprise = [], []
    for seed in (1, 2, 3):
        q, true, device = drawn(belief, seed)
        still, _ = fly(noise, true, device, belief, pose_at, seed, learn=False)
        errors, learned = fly(noise, true, device, belief, pose_at, seed)
        ratios.append(rms(errors[75:]) / rms(still[75:]))
        off = learned.deviations - q
        surprise.append(off @ np.linalg.solve(learned.covariance, off) / len(q))
    assert np.mean(ratios) < 0.85
    assert max(ratios) < 1.05
    assert np.mean(surprise) < 2.0  # the deviations that are left are what the filter claims of them


def test_sensors_that_stand_right_are_left_nearly_alone(array, noise, along_device, pose_at):
    belief = belief_of(array, along_device)
    _, true, device = drawn(belief, 1)
    wrong, _ = fly(noise, true, device, belief, pose_at, 1, learn=False)
    right, _ = fly(noise, array, along_device, belief, pose_at, 1)
    assert rms(right) < 0.5 * rms(wrong)


def test_a_sensor_without_a_word_is_not_learned(array, noise, along_device, pose_at):
    belief = belief_of(array, along_device)
    localizer, learned = Localizer(array, along_device, noise), ArrayFilter(belief)
    _, true, device = drawn(belief, 5)
    rng = np.random.default_rng(5)
    for heading in np.linspace(0, 300, 40):
        pose = pose_at((4.0, 3.0, 60.0), heading)
        recording = record(true, device, pose, rng, NOISE)
        recording = replace(recording, saturated=np.arange(len(array)) == 3)
        found, swing = localizer.locate_swing(recording, pose)
        learned.update(found, swing.compute_array_terms(belief.frames))
        learned.predict(np.zeros(3), np.zeros(3), np.ones(6))
    left = np.sqrt(np.diag(learned.covariance)[:-DEVIATIONS_OF_DEVICE].reshape(-1, DEVIATIONS_PER_SENSOR))
    assert left[3] == pytest.approx(DEVIATIONS, rel=1e-6)
    assert (left[[2, 4]] < 0.95 * DEVIATIONS).any()


def test_another_array_takes_over_the_whitener_of_the_last(array, along_device, pose_at):
    localizer = Localizer(array, along_device)
    belief = belief_of(array, along_device)
    recording = record(array, along_device, pose_at((0.0, 0.0, 60.0)), np.random.default_rng(0), 1e-10)
    _, other, _ = drawn(belief, 1)
    first = prepare_whitened(recording, array, along_device, localizer.noise).model
    second = prepare_whitened(recording, other, along_device, localizer.noise).model
    assert first.array_independent is second.array_independent
    assert not np.allclose(first.positions, second.positions, atol=1e-6)


def test_a_gain_that_is_known_changes_no_pose(array, along_device, pose_at):
    gains = 1.0 + 0.02 * np.random.default_rng(0).standard_normal(len(array))
    pose = pose_at((3.0, -6.0, 60.0), 80.0)
    recording = record(array, along_device, pose, np.random.default_rng(1), 0.0)
    louder = replace(recording, field=gains[:, None] * recording.field)
    learned_array = SensorArray(array.positions, array.axes, array.bandwidth, gains)
    found = Localizer(learned_array, along_device).locate(louder, pose)
    assert np.linalg.norm(found.position - pose.position) < 1e-5
    untold = Localizer(array, along_device).locate(louder, pose)
    assert np.linalg.norm(untold.position - pose.position) > 1e-4


def test_gains_that_are_not_positive_are_refused(array):
    with pytest.raises(InputError, match="gains must be positive"):
        SensorArray(array.positions, array.axes, array.bandwidth, np.zeros(len(array)))


def test_noise_alone_does_not_move_the_sensors_and_real_deviations_do():
    rng = np.random.default_rng(8)
    n, k = 30, 12
    prior = np.diag(rng.uniform(1e-4, 5e-3, n) ** 2)
    prior[3, 3] = 0.0  # assumed to be exact
    own = np.sqrt(np.diag(prior))
    rows = 3.0 * rng.standard_normal((k, n)) / np.where(own > 0.0, own, 1.0)  # the data: rows q + unit noise
    gain = prior @ rows.T @ np.linalg.inv(rows @ prior @ rows.T + np.eye(k))
    covariance = prior - gain @ rows @ prior
    false = [is_significant(gain @ rng.standard_normal(k), covariance, prior) for _ in range(400)]
    true = [
        is_significant(gain @ (rows @ (own * rng.standard_normal(n)) + rng.standard_normal(k)), covariance, prior)
        for _ in range(100)
    ]
    assert sum(false) <= 4  # beyond four sigma of chi-square
    assert all(true)
    assert not is_significant(np.zeros(n), prior, prior)
