"""The shipped single-stroke font: the 94 printable characters of ASCII, as plotters and engravers draw them.

Roman Simplex of the Hershey fonts, digitized by A. V. Hershey at the U. S. National Bureau of Standards, in the
ASCII order and format of James Hurt. Of seven characters with doubled lines ($ @ [ ] { } ~) one line was kept.
"""

from __future__ import annotations

from functools import cache
from importlib import resources

import numpy as np

from smolbot.core.arrays import FloatArray

FIRST_CHARACTER, LAST_CHARACTER = "!", "~"
"""First and last printable character of the font, which has no space."""

KNOWN_CHARACTERS = (
    f"the printable ASCII characters, {FIRST_CHARACTER} to {LAST_CHARACTER} (A to Z, a to z, 0 to 9 and signs)"
)


@cache
def _read_font_lines() -> tuple[str, ...]:
    return tuple(resources.files("smolbot.paths.drawing").joinpath("sans.jhf").read_text(encoding="ascii").splitlines())


def is_in_font(character: str) -> bool:
    """Return whether the font contains a character.

    Parameters
    ----------
    character : str

    Returns
    -------
    bool
        False for a space, and for a string of several characters.

    Examples
    --------
    >>> [is_in_font(c) for c in ("S", "~", " ", "ß", "SS")]
    [True, True, False, False, False]
    """
    return len(character) == 1 and FIRST_CHARACTER <= character <= LAST_CHARACTER


def read_strokes(character: str) -> list[FloatArray]:
    """Return the strokes of a character on the font's grid: y up, base line at -9, cap line at 12.

    A line of the font file holds the code (5 digits), the number of pairs (3 digits), then pairs of letters: left
    and right margin, points, and " R" where the pen is lifted. A letter encodes its distance from "R".

    Parameters
    ----------
    character : str
        One character of the font.

    Returns
    -------
    list of ndarray, each of shape (n, 2)
        With n >= 2.
    """
    data = _read_font_lines()[ord(character) - ord(" ")][10:]
    return [
        np.array(
            [[ord(x) - ord("R"), ord("R") - ord(y)] for x, y in zip(part[::2], part[1::2], strict=True)], dtype=float
        )
        for part in data.split(" R")
    ]
