"""What counts as a visit of a path: all of it, in order, and nothing twice for having been near it once."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smolbot.errors import InputError
from smolbot.paths.curve import Curve
from smolbot.paths.visits import divide_path, find_visits

TOLERANCE = 0.8e-3


def curve(xy_mm):
    flat = 1e-3 * np.asarray(xy_mm, dtype=float)
    return Curve(np.column_stack([flat, np.full(len(flat), 0.06)]))


def circle(radius, turns=1.0, begin=0.0, points=181):
    angle = begin + np.linspace(0.0, 2.0 * np.pi * turns, points)
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def figure_eight():
    a = np.linspace(0.0, 2.0 * np.pi, 201)
    return curve(np.column_stack([8.0 * np.sin(a), 5.0 * np.sin(2.0 * a)]))


def line_with_loop(radius):
    loop = circle(radius, begin=-np.pi / 2) + [0.0, radius]
    return curve(np.vstack([[-6.0, 0.0], loop, [6.0, 0.0]]))


PATHS = {
    "figure eight": figure_eight(),
    "circle twice": curve(circle(7.0, 2.0, points=401)),
    "circle begun elsewhere": curve(circle(5.0, begin=2.0)),
    "there and back": curve([[-6, 0], [6, 0], [-6, 0]]),
    "spiral": curve(circle(1.0, 3.0, points=301) * np.linspace(1.0, 7.0, 301)[:, None]),
    "cusps": curve(8.0 * circle(1.0) ** 3),
    "small loop": line_with_loop(0.5),
    "corner": curve([[0, 0], [4, 0], [4, 3]]),
}


@pytest.mark.parametrize("name", PATHS)
@pytest.mark.parametrize("share", [0.25, 0.5, 0.75, 1.0])
def test_a_part_of_any_path_is_visited_by_flying_it_and_hardly_more(name, share):
    """What lies within the tolerance of the last place counts too: on ahead, and where the path comes by again."""
    path = PATHS[name]
    rng = np.random.default_rng(0)
    trail = path.at(np.linspace(0.0, share * path.length, 400)) + 0.1e-3 * rng.normal(size=(400, 3))
    visited = find_visits(path, trail, TOLERANCE).share
    assert share - 1e-2 <= visited <= share + 4.0 * TOLERANCE / path.length + 1e-2


@pytest.mark.parametrize("name", ["figure eight", "spiral", "corner", "cusps"])
def test_a_path_flown_backwards_is_not_visited_in_order(name):
    path = PATHS[name]
    backwards = path.at(np.linspace(path.length, 0.0, 400))
    assert find_visits(path, backwards, TOLERANCE).share < 0.55


@pytest.mark.parametrize("radius", [0.3, 0.5, 1.0, 2.0])
def test_a_loop_that_a_robot_passes_by_is_not_visited(radius):
    path = line_with_loop(radius)
    past = 1e-3 * np.column_stack([np.linspace(-6.0, 6.0, 100), np.zeros(100), np.full(100, 60.0)])
    missed = 2.0 * np.pi * radius * 1e-3 / path.length
    visits = find_visits(path, past, TOLERANCE)
    assert visits.share < 1.0 - 0.6 * missed
    assert "near (" in visits.describe_longest_skip(path)


def test_a_loop_is_not_visited_from_its_middle():
    path = curve(circle(0.6))
    assert find_visits(path, np.array([[0.0, 0.0, 0.06]]), TOLERANCE).share == 0.0


def test_a_part_that_was_left_out_is_named_by_its_place():
    path = figure_eight()
    half = path.at(np.linspace(0.0, 0.5 * path.length, 200))
    visits = find_visits(path, half, TOLERANCE)
    (begin, end), = visits.skipped  # fmt: skip
    assert begin == pytest.approx(0.5 * path.length, abs=2.0 * TOLERANCE)
    assert end == pytest.approx(path.length, abs=2.0 * TOLERANCE)
    assert find_visits(path, path.points, TOLERANCE).describe_longest_skip(path) == ""


def test_straight_lines_join_the_positions_and_rows_without_a_position_are_left_out():
    path = curve([[-6, 0], [6, 0]])
    ends = np.array([path.points[0], [np.nan, np.nan, np.nan], path.points[-1]])
    assert find_visits(path, ends, TOLERANCE).share == 1.0


def test_nothing_is_visited_by_nobody():
    assert find_visits(figure_eight(), np.zeros((0, 3)), TOLERANCE).share == 0.0


def test_a_detour_and_a_retreat_cost_nothing():
    path = curve([[-6, 0], [6, 0]])
    there = [[-6, 0], [0, 0], [0, 3], [0, 0], [-4, 0], [6, 0]]
    assert find_visits(path, curve(there).points, TOLERANCE).share == 1.0


@settings(max_examples=12)
@given(st.integers(0, 2**32 - 1))
def test_the_share_is_the_greatest_of_all_monotone_assignments(seed):
    """Against a plain table over all pairs of places and cells."""
    rng = np.random.default_rng(seed)
    path = curve(np.cumsum(rng.normal(size=(6, 2)), axis=0) + rng.normal(size=2))
    trail = curve(np.cumsum(rng.normal(size=(8, 2)), axis=0)).points
    cells = divide_path(path, TOLERANCE)
    step = TOLERANCE / 4.0
    places = [trail[:1]]
    for a, b in pairwise(trail):
        count = int(np.ceil(np.linalg.norm(b - a) / step))
        places.append(a + np.arange(1, count + 1)[:, None] / count * (b - a))
    most = np.zeros(len(cells.places) + 1, dtype=int)
    for place in np.vstack(places)[:, :2]:
        within = np.linalg.norm(cells.places - place, axis=1) <= cells.reach
        for j in range(len(within)):
            most[j + 1] = max(most[j + 1], most[j] + int(within[j]))
    assert find_visits(path, trail, TOLERANCE).share == pytest.approx(most[-1] / len(cells.places))


@pytest.mark.parametrize("tolerance", [0.0, -1e-3, float("nan")])
def test_a_tolerance_must_be_greater_than_0(tolerance):
    with pytest.raises(InputError, match="tolerance of a visit"):
        find_visits(figure_eight(), np.zeros((1, 3)), tolerance)
