"""A run as arrays: planned, located, tracked, commanded and (with a witness) true values."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.rig import Witness
from smolbot.core.shots import Actuate
from smolbot.runs.run import CycleRecord, get_trusted_poses

WAY_STEP = 0.2
"""Seconds between two places on a robot's way while nothing listens."""

MAX_REST_STEP = 1e-5
"""A robot that moves less than this (m) in a step rests."""


@dataclass(frozen=True)
class Moment:
    """One cycle, with the ground truth where a witness knows it.

    Attributes
    ----------
    cycle : CycleRecord
    truth : Pose or None
        At the time of the pose.
    truth_at_end : Pose or None
        At the end of the shot.
    way : ndarray, shape (n, 3), in m
        True positions in the world frame during a shot without listening.
    """

    cycle: CycleRecord
    truth: Pose | None
    truth_at_end: Pose | None
    way: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def positions(self) -> FloatArray:
        """True positions (n, 3) in m: during the shot, at the time of the pose, at the end of the shot."""
        known = [p.position for p in (self.truth, self.truth_at_end) if p is not None]
        return np.vstack([self.way, np.array(known).reshape(-1, 3)])


def get_located_poses(moments: Iterable[Moment]) -> list[Pose]:
    """Return the trusted poses of some cycles, in order.

    Parameters
    ----------
    moments : iterable of Moment

    Returns
    -------
    list of Pose
    """
    return get_trusted_poses(m.cycle for m in moments)


def pair_with_truth(moments: Iterable[Moment]) -> list[tuple[Pose, Pose]]:
    """Pair the trusted poses of some cycles with the ground truth at their times.

    Parameters
    ----------
    moments : iterable of Moment

    Returns
    -------
    list of tuple of Pose
        Pose and truth; empty if no ground truth is known.
    """
    return [(pose, m.truth) for m in moments if (pose := m.cycle.trusted) is not None and m.truth is not None]


class Trace:
    """Collect every cycle of a run; besides record and report, nothing else has the ground truth.

    Parameters
    ----------
    witness : Witness or None

    Attributes
    ----------
    knows_truth : bool
        True with a witness, and for a run that was recorded with one.
    moments : list of Moment
    """

    def __init__(self, witness: Witness | None) -> None:
        self._witness = witness
        self.knows_truth = witness is not None
        self.moments: list[Moment] = []

    def __call__(self, record: CycleRecord) -> None:
        """Append one cycle, with the ground truth where a witness knows it.

        Parameters
        ----------
        record : CycleRecord
        """
        truth = end = None
        way = np.zeros((0, 3))
        if self._witness is not None:
            end = self._witness.truth(min(record.shot.end, record.ended))
            truth = self._witness.truth(record.pose.time) if record.pose is not None else end
            if record.shot.listen is None:
                way = self._sample_way(self._witness, record.shot.start, record.ended)
        self.moments.append(Moment(record, truth, end, way))

    @staticmethod
    def _sample_way(witness: Witness, start: float, end: float) -> FloatArray:
        """Return positions at equal time steps, without those at which the robot rested."""
        times = np.arange(start, end, WAY_STEP)
        places = np.array([witness.truth(float(time)).position for time in times]).reshape(-1, 3)
        if len(places) < 2:
            return places
        moved = np.linalg.norm(np.diff(places, axis=0), axis=1) > MAX_REST_STEP
        return places[1:][moved]

    @property
    def following(self) -> list[Moment]:
        """The cycles whose command came after the path's start was reached."""
        begun = next(
            (i for i, m in enumerate(self.moments) if m.cycle.command.phase == "follow" and _has_begun(m)), None
        )
        return [] if begun is None else self.moments[begun:]

    def currents(self, n_coils: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Collect the actuation windows of the run.

        Parameters
        ----------
        n_coils : int

        Returns
        -------
        starts : ndarray, shape (n,), in s
        durations : ndarray, shape (n,), in s
        currents : ndarray, shape (n, n_coils), in A
        """
        found = [
            (m.cycle.shot.start + at, window.duration, window.currents)
            for m in self.moments
            for at, window in m.cycle.shot.timed()
            if isinstance(window, Actuate)
        ]
        if not found:
            return np.zeros(0), np.zeros(0), np.zeros((0, n_coils))
        starts, durations, currents = zip(*found, strict=True)
        return np.array(starts), np.array(durations), np.array(currents)

    def true_positions(self) -> FloatArray:
        """Collect the true positions at pose times and shot ends, in order.

        Returns
        -------
        ndarray, shape (n, 3), in m
            In the world frame.
        """
        return np.vstack([np.zeros((0, 3)), *(m.positions for m in self.moments)])


def _has_begun(moment: Moment) -> bool:
    return moment.cycle.command.window is not None or moment.cycle.command.done


def make_cycle_row(number: int, moment: Moment) -> dict[str, Any]:
    """Build one row of ``cycles.csv``.

    Parameters
    ----------
    number : int
        Number of the cycle.
    moment : Moment

    Returns
    -------
    dict
        SI values with the unit in the key; None where there is no value.
    """
    cycle = moment.cycle
    pose, tracked, truth = cycle.pose, cycle.tracked, moment.truth
    actuate = next((w for w in cycle.shot.windows if isinstance(w, Actuate)), None)
    out: dict[str, Any] = {
        "cycle": number,
        "mode": cycle.shot.mode,
        "start_s": cycle.shot.start,
        "end_s": cycle.shot.end,
        "actuate_s": actuate.duration if actuate else 0.0,
        "currents_a": " ".join(f"{c:.4f}" for c in actuate.currents) if actuate else "",
        "excite_a": " ".join(f"{c:.4f}" for c in cycle.shot.excite.currents) if cycle.shot.excite else "",
        "pose_time_s": pose.time if pose else None,
        "r_squared": pose.r_squared if pose else None,
        "trusted": int(pose.trusted) if pose else None,
        "believed": int(tracked.trusted) if tracked else None,
        "phase": cycle.command.phase,
        "progress_m": cycle.command.progress,
        "note": cycle.command.note,
        "compute_s": cycle.compute,
    }
    for name, value in (("pose", pose), ("tracked", tracked), ("true", truth)):
        for index, axis in enumerate("xyz"):
            out[f"{name}_{axis}_m"] = value.position[index] if value else None
        for index, part in enumerate("wxyz"):
            out[f"{name}_q{part}"] = value.orientation[index] if value else None
    return out
