"""Letters: every printable character is one route, smooth in bends, exact on straight lines and at corners."""

from __future__ import annotations

import numpy as np
import pytest

from smolbot.errors import InputError
from smolbot.paths.corners import compute_curvature, compute_turns, find_corners
from smolbot.paths.drawing.font import FIRST_CHARACTER, LAST_CHARACTER, read_strokes
from smolbot.paths.drawing.joining import join_strokes
from smolbot.paths.glyphs import GLYPHS, make_glyph, make_glyph_outline
from smolbot.paths.polylines import compute_arc_lengths, interpolate_polyline

CHARACTERS = [chr(i) for i in range(ord(FIRST_CHARACTER), ord(LAST_CHARACTER) + 1)]


def length(points):
    return float(compute_arc_lengths(points)[-1])


def dense(points, step):
    return interpolate_polyline(points, np.linspace(0.0, length(points), max(int(length(points) / step), 2)))


def farthest(points, lines):
    """The largest distance of `points` from the nearest of `lines`, by brute force."""
    places = np.vstack([dense(line, 0.05) for line in lines])
    return max(float(np.min(np.linalg.norm(places - p, axis=1))) for p in points)


@pytest.mark.parametrize("name", CHARACTERS)
def test_a_route_covers_every_stroke_of_its_character_and_nothing_else_but_bridges(name):
    drawn = read_strokes(name)
    route = join_strokes(drawn)
    for before, after in zip(route.pieces[:-1], route.pieces[1:]):
        assert np.allclose(before[-1], after[0], atol=1e-9)  # one route, without a jump
    ink = [dense(stroke, 0.3) for stroke in drawn]
    assert farthest(np.vstack(ink), route.pieces) < 0.85  # in units of the grid, on which capitals are 21 high
    pieces = [dense(piece, 0.3) for piece in route.pieces]
    assert farthest(np.vstack(pieces), [*drawn, *route.bridges]) < 0.85


def test_retracing_stays_small():
    shares = {}
    for name in CHARACTERS:
        route = join_strokes(read_strokes(name))
        shares[name] = sum(map(length, route.retraced)) / sum(map(length, route.pieces))
    assert max(shares.values()) < 0.41, shares
    assert np.mean(list(shares.values())) < 0.08
    for name in "BCDGIJLMNOPQSUVWZ0123456789cesovwz":
        assert shares[name] == 0.0, name  # these can be drawn in one go


@pytest.mark.parametrize(
    ("name", "once", "twice"),
    [
        ("+", 20 + 30, 10 + 10),  # from one end to another; the other two arms there and back, the shorter ones
        ("X", 2 * np.hypot(20, 30), np.hypot(20, 30)),
        ("T", 20 + 30, 10),
        ("E", None, None),
    ],
)
def test_no_route_is_shorter(name, once, twice):
    outline = make_glyph_outline(name, 20.0, 30.0)
    if once is None:  # its middle bar, there and back
        xs = outline.points[:, 0]
        bar = float(np.max(xs[np.abs(outline.points[:, 1]) < 10.0]) - xs.min())
        once, twice = 20 + 30 + 20 + bar, bar
    assert length(outline.points) == pytest.approx(once + twice, rel=0.01)
    assert f"drawing {twice:.1f} of" in outline.remarks[0]


@pytest.mark.parametrize("name", ["i", "j", "!", "?", ":", ";", "=", '"', "%"])
def test_a_gap_that_no_robot_can_jump_is_bridged_with_a_remark(name):
    remarks = make_glyph_outline(name, 10.0, 30.0).remarks
    assert any("parts that do not touch" in remark and "bridges the gap" in remark for remark in remarks)


def test_the_bridge_of_an_equals_sign_is_as_long_as_its_gap():
    (bridge,) = join_strokes(read_strokes("=")).bridges
    lines = read_strokes("=")
    assert length(bridge) == pytest.approx(abs(lines[0][0, 1] - lines[1][0, 1]))


@pytest.mark.parametrize("name", CHARACTERS)
@pytest.mark.parametrize("size", [(20.0, 30.0), (6.0, 12.0)])
def test_a_character_fills_its_box_around_the_origin(name, size):
    points = make_glyph(name, *size)
    spread = np.ptp(points, axis=0)
    for have, want in zip(spread, size):
        assert have == pytest.approx(want) or have == pytest.approx(0.0, abs=1e-9)
    assert spread.max() > 0.0
    assert points.min(axis=0) + points.max(axis=0) == pytest.approx(np.zeros(2), abs=1e-9)
    assert np.min(np.linalg.norm(np.diff(points, axis=0), axis=1)) > 1e-6


def test_an_s_of_the_font_is_smooth_evenly_sampled_and_bends_over_once():
    points = make_glyph("s", 20.0, 30.0)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert steps == pytest.approx(steps.mean(), rel=0.01)
    assert np.degrees(compute_turns(points).max()) < 4.5
    way = np.diff(points, axis=0)
    side = np.sign(way[:-1, 0] * way[1:, 1] - way[:-1, 1] * way[1:, 0])
    assert np.sum(side[1:] != side[:-1]) == 1  # left, then right: no waves from the coarse grid
    bend = compute_curvature(points)[1:-1]
    assert np.abs(np.diff(bend)).max() < 0.1 * bend.max()  # curvature goes over gently
    assert 1.0 / bend.max() > 4.0  # mm
    assert points[0, 0] > 0.0 > points[-1, 0]
    assert points[0, 1] > 0.0 > points[-1, 1]


@pytest.mark.parametrize("name", ["O", "0", "o", "8"])
def test_a_closed_letter_has_no_corner_where_it_closes(name):
    points = make_glyph(name, 20.0, 30.0)
    assert np.array_equal(points[0], points[-1]) or np.allclose(points[0], points[-1], atol=1e-9)
    around = np.vstack([points[-2], points[0], points[1]])
    assert np.degrees(compute_turns(around)[0]) < 6.0
    assert find_corners(points) == []


def test_straight_legs_stay_straight_and_corners_exact():
    u = make_glyph("U", 20.0, 30.0)
    legs = u[(u[:, 1] > -5.0)]
    assert np.abs(np.abs(legs[:, 0]) - 10.0).max() < 0.01
    m = make_glyph("M", 20.0, 30.0)
    assert m == pytest.approx(np.array([[-10, -15], [-10, 15], [0, -15], [10, 15], [10, -15.0]]))
    z = make_glyph("Z", 20.0, 30.0)
    assert z == pytest.approx(np.array([[-10, 15], [10, 15], [-10, -15], [10, -15.0]]))


def test_own_letters_come_before_the_font():
    assert set(GLYPHS) == {"I", "L", "R", "S"}
    assert make_glyph("L", 4.0, 6.0) == pytest.approx(np.array([[-2, 3], [-2, -3], [2, -3.0]]))
    assert make_glyph("I", 4.0, 6.0) == pytest.approx(np.array([[0, -3], [0, 3.0]]))
    angle = np.linspace(0.5 * np.pi, -0.5 * np.pi, 49)
    bowl = np.column_stack([2.0 + 6.0 * np.cos(angle), 6.0 + 6.0 * np.sin(angle)])
    assert make_glyph("R", 16.0, 24.0) == pytest.approx(np.vstack([[-8, -12], [-8, 12], bowl, [-8, 0], [8, -12.0]]))


@pytest.mark.parametrize(
    ("name", "words"),
    [("SS", ["one character, got 2", "word"]), (" ", ["known glyphs"]), ("", ["known glyphs"]), ("ä", ["A to Z"])],
)
def test_what_is_not_one_printable_character_is_refused(name, words):
    with pytest.raises(InputError) as error:
        make_glyph(name, 1.0, 1.0)
    for word in words:
        assert word in str(error.value)
