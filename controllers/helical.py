"""Controller of a helical robot: plans turns and axes of the magnet leg by leg, and recovers from step-outs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from controllers.screw_model import Leg, ScrewModel
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.shots import Mechanical, MoveMagnet
from smolbot.motion import helix_kernels as kernels
from smolbot.motion.controller import Command, Gain, HelixSetup, Phase, complete_gains
from smolbot.motion.helix import make_rotate_window, make_state
from smolbot.paths.curve import Curve

RUNWAY = 15e-3
"""Straight continuation of a path at both ends, in m: the way in, and something to look ahead at."""

MIN_TURNS = 2
"""Turns that a plan has at least, or pauses would never end."""

SEARCH = 8e-3
"""Widest search for the nearest place on the path, in m of arc length, behind and ahead of the last one."""

STRETCH = 2.0
"""Largest progress per distance moved, beside one advance per turn: on the inside of a bend a place runs ahead."""

TURN_STEP = 0.25
"""Turns come in quarters: less than half a millimetre."""


@dataclass(frozen=True)
class _Maneuver:
    """A commanded maneuver: its start, its legs, and the predicted end."""

    state: FloatArray
    legs: list[Leg]
    expected: FloatArray


class Helical:
    """Plans, in every pause, the next turns of the magnet and its axis in each, so that the helix follows the path.

    The plan simulates the helix with the learned model, and ends where the position at the next pause would no
    longer be certain enough. A leg that comes out far too short is a step-out: the magnet turned without the robot.
    Then the robot moves back, so that it engages with the gel again, and continues at a lower rate, since drag
    takes a part of the torque in proportion to the rate.

    States, shown in the notes: ``cruise``, ``recover`` (with the number of the attempt), ``slow`` until well past
    the place of the step-out.

    Parameters
    ----------
    setup : HelixSetup
    gains : mapping of str to float
        Values that differ from the defaults.
    """

    kinds: ClassVar[tuple[str, ...]] = ("helical",)
    gains: ClassVar[Mapping[str, Gain]] = {
        "cross_track_mm": Gain(0.4, 0.05, 2.0, True, meaning="distance from the path, two sigma, that ends a plan"),
        "max_turns": Gain(6.0, 1.0, 20.0, meaning="most turns between two pauses"),
        "listens": Gain(3.0, 1.0, 50.0, meaning="shots listened to in every pause"),
        "tilt_deg": Gain(60.0, 5.0, 80.0, meaning="most that the magnet's axis leads the robot's by"),
        "lookahead_turns": Gain(3.5, 0.5, 8.0, meaning="turns over which a choice of axis is evaluated"),
        "heading_mm": Gain(0.4, 0.0, 10.0, meaning="distance that a heading off by one radian counts as"),
        "wander_deg": Gain(2.0, 0.2, 20.0, True, meaning="heading that a turn adds by chance"),
        "blocked_share": Gain(0.6, 0.1, 0.9, meaning="of the expected advance, below which a leg counts as a step-out"),
        "tries": Gain(4.0, 0.0, 10.0, meaning="step-outs in a row that are recovered from"),
        "slower": Gain(0.5, 0.1, 1.0, meaning="each recovery turns at this share of the rate before"),
        "back_turns": Gain(1.0, 0.0, 5.0, meaning="turns to back off by, to seat the robot again"),
        "clear_mm": Gain(5.0, 0.0, 50.0, meaning="progress past a step-out after which the full rate is tried again"),
    }

    def __init__(self, setup: HelixSetup, gains: Mapping[str, float]) -> None:
        self.setup = setup
        g = complete_gains(self.gains, gains, "helical")
        self._bound, self._most = 1e-3 * g["cross_track_mm"], g["max_turns"]
        self._listens, self._most_tilt = round(g["listens"]), math.radians(g["tilt_deg"])
        self._look, self._weight = g["lookahead_turns"], 1e-3 * g["heading_mm"]
        self._blocked_share, self._tries = g["blocked_share"], round(g["tries"])
        self._slower, self._back, self._clear = g["slower"], g["back_turns"], 1e-3 * g["clear_mm"]
        self.model = ScrewModel(setup.helix, math.radians(g["wander_deg"]))
        self._full = setup.limits.max_rotation_frequency
        self._points, self._arc, self._length = np.zeros((2, 2)), np.zeros(2), 0.0
        self._near, self._progress = 0.0, 0.0
        self._place: FloatArray | None = None
        self._flown: _Maneuver | None = None
        self._heard, self._moving, self._seated = 0, False, False
        self._tried, self._blocked_at, self._frequency = 0, -math.inf, self._full
        self._phase: Phase = "approach"

    def reset(self, path: Curve, pose: Pose) -> None:
        """Start following a path from a pose.

        Parameters
        ----------
        path : Curve
        pose : Pose
        """
        ends = path.tangent(np.array([0.0, path.length]))[:, :2]
        first, last = path.points[0, :2] - RUNWAY * ends[0], path.points[-1, :2] + RUNWAY * ends[1]
        self._points = np.ascontiguousarray(np.vstack([first, path.points[:, :2], last]))
        self._arc = np.concatenate([[-RUNWAY], path.arc, [path.length + RUNWAY]])
        self._length = path.length
        self._near, self._progress, self._phase = 0.0, 0.0, "approach"
        self._place = None
        self._flown, self._heard, self._moving, self._seated = None, 0, False, False
        self._tried, self._blocked_at, self._frequency = 0, -math.inf, self._full

    def command(self, pose: Pose) -> Command:
        """Listen until the pause has given enough poses; then evaluate the last maneuver, and plan the next one.

        Parameters
        ----------
        pose : Pose

        Returns
        -------
        Command
        """
        if self._moving:
            self._moving, self._heard = False, 0
            return self._make_command(None, f"listening, 1 of {self._listens}")
        self._heard += pose.trusted
        if self._heard < self._listens or not pose.trusted:
            return self._make_command(None, f"listening, {min(self._heard + 1, self._listens)} of {self._listens}")
        state = make_state(pose.position, pose.orientation)
        event = self._evaluate_maneuver(state, pose) if self._flown is not None else ""
        self._locate(state)
        if self._tried > self._tries:
            at = f"({1e3 * state[0]:.1f}, {1e3 * state[1]:.1f}) mm"
            note = f"gave up near {at}: the robot stepped out {self._tried} times in a row"
            return Command(None, note=note, progress=self._progress, phase=self._phase, stuck=True, event="gave up")
        if self._near >= self._length - self.setup.tolerance:
            return Command(
                None, note="path's end reached", progress=self._length, phase="follow", done=True, event=event
            )
        legs = self._plan_recovery(state) if event == "step-out" else []
        before = legs[-1].course if legs else math.nan
        legs += self._plan(self.model.predict(state, legs), before, pose.covariance)
        self._flown = _Maneuver(state, legs, self.model.predict(state, legs))
        self._moving = True
        return self._make_command(self._make_windows(legs), self._format_state(legs), event)

    def tightest_bend(self) -> float:
        """Compute the radius, in m, of the tightest bend: at the full rate, the magnet's axis leading as far as it may.

        Returns
        -------
        float, in m
        """
        return self.setup.helix.tightest(self._full, self._most_tilt)

    def _make_command(self, window: tuple[Mechanical, ...] | None, note: str, event: str = "") -> Command:
        return Command(window, note=note, progress=self._progress, phase=self._phase, event=event)

    def _format_state(self, legs: list[Leg]) -> str:
        turns = sum(leg.turns for leg in legs)
        state = "cruise" if not self._tried else ("slow" if legs[0].sense > 0 else f"recover, try {self._tried}")
        expected = 1e3 * float(np.linalg.norm(self._flown.expected[:2] - self._flown.state[:2])) if self._flown else 0.0
        return f"{state}: {turns:g} turns at {legs[-1].frequency:.3g} Hz, {expected:.1f} mm"

    def _locate(self, state: FloatArray) -> None:
        moved = SEARCH if self._place is None else float(np.linalg.norm(state[:2] - self._place))
        self._place = state[:2].copy()
        self._near = self._find_place(state, self._near, moved)
        self._progress = max(self._progress, min(max(self._near, 0.0), self._length))
        if self._near > 0.0:
            self._phase = "follow"

    def _find_place(self, state: FloatArray, before: float, moved: float) -> float:
        """Find the arc length nearest to a state, no farther from the one before than the robot can have come."""
        most = min(STRETCH * moved + self.setup.helix.advance, SEARCH)
        place, _, _ = kernels.find_nearest(self._points, self._arc, state[0], state[1], before, most)
        return min(max(float(place), before - most), before + most)

    def _evaluate_maneuver(self, state: FloatArray, pose: Pose) -> str:
        """Evaluate whether the robot followed the magnet; if so, learn from it. Return what happened, or ``''``."""
        flown = self._flown
        assert flown is not None
        planned = flown.expected[:2] - flown.state[:2]
        length = float(np.linalg.norm(planned))
        went = float((state[:2] - flown.state[:2]) @ planned) / length if length > 0 else 0.0
        seat = 0.5 * self.setup.helix.advance
        short = length - went > (1.0 - self._blocked_share) * length + (0.0 if self._seated else seat)
        if short:
            if self._tried == 0 or self._near > self._blocked_at:
                self._blocked_at = self._near
            self._tried += 1
            self._frequency *= self._slower
            return "step-out"
        recovered = self._tried > 0 and flown.legs[0].sense < 0
        if all(leg.sense > 0 for leg in flown.legs):
            self.model.learn(flown.state, flown.legs, state, pose.covariance, 0.1 * seat if self._seated else seat)
        self._seated = True
        if self._tried and self._near > self._blocked_at + self._clear:
            self._tried, self._frequency = 0, self._full
            return "full rate again"
        return "recovered" if recovered else ""

    def _plan_recovery(self, state: FloatArray) -> list[Leg]:
        """Plan the way back along the cut channel, at the lower rate."""
        if self._back == 0:
            return []
        return [Leg(float(state[kernels.HEADING]), -1.0, self._back, self._frequency)]

    def _plan(self, state: FloatArray, before: float, covariance: FloatArray) -> list[Leg]:
        """Plan turns, each with its own axis, until the predicted position gets too uncertain or the path ends.

        `before` (rad) is the present course of the magnet; nan where the magnet approaches anew, and may start at any
        axis.
        """
        body, factors = self.setup.helix.body, self.model.factors
        reach = 0.98 * self.setup.limits.max_steering_rate / self._frequency
        legs: list[Leg] = []
        start, near = state.copy(), self._near
        start[kernels.COURSE] = before
        at = start
        while len(legs) < self._most:
            course = kernels.find_best_course(
                body, factors, at, self._most_tilt, reach, self._look, self._frequency,
                self._points, self._arc, near, self._weight,
            )  # fmt: skip
            turns = self._choose_turns(at, course, near)
            if turns < 1.0 and not math.isnan(at[kernels.COURSE]):  # less time to steer in
                off = kernels.wrap_angle(course - at[kernels.COURSE])
                course = at[kernels.COURSE] + min(max(off, -reach * turns), reach * turns)
            leg = Leg(float(course), 1.0, turns, self._frequency)
            after = kernels.advance_screw(body, factors, at, leg.course, 1.0, turns, leg.frequency)
            near = self._find_place(after, near, float(np.linalg.norm(after[:2] - at[:2])))
            at = after
            spread = self.model.predict_covariance(start, [*legs, leg], covariance)
            if len(legs) >= MIN_TURNS and 2.0 * math.sqrt(spread[1, 1]) > self._bound:
                break
            legs.append(leg)
            if turns < 1.0 or near > self._length - 0.5 * TURN_STEP * self.setup.helix.advance:
                break
        return legs

    def _choose_turns(self, at: FloatArray, course: float, near: float) -> float:
        """Choose a full turn, or as many quarters of one as bring the robot to the path's end."""
        ends = []
        for quarters in range(1, 5):
            after = kernels.advance_screw(
                self.setup.helix.body, self.model.factors, at, course, 1.0, TURN_STEP * quarters, self._frequency
            )
            place = self._find_place(after, near, float(np.linalg.norm(after[:2] - at[:2])))
            ends.append(abs(self._length - place))
        return TURN_STEP * (1 + int(np.argmin(ends)))

    def _make_windows(self, legs: list[Leg]) -> tuple[Mechanical, ...]:
        near, away = MoveMagnet("near", self.setup.move), MoveMagnet("away", self.setup.move)
        return (near, *(make_rotate_window(leg.course, leg.sense, leg.frequency, leg.turns) for leg in legs), away)
