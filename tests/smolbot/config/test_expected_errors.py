"""The error that is to be expected of a pose: noise, swing, and what sensors and device may be off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smolbot.config.expected_errors import ExpectedErrors, compute_horizontal_rms
from smolbot.config.feasibility import compute_states_along, compute_swimming_orientation, make_noise_levels
from smolbot.config.load import load_mission
from smolbot.core.pose import Pose
from smolbot.core.rotations import matrix_from_quaternion
from smolbot.core.sensing import SensorArray
from smolbot.localization.array.filter import compute_tilt_frames
from smolbot.localization.bounds import ListeningWindow, Response
from smolbot.localization.localizer import Localizer
from smolbot.localization.sensor_uncertainty import compute_sensor_terms

NO_TOLERANCES = {f"rig.sensors.{key}": "0.0" for key in ("place_tolerance_mm", "gain_tolerance_percent",
                                                         "axis_tolerance_deg")}  # fmt: skip


def expect(**settings):
    mission = load_mission("line", settings={key.replace("__", "."): value for key, value in settings.items()})
    states = compute_states_along(mission, mission.path, np.array([2e-3, 6e-3]))
    return ExpectedErrors.expect(mission, *states)


@pytest.mark.parametrize("which", ["gain", "tilt", "place", "moment"])
def test_the_shift_by_a_deviating_sensor_is_that_of_a_fit(array, along_device, pose_at, hear, which):
    truth, frames = pose_at((3.0, -4.0, 60.0), 40.0), compute_tilt_frames(array)
    noise = make_noise_levels(load_mission("line").rig).make_model(array)
    response = Response(array, along_device, noise, ListeningWindow(2, 50_000.0, 0.02))
    sensitivity, _ = compute_sensor_terms(response, frames, truth.position[None], truth.rotation[None])
    q = np.zeros(sensitivity.shape[2])
    index = {"gain": 12, "tilt": 13, "place": 15, "moment": -2}[which]
    q[index] = {"gain": 3e-3, "tilt": 3e-3, "place": 1e-4, "moment": 1e-2}[which]
    own = q[:-2].reshape(-1, 6)
    axes = array.axes + np.einsum("nj,njk->nk", own[:, 1:3], frames)
    deviating = SensorArray(array.positions + own[:, 3:], axes, array.bandwidth, np.exp(own[:, 0]))
    device = replace(along_device, moment=along_device.moment * np.exp(q[-2]))
    localizer = Localizer(array, along_device, noise)
    prior = Pose(0.0, truth.position, truth.orientation, 1e-6 * np.eye(6))

    def find(sensors, of, phase):
        heard = hear(sensors, of, truth, phase=phase, amplitude=along_device.theta_max)
        return localizer.locate(heard, prior).position

    phases = np.pi * np.arange(4) / 4
    shift = np.mean([find(deviating, device, p) - find(array, along_device, p) for p in phases], axis=0)
    assert shift == pytest.approx(sensitivity[0, :3] @ q, rel=0.05, abs=0.02 * np.linalg.norm(shift))


def test_twice_the_tolerances_are_twice_the_errors_by_sensors_and_none_leaves_the_device():
    one = expect()
    two = expect(rig__sensors__place_tolerance_mm="0.4", rig__sensors__gain_tolerance_percent="1.0",
                 rig__sensors__axis_tolerance_deg="0.6")  # fmt: skip
    device = expect(
        **{key.replace(".", "__"): value for key, value in NO_TOLERANCES.items()}, rig__tank__mismatch__scale="0.0"
    )
    of = [compute_horizontal_rms(errors.compute_sensor_part()) for errors in (one, two, device)]
    assert of[1] ** 2 - of[2] ** 2 == pytest.approx(4.0 * (of[0] ** 2 - of[2] ** 2), rel=1e-3)
    assert np.all(of[2] < 0.5 * of[0])


def test_a_flight_learns_its_sensors_and_never_below_the_noise():
    errors = expect()
    after = [compute_horizontal_rms(errors.compute_covariances(n)) for n in (0, 10, 100, 1000)]
    assert np.all(np.diff(after, axis=0) < 0.0)
    assert np.all(after[-1] > compute_horizontal_rms(errors.noise))


def test_a_rig_that_states_no_tolerances_is_as_far_off_as_its_mismatch_says_and_learns_nothing():
    errors = expect(**{key.replace(".", "__"): value for key, value in NO_TOLERANCES.items()})
    assert errors.compute_sensor_part() == pytest.approx(expect().compute_sensor_part(), rel=1e-6)
    assert errors.compute_sensor_part(1000.0) == pytest.approx(errors.compute_sensor_part())


def test_a_device_that_swings_less_is_located_worse():
    strong, weak = expect(), expect(cycle__excite_current_a="1.5")
    assert np.all(compute_horizontal_rms(weak.noise) > 1.5 * compute_horizontal_rms(strong.noise))


@pytest.mark.parametrize("which", ["along", "across"])
def test_a_swimming_robot_has_its_moment_ahead_and_the_axis_of_its_swing_upright(devices, which):
    ahead = np.array([0.6, -0.8, 0.0])
    rotation = matrix_from_quaternion(compute_swimming_orientation(devices[which], ahead))
    assert rotation @ devices[which].moment_in_body == pytest.approx(ahead, abs=1e-12)
    assert rotation[:, 1] == pytest.approx([0.0, 0.0, 1.0], abs=1e-12)
