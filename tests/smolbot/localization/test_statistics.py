"""The paper's statistics against scipy's and against sums by hand (Eqs. S20 to S30)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from smolbot.errors import InputError
from smolbot.localization import statistics as s

ANGLES = st.lists(st.floats(-0.7, 0.7), min_size=2, max_size=20)


@given(angles=ANGLES, turn=st.floats(-10.0, 10.0))
def test_circular_mean_and_deviation_are_scipys(angles, turn):
    turned = np.array(angles) + turn
    off = s.compute_circular_mean(turned) - stats.circmean(turned, high=np.pi, low=-np.pi)
    assert abs(s.wrap_angles(off)) < 1e-9
    assert s.compute_circular_standard_deviation(turned) == pytest.approx(stats.circstd(turned), abs=1e-7)


@given(angles=ANGLES, turn=st.integers(-3, 3))
def test_complete_turns_change_no_circular_statistic(angles, turn):
    plain = np.array(angles)
    turned = plain + 2.0 * np.pi * turn
    assert s.compute_circular_standard_deviation(turned) == pytest.approx(
        s.compute_circular_standard_deviation(plain), abs=1e-6
    )
    error = s.compute_differential_circular_mae(turned, np.zeros(len(plain)), [0.0])
    assert error == pytest.approx(s.compute_differential_circular_mae(plain, np.zeros(len(plain)), [0.0]), abs=1e-9)


def test_small_angles_have_the_statistics_of_lengths():
    rng = np.random.default_rng(3)
    angles = 1e-3 * rng.standard_normal((50, 4)) + rng.uniform(-3, 3, 4)
    zero = np.zeros(50)
    size = angles.size
    linear = s.compute_standard_deviation(angles) * np.sqrt((size - 1) / size)
    assert s.compute_circular_standard_deviation(angles) == pytest.approx(linear, rel=1e-3)
    one = angles[:, 0]
    assert s.compute_differential_circular_mae(one, zero, one) == pytest.approx(
        s.compute_differential_mae(one, zero, one), rel=1e-3
    )


def test_errors_of_either_sign_do_not_cancel_on_the_circle():
    errors = np.radians([1.0, -1.0, 359.0, -359.0])
    found = s.compute_differential_circular_mae(errors, np.zeros(4), [0.0])
    assert np.degrees(found) == pytest.approx(1.0)


def test_deviation_is_about_each_datasets_own_mean():
    data = np.array([[0.0, 100.0], [2.0, 104.0], [4.0, 108.0]])
    by_hand = np.sqrt((4 + 0 + 4 + 16 + 0 + 16) / 5)
    assert s.compute_standard_deviation(data) == pytest.approx(by_hand)
    moved = data + np.array([7.0, -50.0])
    assert s.compute_standard_deviation(moved) == pytest.approx(by_hand)


def test_the_reference_place_drops_out_of_differences():
    rng = np.random.default_rng(1)
    truth = np.linspace(0.0, 50.0, 11)
    measured = truth[:, None] + 0.1 * rng.standard_normal((11, 5))
    at_reference = measured[0]
    here = s.compute_differential_mae(measured, truth, at_reference)
    there = s.compute_differential_mae(measured + 8.0, truth, at_reference + 8.0)
    assert here == pytest.approx(there)
    by_hand = np.mean(np.abs(measured - truth[:, None] - at_reference.mean()))
    assert here == pytest.approx(by_hand)


def test_determination_is_one_minus_unexplained_share():
    rng = np.random.default_rng(2)
    x = np.arange(30.0)
    d = 2.0 * x + rng.standard_normal(30)
    line = stats.linregress(x, d)
    fitted = line.intercept + line.slope * x
    assert s.compute_r_squared(d, fitted) == pytest.approx(line.rvalue**2)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: s.compute_r_squared([1.0, np.nan], [1.0, 2.0]), "measured must be finite"),
        (lambda: s.compute_r_squared([1.0, 2.0], [1.0, 2.0, 3.0]), "must match"),
        (lambda: s.compute_circular_mean([0.0, np.pi]), "cancel"),
        (lambda: s.compute_r_squared([1.0, 1.0], [1.0, 2.0]), "differ"),
        (lambda: s.compute_standard_deviation([1.0]), "at least two"),
        (lambda: s.compute_circular_mean([]), "at least one"),
    ],
)
def test_statistics_that_have_no_meaning_are_refused(call, says):
    with pytest.raises(InputError, match=says):
        call()
