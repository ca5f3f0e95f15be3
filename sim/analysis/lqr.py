"""A linear-quadratic regulator for the sampled loop, and the gains of a law whose feedback comes closest to it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim.analysis.flight import Model, simulate_flight
from sim.analysis.linear import Cycle, linearize_cycle
from smolbot.config.plugins import load_plugin
from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError
from smolbot.motion.controller import Controller, Gain


@dataclass(frozen=True)
class Weights:
    """Weights of the regulator: deviations of position (m), heading (rad) and current (share of full) that count alike.

    By default the error of a tracked pose, the turn of one window, and the range of a coil's current about its mean.
    """

    across: float = 1e-4
    heading: float = math.radians(10.0)
    current: float = 0.5

    @classmethod
    def parse(cls, text: str) -> Weights:
        """Read weights from text.

        Parameters
        ----------
        text : str
            Such as ``0.1,10,0.5``: mm, degrees, share of a full current.

        Returns
        -------
        Weights

        Raises
        ------
        InputError
            For anything else than three numbers above 0.
        """
        try:
            across, heading, current = (float(part) for part in text.split(","))
        except ValueError:
            across = heading = current = math.nan
        if not all(0.0 < value < math.inf for value in (across, heading, current)):
            raise InputError(f"--weights must be three numbers above 0, in mm, degrees and share of the full current, "
                             f"such as 0.1,10,0.5; got '{text}'.")  # fmt: skip
        return cls(1e-3 * across, math.radians(heading), current)


PLACES, PAIRS = 24, 4
"""Cycles of a flight at which a law is compared with the regulator, and pairs of poses for each."""

PACE = 1.1
"""Longest duration of a flight with the gains that are found, relative to now."""

STEP, LEAST_STEP = 0.16, 0.05
"""First and last step of the search, as shares of a gain's range."""

SHRINK = 0.5
"""Factor on the step after a round without improvement."""

NO_FEEDBACK = 1e-9
"""Size of a feedback that keeps a quotient finite."""

MIN_INFLUENCE = 0.05
"""Share of the distance that one step of a gain must change for the gain to be searched."""

MIN_IMPROVEMENT = 0.03
"""Share of the distance by which a step must improve to be accepted."""

MAX_FLIGHTS = 48
"""Largest number of flights of the search."""


def design_regulator(cycle: Cycle, weights: Weights, max_current: float) -> FloatArray:
    """Compute the feedback of the linear-quadratic regulator.

    The window's currents vary about those that the law chose; its duration is the law's.

        x' = (1 + M) x + B u,   minimise the sum of (x / w_x)^2 + (u / (w_u I_max))^2

    Parameters
    ----------
    cycle : Cycle
    weights : Weights
    max_current : float, in A

    Returns
    -------
    ndarray, shape (2, 2)
        Motion (across in m, turn in rad) per deviation.
    """
    import control

    state = np.diag([weights.across**-2, weights.heading**-2])
    b = cycle.currents * max_current
    if not np.any(b):
        return np.zeros((2, 2))
    gain, _, _ = control.dlqr(np.eye(2) + cycle.motion, b, state, np.eye(b.shape[1]) / weights.current**2)
    return np.asarray(-b @ np.asarray(gain), dtype=np.float64)


@dataclass(frozen=True)
class Found:
    """Gains closest to the regulator, and how far the law was from it before and is now.

    Attributes
    ----------
    gains : mapping
        Those that are to be changed.
    before, after : float
        Median distance over the path, as a share of the regulator's own feedback.
    duration : tuple of float, in s
        Of a flight without noise, before and after.
    flights : int
        Tried.
    """

    gains: Mapping[str, float]
    before: float
    after: float
    duration: tuple[float, float]
    flights: int


def find_closest_gains(model: Model, weights: Weights | None = None, most: int = MAX_FLIGHTS) -> Found:
    """Search the law's declared ranges, one gain after the other, for the feedback nearest to the regulator's.

    Parameters
    ----------
    model : Model
    weights : Weights, optional
    most : int
        Largest number of flights.

    Returns
    -------
    Found
    """
    weights = weights or Weights()
    declared: Mapping[str, Gain] = load_plugin("controllers", model.mission.law).gains
    start = {name: float(model.mission.gains.get(name, gain.default)) for name, gain in declared.items()}
    stride, target, arcs = _compute_target(model, weights)
    flights, (before, pace) = 1, _compute_distance(model, start, stride, target, arcs, weights, math.inf)
    best, shortest, seconds = dict(start), before, pace

    def tried(name: str, share: float) -> tuple[dict[str, float], float, float]:
        gain = declared[name]
        moved = {**best, name: _move_gain(gain, best[name], share)}
        if moved[name] == best[name]:
            return moved, math.inf, math.inf
        return moved, *_compute_distance(model, moved, stride, target, arcs, weights, PACE * pace)

    matter: dict[str, float] = {}
    step = STEP
    names: Sequence[str] = list(declared)
    while step >= LEAST_STEP and flights < most:
        better = False
        for name in names:
            for sign in (1.0, -1.0):
                if flights >= most:
                    break
                moved, distance, took = tried(name, sign * step)
                flights += 1
                if math.isfinite(distance):
                    matter[name] = max(matter.get(name, 0.0), abs(distance - shortest))
                if distance < (1.0 - MIN_IMPROVEMENT) * shortest:
                    best, shortest, seconds, better = moved, distance, took, True
                    break
        if step == STEP:
            names = sorted((n for n in names if matter.get(n, 0.0) > MIN_INFLUENCE * before), key=lambda n: -matter[n])
        if not better:
            step *= SHRINK
    found = {name: best[name] for name in declared if best[name] != start[name]}
    return Found(found, before, shortest, (pace, seconds), flights)


def interpolate_gains(
    declared: Mapping[str, Gain], start: Mapping[str, float], end: Mapping[str, float], share: float
) -> dict[str, float]:
    """Interpolate gains, each on its own scale.

    Parameters
    ----------
    declared : mapping of str to Gain
    start, end : mapping of str to float
    share : float
        0 at `start`, 1 at `end`.

    Returns
    -------
    dict of str to float
    """
    out = {}
    for name, goal in end.items():
        a, b = start[name], goal
        out[name] = a * (b / a) ** share if declared[name].log else a + share * (b - a)
    return out


def _move_gain(gain: Gain, value: float, share: float) -> float:
    """Move a gain by a share of its range, within it."""
    scale: Callable[[float], float] = math.log if gain.log else float
    low, high, now = scale(gain.low), scale(gain.high), scale(value)
    moved = min(max(now + share * (high - low), low), high)
    return min(max(math.exp(moved) if gain.log else moved, gain.low), gain.high)


def _compute_target(model: Model, weights: Weights) -> tuple[int, FloatArray, FloatArray]:
    """Compute every how many cycles to look, feedback (n, 2, 2) of the regulator there, and arc lengths (n,)."""
    count = sum(1 for _ in simulate_flight(model, model.make_controller(), keep=lambda cycle: False))
    stride = max(count // PLACES, 1)
    cycles = _linearize_flight(model, model.make_controller(), stride)[0]
    limit = model.setup.limits.max_current
    return stride, np.array([design_regulator(c, weights, limit) for c in cycles]), np.array([c.arc for c in cycles])


def _linearize_flight(
    model: Model, controller: Controller, stride: int, longest: float = math.inf
) -> tuple[list[Cycle], float]:
    """Linearise a flight's cycles; return them and its duration in s; raises `InputError` if it arrives too late."""
    cycles, clock, done = [], 0.0, False
    for instant in simulate_flight(model, controller, keep=lambda cycle: cycle % stride == 0):
        clock += instant.cycle
        done = instant.command.done
        if clock > longest:
            break
        if instant.tracker is not None and instant.command.phase == "follow" and not done:
            cycles.append(linearize_cycle(model, instant, PAIRS))
    if not done:
        raise InputError(f"{model.mission.law} does not reach the end of the path in time.")
    return cycles, clock


def _compute_distance(
    model: Model, gains: Mapping[str, float], stride: int, target: FloatArray, arcs: FloatArray, weights: Weights,
    longest: float,
) -> tuple[float, float]:  # fmt: skip
    """Compute the median relative distance of a law's feedback from the regulator's, and the duration; inf if late."""
    try:
        cycles, clock = _linearize_flight(model, model.make_controller(gains), stride, longest)
    except InputError:
        return math.inf, math.inf
    scale = np.array([weights.across, weights.heading])
    unit = scale[None, :] / scale[:, None]
    desired = np.array([target[int(np.argmin(np.abs(arcs - c.arc)))] for c in cycles]) * unit
    found = np.array([c.feedback for c in cycles]) * unit
    apart = np.linalg.norm(found - desired, axis=(1, 2)) / np.maximum(np.linalg.norm(desired, axis=(1, 2)), NO_FEEDBACK)
    return float(np.median(apart)), clock
