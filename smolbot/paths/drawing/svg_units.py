"""Lengths, transforms and viewports of SVG, as numbers in pixels and matrices (3, 3)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError

PIXELS_PER_INCH = 96.0
"""Of CSS, whose pixel is the unit of SVG."""

PIXELS = {
    "": 1.0, "px": 1.0, "in": PIXELS_PER_INCH, "cm": PIXELS_PER_INCH / 2.54, "mm": PIXELS_PER_INCH / 25.4,
    "q": PIXELS_PER_INCH / 101.6, "pt": PIXELS_PER_INCH / 72.0, "pc": PIXELS_PER_INCH / 6.0,
}  # fmt: skip
"""Pixels of each unit of length."""

RADIANS = {"": np.pi / 180.0, "deg": np.pi / 180.0, "grad": np.pi / 200.0, "rad": 1.0, "turn": 2.0 * np.pi}
"""Radians of each unit of angle."""

NUMBER = r"(?>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
"""Regular expression of a number; atomic, or a long list with a fault would be tried in every division."""

GAP = r"(?:\s*,\s*|\s+|(?=[+\-.])|$)"
"""Regular expression of what may follow a number: the sign or point of the next one suffices."""

ALIGNMENTS = {"Min": 0.0, "Mid": 0.5, "Max": 1.0}
"""Share of the free space that lies before the view box."""

_COUNTS = {
    "matrix": (6,), "translate": (1, 2), "translatex": (1,), "translatey": (1,), "scale": (1, 2), "scalex": (1,),
    "scaley": (1,), "rotate": (1, 3), "skew": (1, 2), "skewx": (1,), "skewy": (1,),
}  # fmt: skip
_QUANTITY = re.compile(rf"({NUMBER})([A-Za-z]*|%){GAP}")


class Box(NamedTuple):
    """Size to which percentages refer, in user units; None where the drawing does not give it."""

    width: float | None
    height: float | None

    @property
    def diagonal(self) -> float | None:
        """Size to which percentages of a radius refer: root mean square of width and height."""
        if self.width is None or self.height is None:
            return None
        return float(np.sqrt(0.5 * (self.width**2 + self.height**2)))


def parse_length(text: str, whole: float | None) -> float:
    """Convert a length to pixels, which are user units inside a view box.

    Parameters
    ----------
    text : str
    whole : float or None, in user units
        Length that is 100 %.

    Returns
    -------
    float, in user units

    Raises
    ------
    InputError
        What is no length, or has a unit that depends on a font or a window.

    Examples
    --------
    >>> parse_length("25.4mm", None), parse_length("10%", 60.0)
    (96.0, 6.0)
    """
    match = re.fullmatch(rf"\s*({NUMBER})([A-Za-z]*|%)\s*", text)
    if match is None or not np.isfinite(float(match[1])):
        raise InputError(f"'{text}' is no length")
    amount, unit = float(match[1]), match[2].lower()
    if unit == "%":
        if whole is None:
            raise InputError(f"'{text}' is a share of a drawing without a size; give its <svg> a viewBox")
        return amount / 100.0 * whole
    if unit not in PIXELS:
        raise InputError(f"'{text}' has an unknown unit; known are {', '.join(u for u in PIXELS if u)} and %")
    return amount * PIXELS[unit]


def parse_numbers(text: str) -> list[float]:
    """Read numbers that commas or spaces separate.

    Parameters
    ----------
    text : str

    Returns
    -------
    list of float

    Raises
    ------
    InputError
        Something else than numbers.
    """
    found = _parse_quantities(text)
    if any(unit for _, unit in found):
        raise InputError(f"'{text}' holds a unit; it takes numbers")
    return [amount for amount, _ in found]


def parse_transform(text: str) -> FloatArray:
    """Multiply a list of transforms.

    Attribute and CSS are read alike: angles may have a unit, lengths too.

    Parameters
    ----------
    text : str
        Such as ``"translate(10 5) rotate(30, 50, 45)"``.

    Returns
    -------
    ndarray, shape (3, 3)
        Maps homogeneous points (x, y, 1), in user units.

    Raises
    ------
    InputError
        A function that is unknown, or not flat, or has another number of arguments.

    Examples
    --------
    >>> (parse_transform("translate(1 2) scale(3)") @ [1, 1, 1]).tolist()
    [4.0, 5.0, 1.0]
    """
    matrix = np.eye(3)
    rest = text.strip()
    if rest.lower() == "none":
        return matrix
    while rest:
        match = re.match(r"([A-Za-z][A-Za-z0-9]*)\s*\(([^()]*)\)\s*,?\s*", rest)
        if match is None:
            raise InputError(f"transform '{text}' cannot be read at '{rest[:20]}'")
        matrix = matrix @ _compute_matrix(match[1], match[2].strip())
        rest = rest[match.end() :]
    return matrix


def _compute_matrix(name: str, arguments: str) -> FloatArray:
    """Compute the matrix of one function of a transform."""
    kind = name.lower()
    if kind not in _COUNTS:
        raise InputError(f"transform {name}() is not known; known are {', '.join(_COUNTS)}")
    quantities = _parse_quantities(arguments)
    if len(quantities) not in _COUNTS[kind]:
        wanted = " or ".join(str(n) for n in _COUNTS[kind])
        raise InputError(f"transform {name}({arguments}) has {len(quantities)} numbers; it takes {wanted}")
    match kind:
        case "matrix":
            a, b, c, d, e, f = (_to_plain(q, name) for q in quantities)
            return np.array([[a, c, e], [b, d, f], [0.0, 0.0, 1.0]])
        case "translate" | "translatex" | "translatey":
            x, y = _spread(kind, [_to_pixels(q, name) for q in quantities], other=0.0)
            return make_shift(x, y)
        case "scale" | "scalex" | "scaley":
            factors = [_to_plain(q, name) for q in quantities]
            x, y = _spread(kind, factors, other=factors[0] if kind == "scale" else 1.0)
            return np.diag([x, y, 1.0])
        case "rotate":
            angle = _to_radians(quantities[0], name)
            c, s = np.cos(angle), np.sin(angle)
            turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            x, y = (_to_pixels(q, name) for q in quantities[1:]) if len(quantities) == 3 else (0.0, 0.0)
            return make_shift(x, y) @ turn @ make_shift(-x, -y)
        case _:
            x, y = _spread(kind, [_to_radians(q, name) for q in quantities], other=0.0)
            return np.array([[1.0, np.tan(x), 0.0], [np.tan(y), 1.0, 0.0], [0.0, 0.0, 1.0]])


def _spread(kind: str, values: Sequence[float], other: float) -> tuple[float, float]:
    """Return the values for x and y of a function that has both, or one of them by its name."""
    if kind.endswith("y"):
        return other, values[0]
    return values[0], values[1] if len(values) == 2 else other


def _to_plain(quantity: tuple[float, str], name: str) -> float:
    amount, unit = quantity
    if unit not in ("", "%"):
        raise InputError(f"transform {name}() takes numbers without a unit; got {amount:g}{unit}")
    return amount / 100.0 if unit == "%" else amount


def _to_pixels(quantity: tuple[float, str], name: str) -> float:
    amount, unit = quantity
    if unit == "%":  # of a box; where a shape lies does not count, as it is centred in the end
        return 0.0
    if unit not in PIXELS:
        raise InputError(f"transform {name}() has a length in '{unit}'; known are {', '.join(u for u in PIXELS if u)}")
    return amount * PIXELS[unit]


def _to_radians(quantity: tuple[float, str], name: str) -> float:
    amount, unit = quantity
    if unit not in RADIANS:
        raise InputError(f"transform {name}() has an angle in '{unit}'; known are {', '.join(u for u in RADIANS if u)}")
    return amount * RADIANS[unit]


def _parse_quantities(text: str) -> list[tuple[float, str]]:
    """Read numbers with their units, lower case."""
    found = []
    rest = text.strip()
    while rest:
        match = _QUANTITY.match(rest)
        if match is None:
            raise InputError(f"'{text}' cannot be read at '{rest[:20]}'")
        found.append((float(match[1]), match[2].lower()))
        rest = rest[match.end() :]
    return found


def make_shift(x: float, y: float) -> FloatArray:
    """Make the matrix of a shift.

    Parameters
    ----------
    x, y : float, in user units

    Returns
    -------
    ndarray, shape (3, 3)
    """
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])


def compute_view(size: Box, view_box: Sequence[float] | None, fit: str) -> FloatArray:
    """Compute the matrix that lays a view box into a viewport.

    Parameters
    ----------
    size : Box
        Of the viewport. Without a size the view box keeps its own.
    view_box : sequence of float, optional
        Its least x and y, width and height.
    fit : str
        Attribute ``preserveAspectRatio``.

    Returns
    -------
    ndarray, shape (3, 3)
        From inside the viewport to its surroundings, whose origin is the viewport's corner.

    Raises
    ------
    InputError
        A fit that cannot be read.
    """
    match = re.fullmatch(r"\s*(?:defer\s+)?(none|x(Min|Mid|Max)Y(Min|Mid|Max))(?:\s+(meet|slice))?\s*", fit)
    if match is None:
        raise InputError(f"preserveAspectRatio '{fit}' cannot be read; it is none, or such as xMidYMid meet")
    if view_box is None:
        return np.eye(3)
    x, y, width, height = view_box
    outer = np.array([width if size.width is None else size.width, height if size.height is None else size.height])
    inner = np.array([width, height])
    scale = outer / inner
    before = np.zeros(2)
    if match[1] != "none":
        scale = np.full(2, scale.max() if match[4] == "slice" else scale.min())
        before = (outer - scale * inner) * [ALIGNMENTS[match[2]], ALIGNMENTS[match[3]]]
    return make_shift(*before) @ np.diag([*scale, 1.0]) @ make_shift(-x, -y)


def parse_view_box(text: str | None) -> list[float] | None:
    """Read a ``viewBox``.

    Parameters
    ----------
    text : str or None

    Returns
    -------
    list of float, or None
        Least x and y, width and height; None without one.

    Raises
    ------
    InputError
        Anything but four numbers, of which the last two are more than 0.
    """
    if text is None:
        return None
    numbers = parse_numbers(text)
    if len(numbers) != 4 or min(numbers[2:]) <= 0.0:
        raise InputError(f"viewBox '{text}' must be four numbers, with a width and a height above 0")
    return numbers
