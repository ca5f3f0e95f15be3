"""How well a pose can be expected to be known, against repeated draws of the noise that was described."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smolbot.core.rotations import compute_rotation_error, quaternion_from_matrix
from smolbot.core.sensing import Recording
from smolbot.localization.basis import REFERENCE_ANGLE
from smolbot.localization.expected_covariance import compute_expected_covariance
from smolbot.localization.noise.room import NoiseLevels
from smolbot.localization.problem import prepare_paper

RATE = 50_000.0
NOISE = NoiseLevels(6e-12, 20e-12, 50.0, 8e-9, 11.5e-9, {2: 0.1, 3: 0.3, 5: 0.1})


def coloured(rng, noise, n_channels, n, length=2**13):
    """Sensor noise from `at_1hz` at 1 Hz falling as 1/f in power to its floor, by shaping white noise."""
    f = np.fft.rfftfreq(length, 1 / RATE)
    density = np.sqrt(noise.floor**2 + (noise.at_1hz**2 - noise.floor**2) / np.maximum(f, 0.5))
    density[f > 4000] = 0.0
    white = np.fft.rfft(rng.normal(size=(n_channels, length)) * np.sqrt(RATE / 2))
    return np.fft.irfft(white * density, length)[:, :n]


def mains(rng, noise, sensors, time):
    """Lines of random direction and phase; over directions, the field's change per metre has the described peak."""
    out = np.zeros((len(sensors), len(time)))
    for order, size in {1: 1.0, **noise.harmonics}.items():
        uniform = rng.normal(size=3)
        uniform *= noise.mains / np.linalg.norm(uniform)
        a = rng.normal(size=(3, 3))
        gradient = (a + a.T) / 2 - np.trace(a) / 3 * np.eye(3)
        gradient *= np.sqrt(3) * noise.mains_gradient / np.linalg.norm(gradient)  # |G u|² averages to g² over u
        field = uniform + sensors.positions @ gradient
        wave = np.cos(2 * np.pi * order * noise.mains_frequency * time + rng.uniform(0, 2 * np.pi))
        out += size * np.sum(field * sensors.axes, axis=1)[:, None] * wave
    return out


def scatter_of_fits(sensors, device, noise, pose, half_periods, repeats, amplitude):
    n = round(half_periods * RATE / (2 * device.frequency))
    rng, errors = np.random.default_rng(8), []
    any_samples = np.random.default_rng(1).standard_normal((len(sensors), n))
    prepared = prepare_paper(Recording(any_samples, RATE, 0.02), sensors, device)
    time, size = np.arange(n) / RATE, amplitude / REFERENCE_ANGLE
    for i in range(repeats):
        phase = np.pi * (i % 4) / 4
        clean, _ = prepared.model.compute_response(pose.position, pose.rotation, phase, size)
        field = coloured(rng, noise, len(sensors), n) + mains(rng, noise, sensors, time)
        prepared_noise = prepare_paper(Recording(field, RATE, 0.02), sensors, device)
        fit = replace(prepared_noise, data=prepared_noise.data + clean).fit(pose.position, pose.rotation, phase, size)
        turn = compute_rotation_error(quaternion_from_matrix(fit.rotation), pose.orientation)
        errors.append([*(fit.position - pose.position), *turn])
    return np.sqrt(np.mean(np.square(errors), axis=0))


@pytest.mark.parametrize(("half_periods", "mains_share"), [(2, 1.0), (6, 1.0), (2, 0.0)])
def test_expected_covariance_is_the_scatter_under_the_described_noise(
    array, along_device, pose_at, half_periods, mains_share
):
    noise = replace(NOISE, mains=8e-9 * mains_share, mains_gradient=11.5e-9 * mains_share)
    pose, amplitude = pose_at((4, -6, 60), 35), 0.8 * along_device.theta_max
    expected = compute_expected_covariance(array, along_device, noise, pose, half_periods, RATE, 0.02, amplitude)
    seen = scatter_of_fits(array, along_device, noise, pose, half_periods, 300, amplitude)
    assert seen == pytest.approx(np.sqrt(np.diag(expected)), rel=0.25)


def test_listening_longer_and_swinging_wider_are_expected_to_help(array, along_device, pose_at):
    pose = pose_at((4, -6, 80), 35)

    def error(half_periods=2, amplitude=0.2, noise=NOISE):
        c = compute_expected_covariance(array, along_device, noise, pose, half_periods, RATE, 0.02, amplitude)
        return float(np.sqrt(np.trace(c[:3, :3])))

    assert error(half_periods=6) < error(half_periods=2) < error(half_periods=1)
    assert error(amplitude=0.4) < error(amplitude=0.2)
    # all levels doubled: errors doubled
    double = NoiseLevels(12e-12, 40e-12, 50.0, 16e-9, 23e-9, NOISE.harmonics)
    assert error(noise=double) == pytest.approx(2 * error())
