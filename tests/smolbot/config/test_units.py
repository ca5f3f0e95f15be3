"""What files say in handy units comes in SI, from one place, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest

from smolbot.config.library import list_shipped
from smolbot.config.rig import load_rig
from smolbot.config.rig_sections import ContainerSection
from smolbot.config.units import SI, SIVector


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("size_mm", 44.0, 0.044),
        ("speed_mm_s", 12.0, 0.012),
        ("close_ms", 7.0, 0.007),
        ("pace_percent", 15.0, 0.15),
        ("roll_deg", 15.0, np.radians(15.0)),
        ("max_steering_deg_per_s", 90.0, np.radians(90.0)),
        ("range_ut", 10.0, 1e-5),
        ("sensitivity_v_per_ut", 1.5, 1.5e6),
        ("mains_gradient_nt_per_m", 30.0, 3e-8),
        ("floor_pt_per_rthz", 12.0, 1.2e-11),
    ],
)
def test_the_unit_at_the_end_of_a_key_says_what_it_is_in_si(key, value, expected):
    section = type("Section", (), {key: value, "one": SI(key)})()
    assert section.one == pytest.approx(expected, rel=1e-15)
    many = type("Section", (), {key: (value, -value), "both": SIVector(key)})()
    np.testing.assert_allclose(many.both, [expected, -expected], rtol=1e-15)


@pytest.mark.parametrize("name", list_shipped("rigs"))
def test_a_containers_corners_are_those_that_its_file_names(name):
    """Bit for bit as they were before one place worked them out: recorded flights depend on the last digit."""
    box = load_rig(name).container
    center, size = np.array(box.center_mm), np.array(box.size_mm)
    np.testing.assert_array_equal(box.low, np.array([*(center - 0.5 * size), box.floor_z_mm]) * 1e-3)
    np.testing.assert_array_equal(box.high, np.array([*(center + 0.5 * size), box.surface_z_mm]) * 1e-3)


def test_corners_lie_about_the_center():
    box = ContainerSection(center_mm=(5.0, -3.0), size_mm=(20.0, 40.0), floor_z_mm=40.0, surface_z_mm=55.0)
    np.testing.assert_allclose(box.low, [-5e-3, -23e-3, 40e-3], rtol=1e-12)
    np.testing.assert_allclose(box.high, [15e-3, 17e-3, 55e-3], rtol=1e-12)
