"""The Cramer-Rao bound: against a dense computation, the whitened chain, and what a bound must do."""

from __future__ import annotations

import numpy as np
import pytest

from smolbot.core.rotations import matrix_from_quaternion, multiply_quaternions, quaternion_from_rotation_vector
from smolbot.core.sensing import Device, SensorArray
from smolbot.errors import InputError
from smolbot.localization.bounds import ListeningWindow, compute_pose_bound
from smolbot.localization.forward import compute_deflection, compute_sensor_field
from smolbot.localization.noise.room import NoiseLevels
from smolbot.localization.noise.whitening import make_whitened_model

LEVELS = NoiseLevels(6e-12, 20e-12, 50.0, 9.8e-9, 21e-9, {2: 0.06, 3: 0.3, 5: 0.1})
DEVICE = Device(0.89e-3, np.array([1.0, 0, 0]), 1.5e-3, np.radians(17.8), 103.5, 1.6)
POSITION = np.array([3e-3, -4e-3, 0.078])
ORIENTATION = quaternion_from_rotation_vector(np.array([0.3, -0.5, 0.8]))
WINDOW = ListeningWindow(2, 50e3, 0.02)


def array(bandwidth: float = 1000.0) -> SensorArray:
    places = [[-45, 12], [-3, -21], [59, 40], [-25, -49], [38, -36], [-11, 10], [27, 12], [0, -14], [28, -17], [12, 21]]
    axes = np.eye(3)[[2, 2, 2, 2, 2, 2, 0, 0, 1, 1]]
    return SensorArray(np.column_stack([1e-3 * np.array(places), np.zeros(10)]), axes, bandwidth)


def at(sensors, window=WINDOW, levels=LEVELS, **options):
    rotation = matrix_from_quaternion(ORIENTATION)
    noise = levels.make_model(sensors, 20e3)
    return compute_pose_bound(sensors, DEVICE, noise, [POSITION], [rotation], window, **options)


@pytest.mark.parametrize("half_periods", [1, 2])
def test_halving_the_block_changes_the_bound_by_less_than_one_per_cent(half_periods):
    window = ListeningWindow(half_periods, 48e3, 0.02)  # whole blocks of either size: none loses samples at the end
    coarse, fine = (at(array(), window, block=block).position_rms[0] for block in (1.0e-4, 5e-5))
    assert fine == pytest.approx(coarse, rel=0.01)


@pytest.mark.slow
def test_the_estimators_own_blocks_cost_less_than_three_per_cent():
    for half_periods in (1, 2, 6):
        window = ListeningWindow(half_periods, 50e3, 0.02)
        assert at(array(), window).position_rms[0] < 1.03 * at(array(), window, block=1.25e-4).position_rms[0]


def test_bound_is_that_of_a_dense_computation_with_every_sample():
    """Derivatives by differences of the plain forward model, the constants as ten more unknowns."""
    sensors, rate = array(np.inf), 10e3
    window = ListeningWindow(2, rate, 0.02)
    n = window.count_samples(DEVICE.frequency)
    time = 0.02 + np.arange(n) / rate
    steps = np.array([1e-5, 1e-5, 1e-5, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4])

    def field(change, phase):
        turned = multiply_quaternions(quaternion_from_rotation_vector(change[3:6]), ORIENTATION)
        theta = compute_deflection(DEVICE, time, DEVICE.theta_max + change[7], phase + change[6])
        return compute_sensor_field(sensors, DEVICE, POSITION + change[:3], turned, theta).reshape(-1)

    inverse = np.linalg.inv(LEVELS.make_model(sensors, 20e3).covariance(n, 1.0 / rate))
    constants = np.kron(np.eye(10), np.ones((n, 1))) * 1e-9
    found = []
    for phase in np.pi * np.arange(4) / 4:
        slopes = [(field(s, phase) - field(-s, phase)) / 2.0 for s in np.diag(steps)]  # for steps of size one
        unknowns = np.column_stack([*slopes, constants])
        found.append(np.linalg.inv(unknowns.T @ inverse @ unknowns)[:8, :8] * np.outer(steps, steps))
    dense = np.mean(found, axis=0)
    bound = at(sensors, window, block=1.0 / rate).covariance[0]
    scale = np.sqrt(np.diag(dense))
    np.testing.assert_allclose(bound / np.outer(scale, scale), dense / np.outer(scale, scale), atol=0.01)


def test_whitened_chain_with_the_true_noise_reaches_the_bound():
    sensors = array()
    noise = LEVELS.make_model(sensors, 20e3)
    n = WINDOW.count_samples(DEVICE.frequency)
    model = make_whitened_model(sensors, DEVICE, noise, np.ones(10, dtype=bool).tobytes(), n, 50e3, 0.02)
    covariances = []
    for phase in np.pi * np.arange(4) / 4:
        _, jacobian = model.compute_response(
            POSITION, matrix_from_quaternion(ORIENTATION), phase, DEVICE.theta_max / np.radians(30)
        )
        covariances.append(np.linalg.inv(jacobian.T @ jacobian)[:3, :3])
    reached = np.sqrt(np.trace(np.mean(covariances, axis=0)) / 3)
    assert reached == pytest.approx(at(sensors).position_rms[0], rel=0.005)


def test_noise_twice_as_large_doubles_the_bound():
    double = NoiseLevels(12e-12, 40e-12, 50.0, 19.6e-9, 42e-9, LEVELS.harmonics)
    ratio = at(array(), levels=double).position_rms[0] / at(array()).position_rms[0]
    assert ratio == pytest.approx(2.0, rel=1e-6)


def test_more_unknowns_never_help_and_a_slope_costs_little_in_a_long_window():
    for half_periods, most in ((2, 3.0), (6, 1.03)):
        window = ListeningWindow(half_periods, 50e3, 0.02)
        one, two = (at(array(), window, trend=trend).position_rms[0] for trend in (0, 1))
        assert one <= two <= most * one


def test_half_the_swing_is_known_half_as_well_and_a_little_less_for_its_harmonics():
    full, half = (at(array(), amplitude=a).position_rms[0] for a in (0.1, 0.05))
    assert 2.0 * full < half < 2.3 * full


def test_height_and_amplitude_are_correlated():
    assert 0.5 < abs(at(array()).height_amplitude_correlation[0]) < 1.0


def test_faults_are_named():
    rotation = np.eye(3)
    with pytest.raises(InputError, match="as many positions as rotations"):
        compute_pose_bound(array(), DEVICE, LEVELS.make_model(array()), [POSITION, POSITION], [rotation], WINDOW)
    with pytest.raises(InputError, match="longer blocks"):
        narrow = LEVELS.make_model(array(), 2500.0)
        compute_pose_bound(array(), DEVICE, narrow, [POSITION], [rotation], WINDOW, block=6e-5)
    with pytest.raises(InputError, match="longer window"):
        at(array(), ListeningWindow(0.1, 50e3, 0.02))
