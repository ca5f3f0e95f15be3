"""The paper's law: the field of two coils points toward the goal (Eqs. S11 to S17).

It uses the direction of B in place of the direction of the force, which is correct near the centre only.
Eqs. S14 and S15 are printed inverted; here the coil that needs less gets less (docs/decisions).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from controllers.pace import Pace
from controllers.path_progress import PathProgress
from controllers.table_edge import make_outside_command, move_into_table
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.shots import Actuate
from smolbot.flight.scheduler import compute_actuation_time
from smolbot.motion.controller import Command, ForceProfile, Gain, Phase, Setup, complete_gains
from smolbot.paths.curve import Curve
from smolbot.paths.visits import divide_path

if TYPE_CHECKING:
    from lookup_tables import FieldTable


@dataclass(frozen=True)
class CoilPair:
    """Two coils whose field points in the requested direction.

    Attributes
    ----------
    j, k : int
        Indices of the coils.
    share_j, share_k : float
        Shares of the full current.
    field : float, in T per A
    """

    j: int
    k: int
    share_j: float
    share_k: float
    field: float


def compute_pair_shares(ratio: float) -> tuple[float, float]:
    """Compute the shares of the full current in coils (j, k) for a current ratio lambda (Eqs. S14, S15 corrected).

    Parameters
    ----------
    ratio : float
        lambda, within 0 to 1.

    Returns
    -------
    share_j, share_k : float

    Examples
    --------
    >>> [compute_pair_shares(x) for x in (0.0, 0.25, 0.5, 1.0)]
    [(0.0, 1.0), (0.3333333333333333, 1.0), (1.0, 1.0), (1.0, 0.0)]
    """
    if ratio < 0.5:
        return ratio / (1.0 - ratio), 1.0
    return 1.0, (1.0 - ratio) / ratio


def find_best_pair(fields: FloatArray, direction: FloatArray) -> CoilPair | None:
    """Find the pair of coils with the strongest field along a direction (Eq. S13).

    Parameters
    ----------
    fields : ndarray, shape (n_coils, 2), in T per A, world frame
        Horizontal field of each coil at the robot.
    direction : ndarray, shape (2,)
        Unit vector D (Eq. S11).

    Returns
    -------
    Pair or None
        None if no pair can point there.
    """
    dx, dy = float(direction[0]), float(direction[1])
    coils: list[list[float]] = fields.tolist()
    cross = [bx * dy - by * dx for bx, by in coils]  # B x D
    along = [bx * dx + by * dy for bx, by in coils]
    best: CoilPair | None = None
    for j in range(len(coils)):
        for k in range(j + 1, len(coils)):
            span = cross[j] - cross[k]
            if abs(span) < 1e-15:
                continue
            ratio = -cross[k] / span  # Eq. S13
            if not -1e-9 <= ratio <= 1.0 + 1e-9:
                continue
            share_j, share_k = compute_pair_shares(min(max(ratio, 0.0), 1.0))
            field = share_j * along[j] + share_k * along[k]
            if field > 0.0 and (best is None or field > best.field):
                best = CoilPair(j, k, share_j, share_k, field)
    return best


class CurrentRatio:
    """Steers from goal to goal along the path by the ratio of two coil currents.

    Parameters
    ----------
    setup : Setup
    gains : mapping of str to float
        Values that differ from the defaults.
    """

    gains: ClassVar[Mapping[str, Gain]] = {
        "i_min_a": Gain(6.0, 0.5, 20.0, meaning="current close to a goal"),
        "i_max_a": Gain(8.0, 0.5, 20.0, meaning="current far from a goal"),
        "p_thr_mm": Gain(3.0, 0.5, 20.0, meaning="distance from which the current is reduced"),
        "t_min_ms": Gain(30.0, 5.0, 100.0, meaning="actuation per cycle"),
        "t_max_ms": Gain(80.0, 5.0, 200.0, meaning="actuation per cycle for a turn of 180 degrees"),
        "sharp_deg": Gain(30.0, 0.0, 180.0, meaning="turns beyond this stretch the actuation"),
        "spacing_mm": Gain(1.5, 0.2, 10.0, meaning="distance between goals along the path"),
    }

    def __init__(self, setup: Setup, gains: Mapping[str, float]) -> None:
        self.setup = setup
        values = complete_gains(self.gains, gains, "current_ratio", ("i_min_a", "i_max_a"))
        self._i_min, self._i_max = values["i_min_a"], values["i_max_a"]
        self._most = min(self._i_max, setup.limits.max_current)
        self._threshold = values["p_thr_mm"] * 1e-3
        self._t_min, self._t_max = values["t_min_ms"] * 1e-3, values["t_max_ms"] * 1e-3
        self._sharp = float(np.radians(values["sharp_deg"]))
        self._spacing = values["spacing_mm"] * 1e-3
        self._rest = setup.cycle.duration(setup.device.frequency)
        self._goals, self._reach = np.zeros((0, 3)), np.zeros(0)
        self._paced: tuple[PathProgress, Pace] | None = None
        self._arc = np.zeros(0)
        self._next = 0

    def reset(self, path: Curve, pose: Pose) -> None:
        """Start a path: its first goal is the path's start.

        A loop smaller than the tolerance has its goals closer to each other, to be reached within a share of its
        radius: within the tolerance, the robot would reach all of them from outside the loop.

        Parameters
        ----------
        path : Curve
        pose : Pose
        """
        cells = divide_path(path, self.setup.tolerance)
        in_loop = cells.reach < self.setup.tolerance
        self._arc = np.union1d(path.sampled(self._spacing), cells.arc[in_loop])
        self._goals = path.at(self._arc)
        self._reach = cells.find_reach(self._arc)
        self._next = 0
        self._paced = None
        if path.speed is not None:
            self._paced = PathProgress(path), Pace(path.speed, self._rest + self._t_min)

    def command(self, pose: Pose) -> Command:
        """Compute the currents toward the next goal that is not yet reached (Eq. S16).

        Parameters
        ----------
        pose : Pose

        Returns
        -------
        Command
        """
        inside = move_into_table(self.setup.table, pose, self.setup.tolerance)
        if inside is None:
            return make_outside_command(pose, self._compute_progress(), "approach" if self._next == 0 else "follow")
        pose = inside
        while self._next < len(self._goals) and self._compute_distance(pose) <= self._reach[self._next]:  # Eq. S16
            self._next += 1
        behind = self._compute_progress()
        if self._next >= len(self._goals):
            return Command(None, note="path's end reached", progress=behind, done=True)
        phase: Phase = "approach" if self._next == 0 else "follow"
        goal = self._goals[self._next]
        way = goal[:2] - pose.position[:2]
        distance = float(np.linalg.norm(way))
        direction = way / distance
        currents, saturated, note = self._compute_currents(pose.position, direction, distance)
        heading = (pose.rotation @ self.setup.device.moment_in_body)[:2]
        turn = abs(float(np.arctan2(heading[0] * direction[1] - heading[1] * direction[0], heading @ direction)))
        duration = compute_actuation_time(turn, self._t_min, self._t_max, self._sharp)
        if self._paced is not None and phase == "follow":
            currents = currents * self._compute_share(pose, currents, direction, duration)
        window = Actuate(tuple(float(c) for c in currents), duration) if currents.any() else None
        return Command(window, saturated, note, progress=behind, phase=phase)

    def reach(self, path: Curve) -> ForceProfile:
        """Compute the true force of the law on an aligned moment along the path, at the distance of one goal.

        Parameters
        ----------
        path : Curve

        Returns
        -------
        ForceProfile
        """
        arc = path.sampled(0.5e-3)
        points, tangents = path.at(arc), path.tangent(arc)
        force, error = np.zeros(len(arc)), np.zeros(len(arc))
        for i, (point, tangent) in enumerate(zip(points, tangents, strict=True)):
            currents, _, _ = self._compute_currents(point, tangent[:2], self._spacing)
            pull = compute_aligned_force(self.setup.table, currents, point, self.setup.robot.moment)[:2]
            force[i] = float(np.linalg.norm(pull))
            cosine = pull @ tangent[:2] / max(force[i], 1e-30)
            error[i] = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
        return ForceProfile(points, force, error)

    def _compute_share(self, pose: Pose, currents: FloatArray, direction: FloatArray, duration: float) -> float:
        """Compute the share of the currents that moves the robot as far as the path's speed requires."""
        assert self._paced is not None
        progress, pace = self._paced
        progress.locate(pose.position, self.setup.tolerance)
        stride = pace.compute_stride(pose.time, progress.arc_length)
        robot = self.setup.robot
        pull = float(compute_aligned_force(self.setup.table, currents, pose.position, robot.moment)[:2] @ direction)
        expected = pull / robot.drag * duration
        return 1.0 if expected <= stride else stride / expected

    def _compute_progress(self) -> float:
        """Compute the arc length, in m, of the last goal that was reached."""
        return float(self._arc[max(self._next - 1, 0)]) if len(self._arc) else 0.0

    def _compute_distance(self, pose: Pose) -> float:
        return float(np.linalg.norm(self._goals[self._next][:2] - pose.position[:2]))

    def _compute_currents(
        self, position: FloatArray, direction: FloatArray, distance: float
    ) -> tuple[FloatArray, bool, str]:
        requested = self._i_min + (self._i_max - self._i_min) * distance / self._threshold  # Eq. S12
        size = min(requested, self._most)
        fields = self.setup.table.field(position[None, :])[:, 0, :2]
        currents = np.zeros(len(fields))
        pair = find_best_pair(fields, direction)
        if pair is None:
            return currents, True, "no pair of coils can point along the way"
        currents[pair.j], currents[pair.k] = size * pair.share_j, size * pair.share_k
        return currents, requested > self._most, ""


def compute_aligned_force(table: FieldTable, currents: FloatArray, position: FloatArray, moment: float) -> FloatArray:
    """Compute the force on a moment that has aligned with the field: F = |m| grad |B|.

    Parameters
    ----------
    table : FieldTable
    currents : ndarray, shape (n_coils,), in A
    position : ndarray, shape (3,), in m, world frame
    moment : float, in A·m²

    Returns
    -------
    ndarray, shape (3,), in N, world frame
    """
    field = np.einsum("c,ck->k", currents, table.field(position[None, :])[:, 0])
    gradient = np.einsum("c,ckl->kl", currents, table.gradient(position[None, :])[:, 0])
    return moment * (field @ gradient) / max(float(np.linalg.norm(field)), 1e-30)
