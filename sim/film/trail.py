"""Where a simulated robot truly was: the trail that a run has left, as the camera films it."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from smolbot.arrays import FloatArray
from smolbot.errors import InputError, MissingFileError

PLACE = ("true_x_m", "true_y_m", "true_z_m")
TURN = ("true_qw", "true_qx", "true_qy", "true_qz")


@dataclass(frozen=True, eq=False)
class Trail:
    """True poses in order of time.

    Attributes
    ----------
    times : ndarray, shape (n,), in s
        On the run's clock.
    positions : ndarray, shape (n, 3), in m
        The cantilever's rotation centre, world frame.
    orientations : ndarray, shape (n, 4)
        Unit quaternions, scalar first, of the same sign from row to row.
    """

    times: FloatArray
    positions: FloatArray
    orientations: FloatArray

    def __post_init__(self) -> None:
        turned = self.orientations.copy()
        for i in range(1, len(turned)):  # q and -q are the same turn
            if turned[i] @ turned[i - 1] < 0:
                turned[i] *= -1.0
        object.__setattr__(self, "orientations", turned)

    def at(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions (n, 3) and orientations (n, 4) at `times`, straight between rows, at rest before and after."""
        places = np.column_stack([np.interp(times, self.times, column) for column in self.positions.T])
        turned = np.column_stack([np.interp(times, self.times, column) for column in self.orientations.T])
        return places, turned / np.linalg.norm(turned, axis=1, keepdims=True)


def read_trail(run: str | Path) -> Trail:
    """The trail of a run folder, from the ``true_*`` columns of its ``cycles.csv``.

    Raises
    ------
    MissingFileError
        If there is no such run.
    InputError
        If it holds no truth, as on a bench.
    """
    path = Path(run) / "cycles.csv"
    if not path.is_file():
        raise MissingFileError(f"{path}: no such file; name the folder of a run, as smolbot run leaves it.")
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    wanted = ("end_s", "pose_time_s", *PLACE, *TURN)
    if rows and any(name not in rows[0] for name in wanted):
        raise InputError(f"{path}: is no record of a run; the columns {', '.join(wanted)} are needed.")
    try:
        known = [
            # the truth of a cycle that listened to nothing is that of its end
            [float(r["pose_time_s"] or r["end_s"]), *(float(r[name]) for name in (*PLACE, *TURN))]
            for r in rows
            if r[PLACE[0]]
        ]
    except ValueError as error:
        raise InputError(f"{path}: {error}.") from error
    if len(known) < 2:
        raise InputError(f"{path}: holds no true poses; only a run in the simulated tank can be filmed.")
    table = np.array(known)
    table = table[np.argsort(table[:, 0], kind="stable")]
    table = table[np.concatenate([[True], np.diff(table[:, 0]) > 0])]
    return Trail(table[:, 0], table[:, 1:4], table[:, 4:])
