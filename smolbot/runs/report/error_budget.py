"""Split the tracking error of a run into its causes, by an identity for every step from one pose to the next.

Between pose k and pose m the robot was commanded once. With the true position x, the tracked position p, the
position y that the assumed motion model predicts for the end of the command, and the path's nearest point c to x_m,

    x_m - c = (y - c) + (x_k - p_k) + (x_a - x_k) + [(x_m - x_a) - (y - p_k)],

where x_a is the true position when the command begins to act. Projected on the direction of the error x_m - c, the
parts add up exactly to the tracking error of every step. See docs/decisions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from smolbot.config.mission import Mission
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.shots import Actuate, Window
from smolbot.motion.gradient import advance
from smolbot.paths.arc_lengths import assign_arc_lengths
from smolbot.runs.report.recorded_flight import RecordedFlight
from smolbot.runs.trace import Moment

if TYPE_CHECKING:
    from lookup_tables import FieldTable
    from smolbot.motion.robot import Robot

PARTS = {
    "localization": "true minus tracked position, at the pose that the command was made from",
    "lag": "how far the robot moved from that pose's time to the end of its shot, when the command begins to act; "
    "the controller assumes that it rests",
    "saturation": "distance to the path at which the command would have left the robot by the controller's model, in "
    "steps where a limit cut the command short",
    "aim": "the same in all other steps: errors that the controller had not yet corrected, and corners that it cuts",
    "mismatch": "true motion of the robot minus its motion by the controller's model under the same command",
}
"""Parts of the tracking error, and what they are."""


@dataclass(frozen=True)
class BudgetStep:
    """From one pose to the next, with one command in between.

    Attributes
    ----------
    tracked : ndarray, shape (2,), in m
        The pose that the command was computed from, p_k. All positions are horizontal, in the world frame.
    true : ndarray, shape (2,), in m
        The truth at its time, x_k.
    acting : ndarray, shape (2,), in m
        The truth at the end of its shot, x_a.
    expected : ndarray, shape (2,), in m
        The end position by the assumed motion model, y.
    reached : ndarray, shape (2,), in m
        The truth at the next pose, x_m.
    saturated : bool
        Whether a limit reduced the command.
    time : float, in s
        Of the next pose.
    """

    tracked: FloatArray
    true: FloatArray
    acting: FloatArray
    expected: FloatArray
    reached: FloatArray
    saturated: bool
    time: float


@dataclass(frozen=True)
class ErrorBudget:
    """The tracking error of each step and its parts.

    Attributes
    ----------
    time : ndarray, shape (n,), in s
    arc : ndarray, shape (n,), in m
        Arc length of the path at the end of the step.
    error : ndarray, shape (n,), in m
        Horizontal distance to the path; positive to the left of the direction of travel.
    parts : dict of str to ndarray, shape (n,), in m
        By the names of `PARTS`; they add up to `error`.
    """

    time: FloatArray
    arc: FloatArray
    error: FloatArray
    parts: dict[str, FloatArray]

    @property
    def total_rms(self) -> float:
        """Root mean square of the tracking error, in m."""
        return _compute_rms(self.error)

    @property
    def rms(self) -> dict[str, float]:
        """Root mean square of each part, in m."""
        return {name: _compute_rms(values) for name, values in self.parts.items()}

    @property
    def shares(self) -> dict[str, float]:
        """Share of each part in the mean square error, <e e_i> / <e²>; they add up to one.

        A share is negative if the part compensates others.
        """
        square = float(np.mean(self.error**2))
        return {name: float(np.mean(self.error * values)) / square for name, values in self.parts.items()}


def compute_budget(mission: Mission, steps: list[BudgetStep]) -> ErrorBudget | None:
    """Compute the error budget of steps along the mission's path.

    Parameters
    ----------
    mission : Mission
    steps : list of BudgetStep

    Returns
    -------
    Budget or None
        None without any step.
    """
    if not steps:
        return None
    reached = np.array([step.reached for step in steps])
    arc, distance = mission.path.project(np.column_stack([reached, np.zeros(len(reached))]))
    nearest, ahead = mission.path.at(arc)[:, :2], mission.path.tangent(arc)[:, :2]
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    off = reached - nearest
    side = np.where(np.sum(off * left, axis=1) < 0.0, -1.0, 1.0)
    size = np.linalg.norm(off, axis=1)
    across = np.where(size[:, None] > 1e-9, side[:, None] * off / np.maximum(size, 1e-30)[:, None], left)

    def along(vectors: list[FloatArray]) -> FloatArray:
        found: FloatArray = np.sum(across * np.array(vectors), axis=1)
        return found

    saturated = np.array([step.saturated for step in steps])
    aim = along([step.expected - c for step, c in zip(steps, nearest, strict=True)])
    parts = {
        "localization": along([step.true - step.tracked for step in steps]),
        "lag": along([step.acting - step.true for step in steps]),
        "saturation": np.where(saturated, aim, 0.0),
        "aim": np.where(saturated, 0.0, aim),
        "mismatch": along([(s.reached - s.acting) - (s.expected - s.tracked) for s in steps]),
    }
    in_order = assign_arc_lengths(mission.path, np.column_stack([reached, np.zeros(len(reached))]))
    return ErrorBudget(np.array([step.time for step in steps]), in_order, side * distance, parts)


def find_steps(flight: RecordedFlight) -> list[BudgetStep]:
    """Find every step of a run from the path's start on.

    Left out are steps without ground truth at both ends, and those over a missing cycle.

    A helix rests during pauses, so its steps are those from the last pose of a pause to the first of the next.

    Parameters
    ----------
    flight : RecordedFlight

    Returns
    -------
    list of BudgetStep
    """
    mission = flight.steered
    assert mission is not None
    following = flight.trace.following
    numbers = flight.record.number_of_cycle[len(flight.trace.moments) - len(following) :]
    moments = [(i, m) for i, m in zip(numbers, following, strict=True) if m.cycle.tracked is not None]
    if flight.is_helical:
        return _find_mechanical_steps(moments)
    setup = mission.setup()
    found = []
    for (number, before), (next_number, after) in pairwise(moments):
        estimate = before.cycle.tracked
        if next_number != number + 1 or not _has_truth(before, after) or estimate is None:
            continue
        step = predict_step(setup.robot, setup.table, estimate, after.cycle.shot.windows, setup.device.moment_in_body)
        if step is not None:
            found.append(_make_step(before, after, estimate.position[:2] + step))
    return found


def _find_mechanical_steps(moments: list[tuple[int, Moment]]) -> list[BudgetStep]:
    """Find the steps over each mechanical shot; the tracker's own prediction for it is in the record."""
    found = []
    for (number, before), (_, moved), (last, after) in zip(moments, moments[1:], moments[2:], strict=False):
        if last != number + 2:
            continue
        if moved.cycle.shot.listen is None and before.cycle.shot.listen is not None and _has_truth(before, after):
            assert moved.cycle.tracked is not None
            found.append(_make_step(before, after, moved.cycle.tracked.position[:2]))
    return found


def _make_step(before: Moment, after: Moment, expected: FloatArray) -> BudgetStep:
    estimate = before.cycle.tracked
    assert estimate is not None
    assert before.truth is not None
    assert before.truth_at_end is not None
    assert after.truth is not None
    return BudgetStep(
        estimate.position[:2],
        before.truth.position[:2],
        before.truth_at_end.position[:2],
        expected,
        after.truth.position[:2],
        before.cycle.command.saturated,
        after.truth.time,
    )


def _has_truth(before: Moment, after: Moment) -> bool:
    """Return whether both cycles have a pose and the ground truth."""
    located = before.cycle.pose is not None and after.cycle.pose is not None
    return located and before.truth is not None and before.truth_at_end is not None and after.truth is not None


def predict_step(
    robot: Robot, table: FieldTable, pose: Pose, windows: tuple[Window, ...], moment_in_body: FloatArray
) -> FloatArray | None:
    """Predict the displacement by the actuation windows with the assumed motion model.

    Parameters
    ----------
    robot : Robot
    table : FieldTable
    pose : Pose
        At the start of the windows.
    windows : tuple of Window
        Of one shot.
    moment_in_body : ndarray, shape (3,)
        Direction of the moment in the body frame.

    Returns
    -------
    ndarray, shape (2,), in m, or None
        In the world frame; None outside the table.
    """
    from lookup_tables.errors import OutsideTableError

    place, step = np.array(pose.position), np.zeros(2)
    ahead = pose.rotation @ moment_in_body
    heading = math.atan2(ahead[1], ahead[0])
    for window in windows:
        if not isinstance(window, Actuate) or not any(window.currents):
            continue
        try:
            field, gradient = table.field_and_gradient(place[None, :])
        except OutsideTableError:
            return None
        moved, heading = advance(
            robot, field[:, 0], gradient[:, 0], np.array(window.currents), heading, window.duration
        )
        place[:2] += moved
        step += moved
    return step


def _compute_rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
