"""The simulated board's shared state: `struct state` of ``avr/uno.c``, in a mapped file."""

from __future__ import annotations

import mmap
from pathlib import Path

import numpy as np

MAGIC = 0x31554E4F
"""First word of the state when the board has started, as in uno.c."""

RING_LENGTH = 131072
"""Edges that are kept."""

EDGE = np.dtype([("cycle", "<u8"), ("time", "<f8"), ("pin", "<u4"), ("level", "<u4")])
STATE = np.dtype(
    [
        ("magic", "<u4"),
        ("resets", "<u4"),
        ("steps", "<i8", (2,)),
        ("enabled", "<u4"),
        ("lamp", "<u4"),
        ("cycles", "<u8"),
        ("edges", "<u8"),
        ("done", "<u8"),
        ("taken", "<u8"),
        ("ring", EDGE, (RING_LENGTH,)),
    ]
)
PINS = ("turn step", "turn direction", "steering step", "steering direction", "drivers on")


class SharedState:
    """The board's state, read while it runs. Each number is written by a single thread, atomically.

    Parameters
    ----------
    path : Path
        Of the mapped file.
    """

    def __init__(self, path: Path) -> None:
        with path.open("w+b") as file:
            file.truncate(STATE.itemsize)
            self._map = mmap.mmap(file.fileno(), STATE.itemsize)
        self._view = np.frombuffer(self._map, STATE, count=1)[0]
        self._taken = 0

    def read_number(self, name: str) -> int:
        """Return the present value of a count or flag.

        Parameters
        ----------
        name : str

        Returns
        -------
        int
        """
        return int(self._view[name])

    @property
    def steps(self) -> tuple[int, int]:
        """Steps that the turning and the steering motor have made."""
        turn, steering = self._view["steps"]
        return int(turn), int(steering)

    def take_edges(self) -> np.ndarray:
        """Return the edges since the last call, oldest first; only the last `RING_LENGTH` are kept.

        Returns
        -------
        ndarray of `EDGE`
        """
        end = self.read_number("edges")
        first = max(self._taken, end - RING_LENGTH)
        self._taken = end
        return np.asarray(self._view["ring"][np.arange(first, end) % RING_LENGTH]).copy()
