"""A path from an SVG drawing: one element, drawn without lifting the pen, in mm, y up."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError

PIXELS_PER_INCH = 96.0
"""Of CSS, whose pixel is the unit of SVG."""

MM_PER_PIXEL = 25.4 / PIXELS_PER_INCH
"""Size of a CSS pixel, in mm."""

LENGTH_ERROR = 1e-3
"""Error, in pixels, of the length by which a segment is found to have none."""

MAX_CHORD_ERROR = 5e-3
"""Largest distance of a chord from its curve, in mm."""

MAX_CHORD_TURN = np.radians(5.0)
"""Largest turn within a chord, in rad: a bend must not look like corners."""

MAX_HALVINGS = 14
"""Largest number of halvings of a curve: a cusp turns within every chord."""

FEWEST = 3
"""Smallest number of halvings: the ends of a symmetric curve do not show its turn."""

MERGED = 1e-6
"""Distance, in mm, below which two points coincide."""

NO_SIZE = 1e-9
"""Width or height, in mm, that is rounding."""

TINY = 1e-12
"""Length, in mm, that keeps a quotient finite."""

MAX_PEN_GAP = 1e-3
"""Gap, in mm, up to which a move of the pen is rounding."""

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_COUNTS = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}


def read_svg(path: Path, element: str | None, width: float | None, height: float | None) -> FloatArray:
    """Read one shape of an SVG drawing as points, centred on the origin, y up.

    Transforms, units and the view box are applied; a drawing without units is in pixels of 1/96 inch. Curves and
    arcs become chords that deviate by 5 µm at most.

    Parameters
    ----------
    path : Path
    element : str, optional
        Id of the shape; needed only where the drawing holds more than one.
    width, height : float, in mm, optional
        Size to which the shape is scaled; with one of them the aspect ratio is kept.

    Returns
    -------
    ndarray, shape (n, 2), in mm

    Raises
    ------
    InputError
        With file and element: a file that cannot be read, no shape, several shapes, invalid path data, or a pen
        that is lifted on the way.
    """
    import svgelements

    try:
        drawing = svgelements.SVG.parse(str(path), reify=True, ppi=PIXELS_PER_INCH)
    except ElementTree.ParseError as error:
        raise InputError(f"{path}:{error.position[0]}: not valid XML: {error}.") from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}.") from error
    except (ValueError, TypeError, ArithmeticError, AttributeError) as error:  # what svgelements does not handle
        raise InputError(f"{path}: cannot be read as SVG: {error}.") from error
    if not isinstance(drawing, svgelements.SVG):
        raise InputError(f"{path}: is no SVG: its outermost element is not <svg>.")
    shape, name = _find_shape(path, drawing, element)
    segments = _list_segments(shape, f"{path}: {name}")
    rough = np.vstack([_sample_chords(segment, np.inf) for segment in segments])
    size = np.ptp(rough, axis=0)
    scale = _compute_scale(size, width, height, f"{path}: {name}")
    points = [_sample_chords(segment, MAX_CHORD_ERROR / float(np.max(scale))) for segment in segments]
    outline = np.vstack([points[0], *(chords[1:] for chords in points[1:])]) * scale
    new = np.concatenate([[True], np.linalg.norm(np.diff(outline, axis=0), axis=1) > MERGED])
    return outline[new] - 0.5 * (outline.min(axis=0) + outline.max(axis=0))


def _find_shape(path: Path, drawing: Any, element: str | None) -> tuple[Any, str]:
    """Find the requested shape, and its name for messages."""
    import svgelements

    if element is not None:
        named = [e for e in drawing.elements() if getattr(e, "id", None) == element]
        if not named:
            ids = sorted({str(e.id) for e in drawing.elements() if isinstance(e, svgelements.Shape) and e.id})
            known = f"shapes with an id: {', '.join(ids)}" if ids else "no shape has an id"
            raise InputError(f"{path}: no element has the id '{element}'; {known}.")
        inside = [e for e in named[0].select() if isinstance(e, svgelements.Shape)] if _is_group(named[0]) else named
    else:
        inside = list(drawing.elements())
    shapes = [e for e in inside if isinstance(e, svgelements.Shape) and _is_drawn(e)]
    where = f"element '{element}'" if element is not None else "the drawing"
    if not shapes:
        raise InputError(
            f"{path}: {where} holds no path, line, polyline, polygon, rectangle, circle or ellipse with a length; "
            "text and images must be made paths first."
        )
    if len(shapes) > 1:
        names = ", ".join(str(e.id) if e.id else f"a {_format_kind(e)} without an id" for e in shapes[:8])
        more = f" and {len(shapes) - 8} more" if len(shapes) > 8 else ""
        raise InputError(
            f'{path}: {where} holds {len(shapes)} shapes, {names}{more}; choose one by element = "its id".'
        )
    return shapes[0], f"element '{shapes[0].id}'" if shapes[0].id else f"its {_format_kind(shapes[0])}"


def _is_group(element: Any) -> bool:
    return isinstance(element, list) and hasattr(element, "select")


def _format_kind(shape: Any) -> str:
    return type(shape).__name__.lower()


def _is_drawn(shape: Any) -> bool:
    import svgelements

    if shape.values.get("visibility") == "hidden":
        return False
    return shape.values.get("d") or any(not isinstance(s, svgelements.Move) for s in svgelements.Path(shape))


def _list_segments(shape: Any, where: str) -> list[Any]:
    """Return the segments of a shape that have a length, in order; refuse those that lift the pen."""
    import svgelements

    fault = _find_data_fault(shape.values.get("d") or "")
    if fault:
        raise InputError(f"{where}: broken path data: {fault}.")
    segments: list[Any] = []
    for segment in svgelements.Path(shape):
        if isinstance(segment, svgelements.Move):
            if segments and abs(segment.end - segments[-1].end) * MM_PER_PIXEL > MAX_PEN_GAP:
                ends = (p * MM_PER_PIXEL for p in (segments[-1].end, segment.end))
                last, first = (f"({p.x:.2f}, {p.y:.2f}) mm" for p in ends)
                raise InputError(
                    f"{where}: the line ends at {last} of the page and starts again at {first}; a robot cannot "
                    "jump. Draw one line without a gap."
                )
        elif segment.start is not None and segment.end is not None and segment.length(error=LENGTH_ERROR) > 0.0:
            segments.append(segment)
    if not segments:
        raise InputError(f"{where}: has no length.")
    return segments


def _find_data_fault(data: str) -> str | None:
    """Describe the fault of a path's `d` attribute, which svgelements would otherwise cut there without an error.

    Examples
    --------
    >>> _find_data_fault("M 0,0 l 3 4 5 6 a 1 1 0 0110-5z")
    >>> _find_data_fault("M 0 0 L 10 x 20")
    "'x' at character 12 is no command"
    >>> _find_data_fault("M 0 0 C 1 2 3 4")
    'C at character 7 has 4 numbers; it takes 6 each time'
    """
    for letter in re.finditer(r"[^\d\s,.+\-eE]", data):
        if letter[0].upper() not in _COUNTS:
            return f"'{letter[0]}' at character {letter.start() + 1} is no command"
    for match in re.finditer(r"([A-DF-Za-df-z])([^A-DF-Za-df-z]*)", data):
        command, given, at = match[1], match[2], match.start() + 1
        count = _COUNTS[command.upper()]
        number = rf"{_NUMBER}(?:[\s,]+|(?=[+\-.])|$)"
        if command in "Aa":
            flag = r"[01][\s,]*"
            one = rf"(?:{number}){{3}}{flag}{flag}(?:{number}){{2}}"
            if not re.fullmatch(rf"[\s,]*(?:{one})+", given):
                return f"{command} at character {at} needs radii, rotation, two flags and an end each time"
            continue
        if not re.fullmatch(rf"[\s,]*(?:{number})*", given):
            return f"the numbers of {command} at character {at} cannot be read: '{given.strip()[:40]}'"
        found = len(re.findall(_NUMBER, given))
        if (count == 0 and found) or (count and (found == 0 or found % count)):
            return f"{command} at character {at} has {found} numbers; it takes {count} each time"
    if data.strip() and data.strip()[0] not in "Mm":
        return f"it must begin with M; got '{data.strip()[:20]}'"
    return None


def _compute_scale(size: FloatArray, width: float | None, height: float | None, where: str) -> FloatArray:
    requested = (width, height)
    for present, goal, what in zip(size, requested, ("width", "height"), strict=True):
        if goal is not None and present < NO_SIZE:
            raise InputError(f"{where}: has no {what}, and cannot be scaled to {goal:g} mm; leave out {what}_mm.")
    ratios = [None if goal is None else goal / present for present, goal in zip(size, requested, strict=True)]
    given = [r for r in ratios if r is not None]
    return np.array([r if r is not None else (given[0] if given else 1.0) for r in ratios])


def _sample_chords(segment: Any, flat: float) -> FloatArray:
    """Approximate a segment by points (n, 2), in mm, y up."""
    import svgelements

    def place(t: float) -> FloatArray:
        point = segment.point(t)
        return np.array([point.x * MM_PER_PIXEL, -point.y * MM_PER_PIXEL])

    if isinstance(segment, svgelements.Line | svgelements.Close):
        return np.array([[p.x * MM_PER_PIXEL, -p.y * MM_PER_PIXEL] for p in (segment.start, segment.end)])
    found = [place(0.0)]

    def halve(a: float, p: FloatArray, b: float, q: FloatArray, depth: int) -> None:
        m, middle = 0.5 * (a + b), place(0.5 * (a + b))
        into, out = middle - p, q - middle
        turn = abs(float(np.arctan2(into[0] * out[1] - into[1] * out[0], into @ out)))
        chord = q - p
        beside = abs(float(into[0] * chord[1] - into[1] * chord[0])) / max(float(np.linalg.norm(chord)), TINY)
        if depth >= MAX_HALVINGS or (depth >= FEWEST and turn < MAX_CHORD_TURN and beside <= flat):
            found.append(q)
            return
        halve(a, p, m, middle, depth + 1)
        halve(m, middle, b, q, depth + 1)

    halve(0.0, found[0], 1.0, place(1.0), 0)
    return np.array(found)
