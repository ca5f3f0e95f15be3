"""Paths: length, places along them, distance to them, letters, and files of points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.batch.intervals import compute_wilson_interval
from smolbot.errors import InputError
from smolbot.paths.curve import Curve, read_csv
from smolbot.paths.glyphs import BOWL_RADIUS_SHARE, GLYPHS, make_glyph


@pytest.fixture
def corner() -> Curve:
    """3 mm along x, then 4 mm along y."""
    return Curve(np.array([[0, 0, 0], [1, 0, 0], [3, 0, 0], [3, 4, 0.0]]) * 1e-3)


def test_arc_length_adds_up_along_the_pieces(corner):
    assert corner.length == pytest.approx(7e-3)
    assert corner.arc == pytest.approx([0, 1e-3, 3e-3, 7e-3])


def test_places_and_directions_along_a_path(corner):
    assert corner.at(np.array([0.0, 2e-3, 5e-3])) == pytest.approx(np.array([[0, 0, 0], [2, 0, 0], [3, 2, 0]]) * 1e-3)
    assert corner.at(-1.0) == pytest.approx(corner.points[0])
    assert corner.at(1.0) == pytest.approx(corner.points[-1])
    assert corner.tangent(np.array([0.0, 2.9e-3, 3.1e-3, 7e-3])) == pytest.approx(
        np.array([[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0.0]])
    )


@pytest.mark.parametrize("spacing", [0.4e-3, 1.5e-3, 50e-3])
def test_samples_hold_start_corners_and_end_and_are_never_too_far_apart(corner, spacing):
    arc = corner.sampled(spacing)
    assert arc[0] == 0.0
    assert arc[-1] == pytest.approx(7e-3)
    assert np.min(np.abs(arc - 3e-3)) < 1e-12
    assert np.all(np.diff(arc) > 0)
    assert np.diff(arc).max() <= max(spacing, 0) * (1 + 1e-9) or len(arc) == 3


def test_a_gentle_bend_is_no_corner():
    bend = Curve(np.array([[0, 0, 0], [1, 0, 0], [2, 0.1, 0.0]]))
    assert len(bend.sampled(10.0)) == 2
    assert len(bend.sampled(10.0, corner=np.radians(2.0))) == 3


def test_projection_finds_the_nearest_place_by_brute_force(corner):
    rng = np.random.default_rng(0)
    points = rng.uniform(-3e-3, 7e-3, (50, 3))
    s, distance = corner.project(points)
    dense = np.linspace(0, corner.length, 20_001)
    places = corner.at(dense)
    for p, where, far in zip(points, s, distance, strict=True):
        apart = np.linalg.norm(places[:, :2] - p[:2], axis=1)
        assert far == pytest.approx(apart.min(), abs=3.5e-7)  # half a step of the dense places
        assert np.linalg.norm(corner.at(where)[:2] - p[:2]) == pytest.approx(far, abs=1e-12)


@given(st.floats(0.0, 1.0))
def test_a_place_on_the_path_is_its_own_projection(share):
    curve = Curve(np.array([[0, 0, 0], [2, 1, 0], [3, -1, 0], [5, 0, 0.0]]))
    s, distance = curve.project(curve.at(np.array([share * curve.length])))
    assert distance[0] == pytest.approx(0.0, abs=1e-12)
    assert s[0] == pytest.approx(share * curve.length, abs=1e-9)


def test_height_does_not_count_as_distance_to_a_path(corner):
    assert corner.project(np.array([[1e-3, 0, 0.5]]))[1][0] == pytest.approx(0.0, abs=1e-15)


def test_a_path_has_two_points_that_differ():
    with pytest.raises(InputError, match="at least two points; got 1"):
        Curve(np.zeros((1, 3)))
    with pytest.raises(InputError, match="points 1 and 2 coincide"):
        Curve(np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0], [2, 0, 0.0]]))
    with pytest.raises(InputError, match="finite"):
        Curve(np.array([[0, 0, 0], [np.nan, 0, 0]]))


@pytest.mark.parametrize("name", sorted(GLYPHS))
@pytest.mark.parametrize("size", [(8.0, 12.0), (20.0, 28.0), (3.0, 12.0)])
def test_a_letter_fills_its_box_around_the_origin(name, size):
    points = make_glyph(name, *size)
    low, high = points.min(axis=0), points.max(axis=0)
    assert np.all(low >= -np.array(size) / 2 - 1e-9)
    assert np.all(high <= np.array(size) / 2 + 1e-9)
    assert np.ptp(points[:, 1]) == pytest.approx(size[1])
    if name != "I":
        assert np.ptp(points[:, 0]) == pytest.approx(size[0])
    Curve(np.column_stack([points, np.zeros(len(points))]))  # no two points coincide


def test_the_length_of_an_R_is_stem_bowl_and_leg():
    width, height = 8.0, 12.0
    radius = BOWL_RADIUS_SHARE * height
    bowl = np.pi * radius + 2 * (width - radius)
    leg = np.hypot(width, height / 2)
    points = make_glyph("R", width, height)
    length = Curve(np.column_stack([points, np.zeros(len(points))])).length
    assert length == pytest.approx(height + bowl + leg, rel=1e-3)


def test_a_csv_file_of_points_may_have_a_header_comments_and_semicolons(tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("x,y\n# comment\n0, 1\n\n2;3.5\n")
    assert read_csv(path) == pytest.approx(np.array([[0, 1], [2, 3.5]]))


@pytest.mark.parametrize(
    ("text", "where", "what"),
    [
        ("x,y\n0,0\n1,two\n", ":3:", "'1,two'"),
        ("0,0\n1\n", ":2:", "two numbers"),
        ("0,0\n1,2,3\n", ":2:", "two numbers"),
        ("0,0\n1,nan\n", ":2:", "finite"),
        ("0,0\n\n1,inf\n", ":3:", "finite"),
        ("x,y\nx,y\n0,0\n", ":2:", "two numbers"),
        ("# where\n\nx,y\n0,0\n1,b\n", ":5:", "'1,b'"),
        ("0,o\n1,1\n2,2\n", ":1:", "'0,o'"),
        ("x,y\n0,0\n", ":", "at least two points; found 1"),
        ("", ":", "at least two points; found 0"),
    ],
)
def test_a_bad_row_of_a_csv_file_is_reported_with_file_and_line(tmp_path, text, where, what):
    path = tmp_path / "p.csv"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_csv(path)
    assert str(error.value).startswith(f"{path}{where}")
    assert what in str(error.value)


def test_a_missing_csv_file_is_one_error(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.csv"):
        read_csv(tmp_path / "nowhere.csv")


@given(st.integers(1, 200), st.floats(0, 1))
def test_an_interval_of_a_rate_holds_the_rate_and_agrees_with_scipy(total, share):
    from scipy.stats import binomtest

    passed = round(share * total)
    low, high = compute_wilson_interval(passed, total)
    reference = binomtest(passed, total).proportion_ci(0.95, method="wilson")
    assert (low, high) == pytest.approx((reference.low, reference.high), abs=1e-6)
    assert low <= passed / total + 1e-12
    assert high >= passed / total - 1e-12


def test_without_a_trial_nothing_is_known():
    assert compute_wilson_interval(0, 0) == (0.0, 1.0)
