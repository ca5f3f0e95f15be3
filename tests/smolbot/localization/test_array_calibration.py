"""Sensors that stand a little wrong are found from a device on a known track."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smolbot.config.rig import load_rig
from smolbot.core.pose import Pose
from smolbot.core.rotations import multiply_quaternions, quaternion_from_rotation_vector
from smolbot.core.sensing import Recording, SensorArray
from smolbot.errors import InputError
from smolbot.localization.array.calibration import calibrate_sensors
from smolbot.localization.forward import compute_deflection, compute_sensor_field

RATE = 50_000.0


@pytest.fixture(scope="module")
def nominal():
    return replace(load_rig("tank").sensors, bandwidth=np.inf)


def true_array(nominal, seed):
    """An array drawn around the nominal one, and its gains: 0.2 mm, 0.3 degrees, 0.5 %."""
    rng = np.random.default_rng(seed)
    n = len(nominal)
    axes = nominal.axes + np.radians(0.3) * rng.standard_normal((n, 3))
    array = SensorArray(nominal.positions + 2e-4 * rng.standard_normal((n, 3)), axes, np.inf)
    return array, 1.0 + 5e-3 * rng.standard_normal(n)


def track_recordings(array, gains, device, n_poses, seed, pose_at, noise=1e-10):
    rng = np.random.default_rng(seed)
    poses, recordings = [], []
    n = round(4 * RATE / (2.0 * device.frequency))
    for _ in range(n_poses):
        place = np.append(rng.uniform(-25, 25, 2), rng.uniform(55, 85))
        pose = pose_at(tuple(place), rng.uniform(-180, 180))
        turn = quaternion_from_rotation_vector(0.4 * rng.standard_normal(3))
        pose = Pose(0.0, pose.position, multiply_quaternions(turn, np.array(pose.orientation)), np.eye(6))
        time = 0.02 + np.arange(n) / RATE
        theta = compute_deflection(device, time, rng.uniform(0.5, 0.95) * device.theta_max, rng.uniform(-3, 3))
        field = gains[:, None] * compute_sensor_field(array, device, pose.position, pose.orientation, theta)
        field = field + noise * rng.standard_normal(field.shape) + 5e-8 * rng.standard_normal((len(array), 1))
        poses.append(pose)
        recordings.append(Recording(field, RATE, 0.02))
    return recordings, poses


@pytest.mark.parametrize("seed", [1, 2])
def test_held_out_poses_are_located_better_with_the_array_that_was_found(nominal, along_device, pose_at, seed):
    device = replace(along_device, damping=1.6)
    array, gains = true_array(nominal, seed)
    recordings, poses = track_recordings(array, gains, device, 60, seed, pose_at)
    found = calibrate_sensors(recordings, poses, nominal, device)
    assert found.held_out.recordings == 15
    assert found.held_out.position_after < 0.5 * found.held_out.position_before
    assert found.held_out.orientation_after < 0.6 * found.held_out.orientation_before
    before = np.sqrt(np.mean((nominal.positions - array.positions) ** 2))
    after = np.sqrt(np.mean((found.sensors.positions - array.positions) ** 2))
    assert after < 0.5 * before


def test_gains_are_found_up_to_a_common_factor(nominal, along_device, pose_at):
    device = replace(along_device, damping=1.6)
    gains = np.ones(len(nominal))
    gains[3] = 1.01
    recordings, poses = track_recordings(nominal, gains, device, 40, 5, pose_at, noise=1e-11)
    found = calibrate_sensors(recordings, poses, nominal, device)
    relative = found.gains / np.median(found.gains)
    assert relative[3] == pytest.approx(1.01, abs=3e-3)
    assert np.abs(np.delete(relative, 3) - 1.0).max() < 3e-3
    corrected = found.correct_recording(recordings[0])
    assert corrected.field[3] == pytest.approx(recordings[0].field[3] / found.gains[3])


def test_what_the_track_does_not_determine_stays_as_assumed(nominal, along_device, pose_at):
    device = replace(along_device, damping=1.6)
    array, gains = true_array(nominal, 4)
    recordings, poses = track_recordings(array, gains, device, 24, 4, pose_at)
    deaf = [replace(r, saturated=np.arange(len(nominal)) == 7) for r in recordings]
    found = calibrate_sensors(deaf, poses, nominal, device)
    assert found.sensors.positions[7] == pytest.approx(nominal.positions[7])
    assert found.place_std[7] == pytest.approx([2e-4] * 3)
    assert np.all(np.delete(found.place_std, 7, axis=0) < 2e-4)


def test_too_few_recordings_or_poses_are_refused(nominal, along_device, pose_at):
    recordings, poses = track_recordings(nominal, np.ones(10), along_device, 6, 1, pose_at)
    with pytest.raises(InputError, match="at least 8"):
        calibrate_sensors(recordings, poses, nominal, along_device)
    with pytest.raises(InputError, match="5 poses"):
        calibrate_sensors(recordings, poses[:5], nominal, along_device)
