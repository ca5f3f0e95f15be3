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


SKEW = np.array([[1.0, np.tan(np.radians(20.0))], [0.0, 1.0]])


def turn(degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s], [s, c]])


@pytest.mark.parametrize("place", ["attribute", "style", "sheet", "group", "use"])
@pytest.mark.parametrize(
    ("transform", "matrix"),
    [
        ("rotate(30)", turn(30)),
        ("rotate(30deg)", turn(30)),
        ("scale(-1, 1)", np.diag([-1.0, 1.0])),
        ("skewX(20deg)", SKEW),
        ("matrix(0.5 0.4, -0.3 2, 7 8)", np.array([[0.5, -0.3], [0.4, 2.0]])),
        ("translate(4px,3px)scale(1.5) rotate(-70deg)", 1.5 * turn(-70)),
    ],
)
@pytest.mark.parametrize(
    ("shape", "corners"),
    [
        ("rect", [[0, 0], [20, 0], [20, 10], [0, 10], [0, 0]]),
        ("polygon", [[0, 0], [20, 0], [5, 10], [0, 0]]),
        ("line", [[0, 0], [20, 10]]),
    ],
)
def test_every_shape_is_turned_wherever_the_transform_stands(drawn, shape, corners, transform, matrix, place):
    attributes = {
        "rect": 'x="40" y="40" width="20" height="10"',
        "polygon": 'points="40,40 60,40 45,50"',
        "line": 'x1="40" y1="40" x2="60" y2="50"',
    }[shape]
    body = {
        "attribute": f'<{shape} {attributes} transform="{transform}"/>',
        "style": f'<{shape} {attributes} style="transform: {transform}"/>',
        "sheet": f"<style>g > .t {{ transform: {transform} }}</style><g><{shape} {attributes} class='a t'/></g>",
        "group": f'<g transform="{transform}"><g>{f"<{shape} {attributes}/>"}</g></g>',
        "use": f'<defs><{shape} id="s" {attributes}/></defs><use href="#s" x="3" transform="{transform}"/>',
    }[place]
    expected = np.array(corners, dtype=float) @ matrix.T * [1.0, -1.0]
    assert drawn(body) == pytest.approx(centred(expected), abs=1e-9)


@pytest.mark.parametrize(
    ("radii", "transform", "axes"),
    [
        ("12 5", "rotate(30 50 45)", turn(30) @ np.diag([12.0, 5.0])),
        ("8 8", "rotate(30)", np.diag([8.0, 8.0])),
        ("8 8", "skewX(20)", SKEW * 8.0),
        ("12 5", "matrix(1 0.5 -1 2 0 0)", np.array([[1.0, -1.0], [0.5, 2.0]]) @ np.diag([12.0, 5.0])),
    ],
)
def test_a_turned_circle_or_ellipse_is_the_image_of_the_unit_circle(drawn, radii, transform, axes):
    rx, ry = radii.split()
    points = drawn(f'<ellipse cx="50" cy="45" rx="{rx}" ry="{ry}" transform="{transform}"/>') * [1.0, -1.0]
    on_circle = points @ np.linalg.inv(axes).T
    assert np.hypot(*on_circle.T) == pytest.approx(1.0, abs=2e-3)
    assert np.ptp(points, axis=0) == pytest.approx(2.0 * np.hypot(*axes.T), abs=0.02)


@pytest.mark.parametrize(
    ("root", "body", "size"),
    [
        ('width="100mm" height="50mm" viewBox="0 0 100 100"', '<rect width="20" height="10"/>', (10, 5)),
        (
            'width="100mm" height="50mm" viewBox="0 0 100 100" preserveAspectRatio="none"',
            '<rect width="20" height="10"/>',
            (20, 5),
        ),
        (
            'width="100mm" height="50mm" viewBox="0 0 100 100" preserveAspectRatio="xMinYMax slice"',
            '<rect width="20" height="10"/>',
            (20, 10),
        ),
        ('width="50mm" viewBox="0 0 100 80"', '<rect width="20" height="10"/>', (10, 5)),
        (IN_MM, '<rect width="50%" height="25%"/>', (50, 20)),
        (IN_MM, f'<circle r="{100 / np.sqrt((1 + 0.8**2) / 2)}%"/>', (200, 200)),
        (IN_MM, '<svg width="30" height="30" viewBox="0 0 10 20"><rect width="100%" height="4"/></svg>', (15, 6)),
        (
            IN_MM,
            '<symbol id="s" viewBox="0 0 10 10"><rect width="4" height="2"/></symbol>'
            '<use href="#s" width="30" height="30"/>',
            (12, 6),
        ),
        ('width="96" height="96"', '<line x2="1in" y2="2.54cm"/>', (25.4, 25.4)),
        ('width="96" height="96"', '<line x2="72pt" y2="6pc"/>', (25.4, 25.4)),
        ('style="width: 10mm; height: 10mm" viewBox="0 0 5 5"', '<line x2="4" y2="3"/>', (8, 6)),
        (IN_MM, '<circle r="3" style="r: 5px"/>', (10, 10)),
    ],
)
def test_sizes_follow_view_boxes_shares_and_units(drawn, root, body, size):
    assert np.ptp(drawn(body, root=root), axis=0) == pytest.approx(size, abs=0.01)


@pytest.mark.parametrize("turned", ["", 'transform="rotate(20) scale(2)"'])
def test_a_rectangle_has_round_corners_of_its_radii(drawn, turned):
    points = drawn(f'<rect width="20" height="12" rx="4" ry="90" {turned}/>')  # ry is cut to half the height
    scale = 2.0 if turned else 1.0
    ramanujan = np.pi * (3 * 10 - np.sqrt((3 * 4 + 6) * (4 + 3 * 6)))
    assert compute_arc_lengths(points)[-1] == pytest.approx(scale * (2 * 12 + ramanujan), rel=1e-3)


@pytest.mark.parametrize(
    ("data", "same"),
    [
        ("M 0 0 C 9 0 3 8 5 5 T 20 9", "M 0 0 C 9 0 3 8 5 5 Q 5 5 20 9"),
        ("M 0 0 Q 9 0 5 5 S 3 3 20 9", "M 0 0 Q 9 0 5 5 C 5 5 3 3 20 9"),
        ("M 1 1 t 9 3", "M 1 1 L 10 4"),
        ("M 0 0 Q 4 8 8 0 h 3 t 5 5", "M 0 0 Q 4 8 8 0 L 11 0 L 16 5"),
        ("M 0 0 h 4 v 4 z l -3 -1", "M 0 0 L 4 0 L 4 4 L 0 0 L -3 -1"),
        ("M 0 0 A 0 5 0 0 1 3 9", "M 0 0 L 3 9"),
        ("m 2 2 3 4 5 -6", "M 2 2 L 5 6 L 10 0"),
    ],
)
def test_a_smooth_curve_mirrors_only_one_of_its_kind(drawn, data, same):
    assert drawn(f'<path d="{data}"/>')[[0, -1]] == pytest.approx(drawn(f'<path d="{same}"/>')[[0, -1]])
    lengths = [compute_arc_lengths(drawn(f'<path d="{d}"/>'))[-1] for d in (data, same)]
    assert lengths[0] == pytest.approx(lengths[1], rel=1e-6)


SEEN = '<line x2="10" y2="6"/>'
HIDDEN = '<rect id="h" class="k" width="3" height="3"/>'


@pytest.mark.parametrize(
    "body",
    [
        f'<g display="none"><g style="display: inline">{HIDDEN}</g></g>',
        f"<style>/* a layer */ .k {{ display: none !important }}</style><g>{HIDDEN}</g>",
        f'<style><![CDATA[ g.l rect {{ visibility: hidden }} ]]></style><g class="l">{HIDDEN}</g>',
        f'<g visibility="hidden">{HIDDEN}</g>',
        f"<defs>{HIDDEN}</defs><symbol>{HIDDEN}</symbol><clipPath>{HIDDEN}</clipPath><mask>{HIDDEN}</mask>",
        f'<switch><g requiredExtensions="x">{HIDDEN}</g><g/>{HIDDEN}</switch>',
        '<rect width="9" height="9" style="fill: none"/>',
    ],
)
def test_what_is_hidden_is_no_shape(drawn, body):
    assert drawn(body + SEEN) == pytest.approx(np.array([[-5, 3], [5, -3.0]]))


def test_what_is_shown_within_what_is_invisible_is_seen(drawn):
    assert len(drawn(f'<g visibility="hidden">{HIDDEN}<g visibility="visible">{SEEN}</g></g>')) == 2


@pytest.mark.parametrize(
    ("body", "element", "words"),
    [
        (f'<g id="l" display="none">{HIDDEN}</g>', "h", "element 'h' is hidden by display: none of element 'l'"),
        (f"<defs>{HIDDEN}</defs>", "h", "what stands in <defs> needs a <use>"),
        ('<rect id="r" width="3furlong" height="2"/>', None, "element 'r': width: '3furlong' has an unknown unit"),
        ('<rect id="r" width="2em" height="2"/>', None, "known are px, in, cm, mm, q, pt, pc and %"),
        ('<line id="r" x2="2" transform="rotat(3)"/>', None, "transform rotat() is not known; known are matrix"),
        ('<line id="r" x2="2" transform="rotate(3"/>', None, "transform 'rotate(3' cannot be read at"),
        ('<line id="r" x2="2" transform="rotate(3 4)"/>', None, "has 2 numbers; it takes 1 or 3"),
        ('<polyline id="r" points="1 2 3"/>', None, "element 'r': points has 3 numbers; it takes two a point"),
        ('<use id="r" href="#nothing"/>', None, "'#nothing', and this file holds no element of that id"),
        ('<use id="r" href="other.svg#a"/>', None, "this file holds no element"),
        ('<svg id="r" viewBox="0 0 0 5"/>', None, "viewBox '0 0 0 5' must be four numbers"),
        ('<svg id="r" preserveAspectRatio="middle"/>', None, "preserveAspectRatio 'middle' cannot be read"),
        ('<path id="r" d="M 0 0 L 1e999 2"/>', None, "element 'r': has points that are beyond any number"),
        ('<path id="r" d="M 0 0 L ' + "1.5 " * 5001 + '"/>', None, "L at character 7 has 5001 numbers"),
        ('<path id="r" d="M 0 0 L ' + "1.5 " * 5000 + '+"/>', None, "the numbers of L at character 7 cannot be read"),
    ],
)
def test_what_cannot_be_drawn_is_refused_with_its_place(drawn, tmp_path, body, element, words):
    with pytest.raises(InputError) as error:
        drawn(body, element=element)
    assert str(error.value).startswith(f"{tmp_path}/drawing.svg: ")
    assert words in str(error.value)


def test_ten_thousand_groups_are_no_error(drawn):
    sheet = "<style>g > g line { stroke: red }</style>"
    assert np.ptp(drawn(sheet + "<g>" * 10_000 + SEEN + "</g>" * 10_000), axis=0) == pytest.approx([10.0, 6.0])


@pytest.mark.parametrize(
    "body",
    [
        '<g id="a"><use href="#a"/></g>',
        '<g id="a"><use href="#b"/></g><g id="b"><g><use href="#a"/></g></g>',
        '<use id="a" href="#a"/>',
    ],
)
def test_a_use_of_itself_is_one_error(drawn, body):
    with pytest.raises(InputError, match="shows that <use> again: it would never end"):
        drawn(body + SEEN)


def test_uses_of_uses_end_at_the_limit(drawn):
    levels = [f'<g id="u{k + 1}">{f"""<use href="#u{k}"/>""" * 10}</g>' for k in range(30)]
    with pytest.raises(InputError, match="all <use> together show more than 10000 elements"):
        drawn(f'<defs><line id="u0" x2="3"/>{"".join(levels)}</defs><use href="#u30"/>')


def test_a_shape_in_a_use_is_chosen_by_the_id_of_either(drawn):
    body = f'<defs><g id="d"><line id="s" x2="10" y2="6"/></g></defs><use id="u" href="#d"/>{HIDDEN}'
    for name in ("u", "d", "s"):
        assert drawn(body, element=name) == pytest.approx(np.array([[-5, 3], [5, -3.0]]))


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
