"""Superfast mode: one oscillation in segments that share a model and an amplitude."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smolbot.core.pose import Pose
from smolbot.core.rotations import compute_rotation_error, quaternion_from_axes
from smolbot.core.sensing import Device, Recording, SensorArray
from smolbot.errors import InputError
from smolbot.localization.forward import compute_deflection, compute_envelope, compute_sensor_field
from smolbot.localization.localizer import Localizer
from smolbot.localization.noise.room import NoiseLevels
from smolbot.localization.segments import MAX_SIGMAS, SharedAmplitude, cut_segments, find_anchor

RATE = 20_000.0
LEVELS = NoiseLevels(6e-12, 20e-12, 50.0, 9.8e-9, 21e-9, {2: 0.06, 3: 0.3, 5: 0.1})
EXPONENTIAL = Device(0.89e-3, np.array([1.0, 0, 0]), 1.5e-3, np.radians(17.8), 103.5, 1.6)
LINEAR = replace(EXPONENTIAL, damping=1.1, damping_model="linear")
POSITION = np.array([4e-3, -3e-3, 0.08])
ORIENTATION = quaternion_from_axes(np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]), "zy")
PLACES = [[38, -39], [-40, -8], [-56, -73], [-75, 67], [-38, -29], [59, -38], [50, -44], [20, 45], [57, 58], [-7, 42]]
SENSORS = SensorArray(
    np.column_stack([1e-3 * np.array(PLACES), np.zeros(10)]), np.eye(3)[["xyz".index(c) for c in "yzzzxzxyzz"]]
)
NOISE = LEVELS.make_model(SENSORS)


def record(device, seconds=0.4, since=0.02, noise=0.0, seed=1) -> Recording:
    time = since + np.arange(round(seconds * RATE)) / RATE
    field = compute_sensor_field(
        SENSORS, device, POSITION, ORIENTATION, compute_deflection(device, time, 0.9 * device.theta_max, 0.7)
    )
    field += noise * np.random.default_rng(seed).standard_normal(field.shape)
    return Recording(field + 3e-8, RATE, since)


@pytest.mark.parametrize("device", [EXPONENTIAL, LINEAR, replace(LINEAR, damping=0.0)])
@pytest.mark.parametrize("time", [0.02, 0.3, 0.7])
@pytest.mark.parametrize("earliest", [0.0, 0.05])
def test_one_model_serves_a_later_segment(device, time, earliest):
    anchored, share = find_anchor(device, time, earliest)
    after = np.linspace(0.0, 0.02, 5)
    assert anchored >= min(time, earliest)
    there = share * compute_envelope(device, anchored + after)
    np.testing.assert_allclose(there, compute_envelope(device, time + after), rtol=3e-3)


def test_models_are_few():
    for device, most in ((EXPONENTIAL, 1), (LINEAR, 80)):
        assert len({find_anchor(device, t)[0] for t in np.linspace(0.02, 0.89, 2000)}) <= most


def test_segments_are_of_one_length_and_cover_the_recording():
    recording = record(EXPONENTIAL)
    for half_periods in (1, 3, 4):
        segments = list(cut_segments(recording, EXPONENTIAL, half_periods))
        assert len(segments) == int(0.4 * 207) // half_periods
        assert len({s.field.shape for s in segments}) == 1
        gaps = np.diff([s.time_since_drive for s in segments]) - half_periods / 207.0
        assert np.abs(gaps).max() <= 1.0 / RATE
    for wrong in (0, 1000):
        with pytest.raises(InputError, match="half_periods"):
            list(cut_segments(recording, EXPONENTIAL, wrong))


@pytest.mark.parametrize("device", [EXPONENTIAL, LINEAR])
@pytest.mark.parametrize("estimator", ["whitened", "paper"])
def test_every_segment_of_clean_data_finds_the_truth(device, estimator):
    recording = record(device)
    poses = Localizer(SENSORS, device, NOISE, estimator).locate_segments(recording, 4)
    assert len(poses) == 20
    for pose in poses:
        off = np.abs(pose.position - POSITION)
        assert off.max() < 6e-5
        assert np.linalg.norm(compute_rotation_error(pose.orientation, ORIENTATION)) < 0.05
        assert pose.trusted
    np.testing.assert_allclose(np.diff([p.time for p in poses]), 4 / 207.0, atol=2.0 / RATE)


@pytest.mark.parametrize("device", [EXPONENTIAL, LINEAR])
def test_a_pose_of_the_shot_before_makes_the_first_segment_certain(device):
    """Half a period alone does not tell where in the dark it is; near a known pose it does."""
    recording = record(device, seconds=0.1, noise=2e-10)
    localizer = Localizer(SENSORS, device, NOISE)
    near = Pose(0.0, POSITION + 1e-3, ORIENTATION, np.eye(6) * 1e-6)
    cold, warm = localizer.locate_segments(recording, 1)[0], localizer.locate_segments(recording, 1, near)[0]
    assert not cold.trusted
    assert warm.trusted
    assert np.abs(warm.position - POSITION).max() < 5e-4


def test_a_pose_that_is_no_longer_true_does_no_harm():
    recording = record(EXPONENTIAL, seconds=0.1, noise=2e-10)
    localizer = Localizer(SENSORS, EXPONENTIAL, NOISE)
    far = Pose(0.0, POSITION + np.array([0.03, -0.03, 0.02]), np.array([0.5, 0.5, 0.5, 0.5]), np.eye(6) * 1e-6)
    for tracked, cold in zip(localizer.locate_segments(recording, 2, far), localizer.locate_segments(recording, 2)):
        assert tracked.trusted
        assert tracked.position == pytest.approx(cold.position, abs=1e-5)
        assert abs(tracked.orientation @ cold.orientation) == pytest.approx(1.0, abs=1e-5)


def test_of_two_orientations_with_the_same_signal_the_series_keeps_the_known_one():
    """With the moment along the cantilever a half turn about it changes no signal."""
    device = replace(EXPONENTIAL, moment_in_body=np.array([0.0, 0.0, 1.0]))
    w, x, y, z = ORIENTATION
    turned = np.array([-z, y, -x, w])
    recording = record(device, seconds=0.1)
    for known in (ORIENTATION, turned):
        prior = Pose(0.0, POSITION, known, np.eye(6) * 1e-6)
        poses = Localizer(SENSORS, device, NOISE).locate_segments(recording, 4, prior)
        assert all(abs(p.orientation @ known) > 0.99 for p in poses)


def test_amplitude_is_learned_along_the_way():
    """The same segment alone has a vaguer height than at the end of a series."""
    recording = record(EXPONENTIAL, noise=2e-10)
    localizer = Localizer(SENSORS, EXPONENTIAL, NOISE)
    last = localizer.locate_segments(recording, 4)[-1]
    alone = localizer.locate(list(cut_segments(recording, EXPONENTIAL, 4))[-1], last)
    assert last.covariance[2, 2] < 0.8 * alone.covariance[2, 2]


def test_a_slope_in_every_channel_does_not_move_a_pose():
    """A tool or the device itself moves: static fields rise by as much as the signal within a segment."""
    recording = record(EXPONENTIAL)
    slopes = 3e-6 * np.random.default_rng(2).standard_normal((10, 1))
    tilted = replace(recording, field=recording.field + slopes * np.arange(recording.field.shape[1]) / RATE)
    poses = Localizer(SENSORS, EXPONENTIAL, NOISE).locate_segments(tilted, 4)
    assert max(np.abs(p.position - POSITION).max() for p in poses) < 1e-4


def test_amplitude_belief_narrows_grows_and_gates():
    start = SharedAmplitude.from_device(EXPONENTIAL)
    known = start.update(0.3, 0.001)
    assert (known.mean, known.std) == (0.3, 0.001)
    later = known.predict(EXPONENTIAL, 1.0)
    assert 0.3 * 0.05 * 1.6 <= later.std < 0.3 * 0.05 * 1.6 * 1.01  # five per cent of the damping, over a second
    doubted = known.update(0.3 + 1.01 * MAX_SIGMAS * 0.001, 0.001)
    assert (doubted.mean, doubted.std) == (0.3, 0.002)
    assert known.update(0.3, np.inf) == known
