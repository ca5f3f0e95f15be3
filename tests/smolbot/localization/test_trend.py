"""Slow fields of tools that move past: they rise by more than the signal within a window, and must not move a pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smolbot.core.sensing import Recording
from smolbot.localization.forward import compute_deflection, compute_dipole_field, compute_sensor_field
from smolbot.localization.localizer import Localizer

RATE = 50_000.0


def record(array, device, pose, half_periods, scalpel, seed=0) -> Recording:
    n = round(half_periods * RATE / (2 * device.frequency))
    time = 0.02 + np.arange(n) / RATE
    theta = compute_deflection(device, time, 0.9 * device.theta_max, 0.4)
    field = compute_sensor_field(array, device, pose.position, pose.orientation, theta)
    field += 4e-10 * np.random.default_rng(seed).standard_normal(field.shape)
    if scalpel:
        track = np.stack([np.full(n, 0.04), 0.02 - 0.03 * time, np.full(n, 0.08)], axis=-1)
        blade = compute_dipole_field(array.positions[:, None] - track[None], np.array([0.0, 0.0, 15.97e-3]))
        field += np.einsum("ijk,ik->ij", blade, array.axes)
    return Recording(field, RATE, 0.02)


@pytest.mark.parametrize("half_periods", [2, 4, 6, 10, 20])
def test_a_passing_scalpel_does_not_move_a_pose(array, across_device, pose_at, half_periods):
    truth = pose_at((0, 0, 80))
    localizer = Localizer(array, across_device)
    quiet, disturbed = (localizer.locate(record(array, across_device, truth, half_periods, s), truth) for s in (0, 1))
    sigma = np.sqrt(np.diag(disturbed.covariance)[:3])
    assert disturbed.trusted
    assert np.all(np.abs(disturbed.position - quiet.position) < 4.0 * sigma + 2e-5)


def test_a_short_window_without_a_trend_costs_nothing(array, across_device, pose_at):
    truth = pose_at((0, 0, 80))
    recording = record(array, across_device, truth, 2, False)
    localizer = Localizer(array, across_device)
    alone = localizer._locate_with_trend(recording, truth, 0)[0]
    np.testing.assert_array_equal(localizer.locate(recording, truth).position, alone.position)


def test_the_degree_grows_with_the_window(array, across_device):
    device = replace(across_device, frequency=100.0)
    localizer = Localizer(array, device)
    for half_periods, degree in ((1, 0), (5, 0), (6, 1), (9, 1), (10, 2), (40, 2)):
        recording = Recording(np.zeros((len(array), round(half_periods * RATE / 200.0))), RATE, 0.02)
        assert localizer.free_trend(recording) == degree
    assert Localizer(array, device, estimator="paper").free_trend(recording) == 0
