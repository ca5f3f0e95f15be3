"""Letters and signs as one continuous route in a box of given size: four own letters, and a plotter font."""

from __future__ import annotations

from functools import cache

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError
from smolbot.paths.drawing.font import KNOWN_CHARACTERS, is_in_font, read_strokes
from smolbot.paths.drawing.joining import Route, join_strokes
from smolbot.paths.outline import Outline
from smolbot.paths.polylines import compute_arc_lengths, resample_evenly

BOWL_RADIUS_SHARE = 0.25
"""Radius of the R's bowl as a fraction of its height: the bowl takes the upper half."""

S_TERMINAL_ANGLE_DEG = 10.0
"""Angle at which the S begins and ends on its bowls, in degrees above and below their middle."""

MAX_SAMPLE_TURN = np.radians(4.0)
"""Largest turn between two samples of a bend, in rad: at a radius of 5 mm a chord deviates by 3 µm."""

HALF_TURN_POINTS, QUARTER_POINTS, S_HALF_POINTS = 49, 33, 65
"""Points on the bowl of an R, and on the short and the long arc of half an S."""

NEGLIGIBLE = 1e-9
"""Share of a size, or length in mm, that is rounding."""

STRETCH_DIGITS = 6
"""Decimals of a glyph's stretch by which its route is kept."""


def _draw_r(width: float, height: float) -> FloatArray:
    """Draw an R: up the stem, round the bowl back to the stem, down the leg."""
    radius = BOWL_RADIUS_SHARE * height
    straight = max(width - radius, 0.0)
    stretch = min(width, radius) / radius
    angle = np.linspace(0.5 * np.pi, -0.5 * np.pi, HALF_TURN_POINTS)
    bowl = np.stack([straight + stretch * radius * np.cos(angle), height - radius + radius * np.sin(angle)], axis=1)
    return np.concatenate([[[0.0, 0.0], [0.0, height]], bowl, [[0.0, 0.5 * height], [width, 0.0]]])


def _draw_i(width: float, height: float) -> FloatArray:
    return np.array([[0.5 * width, 0.0], [0.5 * width, height]])


def _draw_l(width: float, height: float) -> FloatArray:
    return np.array([[0.0, height], [0.0, 0.0], [width, 0.0]])


def _draw_s(width: float, height: float) -> FloatArray:
    """Draw an S from the upper end round the upper bowl, through the middle and round the lower bowl.

    The bends are the gentlest that fit: each bowl is half as high as the letter, its ends quarter circles and half
    circles joined by straight pieces.
    """
    radius = BOWL_RADIUS_SHARE * height
    reach = max(0.5 * width - radius, 0.0)
    stretch = min(0.5 * width, radius) / radius
    right = np.linspace(np.radians(S_TERMINAL_ANGLE_DEG), 0.5 * np.pi, QUARTER_POINTS)
    left = np.linspace(0.5 * np.pi, 1.5 * np.pi, S_HALF_POINTS)
    x = np.concatenate([reach + stretch * radius * np.cos(right), -reach + stretch * radius * np.cos(left)])
    y = radius + radius * np.sin(np.concatenate([right, left]))
    upper = np.stack([x, y], axis=1)
    return np.concatenate([upper, -upper[::-1]]) + 0.5 * np.array([width, height])


GLYPHS = {"I": _draw_i, "L": _draw_l, "R": _draw_r, "S": _draw_s}
"""Own letters, designed for robots; every other character is from the font."""


def find_glyph_fault(name: str) -> str | None:
    """Explain why a name is not a glyph.

    Parameters
    ----------
    name : str

    Returns
    -------
    str or None
        None if it is a glyph.
    """
    if len(name) > 1:
        return f"a glyph is one character, got {len(name)} ('{name}'); a word has no path between its letters."
    if not is_in_font(name):
        return f"no glyph is named '{name}'; known glyphs: {KNOWN_CHARACTERS}."
    return None


def make_glyph(name: str, width: float, height: float) -> FloatArray:
    """Draw a character of the given size, centred on the origin.

    Parameters
    ----------
    name : str
        One printable ASCII character.
    width, height : float
        Size of its box, in any unit of length.

    Returns
    -------
    ndarray, shape (n, 2), in the unit of `width`

    Raises
    ------
    InputError
        If `name` is not one printable character.

    Examples
    --------
    >>> print(make_glyph("L", 2.0, 4.0))
    [[-1.  2.]
     [-1. -2.]
     [ 1. -2.]]
    """
    return make_glyph_outline(name, width, height).points


def make_glyph_outline(name: str, width: float, height: float) -> Outline:
    """Draw a character, with remarks on what is drawn twice and which gaps are bridged.

    It fills its box; one without a width or a height, such as ``|``, is as long as the box allows.

    Parameters
    ----------
    name : str
        One printable ASCII character.
    width, height : float, in mm
        Size of its box.

    Returns
    -------
    Outline
        Centred on the origin.

    Raises
    ------
    InputError
        If `name` is not one printable character.
    """
    fault = find_glyph_fault(name)
    if fault:
        raise InputError(fault[0].upper() + fault[1:])
    if name in GLYPHS:
        points = GLYPHS[name](width, height)
        keep = np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > NEGLIGIBLE])
        return Outline(points[keep] - 0.5 * np.array([width, height]))
    box = np.array([width, height])
    size = np.ptp(np.vstack(read_strokes(name)), axis=0)
    route = _make_route(
        name, float(np.round(height * size[0] / (width * size[1]), STRETCH_DIGITS)) if size.all() else 1.0
    )
    size = np.ptp(np.vstack(route.pieces), axis=0)
    scale = np.divide(box, size, out=np.zeros(2), where=size > NEGLIGIBLE)
    pieces = [resample_evenly(piece * scale, MAX_SAMPLE_TURN) for piece in route.pieces]
    points = np.vstack([pieces[0], *(piece[1:] for piece in pieces[1:])])
    points -= 0.5 * (points.min(axis=0) + points.max(axis=0))
    spread = np.ptp(points, axis=0)
    points *= np.divide(box, spread, out=np.ones(2), where=spread > NEGLIGIBLE * box)  # samples miss the extremes
    return Outline(points, _format_remarks(name, route, scale))


@cache
def _make_route(name: str, stretch: float) -> Route:
    return join_strokes(read_strokes(name), stretch)


def _format_remarks(name: str, route: Route, scale: FloatArray) -> tuple[str, ...]:
    again, total = (
        sum(float(compute_arc_lengths(p * scale)[-1]) for p in parts) for parts in (route.retraced, route.pieces)
    )
    remarks = []
    if again:
        remarks.append(f"the strokes of '{name}' are joined by drawing {again:.1f} of {total:.1f} mm twice")
    for bridge in route.bridges:
        gap = float(compute_arc_lengths(bridge * scale)[-1])
        remarks.append(f"'{name}' has parts that do not touch: a line of {gap:.1f} mm bridges the gap between them")
    return tuple(remarks)
