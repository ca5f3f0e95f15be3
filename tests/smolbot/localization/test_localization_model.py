"""The signal of a swinging magnet, the chain that it passes through, and the model that the fit uses."""

from __future__ import annotations

from dataclasses import replace

import magpylib
import numpy as np
import pytest
from scipy import signal
from scipy.spatial.transform import Rotation

from smolbot.core.rotations import matrix_from_quaternion, quaternion_from_rotation_vector
from smolbot.core.sensing import SensorArray
from smolbot.errors import InputError
from smolbot.localization import kernels
from smolbot.localization.basis import REFERENCE_ANGLE
from smolbot.localization.chain import (
    apply_filters,
    choose_sample_points,
    compute_moving_mean,
    compute_taps,
    count_half_periods,
    make_difference_matrix,
)
from smolbot.localization.forward import compute_deflection, compute_envelope, compute_sensor_field
from smolbot.localization.problem import make_paper_model, prepare_paper

RATE = 50_000.0
MU0 = 4e-7 * np.pi


@pytest.fixture(params=["along", "across"])
def device(request, devices):
    return devices[request.param]


@pytest.fixture
def pose(pose_at):
    return pose_at((4.0, -6.0, 80.0), 35.0)


def model_of(array, device, n=967, since=0.02):
    return make_paper_model(array, device, np.ones(len(array), dtype=bool).tobytes(), n, RATE, since)


def turned(rotation, vector):
    return matrix_from_quaternion(quaternion_from_rotation_vector(np.asarray(vector, dtype=float))) @ rotation


def test_a_point_dipole_has_the_field_of_a_cylinder_magnet_of_1_mm_at_80_mm(array, device, pose):
    volume = np.pi / 4 * 1e-3**3
    magnet = magpylib.magnet.Cylinder(polarization=(0, 0, MU0 * device.moment / volume), dimension=(1e-3, 1e-3))
    theta = np.linspace(-device.theta_max, device.theta_max, 9)
    measured = np.zeros((len(array), len(theta)))
    for i, angle in enumerate(theta):
        swing = Rotation.from_matrix(pose.rotation) * Rotation.from_rotvec([0.0, angle, 0.0])
        upright = Rotation.align_vectors([device.moment_in_body], [[0, 0, 1]])[0]
        magnet.position = pose.position + pose.rotation @ (device.l0 * np.array([np.sin(angle), 0, np.cos(angle)]))
        magnet.orientation = swing * upright
        measured[:, i] = np.sum(magnet.getB(array.positions) * array.axes, axis=1)
    ours = compute_sensor_field(array, device, pose.position, pose.orientation, theta)
    assert np.abs(ours - measured).max() < 1e-3 * np.ptp(measured, axis=1).max()


def test_static_field_on_axis_at_80_mm_is_348_nT(along_device, pose_at):
    pose = pose_at((0.0, 0.0, 80.0 - 1.5))  # the magnet is l0 further up
    upright = replace(pose, orientation=np.array([1.0, 0, 0, 0]))
    sensor = SensorArray(np.zeros((1, 3)), np.array([[0, 0, 1.0]]))
    field = compute_sensor_field(sensor, along_device, upright.position, upright.orientation, np.zeros(1))
    assert abs(field[0, 0]) == pytest.approx(348e-9, rel=2e-3)


def test_linear_damping_ends_and_exponential_damping_does_not(along_device, across_device):
    time = np.array([0.0, 0.02, 0.1, 10.0])
    assert compute_envelope(across_device, time) == pytest.approx([1, 1 - 0.022, 1 - 0.11, 0.0])
    assert compute_envelope(along_device, time) == pytest.approx(np.exp(-31.7 * time))


def test_swing_crosses_zero_twice_a_period(across_device):
    time = np.arange(50_000) / RATE * 0.5
    theta = compute_deflection(across_device, time, 0.3, 0.0)
    crossings = np.count_nonzero(np.diff(np.sign(theta)))
    assert crossings == 2 * round(across_device.frequency * time[-1])


def test_jacobian_of_the_model_matches_finite_differences(array, device, pose):
    model, rotation, phase, amplitude = model_of(array, device), pose.rotation, 0.7, 0.4
    _, jacobian = model.compute_response(pose.position, rotation, phase, amplitude)
    steps = [1e-6] * 3 + [1e-5] * 3 + [1e-5, 1e-5]
    for p, h in enumerate(steps):
        sides = []
        for sign in (1, -1):
            move = np.zeros(8)
            move[p] = sign * h
            place, angle = pose.position + move[:3], turned(rotation, move[3:6])
            sides.append(model.compute_response(place, angle, phase + move[6], amplitude + move[7])[0])
        numeric = (sides[0] - sides[1]) / (2 * h)
        assert np.abs(jacobian[..., p] - numeric).max() < 1e-6 * np.abs(jacobian[..., p]).max()


@pytest.mark.parametrize("half_periods", [1, 2, 6, 20])
def test_the_fast_model_equals_the_chain_applied_sample_by_sample(array, device, pose, hear, half_periods):
    amplitude, phase = 0.8 * device.theta_max, 1.1
    recording = hear(array, device, pose, half_periods, phase=phase, amplitude=amplitude)
    problem = prepare_paper(recording, array, device)
    fast, _ = problem.model.compute_response(pose.position, pose.rotation, phase, amplitude / REFERENCE_ANGLE)
    at = problem.model.chain.points.astype(int)
    literal = apply_filters(problem.model.mixing @ recording.field, RATE)[:, at]
    assert literal.shape == (len(problem.model.mixing), 4 * half_periods + 1)
    assert np.abs(fast - literal.ravel()).max() < 1e-5 * np.abs(literal).max()
    assert np.abs(problem.data - literal.ravel()).max() < 1e-9 * np.abs(literal).max()


def test_sensors_of_1_khz_are_modelled_as_a_first_order_low_pass(array, device, pose):
    slow = replace(array, bandwidth=1000.0)
    since, n, phase, amplitude, fine = 0.02, 967, 0.3, 0.25, 8
    time = np.arange(round(since * RATE * fine) + n * fine) / (RATE * fine)
    field = compute_sensor_field(
        slow, device, pose.position, pose.orientation, compute_deflection(device, time, amplitude, phase)
    )
    w = 2 * np.pi * slow.bandwidth
    measured = np.array([signal.lsim(([w], [1.0, w]), row - row[0], time)[1] for row in field])
    measured = measured[:, round(since * RATE * fine) :: fine]
    model = model_of(slow, device, n, since)
    expected = apply_filters(model.mixing @ measured, RATE)[:, model.chain.points.astype(int)].ravel()
    fast, _ = model.compute_response(pose.position, pose.rotation, phase, amplitude / REFERENCE_ANGLE)
    assert np.abs(fast - expected).max() < 1e-3 * np.abs(expected).max()
    ideal, _ = model_of(array, device, n, since).compute_response(
        pose.position, pose.rotation, phase, amplitude / REFERENCE_ANGLE
    )
    assert np.abs(ideal - expected).max() > 2e-2 * np.abs(expected).max()


@pytest.mark.parametrize("n", [242, 483, 1450, 4831])
def test_taps_do_what_the_filters_do(n, device):
    noise = np.random.default_rng(3).normal(size=(4, n))
    chain = compute_taps(n, RATE, 103.5)
    out = kernels.apply_taps(noise, chain.first, chain.weights)
    assert out == pytest.approx(apply_filters(noise, RATE)[:, chain.points.astype(int)], rel=1e-6, abs=1e-6)


def test_the_two_moving_means_together_shift_nothing_in_time():
    ramp = np.arange(400.0)
    smooth = compute_moving_mean(compute_moving_mean(ramp), later=True)
    assert smooth[100:300] == pytest.approx(ramp[100:300])


def test_a_constant_of_a_channel_does_not_pass_the_chain():
    assert np.abs(apply_filters(np.full((1, 500), 3.0), RATE)).max() < 1e-9


def test_4n_plus_1_samples_are_evenly_spread():
    points = choose_sample_points(4831, RATE, 103.5)
    assert count_half_periods(4831, RATE, 103.5) == 20
    assert len(points) == 81
    assert np.ptp(np.diff(points)) <= 1.0
    assert points[0] >= 0
    assert points[-1] <= 4830


def test_same_axis_differences_are_deaf_to_a_uniform_field(array):
    uniform = array.axes @ np.array([3.0, -2.0, 5.0])
    mixing = make_difference_matrix(array.axes, array.positions)
    assert len(mixing) == len(array) - 3
    assert mixing @ uniform == pytest.approx(np.zeros(len(mixing)))


def test_antiparallel_sensors_are_added():
    axes = np.array([[0, 0, 1.0], [0, 0, -1.0], [0, 0, 1.0]])
    places = np.array([[0, 0, 0], [1, 0, 0], [5.0, 0, 0]])
    mixing = make_difference_matrix(axes, places)
    assert mixing @ axes[:, 2] == pytest.approx(np.zeros(2))
    assert np.linalg.matrix_rank(mixing) == 2


def test_less_than_half_a_period_holds_no_sample():
    with pytest.raises(InputError, match=r"2\.00 ms.*4\.83 ms"):
        choose_sample_points(100, RATE, 103.5)
