"""Where a robot is on its way: corners end legs, progress never runs back, a strand nearby does not catch it."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.path_progress import PathProgress
from smolbot.paths.curve import Curve
from smolbot.paths.glyphs import make_glyph

HOOK = Curve(np.array([[0, 0, 60], [4, 0, 60], [4, 3, 60]]) * 1e-3)


def letter_r():
    flat = make_glyph("R", 16.0, 24.0) * 1e-3
    return Curve(np.column_stack([flat, np.full(len(flat), 0.06)]))


def test_a_letter_r_has_legs_between_its_three_corners_and_a_smooth_bowl():
    course = PathProgress(letter_r())
    places = course.points[course.stops] * 1e3
    assert places == pytest.approx(np.array([[-8, -12], [-8, 12], [-8, 0], [8, -12]]), abs=1e-6)


def test_a_robot_that_follows_the_path_passes_leg_after_leg_to_the_end():
    path = letter_r()
    course = PathProgress(path)
    rng = np.random.default_rng(0)
    seen = []
    for s in np.arange(0.0, path.length + 1e-4, 2e-4):
        course.locate(path.at(s) + 1e-4 * rng.normal(size=3), 3e-4)
        seen.append(course.progress)
        if not course.done:
            assert abs(course.arc_length - s) < 1e-3  # where the bowl comes back to the stem, it is not taken for it
    assert np.all(np.diff(seen) >= 0.0)
    assert course.done
    assert course.progress == pytest.approx(path.length)


def test_before_the_start_nothing_is_behind():
    course = PathProgress(HOOK)
    course.locate(np.array([2e-3, 0.0]), 3e-4)
    assert (course.leg, course.progress, course.leg_end) == (-1, 0.0, 0.0)
    course.locate(np.array([2e-4, 0.0]), 3e-4)
    assert course.leg == 0
    assert course.leg_end == pytest.approx(4e-3)


@pytest.mark.parametrize(("place", "leg"), [((3.6, 0.0), 0), ((3.75, 0.0), 1), ((4.1, -0.9), 1)])
def test_a_corner_is_reached_when_it_is_near_or_passed(place, leg):
    course = PathProgress(HOOK)
    for x in (0.0, 1.0, 2.0, 3.0):
        course.locate(np.array([x, 0.0]) * 1e-3, 3e-4)
    course.locate(np.array(place) * 1e-3, 3e-4)
    assert course.leg == leg


def test_the_nearest_place_is_that_of_the_curve():
    path = Curve(letter_r().points[1:-1])
    course = PathProgress(path)
    for s in np.arange(0.0, path.length - 1e-3, 5e-4):
        place = path.at(s) + np.array([1e-4, 1e-4, 0.0])
        course.locate(place, 2e-4)
        assert course.arc_length == pytest.approx(path.project(place[None])[0][0], abs=1e-12)


@pytest.mark.parametrize("handover", [3e-4, 8e-4])
def test_a_closed_path_ends_after_one_round_and_not_where_it_begins(handover):
    angle = np.linspace(0.0, 2 * np.pi, 181)
    circle = Curve(6e-3 * np.column_stack([np.cos(angle), np.sin(angle), np.full(len(angle), 10.0)]))
    course = PathProgress(circle)
    for s in np.arange(0.0, circle.length - 2 * handover, 2e-4):
        course.locate(circle.at(s), handover)
        assert not course.done
        assert course.progress == pytest.approx(s, abs=2e-5)
    course.locate(circle.at(circle.length - 0.5 * handover), handover)
    assert course.done
