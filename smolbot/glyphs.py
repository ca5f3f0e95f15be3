"""Letters as single strokes, in a box of width and height 1, drawn without lifting the pen."""

from __future__ import annotations

import numpy as np

from smolbot.arrays import FloatArray
from smolbot.errors import InputError

BOWL = 0.25
"""Radius of the R's bowl as a fraction of its height: the bowl takes the upper half."""

S_TERMINAL = 10.0
"""Where the S begins and ends on its bowls, in degrees above and below their middle."""


def _letter_r(width: float, height: float) -> FloatArray:
    """Up the stem, round the bowl back to the stem, down the leg."""
    radius = BOWL * height
    straight = max(width - radius, 0.0)
    stretch = min(width, radius) / radius
    angle = np.linspace(0.5 * np.pi, -0.5 * np.pi, 49)
    bowl = np.stack([straight + stretch * radius * np.cos(angle), height - radius + radius * np.sin(angle)], axis=1)
    return np.concatenate([[[0.0, 0.0], [0.0, height]], bowl, [[0.0, 0.5 * height], [width, 0.0]]])


def _letter_i(width: float, height: float) -> FloatArray:
    return np.array([[0.5 * width, 0.0], [0.5 * width, height]])


def _letter_l(width: float, height: float) -> FloatArray:
    return np.array([[0.0, height], [0.0, 0.0], [width, 0.0]])


def _letter_s(width: float, height: float) -> FloatArray:
    """From the upper end round the upper bowl, through the middle, round the lower one: the gentlest bends that fit.

    Each bowl is half as high as the letter, its ends quarter circles and half circles joined by straight pieces.
    """
    radius = BOWL * height
    reach = max(0.5 * width - radius, 0.0)
    stretch = min(0.5 * width, radius) / radius
    right = np.linspace(np.radians(S_TERMINAL), 0.5 * np.pi, 33)
    left = np.linspace(0.5 * np.pi, 1.5 * np.pi, 65)
    x = np.concatenate([reach + stretch * radius * np.cos(right), -reach + stretch * radius * np.cos(left)])
    y = radius + radius * np.sin(np.concatenate([right, left]))
    upper = np.stack([x, y], axis=1)
    return np.concatenate([upper, -upper[::-1]]) + 0.5 * np.array([width, height])


GLYPHS = {"I": _letter_i, "L": _letter_l, "R": _letter_r, "S": _letter_s}


def glyph(name: str, width: float, height: float) -> FloatArray:
    """Points (n, 2) of a letter of the given size, centred on the origin, in the unit of `width`.

    Examples
    --------
    >>> print(glyph("L", 2.0, 4.0))
    [[-1.  2.]
     [-1. -2.]
     [ 1. -2.]]
    """
    if name not in GLYPHS:
        raise InputError(f"No glyph is named '{name}'; known glyphs: {', '.join(GLYPHS)}.")
    points = GLYPHS[name](width, height)
    keep = np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9])
    return points[keep] - 0.5 * np.array([width, height])
