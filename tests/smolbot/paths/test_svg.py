"""SVG: units, transforms, every command, held against closed forms; one line without a break, or a clear error."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from smolbot.errors import InputError
from smolbot.paths.corners import compute_turns, find_corners
from smolbot.paths.drawing.svg import read_svg
from smolbot.paths.polylines import compute_arc_lengths, find_nearest_place

IN_MM = 'width="100mm" height="80mm" viewBox="0 0 100 80"'


@pytest.fixture
def drawn(tmp_path):
    """``drawn('<path d="..."/>')``: its points in mm."""

    def read(body, *, root=IN_MM, element=None, width=None, height=None):
        path = tmp_path / "drawing.svg"
        space = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
        path.write_text(f"<svg {space} {root}>\n{body}\n</svg>")
        return read_svg(path, element, width, height)

    return read


def centred(points):
    return points - 0.5 * (points.min(axis=0) + points.max(axis=0))


def test_y_points_up_and_the_middle_is_the_origin(drawn):
    assert drawn('<path d="M 10 10 L 30 10 L 30 16"/>') == pytest.approx(np.array([[-10, 3], [10, 3], [10, -3.0]]))


@pytest.mark.parametrize(
    ("root", "mm"),
    [
        (IN_MM, 1.0),
        ("", 25.4 / 96.0),
        ('width="960" height="960" viewBox="0 0 100 100"', 25.4 / 10.0),
        ('width="10cm" height="10cm" viewBox="0 0 50 50"', 2.0),
        ('width="2in" height="2in" viewBox="0 0 2 2"', 25.4),
        ('viewBox="0 0 20 20" width="40mm" height="40mm"', 2.0),
    ],
)
def test_units_and_view_box_give_the_size(drawn, root, mm):
    points = drawn('<path d="M 1 1 h 10 v 4"/>', root=root)
    assert np.ptp(points, axis=0) == pytest.approx(np.array([10.0, 4.0]) * mm)


def test_a_width_scales_both_ways_and_two_sizes_stretch(drawn):
    path = '<path d="M 0 0 h 10 v 4"/>'
    assert np.ptp(drawn(path, width=5.0), axis=0) == pytest.approx([5.0, 2.0])
    assert np.ptp(drawn(path, height=8.0), axis=0) == pytest.approx([20.0, 8.0])
    assert np.ptp(drawn(path, width=5.0, height=8.0), axis=0) == pytest.approx([5.0, 8.0])


def test_transforms_of_groups_and_of_elements_are_applied(drawn):
    body = '<g transform="translate(7 3) rotate(30)"><path transform="scale(2 1) skewX(10)" d="M 1 2 L 5 2 L 5 9"/></g>'
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    matrix = np.array([[c, -s], [s, c]]) @ np.diag([2.0, 1.0]) @ np.array([[1.0, np.tan(np.radians(10))], [0.0, 1.0]])
    expected = np.array([[1, 2], [5, 2], [5, 9.0]]) @ matrix.T
    assert drawn(body) == pytest.approx(centred(expected * np.array([1.0, -1.0])), abs=1e-5)


def bezier(points, t):
    level = [np.array(p, dtype=float)[None, :] for p in points]
    while len(level) > 1:  # de Casteljau
        level = [(1.0 - t) * a + t * b for a, b in pairwise(level)]
    return level[0]


@pytest.mark.parametrize(
    ("data", "parts"),
    [
        ("M 10 10 C 20 0 40 40 60 10", [[(10, 10), (20, 0), (40, 40), (60, 10)]]),
        ("M 10 10 c 10 -10 30 30 50 0", [[(10, 10), (20, 0), (40, 40), (60, 10)]]),
        (
            "M10,10C20,0 40,40 60,10S70 60 90 60",
            [[(10, 10), (20, 0), (40, 40), (60, 10)], [(60, 10), (80, -20), (70, 60), (90, 60)]],
        ),
        ("M 10 10 Q 20 60 40 10 T 70 10", [[(10, 10), (20, 60), (40, 10)], [(40, 10), (60, -40), (70, 10)]]),
        ("m 10 10 q 10 50 30 0 t 30 0", [[(10, 10), (20, 60), (40, 10)], [(40, 10), (60, -40), (70, 10)]]),
    ],
)
def test_curves_keep_within_5_um_of_their_equations(drawn, data, parts):
    points = drawn(f'<path d="{data}"/>')
    t = np.linspace(0.0, 1.0, 4001)[:, None]
    true = np.vstack([bezier(part, t)[k > 0 :] for k, part in enumerate(parts)]) * np.array([1.0, -1.0])
    shift = points[0] - true[0]
    away = [find_nearest_place(points, p + shift)[1] for p in true[::13]]
    assert max(away) < 6e-3  # mm
    spread = [find_nearest_place(true + shift, p)[1] for p in points]
    assert max(spread) < 1e-3


@pytest.mark.parametrize(
    ("body", "radii", "share"),
    [
        ('<circle cx="20" cy="20" r="8"/>', (8, 8), 1.0),
        ('<ellipse cx="20" cy="20" rx="12" ry="5"/>', (12, 5), 1.0),
        ('<path d="M 12 20 A 8 8 0 0 1 28 20 A 8 8 0 0 1 12 20 Z"/>', (8, 8), 1.0),
        ('<path d="M 12 20 a 8 8 0 1118-0"/>', None, None),
    ],
)
def test_arcs_lie_on_their_circle_or_ellipse(drawn, body, radii, share):
    points = drawn(body)
    assert find_corners(points) == []
    if radii is None:  # an arc of a radius that is too small for its ends grows to a half circle, as SVG has it
        away = np.linalg.norm(points - 0.5 * (points[0] + points[-1]), axis=1)
        assert away == pytest.approx(9.0, abs=1e-5)
        return
    assert np.hypot(points[:, 0] / radii[0], points[:, 1] / radii[1]) == pytest.approx(1.0, abs=1e-5)
    a, b = radii
    ramanujan = np.pi * (3 * (a + b) - np.sqrt((3 * a + b) * (a + 3 * b)))
    assert compute_arc_lengths(points)[-1] == pytest.approx(share * ramanujan, rel=1e-3)


@pytest.mark.parametrize(
    ("body", "corners"),
    [
        ('<rect x="3" y="4" width="10" height="6"/>', [[-5, 3], [5, 3], [5, -3], [-5, -3], [-5, 3]]),
        ('<polyline points="0,0 10,0 10,6"/>', [[-5, 3], [5, 3], [5, -3]]),
        ('<polygon points="0,0 10,0 10,6"/>', [[-5, 3], [5, 3], [5, -3], [-5, 3]]),
        ('<line x1="0" y1="0" x2="10" y2="6"/>', [[-5, 3], [5, -3]]),
        ('<path d="M 1 1 H 11 V 7 h -4 Z"/>', [[-5, 3], [5, 3], [5, -3], [1, -3], [-5, 3]]),
        ('<defs><path id="p" d="M 0 0 L 10 6"/></defs><use xlink:href="#p"/>', [[-5, 3], [5, -3]]),
        ('<path d="M 0 0 L 10 0 M 10 0 L 10 6"/>', [[-5, 3], [5, 3], [5, -3]]),  # starts again where it ended
        ('<path style="display:none" d="M 0 0 L 1 1"/><path d="M 0 0 L 10 6"/>', [[-5, 3], [5, -3]]),
        ('<path d=""/><circle r="0"/><path d="M 0 0 L 10 6"/>', [[-5, 3], [5, -3]]),
    ],
)
def test_straight_shapes_are_their_corners_alone(drawn, body, corners):
    assert drawn(body) == pytest.approx(np.array(corners, dtype=float), abs=1e-5)


def test_an_element_or_a_group_with_one_is_chosen_by_its_id(drawn):
    body = '<path id="a" d="M 0 0 L 4 4"/><g id="g"><circle id="b" r="3"/></g>'
    for name in ("b", "g"):
        assert np.ptp(drawn(body, element=name), axis=0) == pytest.approx([6.0, 6.0])


def test_a_tight_bend_is_no_corner_and_a_corner_no_bend(drawn):
    points = drawn('<path d="M 0 0 L 10 0 A 0.05 0.05 0 0 1 10.05 0.05 L 10.05 8 L 20 8"/>')
    assert len(find_corners(points)) == 1
    assert np.sum(compute_turns(points) > np.radians(3.0)) > 10


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ('<path id="a" d="M 0 0 L 4 0 L 4 2 M 6 2 L 9 2"/>', ["element 'a'", "ends at (4.00, 2.00)", "(6.00, 2.00)"]),
        ('<path id="a" d="M0 0L4 0"/><rect width="3" height="2"/>', ["2 shapes, a, a rect without an id", "element ="]),
        ('<path d="M 0 0 L 10 x 20"/>', ["broken path data", "'x' at character 12"]),
        ('<path d="M 0 0 L 10"/>', ["L at character 7 has 1 numbers; it takes 2"]),
        ('<path d="M 0 0 L nan 3"/>', ["'n' at character 9"]),
        ('<path d="L 0 0 3 3"/>', ["must begin with M"]),
        ('<path d="M 0 0 A 5 5 0 2 0 3 3"/>', ["A at character 7", "two flags"]),
        ('<path transform="scale(0)" d="M 0 0 L 3 3"/>', ["has no length"]),
        ("<text>SMOL</text>", ["holds no path", "text and images must be made paths"]),
        ("", ["holds no path"]),
    ],
)
def test_a_drawing_that_is_no_single_line_is_refused_with_the_reason(drawn, tmp_path, body, words):
    with pytest.raises(InputError) as error:
        drawn(body)
    assert str(error.value).startswith(f"{tmp_path}/drawing.svg: ")
    for word in words:
        assert word in str(error.value)


def test_an_unknown_id_is_refused_with_the_known_ones(drawn):
    with pytest.raises(InputError, match="no element has the id 'c'; shapes with an id: a, b"):
        drawn('<path id="b" d="M 0 0 L 4 4"/><circle id="a" r="3"/>', element="c")
    with pytest.raises(InputError, match="no shape has an id"):
        drawn('<path d="M 0 0 L 4 4"/>', element="c")


def test_a_line_without_height_cannot_be_brought_to_one(drawn):
    with pytest.raises(InputError, match=r"has no height, and cannot be scaled to 3 mm; leave out height_mm"):
        drawn('<path d="M 0 0 L 4 0"/>', height=3.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<svg><path d='M 0 0", ":1: not valid XML"),
        ("", "not valid XML"),
        ("<html/>", "is no SVG"),
        ("\x00", "not valid"),
    ],
)
def test_a_file_that_is_no_svg_is_refused_with_its_line(tmp_path, text, words):
    path = tmp_path / "x.svg"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_svg(path, None, None, None)
    assert str(path) in str(error.value)
    assert words in str(error.value)


def test_a_missing_file_is_reported(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.svg: cannot be read"):
        read_svg(tmp_path / "nowhere.svg", None, None, None)
