"""A tracker that learns in flight how far the robot moves in each coil's field, and how the liquid carries it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from lookup_tables import FieldTable
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.sensing import Device
from smolbot.core.shots import Shot
from smolbot.flight.tracking.tracker import GATE, GATE_PER_DEGREE, State, Tracker
from smolbot.motion.gradient import advance
from smolbot.motion.robot import Robot

COMMON_GAIN_STD, OWN_GAIN_STD = 0.6, 0.2
"""Standard deviations of the coils' gains at the start: of what they share, such as a drag of half or twice the assumed
one, and of each coil's own."""

COMMON_GAIN_NOISE_DENSITY, OWN_GAIN_NOISE_DENSITY = 0.02, 0.01
"""Process noise of both per square root of a second: glycerol that warms by 3 K within some minutes."""

GAIN_RANGE = (-2.0, 5.0)
"""Smallest and largest gain: a coil wired the wrong way round, and a liquid a fifth as viscous."""

DRIFT_STD, DRIFT_NOISE_DENSITY = np.array([5e-4, 5e-4, 5e-5]), np.array([5e-5, 5e-5, 5e-6])
"""Initial standard deviation of the drift per axis (m/s), and its process noise (m/s per square root of a second): a
current that moves a robot off its path within seconds. The surface holds the height."""

LEARNED_MOTION_ERROR_SHARE = 0.15
"""Standard deviation of a step that is predicted with learned gains, as a share of it: errors of its direction."""

MAX_INNOVATION_SCALE = 4.0
"""Average squared innovation over the expected one above which gains and drift have changed, and are learned anew."""

GAIN_TOLERANCES, DRIFT_TOLERANCE = (0.15, 0.1), 8e-5
"""What an assumed model may be off by without harm, as standard deviations: gains, in common and of each coil, and the
drift (m/s)."""

GAIN_STEP = 0.02
"""Change of a gain for a derivative by finite differences."""

_P, _E, _V, _G = slice(0, 3), slice(3, 6), slice(7, 10), slice(10, None)
_FIRST = 10  # entries of the state before the gains


@dataclass(frozen=True)
class LearnedState(State):
    """Tracker state with a gain of each coil, last in the covariance.

    Attributes
    ----------
    gains : ndarray, shape (n_coils,)
        Factors on the currents with which the assumed robot would move as the true one does.
    """

    gains: FloatArray = field(default_factory=lambda: np.ones(0))


class MotionLearningTracker(Tracker):
    """A tracker whose state holds the gain of each coil, too, and that lets the drift change faster.

    The step s of a window is predicted with the currents c_k I_k, and the gains c_k are estimated with the pose::

        P <- F P F^T + Q,   F = 1 + dt (position by drift) + ds/dc_k (position by gain k)

    In drag as in a coil's current, force and torque are linear, so that a drag of half the assumed one shows as gains
    that are all 2, and a coil without current as a gain of 0. Turns do not tell of gains: near the end of a turn the
    predicted rest of it depends on where the field points, to a degree, and not on how fast the robot turns.

    Parameters
    ----------
    robot : Robot or None
    device : Device
    table : FieldTable or None
    """

    _state: LearnedState | None
    _motion_error_share = LEARNED_MOTION_ERROR_SHARE

    def __init__(self, robot: Robot | None, device: Device, table: FieldTable | None) -> None:
        super().__init__(robot, device, table)
        n = 0 if table is None else table.n_coils
        self._gain_prior, self._gain_noise, tolerated = (
            common**2 * np.ones((n, n)) + own**2 * np.eye(n)
            for common, own in (
                (COMMON_GAIN_STD, OWN_GAIN_STD),
                (COMMON_GAIN_NOISE_DENSITY, OWN_GAIN_NOISE_DENSITY),
                GAIN_TOLERANCES,
            )
        )
        self._tolerated = np.zeros((2 + n, 2 + n))
        self._tolerated[:2, :2], self._tolerated[2:, 2:] = DRIFT_TOLERANCE**2 * np.eye(2), tolerated
        self._slopes = np.zeros((2, n))

    @property
    def learned(self) -> bool:
        """True: gains and drift are learned in flight."""
        return True

    @property
    def gains(self) -> FloatArray:
        """Factors (n_coils,) on the currents, as learned."""
        return super().gains if self._state is None else self._state.gains.copy()

    @property
    def deviates(self) -> bool:
        """Whether gains and drift are surely farther from 1 and 0 than an assumed model may be off."""
        state = self._state
        if state is None:
            return False
        off = np.concatenate([state.drift[:2], state.gains - 1.0])
        of_motion = np.r_[7:9, _FIRST : _FIRST + len(state.gains)]
        covariance = state.covariance[np.ix_(of_motion, of_motion)] + self._tolerated
        return float(off @ np.linalg.solve(covariance, off)) > GATE + GATE_PER_DEGREE * (len(off) - 6)

    def _begin(self, pose: Pose) -> None:
        before = self._state
        super()._begin(pose)
        state = self._state
        assert state is not None
        n = len(self._gain_prior)
        covariance = np.zeros((_FIRST + n, _FIRST + n))
        covariance[:7, :7] = state.covariance[:7, :7]
        self._state = LearnedState(
            state.time, state.position, state.orientation, state.amplitude,
            np.zeros(3) if before is None else before.drift, covariance, np.ones(n) if before is None else before.gains,
        )  # fmt: skip
        self._doubt()

    def _doubt(self) -> None:
        """Forget how well gains and drift are known."""
        assert self._state is not None
        covariance = self._state.covariance.copy()
        covariance[7:, :] = covariance[:, 7:] = 0.0
        covariance[_V, _V], covariance[_G, _G] = np.diag(DRIFT_STD**2), self._gain_prior
        self._state = replace(self._state, covariance=covariance)
        self._innovation_scale = 1.0

    def _predict(self, shot: Shot, time: float) -> None:
        self._slopes[:] = 0.0
        super()._predict(shot, time)

    def _compute_motion(
        self,
        robot: Robot,
        field: FloatArray,
        gradient: FloatArray,
        currents: FloatArray,
        heading: float,
        duration: float,
    ) -> tuple[FloatArray, float]:
        assert self._state is not None
        gains = self._state.gains
        step, turn = super()._compute_motion(robot, field, gradient, gains * currents, heading, duration)
        for coil in np.flatnonzero(currents):
            other = gains.copy()
            other[coil] += GAIN_STEP
            moved, _ = advance(robot, field, gradient, other * currents, heading, duration)
            self._slopes[:, coil] += (moved - step) / GAIN_STEP
        return step, turn

    def _predict_covariance(self, covariance: FloatArray, wait: float, noise: FloatArray) -> FloatArray:
        through, added = np.eye(len(covariance)), np.zeros_like(covariance)
        through[_P, _V] = wait * np.eye(3)
        through[:2, _G] = self._slopes
        added[:7, :7] = np.diag(noise[:7])
        added[_V, _V] = wait * np.diag(DRIFT_NOISE_DENSITY**2)
        added[_G, _G] = wait * self._gain_noise
        return through @ covariance @ through.T + added

    def _update_further_states(self, change: FloatArray) -> None:
        assert self._state is not None
        self._state = replace(self._state, gains=np.clip(self._state.gains + change[_G], *GAIN_RANGE))
        if self._innovation_scale > MAX_INNOVATION_SCALE:
            self._doubt()
