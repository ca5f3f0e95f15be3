"""Speed profiles: limits hold everywhere, and nothing is slower than they ask for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import linprog

from smolbot.errors import InputError
from smolbot.paths.curve import Curve
from smolbot.paths.speed_profile import CORNER_RADIUS, SpeedProfile, compute_speed_profile

SPEED, LATERAL = 2e-3, 0.2e-3


def in_space(points):
    flat = np.asarray(points, dtype=float)
    return np.column_stack([flat, np.zeros(len(flat))]) * 1e-3


def circle(radius, n=200):
    angle = np.linspace(0.0, 2.0 * np.pi, n)
    return in_space(radius * np.column_stack([np.cos(angle), np.sin(angle)]))


@pytest.mark.parametrize("radius", [1.0, 5.0, 15.0])
def test_a_circle_is_followed_at_the_speed_that_its_radius_allows(radius):
    profile = compute_speed_profile(circle(radius), SPEED, LATERAL)
    expected = min(SPEED, np.sqrt(LATERAL * radius * 1e-3))
    middle = profile.speed[len(profile.speed) // 4 : -len(profile.speed) // 4]
    assert middle == pytest.approx(expected, rel=1e-3)


def test_without_a_limit_the_speed_is_the_same_everywhere():
    curve = Curve(circle(3.0))
    profile = compute_speed_profile(curve.points, SPEED)
    assert profile.duration == pytest.approx(curve.length / SPEED)
    assert profile.at(0.5 * curve.length) == pytest.approx(SPEED)


def test_a_corner_is_braked_for_and_left_at_the_same_acceleration():
    profile = compute_speed_profile(in_space([[0, 0], [30, 0], [30, 30]]), SPEED, LATERAL, 0.1e-3)
    slow = np.sqrt(LATERAL * CORNER_RADIUS)
    away = np.abs(profile.arc - 30e-3)
    expected = np.minimum(np.sqrt(slow**2 + 2.0 * 0.1e-3 * away), SPEED)
    assert profile.speed == pytest.approx(expected, rel=1e-6)
    braking = (SPEED - slow) / 0.1e-3
    straight = 60e-3 - 2.0 * (SPEED**2 - slow**2) / (2.0 * 0.1e-3)
    assert profile.duration == pytest.approx(2.0 * braking + straight / SPEED, rel=1e-4)


@given(st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9)), min_size=3, max_size=7), st.floats(0.02e-3, 2e-3))
def test_no_limit_is_broken_on_any_path(points, lateral):
    kept = [p for k, p in enumerate(points) if k == 0 or p != points[k - 1]]
    if len(kept) < 2:
        return
    profile = compute_speed_profile(in_space(kept), SPEED, lateral, 0.1e-3)
    assert np.all(profile.speed <= SPEED * (1 + 1e-12))
    assert np.all(np.abs(np.diff(profile.speed**2)) <= 2.0 * 0.1e-3 * np.diff(profile.arc) * (1 + 1e-9) + 1e-18)


def test_no_profile_within_the_limits_is_quicker():
    points = np.vstack([in_space([[-12, 0], [-2, 0], [-2, 5]]), circle(2.0, 40)[5:30] + [0, 8e-3, 0]])
    profile = compute_speed_profile(points, SPEED, LATERAL, 0.05e-3)
    free = compute_speed_profile(points, SPEED, LATERAL, 1e9)  # limits of bends alone
    n, step = len(profile.arc), np.diff(profile.arc)
    rise = np.zeros((2 * (n - 1), n))
    for i in range(n - 1):
        rise[i, [i, i + 1]] = [-1.0, 1.0]
        rise[n - 1 + i, [i, i + 1]] = [1.0, -1.0]
    scale = SPEED**2
    best = linprog(
        -np.ones(n), rise, np.tile(2.0 * 0.05e-3 * step / scale, 2), bounds=[(0.0, v**2 / scale) for v in free.speed]
    )
    assert profile.speed**2 / scale == pytest.approx(best.x, abs=1e-7)


def test_time_and_place_are_each_others_inverse():
    profile = compute_speed_profile(in_space([[0, 0], [10, 0], [10, 10]]), SPEED, LATERAL)
    for s in (0.0, 3e-3, 10e-3, 17e-3):
        time = float(np.interp(s, profile.arc, profile.times))
        assert profile.after(0.0, time) == pytest.approx(s, abs=1e-9)
        assert profile.after(s, profile.duration) == pytest.approx(20e-3)
    times = np.linspace(0.0, 0.99 * profile.duration, 50)
    flow = solve_ivp(lambda _, s: [profile.at(float(s[0]))], (0.0, times[-1]), [0.0], t_eval=times, max_step=0.05)
    assert [profile.after(0.0, t) for t in times] == pytest.approx(flow.y[0], abs=0.03e-3)


def test_a_profile_must_go_forward():
    with pytest.raises(InputError, match=r"greater than 0 m/s; got 0"):
        SpeedProfile(np.array([0.0, 1.0]), np.array([1.0, 0.0]))
    with pytest.raises(InputError, match="rising arc lengths"):
        SpeedProfile(np.array([0.0, 0.0]), np.array([1.0, 1.0]))
