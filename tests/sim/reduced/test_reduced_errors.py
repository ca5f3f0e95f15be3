"""Errors of the reduced plant's poses: those of the mission's own localizer, had it heard the signal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim.reduced.fit_errors import FitErrors, SignalSource
from smolbot.config.feasibility import make_noise_levels
from smolbot.core.rotations import compute_rotation_error
from smolbot.core.sensing import Recording
from smolbot.localization.expected_covariance import compute_expected_covariance
from smolbot.localization.forward import compute_deflection, compute_sensor_field
from smolbot.localization.localizer import Localizer

PLACE = ((3.0, -5.0, 59.6), 25.0)
AMPLITUDE = np.radians(14.0)
RATE, SINCE = 50_000.0, 0.02


class Silence:
    """A generator that draws no noise, and phase zero."""

    def random(self):
        return 0.0

    def standard_normal(self, n):
        return np.zeros(n)


@pytest.fixture(scope="module")
def room(array, line):
    return make_noise_levels(line.rig).sample_room_model(array, 3)


def heard_by(sensors, device, room):
    return SignalSource(sensors.positions, sensors.axes, device.moment * device.moment_in_body, device.l0, room)


def a_little_wrong(array, device):
    """Sensors and device as `[tank.mismatch]` draws them, and half of it again."""
    rng = np.random.default_rng(2)
    positions = array.positions + 0.3e-3 * rng.standard_normal(array.positions.shape)
    axes = array.axes + np.radians(0.4) * rng.standard_normal(array.axes.shape)
    true = replace(device, moment=1.02 * device.moment, l0=0.97 * device.l0)
    return replace(array, positions=positions, axes=axes), true


def error_of(fitted, truth):
    return np.concatenate(
        [fitted.position - truth.position, compute_rotation_error(fitted.orientation, truth.orientation)]
    )


@pytest.mark.parametrize("half_periods", [2, 6])
@pytest.mark.parametrize("estimator", ["whitened", "paper"])
def test_wrong_sensors_and_magnets_move_a_synthetic_pose_as_they_move_a_fit(
    estimator, half_periods, array, along_device, pose_at, line, room
):
    truth = pose_at(*PLACE)
    sensors, device = a_little_wrong(array, along_device)
    localizer = Localizer(array, along_device, room, estimator)
    n = round(half_periods * RATE / (2.0 * device.frequency))
    theta = compute_deflection(device, SINCE + np.arange(n) / RATE, AMPLITUDE, 0.0)
    field = compute_sensor_field(sensors, device, truth.position, truth.orientation, theta)
    fit, swing = localizer.locate_swing(Recording(field, RATE, SINCE), truth)
    errors = FitErrors(localizer, line.rig, heard_by(sensors, device, room), Silence())
    drawn = errors.sample(truth.position, truth.orientation, AMPLITUDE, half_periods, SINCE)
    expected = np.concatenate(
        [fit.position - truth.position, compute_rotation_error(fit.orientation, truth.orientation)]
    )
    assert np.linalg.norm(expected[:3]) > 0.1e-3
    assert error_of(drawn, truth)[:3] == pytest.approx(expected[:3], abs=0.03e-3 + 0.05 * np.abs(expected[:3]).max())
    assert error_of(drawn, truth)[3:] == pytest.approx(expected[3:], abs=np.radians(0.3))
    assert drawn.amplitude == pytest.approx(swing.amplitude, rel=0.01)
    if estimator == "whitened":
        sigma, claimed = np.sqrt(np.diag(swing.covariance)), np.sqrt(np.diag(drawn.covariance))
        assert claimed == pytest.approx(sigma, rel=0.1)
        assert 1.0 - drawn.r_squared == pytest.approx(1.0 - fit.r_squared, rel=0.3)


def test_poses_scatter_as_their_covariance_claims(array, along_device, pose_at, line, room):
    truth = pose_at(*PLACE)
    errors = FitErrors(
        Localizer(array, along_device), line.rig, heard_by(array, along_device, room), np.random.default_rng(5)
    )
    drawn = [errors.sample(truth.position, truth.orientation, AMPLITUDE, 2, SINCE) for _ in range(4000)]
    found = np.array([[*error_of(d, truth), d.amplitude - AMPLITUDE] for d in drawn])
    claimed = np.mean([d.covariance for d in drawn], axis=0)
    scatter = np.cov(found.T)
    sigma = np.sqrt(np.diag(claimed))
    assert np.sqrt(np.diag(scatter)) == pytest.approx(sigma, rel=0.06)
    assert scatter / np.outer(sigma, sigma) == pytest.approx(claimed / np.outer(sigma, sigma), abs=0.08)
    distances = np.array([x @ np.linalg.solve(d.covariance, x) for x, d in zip(found, drawn)])
    assert distances.mean() == pytest.approx(7.0, rel=0.06)
    assert np.mean(distances > 18.475) == pytest.approx(0.01, abs=0.006)  # chi-square of 7 degrees


def test_poses_of_the_papers_estimator_scatter_as_expected_of_it(array, along_device, pose_at, line, room):
    truth = pose_at(*PLACE)
    errors = FitErrors(
        Localizer(array, along_device, estimator="paper"), line.rig, heard_by(array, along_device, room),
        np.random.default_rng(6),
    )  # fmt: skip
    drawn = [errors.sample(truth.position, truth.orientation, AMPLITUDE, 2, SINCE) for _ in range(3000)]
    scatter = np.sqrt(np.var([error_of(d, truth) for d in drawn], axis=0))
    wanted = compute_expected_covariance(
        array, along_device, make_noise_levels(line.rig), truth, 2, RATE, SINCE, AMPLITUDE
    )
    assert scatter == pytest.approx(np.sqrt(np.diag(wanted)), rel=0.1)


def test_a_smaller_swing_is_located_less_well_and_none_not_at_all(array, along_device, pose_at, line, room):
    truth = pose_at(*PLACE)
    errors = FitErrors(
        Localizer(array, along_device), line.rig, heard_by(array, along_device, room), np.random.default_rng(7)
    )

    def draw(amplitude):
        return errors.sample(truth.position, truth.orientation, amplitude, 2, SINCE)

    sigmas = [np.sqrt(np.median([draw(a).covariance[0, 0] for _ in range(20)])) for a in (0.3, 0.15)]
    assert 1.6 < sigmas[1] / sigmas[0] < 2.4
    assert draw(1e-5).r_squared < 0.7


def test_doubled_mismatches_double_the_systematic_error(line):
    from sim.reduced.rig import ReducedRig
    from sim.tank.settings import TankSettings
    from smolbot.config.document import validate

    settings, _ = validate(TankSettings, line.rig.sections.tank, ("tank",))

    def bias(scale):
        scaled = settings.model_copy(update={"mismatch": settings.mismatch.model_copy(update={"scale": scale})})
        rig = ReducedRig(line.rig, line.robot, scaled, np.zeros(2), 2)
        localizer = Localizer(rig.sensors, line.robot.device)
        rig.make_synthetic_localizer(localizer)
        errors = rig._errors
        errors._rng = Silence()
        fitted = errors.sample(np.array([0.0, 0.0, 0.0596]), np.array([0.5, 0.5, 0.5, 0.5]), AMPLITUDE, 2, SINCE)
        return fitted.position - [0.0, 0.0, 0.0596]

    ideal, once, twice = bias(0.0), bias(1.0), bias(2.0)
    assert np.linalg.norm(ideal) < 0.05e-3
    assert np.linalg.norm(once) > 0.2e-3
    assert np.linalg.norm(twice) / np.linalg.norm(once) == pytest.approx(2.0, rel=0.25)
