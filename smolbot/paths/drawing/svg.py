"""A path from an SVG drawing: one element, drawn without lifting the pen, in mm, y up."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError
from smolbot.paths.drawing.svg_path import Arc, Bezier, find_data_fault, parse_path
from smolbot.paths.drawing.svg_shapes import SHAPES
from smolbot.paths.drawing.svg_units import PIXELS_PER_INCH

if TYPE_CHECKING:
    from smolbot.paths.drawing.svg_tree import Document, DrawnShape

MM_PER_PIXEL = 25.4 / PIXELS_PER_INCH
"""Size of a CSS pixel, in mm."""

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

MOST_NAMED = 8
"""Shapes that a message names."""


def read_svg(path: Path, element: str | None, width: float | None, height: float | None) -> FloatArray:
    """Read one shape of an SVG drawing as points, centred on the origin, y up.

    Transforms, units, view boxes, uses and style sheets are applied; a drawing without units is in pixels of 1/96
    inch. What is hidden is no shape, nor is one without fill and stroke beside others that have them. Clips and masks
    are not applied. Curves and arcs become chords that deviate by 5 µm at most.

    Parameters
    ----------
    path : Path
    element : str, optional
        Id of the shape, or of a group or use that shows it; needed only where the drawing holds more than one.
    width, height : float, in mm, optional
        Size to which the shape is scaled; with one of them the aspect ratio is kept.

    Returns
    -------
    ndarray, shape (n, 2), in mm

    Raises
    ------
    InputError
        With file and element: a file that cannot be read, an invalid attribute, no shape, several shapes, or a pen
        that is lifted on the way.
    """
    from smolbot.paths.drawing.svg_tree import Document

    with np.errstate(over="ignore", invalid="ignore"):  # numbers beyond any are found where the curves are complete
        shape = _find_shape(path, Document(path), element)
        where = f"{path}: {shape.name}"
        curves = _list_curves(shape, where)
    rough = np.vstack([_sample_chords(curve, np.inf) for curve in curves])
    if np.all(np.ptp(rough, axis=0) < NO_SIZE):
        raise InputError(f"{where}: has no length.")
    finest = float(np.max(_compute_scale(np.ptp(rough, axis=0), width, height, where)))
    points = [_sample_chords(curve, MAX_CHORD_ERROR / finest) for curve in curves]
    outline = np.vstack([points[0], *(chords[1:] for chords in points[1:])])
    outline = outline * _compute_scale(np.ptp(outline, axis=0), width, height, where)
    new = np.concatenate([[True], np.linalg.norm(np.diff(outline, axis=0), axis=1) > MERGED])
    return outline[new] - 0.5 * (outline.min(axis=0) + outline.max(axis=0))


def _find_shape(path: Path, document: Document, element: str | None) -> DrawnShape:
    """Find the requested shape."""
    shapes = [shape for shape in document.list_shapes(element) if shape.asked and shape.data]
    where = f"element '{element}'" if element is not None else "the drawing"
    if element is not None and element not in document.kinds:
        ids = sorted(name for name, kind in document.kinds.items() if kind in SHAPES)
        known = f"shapes with an id: {', '.join(ids)}" if ids else "no shape has an id"
        raise InputError(f"{path}: no element has the id '{element}'; {known}.")
    seen = [shape for shape in shapes if not shape.hidden]
    if shapes and not seen:
        raise InputError(f"{path}: {where} is hidden by {shapes[0].hidden}; show it.")
    if not seen:
        raise InputError(
            f"{path}: {where} holds no path, line, polyline, polygon, rectangle, circle or ellipse that is drawn; text "
            "and images must be made paths first, and what stands in <defs> needs a <use>."
        )
    seen = [shape for shape in seen if shape.painted] or seen
    if len(seen) > 1:
        names = ", ".join(shape.id or f"a {shape.kind} without an id" for shape in seen[:MOST_NAMED])
        more = f" and {len(seen) - MOST_NAMED} more" if len(seen) > MOST_NAMED else ""
        raise InputError(f'{path}: {where} holds {len(seen)} shapes, {names}{more}; choose one by element = "its id".')
    return seen[0]


def _list_curves(shape: DrawnShape, where: str) -> list[Bezier | Arc]:
    """Return the curves of a shape in order, on the page, in mm, y up; refuse a pen that is lifted."""
    fault = find_data_fault(shape.data)
    if fault:
        raise InputError(f"{where}: broken path data: {fault}.")
    to_page = np.diag([MM_PER_PIXEL, -MM_PER_PIXEL, 1.0]) @ shape.matrix
    strokes = [[curve.place(to_page) for curve in stroke] for stroke in parse_path(shape.data)]
    curves = [curve for stroke in strokes for curve in stroke]
    if not curves:
        raise InputError(f"{where}: has no length.")
    if not np.all(np.isfinite([curve.at(t) for curve in curves for t in (0.0, 1.0)])):
        raise InputError(f"{where}: has points that are beyond any number.")
    for before, after in pairwise(strokes):
        last, first = before[-1].at(1.0), after[0].at(0.0)
        if np.linalg.norm(first - last) > MAX_PEN_GAP:
            gap = [f"({x:.2f}, {-y:.2f}) mm" for x, y in (last, first)]
            raise InputError(
                f"{where}: the line ends at {gap[0]} of the page and starts again at {gap[1]}; a robot cannot jump. "
                "Draw one line without a gap."
            )
    return curves


def _compute_scale(size: FloatArray, width: float | None, height: float | None, where: str) -> FloatArray:
    requested = (width, height)
    for present, goal, what in zip(size, requested, ("width", "height"), strict=True):
        if goal is not None and present < NO_SIZE:
            raise InputError(f"{where}: has no {what}, and cannot be scaled to {goal:g} mm; leave out {what}_mm.")
    ratios = [None if goal is None else goal / present for present, goal in zip(size, requested, strict=True)]
    given = [r for r in ratios if r is not None]
    return np.array([r if r is not None else (given[0] if given else 1.0) for r in ratios])


def _sample_chords(curve: Bezier | Arc, flat: float) -> FloatArray:
    """Approximate a curve by points (n, 2), in mm, none further than `flat` from it."""
    if curve.straight:
        return np.array([curve.at(0.0), curve.at(1.0)])
    found = [curve.at(0.0)]

    def halve(a: float, p: FloatArray, b: float, q: FloatArray, depth: int) -> None:
        m, middle = 0.5 * (a + b), curve.at(0.5 * (a + b))
        into, out = middle - p, q - middle
        turn = abs(float(np.arctan2(into[0] * out[1] - into[1] * out[0], into @ out)))
        chord = q - p
        beside = abs(float(into[0] * chord[1] - into[1] * chord[0])) / max(float(np.linalg.norm(chord)), TINY)
        if depth >= MAX_HALVINGS or (depth >= FEWEST and turn < MAX_CHORD_TURN and beside <= flat):
            found.append(q)
            return
        halve(a, p, m, middle, depth + 1)
        halve(m, middle, b, q, depth + 1)

    halve(0.0, found[0], 1.0, curve.at(1.0), 0)
    return np.array(found)
