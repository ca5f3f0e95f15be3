"""Fit residuals of a channel are noise as predicted, or show which sensor has changed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smolbot.core.sensing import Recording
from smolbot.flight.tracking.noise_monitor import POWER_RATIO_RANGE, NoiseMonitor
from smolbot.localization.localizer import Localizer
from smolbot.localization.noise.model import NoiseModel

RATE = 50_000.0
FLOOR = 6e-12


def noise_of(array, samples: int, rng: np.random.Generator, louder: dict[int, float]) -> np.ndarray:
    """White sensors, of which some have so many times the power, and mains from one direction."""
    size = np.full(len(array), FLOOR * np.sqrt(RATE / 2.0))
    for sensor, power in louder.items():
        size[sensor] *= np.sqrt(power)
    wave = np.cos(2.0 * np.pi * 50.0 * np.arange(samples) / RATE + rng.uniform(0.0, 2.0 * np.pi))
    mains = 10e-9 * np.outer(array.axes @ np.array([0.6, 0.48, 0.64]), wave)
    constant = 50e-9 * rng.standard_normal((len(array), 1))
    return size[:, None] * rng.standard_normal((len(array), samples)) + mains + constant


def room(array) -> NoiseModel:
    """That noise, learned."""
    rng = np.random.default_rng(99)
    return NoiseModel.learn([Recording(noise_of(array, round(RATE), rng, {}), RATE, np.nan) for _ in range(10)])


def watched(array, device, truth, clean, louder, shots=60, seed=0):
    rng, noise = np.random.default_rng(seed), room(array)
    localizer = Localizer(array, device, noise)
    found, expected = np.zeros(len(array)), np.zeros(len(array))
    for _ in range(shots):
        recording = replace(clean, field=clean.field + noise_of(array, clean.field.shape[1], rng, louder))
        one, other = localizer.locate_swing(recording, truth)[1].compute_energies(recording, noise)
        found, expected = found + one, expected + other
    return found, expected


@pytest.mark.parametrize("half_periods", [2, 6, 20])
def test_of_noise_as_predicted_the_residual_energy_is_the_expected_one(array, devices, pose_at, hear, half_periods):
    truth = pose_at((2, -3, 75))
    clean = hear(array, devices["along"], truth, half_periods)
    found, expected = watched(array, devices["along"], truth, clean, {}, shots=40)
    assert np.all(expected > 0.0)
    np.testing.assert_allclose(found / expected, 1.0, atol=0.05 + 4.0 * np.sqrt(2.0 / expected.min()))


@pytest.mark.parametrize("power", [4.0, 12.0])
def test_a_sensor_that_became_noisier_is_the_one_that_stands_out(array, devices, pose_at, hear, power):
    truth = pose_at((2, -3, 75))
    clean = hear(array, devices["along"], truth)
    found, expected = watched(array, devices["along"], truth, clean, {3: power})
    ratios = found / expected
    assert np.argmax(ratios) == 3
    assert ratios[3] == pytest.approx(power, rel=0.3)
    assert np.all(np.delete(ratios, 3) < 0.3 * power + 0.2)  # they were predicted with its help


def test_a_constant_sensor_is_not_evaluated(array, devices, pose_at, hear):
    truth = pose_at((2, -3, 75))
    recording = hear(array, devices["along"], truth)
    recording.field[:] += noise_of(array, recording.field.shape[1], np.random.default_rng(1), {})
    recording.field[4] = 2e-8
    noise = room(array)
    found, expected = (
        Localizer(array, devices["along"], noise).locate_swing(recording, truth)[1].compute_energies(recording, noise)
    )
    assert found[4] == expected[4] == 0.0
    assert np.all(np.delete(expected, 4) > 0.0)


def test_the_refreshed_model_has_the_covariance_of_the_new_noise(array):
    noise, ratios = room(array), np.ones(len(array))
    ratios[2] = 9.0
    before, after = (m.covariance(4, 5e-4) for m in (noise, noise.rescaled(ratios)))
    own = slice(2 * 4, 3 * 4)
    mains = replace(noise, spectrum=0.0 * noise.spectrum).covariance(4, 5e-4)[own, own]
    np.testing.assert_allclose(after[own, own] - mains, 9.0 * (before[own, own] - mains), rtol=1e-3, atol=1e-26)
    assert np.linalg.eigvalsh(after).min() > 0.0


def test_the_monitor_waits_for_significance_and_then_starts_anew():
    rng, watch = np.random.default_rng(5), NoiseMonitor(3)
    answers = [watch.update(rng.chisquare(20, 3) * [1.0, 4.0, 1.0], np.full(3, 20.0)) for _ in range(40)]
    given = [a for a in answers if a is not None]
    assert [i for i, a in enumerate(answers) if a is not None] == [19, 39]
    for ratios in given:
        assert ratios == pytest.approx([1.0, 4.0, 1.0], rel=0.3)


def test_the_monitor_reports_nothing_for_noise_as_predicted_and_limits_a_change():
    rng, watch = np.random.default_rng(6), NoiseMonitor(10)
    assert all(watch.update(rng.chisquare(20, 10), np.full(10, 20.0)) is None for _ in range(4000))
    leap = [watch.update(np.array([2e6]), np.array([20.0])) for watch in [NoiseMonitor(1)] for _ in range(20)][-1]
    assert leap == pytest.approx(POWER_RATIO_RANGE[1])
