"""A tracker that believes in a hand: velocity and turn rate wander; and bursts that undo a swing still there."""

from __future__ import annotations

import numpy as np
import pytest

from smolbot.core.drive import compute_amplitude_after_burst, compute_drive
from smolbot.core.pose import Pose
from smolbot.core.rotations import (
    compute_mean_rotation,
    compute_rotation_error,
    multiply_quaternions,
    quaternion_from_rotation_vector,
)
from smolbot.core.sensing import Device
from smolbot.core.shots import Excite, Listen, RingDown, Shot
from smolbot.flight.tracking.passive_trackers import VelocityTracker
from smolbot.flight.tracking.tracker import Tracker
from smolbot.motion.external_motion import ExternalMotion
from smolbot.motion.robot import compute_magnet_inertia

DEVICE = Device(0.89e-3, np.array([1.0, 0.0, 0.0]), 1.5e-3, np.radians(17.8), 103.5, 1.1, "linear")
MOTION = ExternalMotion(8e-3, np.radians(30.0), 0.3)
VELOCITY, TURN = np.array([8e-3, -5e-3, 2e-3]), np.array([0.1, -0.2, 0.8])


def shot(start: float) -> Shot:
    return Shot((Excite((3.0, 0.0), 103.5, 3), RingDown(0.012), Listen(6, 103.5)), "track", start)


def guided_pose(time: float) -> Pose:
    covariance = np.diag(np.array([5e-5] * 3 + [5e-3] * 3) ** 2)
    turn = quaternion_from_rotation_vector(TURN * time)
    return Pose(time, VELOCITY * time, turn, covariance, 0.99)


def guided_tracker(until: float) -> Tracker:
    tracker = VelocityTracker(DEVICE, MOTION)
    for start in np.arange(0.0, until, 0.075):
        one = shot(float(start))
        tracker.update(one, guided_pose(one.end - 0.0145))
    return tracker


def test_a_steady_motion_is_predicted_in_position_and_rotation():
    tracker = guided_tracker(2.0)
    np.testing.assert_allclose(tracker.drift, VELOCITY, atol=1.5e-3)
    np.testing.assert_allclose(tracker.turn_rate, TURN, atol=0.15)
    ahead = tracker.pose.time + 0.06
    predicted, truth = tracker.pose_at(ahead), guided_pose(ahead)
    assert np.linalg.norm(predicted.position - truth.position) < 1.5e-4
    assert np.linalg.norm(compute_rotation_error(predicted.orientation, truth.orientation)) < np.radians(1.0)


def test_a_tracker_that_assumes_rest_lags_behind_a_moved_device():
    believing, resting = guided_tracker(2.0), Tracker(None, DEVICE, None)
    for start in np.arange(0.0, 2.0, 0.075):
        one = shot(float(start))
        resting.update(one, guided_pose(one.end - 0.0145))
    ahead = believing.pose.time + 0.06
    truth = guided_pose(ahead)
    off = [np.linalg.norm(t.pose_at(ahead).position - truth.position) for t in (believing, resting)]
    assert off[0] < 0.4 * off[1]


def test_after_a_gap_the_pose_is_as_uncertain_as_the_motion_model_predicts():
    tracker = guided_tracker(1.0)
    last = tracker.pose
    soon, late = (np.sqrt(np.diag(tracker.pose_at(last.time + wait).covariance)) for wait in (0.05, 5.0))
    assert np.all(late[:3] > 5.0 * soon[:3])
    assert late[0] == pytest.approx(MOTION.speed * np.sqrt(2.0 * MOTION.correlation_time * 5.0), rel=0.15)


@pytest.mark.parametrize("wait", [0.05, 0.3, 2.0])
def test_the_process_noise_of_a_random_rate_agrees_with_simulated_walks(wait):
    rng = np.random.default_rng(1)
    steps, walks = 200, 40000
    keep = np.exp(-wait / steps / MOTION.correlation_time)
    rate, path = np.zeros(walks), np.zeros(walks)
    for _ in range(steps):
        after = keep * rate + np.sqrt(1.0 - keep**2) * rng.standard_normal(walks)
        path += 0.5 * (rate + after) * wait / steps
        rate = after
    found = MOTION.compute_process_noise(wait)
    assert found == pytest.approx((np.var(path), np.mean(path * rate), np.var(rate)), rel=0.05)


@pytest.mark.parametrize("phase", np.linspace(0.0, 2.0 * np.pi, 13)[:-1])
def test_a_burst_that_minds_a_swing_ends_near_the_stops_whatever_its_phase(phase):
    inertia = compute_magnet_inertia(DEVICE.moment, DEVICE.l0)
    fields = np.array([[0.0, 0.0, -1e-4], [0.0, 1e-4, 0.0]])  # T per A; the device is driven along body -z
    pose = Pose(0.0, np.zeros(3), np.array([1.0, 0, 0, 0]), np.eye(6))
    left = 0.9
    ends = []
    for minded in (0.0, left):
        currents = compute_drive(fields, pose, DEVICE, inertia, 3, 10.0, minded).currents
        ends.append(swing_after(float(currents @ (fields @ [0.0, 0.0, -1.0])), phase, left, inertia))
    assert ends[1] > 0.85
    if np.cos(phase - 0.5 * np.pi) < -0.95 or np.cos(phase + 0.5 * np.pi) < -0.95:
        assert min(ends) == ends[0] or ends[0] > 0.85


def swing_after(field: float, phase: float, left: float, inertia: float) -> float:
    """Share of the stops after three cycles of `field` T on a device that still swings; stops give back a fifth."""
    omega, h = 2.0 * np.pi * DEVICE.frequency, 1e-5
    top = DEVICE.theta_max
    theta, rate = left * top * np.cos(phase), -left * top * omega * np.sin(phase)
    for k in range(round(3.0 / DEVICE.frequency / h)):
        push = DEVICE.moment * field * np.sin(omega * (k + 0.5) * h) / inertia
        rate += h * (push - omega**2 * theta)
        theta += h * rate
        if abs(theta) > top:
            theta = np.copysign(top, theta)
            rate = -0.2 * rate if rate * theta > 0.0 else rate
    return float(np.hypot(theta, rate / omega) / top)


def test_a_burst_from_rest_is_what_it_was():
    inertia = compute_magnet_inertia(DEVICE.moment, DEVICE.l0)
    fields, pose = np.array([[0.0, 0.0, -1e-4]]), Pose(0.0, np.zeros(3), np.array([1.0, 0, 0, 0]), np.eye(6))
    once, twice = (compute_drive(fields, pose, DEVICE, inertia, 3, 10.0, left).currents for left in (0.0, 1.0))
    np.testing.assert_allclose(twice, 2.0 * once)
    assert compute_amplitude_after_burst(1e-4 * float(np.abs(once[0])), DEVICE, inertia, 3) == pytest.approx(
        DEVICE.theta_max
    )


def test_the_mean_of_rotations_is_the_middle_of_them():
    middle = quaternion_from_rotation_vector(np.array([0.4, -1.0, 2.0]))
    turns = [np.array([0.0, 0.3, 0.1]), np.array([-0.2, 0.0, 0.05])]
    both = [multiply_quaternions(quaternion_from_rotation_vector(s * t), middle) for t in turns for s in (1.0, -1.0)]
    signs = np.array([1.0, -1.0, -1.0, 1.0])[:, None]
    mean = compute_mean_rotation(signs * np.array(both))
    assert np.linalg.norm(compute_rotation_error(mean, middle)) < 1e-6
