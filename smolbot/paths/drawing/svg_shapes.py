"""Shapes of SVG as data of a path, in user units: each begins and runs as the standard says."""

from __future__ import annotations

import re
from collections.abc import Mapping

from smolbot.errors import InputError
from smolbot.paths.drawing.svg_units import Box, parse_length, parse_numbers

SHAPES = ("path", "line", "polyline", "polygon", "rect", "circle", "ellipse")
"""Elements that draw a line."""


def make_path_data(kind: str, values: Mapping[str, str], box: Box) -> str:
    """Write a shape as the data of a path.

    Parameters
    ----------
    kind : str
        One of `SHAPES`.
    values : mapping of str
        Its attributes, and the properties that CSS states.
    box : Box
        Size to which percentages refer.

    Returns
    -------
    str
        Empty where nothing is drawn, such as a circle without a radius.

    Raises
    ------
    InputError
        An attribute that cannot be read.

    Examples
    --------
    >>> make_path_data("line", {"x2": "10", "y2": "50%"}, Box(20.0, 8.0))
    'M 0.0 0.0 L 10.0 4.0'
    """

    def get(name: str, whole: float | None, default: float = 0.0) -> float:
        text = values.get(name)
        if text is None or text.strip() == "auto":
            return default
        try:
            return parse_length(text, whole)
        except InputError as error:
            raise InputError(f"{name}: {error}") from error

    match kind:
        case "path":
            return _strip_function(values.get("d", "none"))
        case "polyline" | "polygon":
            return _join_points(values.get("points", ""), closed=kind == "polygon")
        case "line":
            x1, x2 = get("x1", box.width), get("x2", box.width)
            y1, y2 = get("y1", box.height), get("y2", box.height)
            return f"M {x1} {y1} L {x2} {y2}"
        case "circle":
            radius = get("r", box.diagonal)
            return _write_ellipse(get("cx", box.width), get("cy", box.height), radius, radius)
        case "ellipse":
            rx, ry = get("rx", box.width, -1.0), get("ry", box.height, -1.0)
            rx, ry = (ry if rx < 0.0 else rx), (rx if ry < 0.0 else ry)
            return _write_ellipse(get("cx", box.width), get("cy", box.height), rx, ry)
    x, width = get("x", box.width), get("width", box.width)
    y, height = get("y", box.height), get("height", box.height)
    rx, ry = get("rx", box.width, -1.0), get("ry", box.height, -1.0)
    rx, ry = (ry if rx < 0.0 else rx), (rx if ry < 0.0 else ry)
    return _write_rectangle(x, y, width, height, min(rx, 0.5 * width), min(ry, 0.5 * height))


def _write_ellipse(x: float, y: float, rx: float, ry: float) -> str:
    """Write an ellipse about (x, y), from its rightmost point, first towards larger y."""
    if rx <= 0.0 or ry <= 0.0:
        return ""
    arc = f"A {rx} {ry} 0 0 1"
    return f"M {x + rx} {y} {arc} {x} {y + ry} {arc} {x - rx} {y} {arc} {x} {y - ry} {arc} {x + rx} {y} Z"


def _write_rectangle(x: float, y: float, width: float, height: float, rx: float, ry: float) -> str:
    """Write a rectangle with its least corner at (x, y), first towards larger x; radii are not above half its size."""
    if width <= 0.0 or height <= 0.0:
        return ""
    if rx <= 0.0 or ry <= 0.0:
        return f"M {x} {y} H {x + width} V {y + height} H {x} Z"
    arc, right, low = f"A {rx} {ry} 0 0 1", x + width, y + height
    return (
        f"M {x + rx} {y} H {right - rx} {arc} {right} {y + ry} V {low - ry} {arc} {right - rx} {low} "
        f"H {x + rx} {arc} {x} {low - ry} V {y + ry} {arc} {x + rx} {y} Z"
    )


def _join_points(text: str, closed: bool) -> str:
    numbers = parse_numbers(text)
    if len(numbers) % 2:
        raise InputError(f"points has {len(numbers)} numbers; it takes two a point")
    points = [f"{x} {y}" for x, y in zip(numbers[::2], numbers[1::2], strict=True)]
    return f"M {' L '.join(points)}{' Z' if closed else ''}" if points else ""


def _strip_function(data: str) -> str:
    """Return the data of a path: the attribute as it is, or what CSS has within ``path("…")``."""
    match = re.fullmatch(r"""\s*path\(\s*(["'])(.*)\1\s*\)\s*""", data, re.DOTALL)
    inner = match[2] if match else data
    return "" if inner.strip() in ("", "none") else inner
