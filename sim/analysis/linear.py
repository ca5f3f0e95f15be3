"""Linearise one cycle of the loop: how a small deviation from the path changes the next motion.

The law is evaluated as it is, with its internal state, at poses around the nominal one, spread like the errors of
tracked poses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from sim.analysis.flight import Instant, Model, State, displace_pose
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.rotations import compute_rotation_error
from smolbot.core.shots import Actuate
from smolbot.motion.controller import Controller

PROBE_PAIRS = 8
"""Pairs of poses, symmetric about the nominal one, at which a law is evaluated."""

CURRENT_STEP = 0.02
"""Step of the currents in a difference quotient, as a share of the largest."""

MIN_SIGMA = np.array([5e-5, math.radians(1.0)])
"""Smallest step of the pose, in m and rad."""

END = 1e-9
"""Distance, in m, before the end of a path at which its last tangent is taken."""

NO_MOTION, TINY = 1e-24, 1e-300
"""Sum of squares (m² or rad²) without motion to explain, and one that keeps a quotient finite."""


@dataclass(frozen=True, eq=False)
class Cycle:
    """The loop linearised about one nominal cycle. Deviations x are (across the path in m, heading in rad).

        x' = x + M x + G x^

    M is the motion of the same window from a deviating state; G is that of the window that the law gives for a pose x^.

    Attributes
    ----------
    arc : float, in m
        Progress along the path.
    position : ndarray, shape (2,), in m
    speed : float, in m
        Advance along the path in this cycle.
    duration, wait : float, in s
        Of the cycle; from the middle of listening to its end.
    sigma : ndarray, shape (2,)
        Standard deviation of the tracked pose; the law is evaluated within it.
    motion : ndarray, shape (2, 2)
        M.
    feedback : ndarray, shape (2, 2)
        G: the gain with the least residual motion, over poses with the errors of tracked ones.
    explained : ndarray, shape (2,)
        Share of the variance of the motion (across, turn) that G explains; 1 for a linear law.
    currents : ndarray, shape (2, n_coils), per A
        Motion per change of each coil's current.
    kalman : ndarray, shape (3, 2)
        Change of the tracked state (across, heading, drift across in m/s) per error of the measured pose.
    saturated : bool
    """

    arc: float
    position: FloatArray
    speed: float
    duration: float
    wait: float
    sigma: FloatArray
    motion: FloatArray
    feedback: FloatArray
    explained: FloatArray
    currents: FloatArray
    kalman: FloatArray
    saturated: bool


def linearize_cycle(model: Model, instant: Instant, pairs: int = PROBE_PAIRS) -> Cycle:
    """Linearise the loop about one instant of a flight.

    Parameters
    ----------
    model : Model
    instant : Instant
        With copies of tracker and law.
    pairs : int
        Pairs of poses at which the law is evaluated.

    Returns
    -------
    Cycle
    """
    assert instant.tracker is not None
    assert instant.controller is not None
    path, state, command = model.mission.path, instant.state, instant.command
    tangent = path.tangent(np.array([min(command.progress, path.length - END)]))[0, :2]
    normal = np.array([-tangent[1], tangent[0]])
    covariance = np.asarray(instant.pose.covariance)
    across = float(normal @ covariance[:2, :2] @ normal)
    sigma = np.maximum(np.sqrt([across, covariance[5, 5]]), MIN_SIGMA)
    feedback, explained = fit_feedback(model, instant.controller, instant.pose, state, normal, sigma, pairs)
    window = command.window

    def project(moved: tuple[FloatArray, float]) -> FloatArray:
        return np.array([moved[0] @ normal, moved[1]])

    motion = np.empty((2, 2))
    for k, step in enumerate(np.diag(sigma)):
        ends = [
            project(model.compute_motion(state.move(sign * step[0] * normal, sign * step[1]), window))
            for sign in (1.0, -1.0)
        ]
        motion[:, k] = (ends[0] - ends[1]) / (2.0 * sigma[k])
    return Cycle(
        arc=command.progress,
        position=state.position[:2].copy(),
        speed=float(model.compute_motion(state, window)[0] @ tangent),
        duration=instant.cycle,
        wait=instant.wait,
        sigma=sigma,
        motion=motion,
        feedback=feedback,
        explained=explained,
        currents=_differentiate_by_currents(model, state, window, normal),
        kalman=_differentiate_tracker(model, instant, normal, sigma),
        saturated=command.saturated,
    )


def fit_feedback(
    model: Model, controller: Controller, pose: Pose, state: State, normal: FloatArray, sigma: FloatArray, pairs: int
) -> tuple[FloatArray, FloatArray]:
    """Fit the feedback of a law about a pose.

    A law has dead zones, limits and branches, so a derivative at a point may be anything. This is the gain that a noisy
    input sees: least squares over poses that err as the tracked one does.

    Parameters
    ----------
    model : Model
    controller : Controller
    pose : Pose
        Nominal.
    state : State
        True state, from which motions are computed.
    normal : ndarray, shape (2,)
        Unit vector across the path.
    sigma : ndarray, shape (2,), in m and rad
        Standard deviation of the tracked pose.
    pairs : int

    Returns
    -------
    feedback : ndarray, shape (2, 2)
    explained : ndarray, shape (2,)
        Share of the variance that it explains.
    """
    points = _sample_normal_points(pairs) * sigma
    moved = np.empty((len(points), 2))
    for row, (off, turn) in enumerate(points):
        answer = model.copy_controller(controller).command(displace_pose(pose, off, normal, turn))
        step, swung = model.compute_motion(state, answer.window)
        moved[row] = step @ normal, swung
    design = np.column_stack([np.ones(len(points)), points / sigma])
    found, *_ = np.linalg.lstsq(design, moved, rcond=None)
    left = np.sum((moved - design @ found) ** 2, axis=0)
    total = np.sum((moved - moved.mean(axis=0)) ** 2, axis=0)
    explained = np.where(total > NO_MOTION, 1.0 - left / np.maximum(total, TINY), 1.0)
    return found[1:].T / sigma, explained


@cache
def _sample_normal_points(pairs: int) -> FloatArray:
    """Points (2 pairs, 2) of unit covariance in opposite pairs; the same each time, not random."""
    index = np.arange(pairs)
    # radii at the middles of equal shares of their distribution, each rotated by the golden section of half a turn
    radii = np.sqrt(-2.0 * np.log(1.0 - (index + 0.5) / pairs))
    angles = math.pi * ((index * 0.5 * (math.sqrt(5.0) - 1.0)) % 1.0)
    half = radii[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    points = np.concatenate([half, -half])
    factor = np.linalg.cholesky(points.T @ points / len(points))
    whitened: FloatArray = np.linalg.solve(factor, points.T).T
    return whitened


def _differentiate_by_currents(model: Model, state: State, window: object, normal: FloatArray) -> FloatArray:
    n = model.setup.table.n_coils
    out = np.zeros((2, n))
    if not isinstance(window, Actuate):
        return out
    step = CURRENT_STEP * model.setup.limits.max_current
    for c in range(n):
        ends = []
        for sign in (1.0, -1.0):
            currents = np.array(window.currents)
            currents[c] += sign * step
            moved, turn = model.compute_motion(state, Actuate(tuple(currents.tolist()), window.duration))
            ends.append(np.array([moved @ normal, turn]))
        out[:, c] = (ends[0] - ends[1]) / (2.0 * step)
    return out


def _differentiate_tracker(model: Model, instant: Instant, normal: FloatArray, sigma: FloatArray) -> FloatArray:
    """Compute the tracker's response to an error of a measured pose; exact, since it is linear in it."""
    assert instant.tracker is not None
    out = np.empty((3, 2))
    for k, (off, turn) in enumerate(np.diag(sigma)):
        ends = []
        for sign in (1.0, -1.0):
            tracker = model.copy_tracker(instant.tracker)
            tracker.update(instant.shot, displace_pose(instant.measured, sign * off, normal, sign * turn))
            assert tracker.pose is not None
            heading = compute_rotation_error(
                np.asarray(tracker.pose.orientation), np.asarray(instant.measured.orientation)
            )[2]
            place = normal @ np.asarray(tracker.pose.position)[:2]
            ends.append(np.array([place, heading, normal @ tracker.drift[:2]]))
        out[:, k] = (ends[0] - ends[1]) / (2.0 * sigma[k])
    return out


def average_cycles(cycles: list[Cycle], index: int, reach: int) -> Cycle:
    """Average the loop over neighbouring cycles: what acts on the loop while it settles.

    Parameters
    ----------
    cycles : list of Cycle
    index : int
        Of the cycle in the middle.
    reach : int
        Cycles before and after it.

    Returns
    -------
    Cycle
    """
    near = cycles[max(index - reach, 0) : index + reach + 1]
    here = cycles[index]

    def mean(name: str) -> FloatArray:
        return np.mean([getattr(c, name) for c in near], axis=0)

    return Cycle(
        here.arc, here.position, float(mean("speed")), float(mean("duration")), here.wait, mean("sigma"),
        mean("motion"), mean("feedback"), mean("explained"), mean("currents"), mean("kalman"), here.saturated,
    )  # fmt: skip
