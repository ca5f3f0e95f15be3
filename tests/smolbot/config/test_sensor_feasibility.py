"""A mission whose device the rig cannot drive or hear is refused, with what it would need."""

from __future__ import annotations

import json

import numpy as np
import pytest

import smolbot
from smolbot.config.rig import load_rig
from smolbot.errors import ConfigError
from smolbot.localization.forward import compute_dipole_field


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"rig.sensors.bandwidth_hz": "60.0"}, "bandwidth of 60 Hz, below the device's resonance of 103.5 Hz"),
        ({"rig.sensors.range_ut": "0.03"}, "measure up to 30 nT, and the room alone has 59.8 nT"),
        ({"rig.sensors.adc_range_v": "0.03"}, "measure up to 30 nT"),
        ({"localization.quiet_s": "0.2"}, "localization.quiet_s=0.2: 0.2 s are too short to learn the noise from"),
        ({"rig.limits.max_listen_ms": "400.0"}, "it may listen for 400 ms; learning noise takes 610 ms"),
        ({"rig.limits.max_excitation_current_a": "0.001"}, "makes the device swing to 0.0"),
        ({"rig.sensors.adc_bits": "12"}, "A step is 4.9 nT: choose more adc_bits or a smaller adc_range_v"),
        ({"rig.sensors.range_ut": "0.07"}, "the robot's magnet saturates 10 of 10 sensors"),
    ],
)
def test_what_sensors_cannot_hear_is_refused(settings, words):
    with pytest.raises(ConfigError) as error:
        smolbot.load_mission("line", settings=settings)
    assert words in str(error.value)


def test_a_container_smaller_than_the_robot_is_named_so():
    with pytest.raises(ConfigError, match=r"the container of 3 x 3 mm is too small for this robot, which needs 4.9 mm"):
        smolbot.load_mission("line", settings={"rig.container.size_mm": "[3.0, 3.0]"})


def test_a_window_beyond_the_limit_is_refused_before_its_bound_is_computed():
    settings = {"cycle.half_periods": "400", "rig.limits.max_listen_ms": "1000.0"}
    with pytest.raises(ConfigError, match=r"Listen window must last at most 1 s; got 1.932 s") as error:
        smolbot.load_mission("line", settings=settings)
    assert "localization error" not in str(error.value)


@pytest.mark.parametrize(
    "settings",
    [{"rig.sensors.bandwidth_hz": "104.0"}, {"localization.quiet_s": "0.0"}, {"rig.sensors.adc_bits": "14"}],
)
def test_what_suffices_is_read(settings):
    assert smolbot.load_mission("line", settings=settings).name == "line"


def test_the_largest_reading_of_a_magnet_is_that_of_its_worst_direction():
    from smolbot.config.sensor_feasibility import _compute_largest_fields

    random = np.random.default_rng(4)
    place, axis = np.array([0.02, -0.01, -0.05]), np.array([0.6, 0.0, 0.8])
    moments = random.standard_normal((20_000, 3))
    moments /= np.linalg.norm(moments, axis=1)[:, None]
    readings = [abs(compute_dipole_field(place[None, :], m)[0] @ axis) for m in moments]
    largest = _compute_largest_fields(place[None, :], axis[None, :], np.zeros((1, 3)))[0, 0]
    assert max(readings) == pytest.approx(largest, rel=1e-2)
    assert max(readings) <= largest


def test_sensors_under_the_robot_that_saturate_are_too_few():
    near = [[x, y, 44.0] for x in (-8.0, -2.0, 4.0) for y in (-8.0, -2.0, 4.0)] + [[8.0, 8.0, 44.0]]
    settings = {"rig.sensors.positions_mm": json.dumps(near), "rig.excitation": "[]"}
    assert load_rig("tank").sensor_range == pytest.approx(1e-5)
    with pytest.raises(ConfigError, match=r"saturates \d+ of 10 sensors"):
        smolbot.load_mission("line", settings={k: v for k, v in settings.items() if k != "rig.excitation"})


def test_the_field_of_an_excitation_coil_is_that_of_magpylib():
    from smolbot.config.drive_feasibility import compute_flat_coil_field

    points = np.array([[0.0, 0.0, 0.06], [0.02, -0.015, 0.05], [-0.02, 0.02, 0.065]])
    for coil in load_rig("tank").flat_coils():
        assert compute_flat_coil_field(coil, points) == pytest.approx(coil.field(points), rel=0.01, abs=1e-7)
