"""Whether each sensor of a fit agrees with the others: what noise and tolerances explain, and what they do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smolbot.config.rig import load_rig
from smolbot.config.robot import load_robot
from smolbot.core.rotations import quaternion_from_axes
from smolbot.core.sensing import Recording
from smolbot.localization.array.consistency import compute_gain_sigmas, compute_sigmas
from smolbot.localization.array.filter import compute_tilt_frames
from smolbot.localization.forward import compute_deflection, compute_sensor_field
from smolbot.localization.localizer import Localizer
from smolbot.localization.noise.model import NoiseModel

RATE, NOISE = 20e3, 2e-10
SENSORS = load_rig("tank").sensors
DEVICE = load_robot("gradient").device
FRAMES = compute_tilt_frames(SENSORS)
TOLERANCES = np.diag(np.append(np.tile([5e-3, 5e-3, 5e-3, 2e-4, 2e-4, 2e-4], len(SENSORS)), [0.02, 4e-5]) ** 2)
MIN_SIGMAS = 5.0


@pytest.fixture(scope="module")
def localizer():
    rng = np.random.default_rng(1)
    quiet = [Recording(NOISE * rng.standard_normal((len(SENSORS), 20000)), RATE, np.inf) for _ in range(4)]
    return Localizer(SENSORS, DEVICE, NoiseModel.learn(quiet))


def make_recording(rng, sensors=SENSORS):
    place = np.array([*rng.uniform(-0.012, 0.012, 2), 0.06])
    heading = rng.uniform(-np.pi, np.pi)
    orientation = quaternion_from_axes(
        np.array([np.cos(heading), np.sin(heading), 0.0]), np.array([0.0, 0.0, 1.0]), "zy"
    )
    time = 0.005 + np.arange(round(RATE / DEVICE.frequency)) / RATE
    theta = compute_deflection(DEVICE, time, 0.7 * DEVICE.theta_max, rng.uniform(0.0, 6.0))
    field = compute_sensor_field(sensors, DEVICE, place, orientation, theta)
    return Recording(field + NOISE * rng.standard_normal(field.shape), RATE, 0.005)


def check(localizer, recording):
    return localizer.locate_swing(recording)[1].check_channels(FRAMES, TOLERANCES)


@pytest.mark.parametrize("seed", range(6))
def test_sensors_within_their_tolerances_agree_with_each_other(localizer, seed):
    rng = np.random.default_rng(seed)
    off = replace(
        SENSORS,
        positions=SENSORS.positions + 2e-4 * rng.standard_normal((len(SENSORS), 3)),
        gains=1.0 + 5e-3 * rng.standard_normal(len(SENSORS)),
    )
    assert check(localizer, make_recording(rng, off)).sigmas.max() < MIN_SIGMAS


@pytest.mark.parametrize("channel", range(0, 10, 3))
@pytest.mark.parametrize("gain", [0.5, 2.0])
def test_the_sensor_whose_gain_has_changed_deviates_most(localizer, channel, gain):
    recording = make_recording(np.random.default_rng(channel))
    field = recording.field.copy()
    field[channel] *= gain
    sigmas = check(localizer, replace(recording, field=field)).sigmas
    assert np.argmax(sigmas) == channel
    assert sigmas[channel] > MIN_SIGMAS


def test_a_sensor_that_took_no_part_deviates_by_nothing(localizer):
    recording = make_recording(np.random.default_rng(2))
    saturated = np.zeros(len(SENSORS), dtype=np.bool_)
    saturated[4] = True
    sigmas = check(localizer, replace(recording, saturated=saturated)).sigmas
    assert sigmas[4] == -np.inf
    assert np.isfinite(np.delete(sigmas, 4)).all()


def test_the_cube_root_of_chi_square_is_normal():
    stats = pytest.importorskip("scipy.stats")
    for freedom in (9.0, 14.0, 80.0):  # of one sensor's response, and of a complete fit
        for sigmas in (2.0, 3.0, 5.0):
            chi_square = stats.chi2.isf(stats.norm.sf(sigmas), freedom)
            assert compute_sigmas(np.array(chi_square), np.array(freedom)) == pytest.approx(sigmas, abs=0.15)


def test_deviations_as_likely_as_the_tolerances_say_are_no_change_of_gain():
    """In many worlds, the deviation of a sensor that works is a standard normal number."""
    rng = np.random.default_rng(3)
    rows = rng.standard_normal((40, len(TOLERANCES))) / np.sqrt(np.diag(TOLERANCES))
    information = rows.T @ rows
    found = []
    for _ in range(200):
        q = np.sqrt(np.diag(TOLERANCES)) * rng.standard_normal(len(TOLERANCES))
        right = rows.T @ (rows @ q + rng.standard_normal(len(rows)))
        found.append(compute_gain_sigmas(information, right, TOLERANCES))
    assert np.mean(np.square(found)) == pytest.approx(1.0, abs=0.1)
