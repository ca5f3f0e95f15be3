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
    progress = PathProgress(letter_r())
    places = progress.points[progress.stops] * 1e3
    assert places == pytest.approx(np.array([[-8, -12], [-8, 12], [-8, 0], [8, -12]]), abs=1e-6)


def test_a_robot_that_follows_the_path_passes_leg_after_leg_to_the_end():
    path = letter_r()
    progress = PathProgress(path)
    rng = np.random.default_rng(0)
    seen = []
    for s in np.arange(0.0, path.length + 1e-4, 2e-4):
        progress.locate(path.at(s) + 1e-4 * rng.normal(size=3), 3e-4)
        seen.append(progress.progress)
        if not progress.done:
            assert abs(progress.arc_length - s) < 1e-3  # where the bowl comes back to the stem, it is not taken for it
    assert np.all(np.diff(seen) >= 0.0)
    assert progress.done
    assert progress.progress == pytest.approx(path.length)


def test_before_the_start_nothing_is_behind():
    progress = PathProgress(HOOK)
    progress.locate(np.array([2e-3, 0.0]), 3e-4)
    assert (progress.leg, progress.progress, progress.leg_end) == (-1, 0.0, 0.0)
    progress.locate(np.array([2e-4, 0.0]), 3e-4)
    assert progress.leg == 0
    assert progress.leg_end == pytest.approx(4e-3)


@pytest.mark.parametrize(("place", "leg"), [((3.6, 0.0), 0), ((3.75, 0.0), 1), ((4.1, -0.9), 1)])
def test_a_corner_is_reached_when_it_is_near_or_passed(place, leg):
    progress = PathProgress(HOOK)
    for x in (0.0, 1.0, 2.0, 3.0):
        progress.locate(np.array([x, 0.0]) * 1e-3, 3e-4)
    progress.locate(np.array(place) * 1e-3, 3e-4)
    assert progress.leg == leg


def test_the_nearest_place_is_that_of_the_curve():
    path = Curve(letter_r().points[1:-1])
    progress = PathProgress(path)
    for s in np.arange(0.0, path.length - 1e-3, 5e-4):
        place = path.at(s) + np.array([1e-4, 1e-4, 0.0])
        progress.locate(place, 2e-4)
        assert progress.arc_length == pytest.approx(path.project(place[None])[0][0], abs=1e-12)


@pytest.mark.parametrize("handover", [3e-4, 8e-4])
def test_a_closed_path_ends_after_one_round_and_not_where_it_begins(handover):
    angle = np.linspace(0.0, 2 * np.pi, 181)
    circle = Curve(6e-3 * np.column_stack([np.cos(angle), np.sin(angle), np.full(len(angle), 10.0)]))
    progress = PathProgress(circle)
    for s in np.arange(0.0, circle.length - 2 * handover, 2e-4):
        progress.locate(circle.at(s), handover)
        assert not progress.done
        assert progress.progress == pytest.approx(s, abs=2e-5)
    progress.locate(circle.at(circle.length - 0.5 * handover), handover)
    assert progress.done


def plane(xy_mm):
    flat = 1e-3 * np.asarray(xy_mm, dtype=float)
    return Curve(np.column_stack([flat, np.full(len(flat), 0.06)]))


def ring(radius, turns, points, middle=(0.0, 0.0), begin=0.0):
    angle = begin + np.linspace(0.0, 2.0 * np.pi * turns, points)
    return radius * np.column_stack([np.cos(angle), np.sin(angle)]) + middle


def eight():
    a = np.linspace(0.0, 2.0 * np.pi, 201)
    return np.column_stack([8.0 * np.sin(a), 5.0 * np.sin(2.0 * a)])


SELF_TOUCHING = {
    "figure eight begun at its crossing": eight(),
    "circle twice": ring(7.0, 2.0, 401),
    "circle twice, few points": ring(6.0, 2.0, 181),
    "small loop": np.vstack([[-6.0, 0.0], ring(0.5, 1.0, 61, (0.0, 0.5), -np.pi / 2), [6.0, 0.0]]),
    "loop three times": np.vstack([[-6.0, 0.0], ring(1.0, 3.0, 181, (0.0, 1.0), -np.pi / 2), [6.0, 0.0]]),
    "loop with corners": [[-6, 0], [0.5, 0], [0.5, 1], [-0.5, 1], [-0.5, 0], [6, 0]],
    "there and back": [[-6, 0], [6, 0], [-6, 0]],
    "close strands": np.vstack([[[-6, 0]], ring(0.15, 0.5, 31, (6.0, 0.15), -np.pi / 2), [[-6, 0.3]]]),
}


@pytest.mark.parametrize("handover", [2.5e-4, 8e-4])
@pytest.mark.parametrize("name", SELF_TOUCHING)
def test_no_piece_is_skipped_where_a_path_crosses_or_touches_itself(name, handover):
    """Progress stays where the robot is, to within the handover and what the noise of its poses allows."""
    path = plane(SELF_TOUCHING[name])
    progress = PathProgress(path)
    rng = np.random.default_rng(1)
    for s in np.arange(0.0, path.length, 2e-4):
        progress.locate(path.at(s) + 5e-5 * rng.normal(size=3), handover)
        if not progress.done:
            assert progress.progress - s < 2.0 * handover + 4e-4
    assert progress.done


@pytest.mark.parametrize("name", SELF_TOUCHING)
def test_a_robot_that_rests_makes_no_progress(name):
    path = plane(SELF_TOUCHING[name])
    for share in (0.0, 0.3, 0.5, 0.8):
        progress = PathProgress(path)
        for s in np.arange(0.0, share * path.length + 1e-9, 2e-4):
            progress.locate(path.at(s), 2.5e-4)
        before = progress.progress
        for _ in range(50):
            progress.locate(path.at(share * path.length), 2.5e-4)
        assert progress.progress - before <= 5e-4


def test_a_robot_that_is_carried_on_along_the_path_is_found_again():
    path = plane([[-6, 0], [6, 0]])
    progress = PathProgress(path)
    progress.locate(path.at(0.0), 2.5e-4)
    progress.locate(path.at(3e-3), 2.5e-4)
    assert progress.arc_length == pytest.approx(3e-3)
    progress.locate(path.at(1.5e-3), 2.5e-4)
    assert progress.arc_length == pytest.approx(1.5e-3)
