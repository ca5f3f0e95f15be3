"""Data of an SVG path as Bézier curves and arcs.

Equations of arcs: SVG 2, appendix B.2, "Elliptical arc implementation notes".
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.paths.drawing.svg_units import GAP, NUMBER

_COUNTS = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}
_ARC = re.compile("".join(rf"({part})" + GAP for part in (NUMBER,) * 3) + r"([01])\s*,?\s*([01])\s*,?\s*"
                  + "".join(rf"({part})" + GAP for part in (NUMBER,) * 2))  # fmt: skip

TINY = 1e-300
"""Squared length that keeps a quotient finite."""


@dataclass(frozen=True)
class Bezier:
    """A Bézier curve; a straight line has two control points.

    Attributes
    ----------
    points : ndarray, shape (n, 2)
        Control points, n from 2 to 4.
    """

    points: FloatArray

    def at(self, t: float) -> FloatArray:
        """Compute a point by de Casteljau's construction.

        Parameters
        ----------
        t : float
            0 at the start, 1 at the end.

        Returns
        -------
        ndarray, shape (2,)
        """
        level = self.points
        while len(level) > 1:
            level = (1.0 - t) * level[:-1] + t * level[1:]
        return level[0]

    def place(self, matrix: FloatArray) -> Bezier:
        """Map the curve.

        Parameters
        ----------
        matrix : ndarray, shape (3, 3)
            Affine map of homogeneous points.

        Returns
        -------
        Bezier
        """
        return Bezier(self.points @ matrix[:2, :2].T + matrix[:2, 2])

    @property
    def straight(self) -> bool:
        """Whether it is a straight line by its kind."""
        return len(self.points) == 2


@dataclass(frozen=True)
class Arc:
    """A piece of an ellipse: x(t) = center + axes (cos a, sin a), a = begin + t sweep.

    Attributes
    ----------
    center : ndarray, shape (2,)
    axes : ndarray, shape (2, 2)
        Two half diameters as columns.
    begin, sweep : float, in rad
    """

    center: FloatArray
    axes: FloatArray
    begin: float
    sweep: float

    straight = False

    def at(self, t: float) -> FloatArray:
        """Compute a point.

        Parameters
        ----------
        t : float
            0 at the start, 1 at the end.

        Returns
        -------
        ndarray, shape (2,)
        """
        angle = self.begin + t * self.sweep
        return self.center + self.axes @ (np.cos(angle), np.sin(angle))

    def place(self, matrix: FloatArray) -> Arc:
        """Map the arc.

        Parameters
        ----------
        matrix : ndarray, shape (3, 3)
            Affine map of homogeneous points.

        Returns
        -------
        Arc
        """
        linear = matrix[:2, :2]
        return Arc(linear @ self.center + matrix[:2, 2], linear @ self.axes, self.begin, self.sweep)


def find_data_fault(data: str) -> str | None:
    """Describe the fault of a path's data; a browser would draw the path up to it.

    Parameters
    ----------
    data : str
        Attribute ``d``.

    Returns
    -------
    str or None

    Examples
    --------
    >>> find_data_fault("M 0,0 l 3 4 5 6 a 1 1 0 0110-5z")
    >>> find_data_fault("M 0 0 L 10 x 20")
    "'x' at character 12 is no command"
    >>> find_data_fault("M 0 0 C 1 2 3 4")
    'C at character 7 has 4 numbers; it takes 6 each time'
    """
    for letter in re.finditer(r"[^\d\s,.+\-eE]", data):
        if letter[0].upper() not in _COUNTS:
            return f"'{letter[0]}' at character {letter.start() + 1} is no command"
    for match in re.finditer(r"([A-DF-Za-df-z])([^A-DF-Za-df-z]*)", data):
        command, given, at = match[1], match[2], match.start() + 1
        count = _COUNTS[command.upper()]
        if command in "Aa":
            if not re.fullmatch(rf"\s*(?:{_ARC.pattern})+", given):
                return f"{command} at character {at} needs radii, rotation, two flags and an end each time"
            continue
        if not re.fullmatch(rf"\s*(?:{NUMBER}{GAP})*", given):
            return f"the numbers of {command} at character {at} cannot be read: '{given.strip()[:40]}'"
        found = len(re.findall(NUMBER, given))
        if (count == 0 and found) or (count and (found == 0 or found % count)):
            return f"{command} at character {at} has {found} numbers; it takes {count} each time"
    if data.strip() and data.strip()[0] not in "Mm":
        return f"it must begin with M; got '{data.strip()[:20]}'"
    return None


def parse_path(data: str) -> list[list[Bezier | Arc]]:
    """Convert the data of a path to curves.

    Parameters
    ----------
    data : str
        Without a fault, see `find_data_fault`.

    Returns
    -------
    list of list of Bezier or Arc
        Strokes, each drawn without lifting the pen.

    Examples
    --------
    >>> [[curve.points.tolist() for curve in stroke] for stroke in parse_path("M 0 0 h 2 v 1")]
    [[[[0.0, 0.0], [2.0, 0.0]], [[2.0, 0.0], [2.0, 1.0]]]]
    """
    strokes: list[list[Bezier | Arc]] = [[]]
    pen = begin = np.zeros(2)
    last, handle = "", pen  # the command before, and the control point that a smooth curve mirrors
    for command, numbers in _list_commands(data):
        kind, origin = command.upper(), pen if command.islower() else np.zeros(2)
        mirrored = 2.0 * pen - handle if last and last in {"S": "CS", "T": "QT"}.get(kind, "") else pen
        last = kind
        match kind:
            case "M":
                pen = begin = handle = origin + numbers
                strokes.append([])
                continue
            case "Z":
                controls = np.array([begin])
            case "H":
                controls = np.array([[origin[0] + numbers[0], pen[1]]])
            case "V":
                controls = np.array([[pen[0], origin[1] + numbers[0]]])
            case "A":
                end = origin + numbers[5:]
                strokes[-1].append(_make_arc(pen, end, numbers))
                pen = handle = end
                continue
            case _:
                controls = origin + np.reshape(numbers, (-1, 2))
                if kind in "ST":
                    controls = np.vstack([mirrored, controls])
        curve = Bezier(np.vstack([pen, controls]))
        strokes[-1].append(curve)
        handle, pen = curve.points[-2], curve.points[-1]
    return [stroke for stroke in strokes if stroke]


def _list_commands(data: str) -> list[tuple[str, FloatArray]]:
    """List the commands with their numbers, each once for every time that it is repeated."""
    commands = []
    for command, given in re.findall(r"([A-DF-Za-df-z])([^A-DF-Za-df-z]*)", data):
        if command in "Aa":
            numbers = [float(n) for found in _ARC.findall(given) for n in found]
        else:
            numbers = [float(n) for n in re.findall(NUMBER, given)]
        count = _COUNTS[command.upper()]
        times = len(numbers) // count if count else 1
        for k in range(times):
            repeated = {"M": "L", "m": "l"}.get(command, command) if k else command
            commands.append((repeated, np.array(numbers[k * count : (k + 1) * count])))
    return commands


def _make_arc(start: FloatArray, end: FloatArray, numbers: FloatArray) -> Bezier | Arc:
    """Make an arc from its ends; radii that are too small for these grow until they suffice, 0 is a straight line."""
    (rx, ry), turn = np.abs(numbers[:2]), np.radians(numbers[2])
    large, clockwise = numbers[3] == 1.0, numbers[4] == 1.0
    if rx == 0.0 or ry == 0.0 or np.array_equal(start, end):
        return Bezier(np.array([start, end]))
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s], [s, c]])
    half = rotation.T @ (start - end) / 2.0 / (rx, ry)  # on the unit circle's scale
    growth = max(float(np.linalg.norm(half)), 1.0)
    half = half / growth
    beside = np.sqrt(max(1.0 / max(half @ half, TINY) - 1.0, 0.0)) * (1.0 if large != clockwise else -1.0)
    center = beside * np.array([half[1], -half[0]])
    first, second = half - center, -half - center
    begin = np.arctan2(first[1], first[0])
    sweep = (np.arctan2(second[1], second[0]) - begin) % (2.0 * np.pi)
    if not clockwise:
        sweep -= 2.0 * np.pi
    axes = rotation @ np.diag([rx, ry]) * growth
    return Arc(axes @ center + (start + end) / 2.0, axes, begin, sweep)
