"""Model predictive control: the next window is chosen by simulating the robot's motion, turn and cantilever."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from controllers.adaptation import Adaptation
from controllers.force_allocator import ForceAllocator, UnreachableForceError
from controllers.heading_planner import HeadingPlanner
from controllers.pace import Pace
from controllers.path_progress import PathProgress
from controllers.plan_starts import make_plan_starts
from controllers.table_edge import make_outside_command, move_into_table
from lookup_tables import OutsideTableError
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.shots import Actuate
from smolbot.errors import InputError
from smolbot.motion.controller import Command, ForceProfile, Gain, Phase, Setup, complete_gains
from smolbot.motion.gradient import pack_robot
from smolbot.motion.kernels import DRAG, HEADING, MISSING_PROGRESS, PATH_DISTANCE, ROTATIONAL_DRAG, plan_currents
from smolbot.paths.curve import Curve

MAX_ROLLOUT_STEP = 7.5e-3
"""Longest step of a rollout, in s."""

REFINED_STARTS, GAUSS_NEWTON_STEPS = 2, 6
"""Number of starts that are refined, and the most Gauss-Newton steps for each."""

HEADING_SPACING, EXTRA_HEADINGS = 2.5e-4, 12
"""Spacing, in m, of planned headings along the path, and how often the next leg's first one is appended to a leg."""

HUBER_KNEE = 0.5
"""Heading error, in rad, beyond which its cost grows linearly."""

TWO_WINDOW_DISTANCE = 1e-3
"""Distance to a corner, in m, below which the window after the next is planned too, as it is in every turn."""

MAX_URGENCY, EASED_URGENCY = 8.0, 4.0
"""Thresholds of the urgency, a factor on the weights of progress and heading that grows with each plan that neither
advances nor turns: at the first, the robot is pulled straight to a point ahead; from the second on, a leg's end counts
as reached from three times as far."""

RESCUE_FORCE = 80e-6
"""Force, in N, with which it is pulled to a point ahead."""


@dataclass(frozen=True)
class _Plan:
    """The predicted effect of a plan: `moved` (2,) in m at mobility 1, `swung` (2,) in m by turning."""

    pose: Pose
    heading: float
    moved: FloatArray
    swung: FloatArray
    turned: float
    currents: FloatArray


class Predictive:
    """Model predictive control along the path.

    Currents I (n_coils,) of the next window, and in turns and at corners of the one after, minimise over windows w::

        J = sum_w  n^2 (d(t_w / 2)^2 / 4 + d(t_w)^2)            distance from the path, half way and at the end
                 + f^2 (s_w* - s_w)^2                           arc length still missing to the requested one
                 + h^2 rho(psi_w - psi_path(s_w + a))           heading against the path's, a little ahead
                 + p^2 tail_w^2                                 distance that the robot is pushed tail first
                 + c^2 max(0, 1 - |B_w| / B_least)^2            weak field, whose direction is less certain
                 + q^2 sum_k (I_wk / I_max)^2                   heat

        subject to  I_min <= I_wk <= I_max,

    lengths in mm, angles in rad. rho(x) = x^2 up to `HUBER_KNEE`, and grows linearly beyond. By the gains:

    ===========  =============================================================================================
    n            1 / (1 + (sigma / confidence_mm)^2), sigma of the pose in the plane: weight of the correction
    s_w*         s_0 + w n stride, up to the leg's end; stride: distance per window at speed_mm_s or the path's speed
    f            forward, times (full stride / stride) and the urgency, which grows while plans do not advance
    h, a         heading_mm times the urgency, ahead_mm
    p            1, or 0 with tail_first
    c, B_least   firm_mm, least_field_mt
    q            heat_mm
    ===========  =============================================================================================

    d, s, psi, tail and B follow from I by a model that turns the robot against viscous drag, bends the cantilever up
    to its stop, and pulls it by the true force on its moment (`smolbot.motion.kernels`). So it turns before it pulls,
    without a separate rule. Mobility, agility and drift of the model are learned from the measured motion of each
    window (`controllers.adaptation`).

    Parameters
    ----------
    setup : Setup
    gains : mapping of str to float
        Values that differ from the defaults in `gains`.
    """

    gains: ClassVar[Mapping[str, Gain]] = {
        "window_ms": Gain(90.0, 20.0, 200.0, meaning="actuation per cycle, as far as the rig allows it"),
        "short_ms": Gain(40.0, 10.0, 200.0, meaning="actuation per cycle where a goal is nearly reached"),
        "speed_mm_s": Gain(6.0, 0.5, 20.0, True, meaning="requested speed during actuation"),
        "forward": Gain(0.3, 0.03, 3.0, True, meaning="weight of missing arc length against distance from the path"),
        "heading_mm": Gain(0.5, 0.01, 3.0, True, meaning="distance from the path that weighs as much as 1 rad"),
        "ahead_mm": Gain(0.5, 0.0, 3.0, meaning="how far ahead the path's heading counts"),
        "heat_mm": Gain(0.02, 0.001, 0.3, True, meaning="distance from the path that weighs as much as a full current"),
        "confidence_mm": Gain(0.2, 0.02, 2.0, True, meaning="uncertainty of a pose that halves correction and speed"),
        "handover_mm": Gain(0.25, 0.05, 2.0, True, meaning="distance at which start, corners and end count as reached"),
        "least_field_mt": Gain(1.5, 0.05, 5.0, True, meaning="field below which a robot may not turn as planned"),
        "firm_mm": Gain(0.1, 0.001, 1.0, True, meaning="distance from the path that weighs as much as no field at all"),
        "turn_s": Gain(0.15, 0.01, 2.0, True, meaning="assumed time of a turn of 1 rad"),
        "tail_first": Gain(0.0, 0.0, 1.0, meaning="1: may be pushed tail first, which reaches further"),
    }

    def __init__(self, setup: Setup, gains: Mapping[str, float]) -> None:
        self.setup = setup
        values = complete_gains(self.gains, gains, "predictive", ("short_ms", "window_ms"))
        longest = setup.limits.max_actuation
        self._window, self._short = (min(values[name] * 1e-3, longest) for name in ("window_ms", "short_ms"))
        self._speed = values["speed_mm_s"] * 1e-3
        self._ahead = values["ahead_mm"] * 1e-3
        self._confidence = values["confidence_mm"] * 1e-3
        self._handover = min(values["handover_mm"] * 1e-3, setup.tolerance)
        self._head_first = values["tail_first"] < 0.5
        tail = 1.0 if self._head_first else 0.0
        least = values["least_field_mt"] * 1e-3
        distance, turn = values["forward"], values["heading_mm"]
        weights = [1.0, distance, turn, tail, values["heat_mm"], values["firm_mm"], least, HUBER_KNEE]
        self._weights = np.array(weights)
        self._rest = setup.cycle.duration(setup.device.frequency)
        self._high = np.full(setup.table.n_coils, setup.limits.max_current)
        self._low = np.zeros(setup.table.n_coils) if setup.limits.unipolar else -self._high
        starts = make_plan_starts(self._low, self._high)
        starts = np.concatenate([np.zeros((1, len(self._high))), starts])  # the first row is for the last plan
        self._starts = {n: np.repeat(starts[:, None, :], n, axis=1) for n in (1, 2)}
        self._heading_planner = HeadingPlanner(setup, self._low, self._high, self._head_first, least, values["turn_s"])
        self._allocator = ForceAllocator.of(setup, head_first=self._head_first, least_field=least)
        self._headings: list[FloatArray] = []
        self._progress: PathProgress | None = None
        self._pace: Pace | None = None
        self._adaptation = Adaptation()
        self._coil_gains: FloatArray | None = None
        self._planned: _Plan | None = None
        self._hurry = 1.0
        self._warm_up()

    @property
    def learned(self) -> Adaptation:
        """Mobility, agility and drift as learned so far."""
        return self._adaptation

    def reset(self, path: Curve, pose: Pose) -> None:
        """Start a path: first go to its start. What was learned of the robot is kept.

        Parameters
        ----------
        path : Curve
        pose : Pose
        """
        self._progress = progress = PathProgress(path)
        self._pace = None if path.speed is None else Pace(path.speed, self._rest + self._window)
        self._hurry = 1.0
        self._planned = None
        arc = [
            np.arange(a, b + 0.5 * HEADING_SPACING, HEADING_SPACING)
            for a, b in itertools.pairwise(progress.arc[progress.stops])
        ]
        arcs = np.concatenate(arc)
        along = np.clip(np.searchsorted(progress.arc, arcs + 1e-9) - 1, 0, len(progress.tangents) - 1)
        first = np.cumsum([0, *(len(a) for a in arc)])
        headings = self._heading_planner.plan_headings(path.at(arcs), progress.tangents[along], HEADING_SPACING)
        self._headings = [
            np.concatenate([headings[a:b], np.full(EXTRA_HEADINGS, headings[min(b, len(headings) - 1)])])
            for a, b in itertools.pairwise(first)
        ]

    def command(self, pose: Pose) -> Command:
        """Compute the window with the least cost by the model.

        Parameters
        ----------
        pose : Pose

        Returns
        -------
        Command

        Raises
        ------
        InputError
            Before the first `reset`.
        """
        progress = self._progress
        if progress is None:
            raise InputError("predictive has no path yet: call reset first.")
        inside = move_into_table(self.setup.table, pose, self.setup.tolerance)
        if inside is None:
            self._planned = None
            return make_outside_command(pose, progress.progress, "approach" if progress.leg < 0 else "follow")
        pose = inside
        # 1. Compare the effect of the last window with its plan
        heading = self._compute_heading(pose)
        self._learn(pose, heading)
        # 2. Find the place on the path; a leg's end that is hard to reach counts as reached from farther away
        eased = 3.0 if self._hurry >= EASED_URGENCY else 1.0
        progress.locate(pose.position, min(eased * self._handover, self.setup.tolerance))
        if progress.done:
            return Command(None, note="path's end reached", progress=progress.progress, done=True)
        phase: Phase = "approach" if progress.leg < 0 else "follow"
        # 3. Distance to cover in this window, by the law's speed and the path's
        stride = self._speed * self._window
        if self._pace is not None and phase == "follow":
            stride = min(stride, self._pace.compute_stride(pose.time, progress.arc_length))
            if stride <= 0.0:
                return Command(None, note="ahead of the requested speed", progress=progress.progress, phase=phase)
        # 4. The best currents, and a note on them
        duration, currents, gone, turning = self._plan_window(pose, heading, progress, stride)
        sent = currents.tolist()
        limits = zip(sent, self._low.tolist(), self._high.tolist(), strict=True)
        saturated = any(i > 0.999 * high or i < 0.999 * low - 1e-9 for i, low, high in limits)
        note = "turning" if turning else ""
        if not turning and gone < 0.03 * stride * duration / self._window:
            note = "hardly any force along the path here" + (", head first" if self._head_first else "")
        window = Actuate(tuple(sent), duration)
        return Command(window, saturated, note, progress=progress.progress, phase=phase)

    def adopt_motion(self, gains: FloatArray, drift: FloatArray) -> None:
        """Take over gains of the coils and drift from the tracker; the law learns neither by itself from then on.

        Parameters
        ----------
        gains : ndarray, shape (n_coils,)
            Factors on the coils' currents.
        drift : ndarray, shape (3,), in m/s
            World frame.
        """
        self._coil_gains = gains
        self._adaptation.adopt(drift[:2])

    def unplayed(self) -> None:
        """Discard the last plan: it was not played, so there is nothing to learn from it."""
        self._planned = None

    def reach(self, path: Curve) -> ForceProfile:
        """Compute the strongest force along the path with a field that turns the robot in time.

        The force is 0 where there is none.

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
            try:
                found = self._allocator.allocate(point, np.array([tangent[0], tangent[1], 0.0]))
            except UnreachableForceError:
                continue
            force[i], error[i] = np.linalg.norm(found.force[:2]), found.direction_error
        return ForceProfile(points, force, error)

    def _warm_up(self) -> None:
        """Plan once, so that nothing is compiled or loaded while a robot waits for its next window."""
        middle = np.mean(self.setup.table.bounds, axis=0)
        pose = Pose(0.0, middle, np.array([1.0, 0.0, 0.0, 0.0]), np.zeros((6, 6)))
        self.reset(Curve(np.array([middle, middle + np.array([1e-3, 0.0, 0.0])])), pose)
        self.command(pose)
        self._progress, self._planned, self._hurry = None, None, 1.0

    def _compute_heading(self, pose: Pose) -> float:
        ahead = pose.rotation @ self.setup.device.moment_in_body
        return math.atan2(ahead[1], ahead[0])

    def _plan_window(
        self, pose: Pose, heading: float, progress: PathProgress, stride: float
    ) -> tuple[float, FloatArray, float, bool]:
        """Compute duration, currents, expected progress in m, and whether the window is a turn."""
        place = pose.position[:2]
        c, v = math.cos(heading), math.sin(heading)
        # 1. Field and gradient of each coil at the magnet, or at the rotation centre where the table ends between them
        at = np.array(pose.position)
        at[0] += self.setup.robot.magnet_ahead * c
        at[1] += self.setup.robot.magnet_ahead * v
        try:
            field, gradient = self.setup.table.field_and_gradient(at[None, :])
        except OutsideTableError:
            at[:] = pose.position
            field, gradient = self.setup.table.field_and_gradient(at[None, :])
        origin = at[:2]
        b = np.ascontiguousarray(field[:, 0, :2])
        g = np.ascontiguousarray(gradient[:, 0, :2, :2])
        if self._coil_gains is not None:
            b, g = b * self._coil_gains[:, None], g * self._coil_gains[:, None, None]
        # 2. The leg, and whether to plan a second window: in turns, before a corner, and after idle plans
        points, arc, first, last, guess, headings = self._make_route(pose, heading, progress)
        index = min(int((guess - float(arc[first])) / HEADING_SPACING), len(headings) - 2)
        turning = abs(_wrap_angle(heading - headings[index])) > HUBER_KNEE
        windows = 2 if turning or self._hurry > 1.0 or arc[last] - guess < TWO_WINDOW_DISTANCE else 1
        # 3. Weights of the cost: n by the pose's covariance, f and h by the urgency
        sigma = math.sqrt(max(float(pose.covariance[0, 0] + pose.covariance[1, 1]), 0.0))
        doubt = 1.0 / (1.0 + (sigma / self._confidence) ** 2)
        weights = self._weights.copy()
        weights[PATH_DISTANCE] *= doubt
        weights[MISSING_PROGRESS] *= self._hurry
        weights[HEADING] *= self._hurry
        weights[MISSING_PROGRESS] *= self._speed * self._window / stride  # equal fractions missing cost the same
        # 4. The model as it was learned, in places relative to `origin`
        body = pack_robot(self.setup.robot)
        body[DRAG] /= self._adaptation.mobility
        body[ROTATIONAL_DRAG] /= self._adaptation.agility
        state = np.array([place[0] - origin[0], place[1] - origin[1], heading])
        route = (points - origin, arc, headings, HEADING_SPACING)
        leg = (first, last, guess, stride * doubt, self._ahead, 0.5 * self._handover)
        # 5. Minimise J; near a leg's end a shorter window may serve better
        starts = self._with_last(windows)
        drift = self._adaptation.drift
        best = None
        near_end = arc[last] - guess < 2.0 * self._speed * self._window
        for duration in (self._window, self._short) if near_end else (self._window,):
            steps = math.ceil(duration / MAX_ROLLOUT_STEP)
            cost, currents, ends = plan_currents(
                b, g, self._low, self._high, body, state, drift, self._rest, duration, steps, route, leg, weights,
                starts, REFINED_STARTS, GAUSS_NEWTON_STEPS,
            )  # fmt: skip
            if best is None or cost < best[0]:
                best = cost, duration, currents, ends
            starts = currents[None]  # the best currents of the other duration are similar
        assert best is not None
        _, duration, currents, ends = best
        # 6. Keep the plan for `_learn`: the motion at mobility 1, without drift and without the centre's own swing
        x, y, after = ends[0].tolist()
        center = self.setup.robot.center_ahead
        swung = -center * np.array([math.cos(after) - c, math.sin(after) - v])
        step = np.array([x - state[0], y - state[1]])
        moved = (step - drift * duration - swung) / self._adaptation.mobility
        self._planned = _Plan(pose, heading, moved, swung, after - heading, currents[0])
        # 7. Progress along the path; plans that neither advance nor turn raise the urgency, up to a plain pull
        goal = points[min(int(np.searchsorted(arc, guess, side="right")), last)]
        here = goal[0] - place[0], goal[1] - place[1]
        gone = float(step[0] * here[0] + step[1] * here[1]) / max(math.hypot(*here), 1e-9)
        if self._hurry >= MAX_URGENCY:
            rescue = self._compute_rescue_currents(pose, progress)
            if rescue is not None:
                self._planned, self._hurry = None, 0.75 * MAX_URGENCY
                return self._window, rescue, self._speed * self._window, turning
        idle = gone < 0.1 * stride and abs(after - heading) < 0.05
        self._hurry = min(1.5 * self._hurry, MAX_URGENCY) if idle else max(self._hurry / 1.5, 1.0)
        return duration, currents[0], gone, turning

    def _compute_rescue_currents(self, pose: Pose, progress: PathProgress) -> FloatArray | None:
        """Compute currents straight to a point ahead, or None where none pull there."""
        ahead = min(progress.arc_length + 2.0 * self._ahead, progress.leg_end) if progress.leg >= 0 else 0.0
        way = progress.interpolate(ahead) - pose.position[:2]
        try:
            return self._allocator.currents(pose.position, np.array([way[0], way[1], 0.0]), RESCUE_FORCE)
        except UnreachableForceError as error:
            if error.most <= 0.0:
                return None
        return self._allocator.currents(pose.position, np.array([way[0], way[1], 0.0]))

    def _make_route(
        self, pose: Pose, heading: float, progress: PathProgress
    ) -> tuple[FloatArray, FloatArray, int, int, float, FloatArray]:
        """Return points, arc, first and last vertex of the leg, present arc length, and headings along the leg."""
        if progress.leg >= 0:
            first, last = progress.stops[progress.leg], progress.stops[progress.leg + 1]
            return progress.points, progress.arc, first, last, progress.arc_length, self._headings[progress.leg]
        place = pose.position[:2]
        way = progress.points[0] - place
        length = math.hypot(way[0], way[1])
        share = np.linspace(0.0, 1.0, 4)
        points = np.column_stack([place + share[:, None] * way, np.full(4, pose.position[2])])
        ways = np.repeat(way[None, :] / length, 4, axis=0)
        few = self._heading_planner.plan_headings(points, ways, length / 4, heading)
        counts = math.ceil(length / HEADING_SPACING) + 1
        headings = np.interp(np.linspace(0.0, 1.0, counts), share, few)
        onward = np.full(EXTRA_HEADINGS, self._headings[0][0])
        headings = np.concatenate([headings, onward])
        return np.array([place, progress.points[0]]), np.array([0.0, length]), 0, 1, 0.0, headings

    def _with_last(self, windows: int) -> FloatArray:
        """Return the last plan and the usual starts, each repeated for all windows, shape (m, windows, n_coils)."""
        starts = self._starts[windows]
        if self._planned is None:
            return starts[1:]
        starts[0] = self._planned.currents
        return starts

    def _learn(self, pose: Pose, heading: float) -> None:
        """Compare the last plan with the present pose."""
        last = self._planned
        self._planned = None
        if last is None or pose.time <= last.pose.time or not pose.trusted:
            return
        measured = pose.position[:2] - last.pose.position[:2] - last.swung
        turned = _wrap_angle(heading - last.heading)
        self._adaptation.learn(measured, last.moved, turned, last.turned, pose.time - last.pose.time)


def _wrap_angle(angle: float) -> float:
    return angle - 2.0 * math.pi * round(angle / (2.0 * math.pi))
