"""Corners of a path, in the plane or in space: detection, counting, and rounding by arcs."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.paths.outline import Outline
from smolbot.paths.polylines import compute_arc_lengths, find_nearest_place, interpolate_polyline

MIN_CORNER_ANGLE = np.radians(20.0)
"""Turns above this angle, in rad, are corners; smaller ones are samples of a bend."""

MIN_REVERSAL_ANGLE = np.radians(170.0)
"""Turns above this angle, in rad, reverse the path and cannot be rounded."""

ARC_STEP_ANGLE = np.radians(5.0)
"""Turn between two points of an arc, in rad."""

MERGED = 1e-6
"""Distance, in mm, below which two points coincide."""

SHORT = 1.0 - 1e-6
"""Share of the requested radius below which a fillet counts as short."""

TINY = 1e-12
"""Chord of two equal points: keeps the quotient finite."""

ROUNDING = 1e-9
"""Slack on a length along a side, in mm."""

ROUNDED_STEPS = 1e-6
"""Share of a step of an arc that is rounding, not one more step."""

RADIUS_STEPS, CENTER_STEPS = 30, 40
"""Bisections for the largest radius that fits, and for the centre of an arc along a bend."""

SCAN_POINTS = 33
"""Number of places along a bend at which a first centre of the arc is searched."""


def compute_directions(points: FloatArray) -> FloatArray:
    """Compute the unit vectors of a polyline's segments.

    Parameters
    ----------
    points : ndarray, shape (n, d)

    Returns
    -------
    ndarray, shape (n - 1, d)
    """
    steps = np.diff(points, axis=0)
    return np.asarray(steps / np.linalg.norm(steps, axis=1, keepdims=True))


def compute_turns(points: FloatArray) -> FloatArray:
    """Compute the angle by which a polyline turns at each inner point.

    Parameters
    ----------
    points : ndarray, shape (n, d)

    Returns
    -------
    ndarray, shape (n - 2,), in rad
    """
    way = compute_directions(points)
    return 2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(way[1:] - way[:-1], axis=1), 0.0, 1.0))


def find_corners(points: FloatArray) -> list[int]:
    """Find the inner points of a polyline that are corners.

    Parameters
    ----------
    points : ndarray, shape (n, d)

    Returns
    -------
    list of int
        Indices into `points`.
    """
    return [int(i) + 1 for i in np.flatnonzero(compute_turns(points) > MIN_CORNER_ANGLE)]


def compute_curvature(points: FloatArray) -> FloatArray:
    """Compute the curvature at each point: that of the circle through the point and its two neighbours.

    Parameters
    ----------
    points : ndarray, shape (n, d)

    Returns
    -------
    ndarray, shape (n,), in 1 over the unit of `points`
        0 at ends and corners.

    Examples
    --------
    >>> angle = np.linspace(0.0, 1.0, 30)
    >>> print(compute_curvature(4.0 * np.column_stack([np.cos(angle), np.sin(angle)]))[1:-1].round(6).min())
    0.25
    """
    found = np.zeros(len(points))
    turn = compute_turns(points)
    chord = np.linalg.norm(points[2:] - points[:-2], axis=1)
    found[1:-1] = np.where(turn > MIN_CORNER_ANGLE, 0.0, 2.0 * np.sin(turn) / np.maximum(chord, TINY))
    return found


def round_corners(points: FloatArray, radius: float) -> Outline:
    """Replace every corner by an arc that touches both of its sides.

    A side between two corners gives half of its length to each of them. Where that is too short, the arc is as
    large as the side allows, and a remark reports it. Where the path turns back on itself, the corner stays.

    Parameters
    ----------
    points : ndarray, shape (n, d), in mm
    radius : float, in mm
        0 keeps all corners.

    Returns
    -------
    Outline
        The new points, and remarks on corners that could not be rounded as requested.
    """
    corners = find_corners(points)
    if radius <= 0.0 or not corners:
        return Outline(points)
    sides = [points[a : b + 1] for a, b in pairwise([0, *corners, len(points) - 1])]
    lengths = [float(compute_arc_lengths(side)[-1]) for side in sides]
    turn = compute_turns(points)
    parts: list[FloatArray] = []
    start, short, kept = 0.0, [], 0
    for k, corner in enumerate(corners):
        before, after = sides[k][::-1], sides[k + 1]
        room = (lengths[k] * (0.5 if k else 1.0), lengths[k + 1] * (0.5 if k + 1 < len(corners) else 1.0))
        fillet = None if turn[corner - 1] > MIN_REVERSAL_ANGLE else _fit_largest_arc(before, after, room, radius)
        back, arc, size, onward = fillet or (0.0, points[corner][None], 0.0, 0.0)
        if turn[corner - 1] > MIN_REVERSAL_ANGLE:
            kept += 1
        elif size < radius * SHORT:
            short.append((size, points[corner]))
        parts += [_cut_side(sides[k], start, lengths[k] - back), arc]
        start = onward
    parts.append(_cut_side(sides[-1], start, lengths[-1]))
    joined = np.vstack(parts)
    new = np.concatenate([[True], np.linalg.norm(np.diff(joined, axis=0), axis=1) > MERGED])
    remarks = []
    if short:
        least, where = min(short, key=lambda item: item[0])
        remarks.append(
            f"{len(short)} of {len(corners)} corners have sides too short for an arc of {radius:g} mm: "
            f"down to {least:.2f} mm, at ({where[0]:.1f}, {where[1]:.1f}) mm"
        )
    if kept:
        these = "1 corner stays as it is" if kept == 1 else f"{kept} corners stay as they are"
        remarks.append(f"{these}: the path turns back on itself there")
    return Outline(joined[new], tuple(remarks))


def _cut_side(side: FloatArray, low: float, high: float) -> FloatArray:
    """Cut a side between two arc lengths; a single point if nothing is left between two arcs."""
    arc = compute_arc_lengths(side)
    inner = side[(arc > low + ROUNDING) & (arc < high - ROUNDING)]
    return np.vstack([interpolate_polyline(side, min(low, high)), inner, interpolate_polyline(side, high)])


Fillet = tuple[float, FloatArray, float, float]
"""Length that the arc replaces on the side before it, its points, its radius, and the length on the side after it."""


def _fit_largest_arc(before: FloatArray, after: FloatArray, room: tuple[float, float], radius: float) -> Fillet | None:
    """Compute the arc of `radius`, or the largest one that fits."""
    found = _fit_arc(before, after, room, radius)
    if found is not None:
        return found
    low, high = 0.0, radius
    for _ in range(RADIUS_STEPS):
        middle = 0.5 * (low + high)
        tried = _fit_arc(before, after, room, middle)
        if tried is None:
            high = middle
        else:
            low, found = middle, tried
    return found


def _fit_arc(before: FloatArray, after: FloatArray, room: tuple[float, float], radius: float) -> Fillet | None:
    """Compute the arc of `radius` that touches both sides, which begin at the corner; None if it does not fit."""
    one, other = compute_directions(before)[0], compute_directions(after)[0]
    half = float(np.arcsin(min(0.5 * float(np.linalg.norm(one + other)), 1.0)))  # of the turn
    back = onward = radius * np.tan(half)
    normal = other - (other @ one) * one
    center = before[0] + back * one + radius * normal / np.linalg.norm(normal)
    first = min(float(np.linalg.norm(side[1] - side[0])) for side in (before, after))
    if back > min(first, *room):
        bent = None if len(before) == len(after) == 2 else _fit_arc_to_bends(before, after, room, radius)
        if bent is None:
            return None
        back, onward, center = bent
    p, q = interpolate_polyline(before, back) - center, interpolate_polyline(after, onward) - center
    angle = float(np.arccos(np.clip(p @ q / np.linalg.norm(p) / np.linalg.norm(q), -1.0, 1.0)))
    share = np.linspace(0.0, 1.0, max(int(np.ceil(angle / ARC_STEP_ANGLE - ROUNDED_STEPS)), 2) + 1)[:, None]
    sweep = (np.sin((1.0 - share) * angle) * p + np.sin(share * angle) * q) / np.sin(angle)
    return back, center + sweep, radius, onward


def _fit_arc_to_bends(
    before: FloatArray, after: FloatArray, room: tuple[float, float], radius: float
) -> tuple[float, float, FloatArray] | None:
    """Compute the lengths that an arc takes of two curved sides, and its centre; None if it does not fit.

    The centre lies `radius` beside the first side, and is as far from the second.
    """
    ways, arc = compute_directions(before), compute_arc_lengths(before)
    beside = compute_directions(after)[0]
    normals = []
    for way in ways:  # parallel transport: no turn about the bend's own direction
        beside = beside - (beside @ way) * way
        beside = beside / np.linalg.norm(beside)
        normals.append(beside)
    at = np.vstack([normals[:1], 0.5 * (np.array(normals[1:]) + normals[:-1]).reshape(-1, len(beside)), normals[-1:]])

    def center(s: float) -> FloatArray:
        normal = np.array([np.interp(s, arc, at[:, k]) for k in range(before.shape[1])])
        return interpolate_polyline(before, s) + radius * normal / np.linalg.norm(normal)

    def gap(s: float) -> float:
        return find_nearest_place(after, center(s))[1] - radius

    steps = np.linspace(0.0, room[0], SCAN_POINTS)
    first = next((i for i, s in enumerate(steps) if i and gap(s) >= 0.0), None)
    if first is None:
        return None
    low, high = float(steps[first - 1]), float(steps[first])
    for _ in range(CENTER_STEPS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if gap(middle) < 0.0 else (low, middle)
    onward = find_nearest_place(after, center(high))[0]
    return (high, onward, center(high)) if 0.0 < onward <= room[1] + ROUNDING else None
