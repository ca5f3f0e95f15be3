"""Corners: kept exactly, or rounded by arcs that touch both sides."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smolbot.core.rotations import matrix_from_quaternion
from smolbot.paths.corners import MIN_CORNER_ANGLE, compute_curvature, compute_turns, find_corners, round_corners
from smolbot.paths.polylines import compute_arc_lengths, find_nearest_place

SQUARE = np.array([[0, 0], [10, 0], [10, 10], [0, 10.0]])


def length(points):
    return float(compute_arc_lengths(points)[-1])


def test_a_right_angle_becomes_a_quarter_of_a_circle():
    shaped = round_corners(SQUARE[:3], 2.0)
    assert shaped.remarks == ()
    assert length(shaped.points) == pytest.approx(20.0 - 4.0 + np.pi, rel=1e-3)
    arc = shaped.points[(shaped.points[:, 0] >= 8.0) & (shaped.points[:, 1] <= 2.0)]
    assert np.linalg.norm(arc - np.array([8.0, 2.0]), axis=1) == pytest.approx(2.0, abs=1e-9)
    assert len(arc) > 15
    assert shaped.points[[0, -1]] == pytest.approx(SQUARE[[0, 2]])


@given(st.floats(0.4, 2.9), st.floats(0.1, 1.0))
def test_an_arc_shortens_any_corner_as_in_geometry(turn, radius):
    corner = np.array([[-30, 0], [0, 0], [30 * np.cos(turn), 30 * np.sin(turn)]])
    shaped = round_corners(corner, radius)
    expected = 60.0 - 2.0 * radius * np.tan(0.5 * turn) + radius * turn
    assert length(shaped.points) == pytest.approx(expected, abs=1e-3 * radius * turn + 1e-6)
    assert compute_turns(shaped.points).max() < np.radians(6.0)
    assert compute_curvature(shaped.points).max() == pytest.approx(1.0 / radius, rel=1e-2)


def test_radius_0_and_smooth_paths_change_nothing():
    assert round_corners(SQUARE, 0.0).points is SQUARE
    angle = np.linspace(0, 2, 60)
    bend = np.column_stack([5 * np.cos(angle), 5 * np.sin(angle)])
    assert round_corners(bend, 1.0).points is bend


def test_sides_too_short_get_the_largest_arc_and_a_remark():
    shaped = round_corners(SQUARE, 100.0)
    assert "2 of 2 corners have sides too short for an arc of 100 mm: down to 5.00 mm" in shaped.remarks[0]
    assert length(shaped.points) == pytest.approx(5 + 5 * np.pi + 5, rel=2e-3)
    assert find_corners(shaped.points) == []


def test_a_path_that_turns_back_on_itself_keeps_that_corner():
    there_and_back = np.array([[0, 0], [10, 0], [0, 0], [0, 5.0]])
    shaped = round_corners(there_and_back, 1.0)
    assert "1 corner stays as it is" in shaped.remarks[0]
    assert [10.0, 0.0] in shaped.points.tolist()
    assert len(find_corners(shaped.points)) == 1


def test_an_arc_touches_a_straight_side_and_a_bend():
    angle = np.linspace(0.0, 0.5 * np.pi, 200)
    bend = np.column_stack([6.0 * np.sin(angle), 6.0 - 6.0 * np.cos(angle)])  # leaves the origin along x
    stem = np.array([[0.0, 8.0], [0.0, 0.0]])
    shaped = round_corners(np.vstack([stem, bend[1:]]), 1.0)
    assert shaped.remarks == ()
    assert find_corners(shaped.points) == []
    # the circle of radius 1 that touches x = 0 and, from inside, the circle of radius 6 about (0, 6)
    center = np.array([1.0, 6.0 - np.sqrt(5.0**2 - 1.0)])
    on_arc = np.abs(np.linalg.norm(shaped.points - center, axis=1) - 1.0) < 2e-3
    assert on_arc.sum() > 10
    assert abs(find_nearest_place(shaped.points, center)[1] - 1.0) < 2e-3


@given(
    st.lists(
        st.tuples(st.floats(1.001, 20.0), st.floats(0.0, 1.0), st.sampled_from([-1.0, 1.0])), min_size=2, max_size=6
    ),
    st.floats(0.2, 5.0),
)
@settings(max_examples=40)
def test_after_rounding_no_corner_is_left_but_reversals(legs, radius):
    lengths, shares, senses = (np.array(values) for values in zip(*legs, strict=True))
    turns = senses * (1.01 * MIN_CORNER_ANGLE + shares * (np.radians(164.0) - 1.01 * MIN_CORNER_ANGLE))
    heading = np.cumsum(turns)
    steps = lengths[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    path = np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)])
    shaped = round_corners(path, radius).points
    assert compute_turns(shaped).max() < MIN_CORNER_ANGLE
    assert shaped[[0, -1]] == pytest.approx(path[[0, -1]], abs=2e-6)
    assert length(shaped) <= length(path) + 1e-9


def test_corners_are_rounded_in_space_as_in_the_plane():
    turned = matrix_from_quaternion(np.array([0.5, 0.5, 0.1, np.sqrt(0.49)]))
    flat = np.column_stack([SQUARE, np.zeros(4)])
    assert round_corners(flat @ turned.T, 2.0).points == pytest.approx(
        round_corners(flat, 2.0).points @ turned.T, abs=1e-9
    )
    assert round_corners(flat, 2.0).points[:, :2] == pytest.approx(round_corners(SQUARE, 2.0).points, abs=1e-9)
