"""The sampled loop as matrices: closed with a factor or with delayed poses; its margins and responses."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sim.analysis.linear import Cycle
from smolbot.core.arrays import FloatArray

if TYPE_CHECKING:
    from control import StateSpace

ComplexArray = npt.NDArray[np.complex128]

UNSTABLE = 1.0 + 1e-6
"""Magnitude of a pole above which a loop is unstable; a loop without feedback has one at 1."""

MOST_GAIN, FREQUENCIES = 100.0, 500
"""Largest factor on the loop that is tested, and number of frequencies up to half the sampling rate."""

BAND = 0.05
"""Share of a step within which a settled response stays."""

MAX_CYCLES = 400
"""Cycles of a step response."""

BISECTIONS = 30
"""Steps to the largest stable factor."""

TINY, NO_RESPONSE = 1e-12, 1e-6
"""Distance from 1 that keeps a quotient finite, and a response at low frequency that is none."""

STEPS, MOST_LATE = 120, 24
"""Factors that are tested up to the largest, and largest delay of poses, in cycles."""


@dataclass(frozen=True, eq=False)
class SampledLoop:
    """One cycle after the other, about the path. Deviations are (across in m, heading in rad), n = 2 of them, or fewer.

        x' = (1 + M) x + c G x~                      the robot, under a factor c
        p  = (1 + M)(x^ + T v D) + G x~              the tracker's prediction
        x^' = p + K (x'[late] - p),  v' = v + K_v (x'[late] - p),   x~ = x^ + wait v D

    Attributes
    ----------
    motion, feedback : ndarray, shape (n, n)
        M and G.
    kalman : ndarray, shape (n + m, n)
        K, and below it K_v of m drifts.
    drifts : ndarray, shape (n, m)
        D: which deviation each drift carries off.
    period, wait : float, in s
        T; from the middle of listening to the next command.
    """

    motion: FloatArray
    feedback: FloatArray
    kalman: FloatArray
    drifts: FloatArray
    period: float
    wait: float

    @classmethod
    def from_cycle(cls, cycle: Cycle) -> SampledLoop:
        """Build the loop of one linearised cycle.

        Parameters
        ----------
        cycle : Cycle

        Returns
        -------
        SampledLoop
        """
        drifts = np.array([[1.0], [0.0]])
        return cls(cycle.motion, cycle.feedback, cycle.kalman, drifts, cycle.duration, cycle.wait)

    @property
    def size(self) -> int:
        """Number of deviations."""
        return len(self.motion)

    def open_loop(self, late: int = 0) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the open loop in state space, from the motion w (n,) to the motion that the law commands (n,).

        The state is (x, x^, v, x one cycle ago, two ago, …); closed, w = c C z.

        Parameters
        ----------
        late : int
            Cycles by which poses are delayed.

        Returns
        -------
        a, b, c : ndarray, shapes (k, k), (k, n), (n, k)
        """
        # state: true deviation (n), estimate (n), drift (m), then the last `late` deviations; input: the law's motion
        n, m = self.drifts.shape
        eye, zero = np.eye(n), np.zeros((n, n))
        k, kv = self.kalman[:n], self.kalman[n:]
        commanded = np.hstack([zero, self.feedback, self.wait * self.feedback @ self.drifts])
        predicted = np.hstack([zero, eye + self.motion, (eye + self.motion) @ self.drifts * self.period]) + commanded
        order = 2 * n + m + late * n
        a, b = np.zeros((order, order)), np.zeros((order, n))
        a[:n, :n], b[:n] = eye + self.motion, eye
        measured, measured_w = np.zeros((n, order)), np.zeros((n, n))
        if late == 0:
            measured[:, :n], measured_w = eye + self.motion, eye
        elif late == 1:
            measured[:, :n] = eye
        else:
            measured[:, 2 * n + m + (late - 2) * n : 2 * n + m + (late - 1) * n] = eye
        wide = np.zeros((n, order))
        wide[:, : 2 * n + m] = predicted
        a[n : 2 * n] = wide + k @ (measured - wide)
        a[2 * n : 2 * n + m] = kv @ (measured - wide)
        a[2 * n : 2 * n + m, 2 * n : 2 * n + m] += np.eye(m)
        b[n : 2 * n], b[2 * n : 2 * n + m] = k @ measured_w, kv @ measured_w
        for i in range(late):
            row = 2 * n + m + i * n
            source = 0 if i == 0 else row - n
            a[row : row + n, source : source + n] = eye
        c = np.zeros((n, order))
        c[:, : 2 * n + m] = commanded
        return a, b, c

    def close_loop(self, factor: float = 1.0, late: int = 0) -> FloatArray:
        """Return the matrix that takes one cycle's state to the next.

        Parameters
        ----------
        factor : float
            Loop gain relative to the law's.
        late : int
            Cycles by which poses are delayed.

        Returns
        -------
        ndarray, shape (k, k)
        """
        a, b, c = self.open_loop(late)
        return a + factor * b @ c

    def compute_spectral_radius(self, factor: float = 1.0, late: int = 0) -> float:
        """Return the magnitude of the largest pole of the closed loop.

        Parameters
        ----------
        factor : float
            Loop gain relative to the law's.
        late : int
            Cycles by which poses are delayed.

        Returns
        -------
        float
        """
        return float(np.max(np.abs(np.linalg.eigvals(self.close_loop(factor, late)))))

    def compute_loci(self, angles: FloatArray, late: int = 0) -> ComplexArray:
        """Return the eigenvalues of minus the open loop; at -1 the closed loop oscillates.

        Parameters
        ----------
        angles : ndarray, shape (k,), in rad per cycle
        late : int
            Cycles by which poses are delayed.

        Returns
        -------
        ndarray of complex, shape (k, n)
        """
        a, b, c = self.open_loop(late)
        z = np.exp(1j * angles)[:, None, None]
        response = -(c @ np.linalg.solve(z * np.eye(len(a)) - a, np.broadcast_to(b, (len(angles), *b.shape))))
        return np.asarray(np.linalg.eigvals(response), dtype=np.complex128)

    def build_measurement_input(self) -> FloatArray:
        """Return how an error of the measured pose enters the state of the closed loop.

        Returns
        -------
        ndarray, shape (k, n)
        """
        n, m = self.drifts.shape
        out = np.zeros((2 * n + m, n))
        out[n:] = self.kalman
        return out

    def to_state_space(self) -> StateSpace:
        """Return the closed loop for python-control: from an error of the measured pose to the deviations.

        Returns
        -------
        control.StateSpace
        """
        import control

        n = self.size
        return control.ss(
            self.close_loop(),
            self.build_measurement_input(),
            np.eye(n, 2 * n + len(self.drifts[0])),
            0.0,
            dt=self.period,
        )

    def simulate_step(self, cycles: int) -> FloatArray:
        """Return the response to an unmeasured unit step of the first deviation.

        Parameters
        ----------
        cycles : int

        Returns
        -------
        ndarray, shape (cycles + 1, n), in m and rad
        """
        a = self.close_loop()
        state = np.zeros(len(a))
        state[0] = 1.0
        out = np.empty((cycles + 1, self.size))
        for k in range(cycles + 1):
            out[k] = state[: self.size]
            state = a @ state
        return out


@dataclass(frozen=True)
class Margins:
    """Stability margins of a loop: zero where it is unstable already, infinite where nothing makes it unstable.

    Attributes
    ----------
    gain, least_gain : float
        Factor on what the law makes of a deviation, up to which and down to which the loop is stable.
    phase : float, in rad
    delay : float, in cycles
        Of the poses. Whole cycles are exact, in between the phase of a pure delay is taken.
    late : int
        Whole cycles by which poses may be late.
    disc : float
        Largest alpha for which factors (1 + alpha/2 d) / (1 - alpha/2 d), complex |d| < 1, leave the loop stable.
    radius : float
        Size of the largest pole.
    bandwidth : float, in Hz
        At which the robot follows an error of the pose across the path by 3 dB less than a slow one.
    settling : float, in s
        Until the response to a step across the path stays within 5 %.
    """

    gain: float
    least_gain: float
    phase: float
    delay: float
    late: int
    disc: float
    radius: float
    bandwidth: float
    settling: float

    @property
    def stable(self) -> bool:
        """Whether the loop is stable."""
        return self.radius <= UNSTABLE

    @property
    def gain_db(self) -> float:
        """The upper gain margin in dB."""
        return 20.0 * math.log10(self.gain) if self.gain < math.inf else math.inf


def compute_margins(loop: SampledLoop) -> Margins:
    """Compute gain, phase and delay margins, bandwidth and settling of a loop.

    Parameters
    ----------
    loop : SampledLoop

    Returns
    -------
    Margins
    """
    a, b, c = loop.open_loop()
    fed = b @ c
    radius = loop.compute_spectral_radius()
    bandwidth, settling = _find_bandwidth(loop), _count_settling_cycles(loop)
    if radius > UNSTABLE:
        return Margins(1.0, 1.0, 0.0, 0.0, -1, 0.0, radius, bandwidth, math.inf)
    angles = np.linspace(0.0, math.pi, FREQUENCIES + 1)[1:]
    loci = loop.compute_loci(angles)
    share = np.linspace(0.0, 1.0, STEPS + 1)[1:]
    return Margins(
        gain=_find_first_unstable(a, fed, lambda x: MOST_GAIN**x, share, math.inf),
        least_gain=_find_first_unstable(a, fed, lambda x: MOST_GAIN**-x, share, 0.0),
        phase=abs(np.angle(_find_first_unstable(a, fed, lambda x: np.exp(-1j * math.pi * x), share, -1.0))),
        delay=_find_delay(angles, loci),
        late=_count_late_cycles(loop),
        disc=float(np.min(2.0 * np.abs(1.0 + loci) / np.maximum(np.abs(1.0 - loci), TINY))),
        radius=radius,
        bandwidth=bandwidth,
        settling=settling,
    )


def _find_first_unstable(
    a: FloatArray, fed: FloatArray, factor: Callable[[Any], Any], share: FloatArray, nothing: float
) -> Any:
    """Find the first of the factors at `share` that makes the loop unstable, refined; `nothing` if none does."""

    def unstable(x: Any) -> Any:
        matrices = a + np.asarray(factor(x))[..., None, None] * fed
        return np.max(np.abs(np.linalg.eigvals(matrices)), axis=-1) > UNSTABLE

    found = np.flatnonzero(unstable(share))
    if not found.size:
        return nothing
    high = float(share[found[0]])
    low = high - float(share[0])
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if unstable(middle) else (middle, high)
    return factor(low)


def _find_delay(angles: FloatArray, loci: ComplexArray) -> float:
    """Smallest delay, in cycles, that turns a locus of size 1 to -1."""
    curves, best = _sort_loci(loci), math.inf
    size = np.abs(curves)
    for i in range(curves.shape[1]):
        for k in np.flatnonzero((size[:-1, i] - 1.0) * (size[1:, i] - 1.0) < 0.0):
            t = (1.0 - size[k, i]) / (size[k + 1, i] - size[k, i])
            angle = angles[k] + t * (angles[k + 1] - angles[k])
            phase = np.angle(curves[k, i] + t * (curves[k + 1, i] - curves[k, i]))
            best = min(best, float((phase + math.pi) % (2.0 * math.pi) / angle))
    return best


def _sort_loci(loci: ComplexArray) -> ComplexArray:
    """Sort at most two columns of the loci into continuous curves."""
    if loci.shape[1] != 2:
        return loci
    out = loci.copy()
    for k in range(1, len(out)):
        step = np.abs(out[k][:, None] - out[k - 1][None, :])
        if step[1, 0] + step[0, 1] < step[0, 0] + step[1, 1]:
            out[k] = out[k, ::-1]
    return out


def _count_late_cycles(loop: SampledLoop) -> int:
    """Count the cycles by which poses may be late, up to `MOST_LATE`."""
    return next(
        (late - 1 for late in range(1, MOST_LATE + 1) if loop.compute_spectral_radius(late=late) > UNSTABLE), MOST_LATE
    )


def _find_bandwidth(loop: SampledLoop) -> float:
    """In Hz; nan where the loop does not follow at all, half the sampling rate where it follows everything."""
    angles = np.linspace(0.0, math.pi, FREQUENCIES + 1)[1:]
    a, measured = loop.close_loop(), loop.build_measurement_input()
    z = np.exp(1j * angles)[:, None, None]
    response = np.linalg.solve(z * np.eye(len(a)) - a, np.broadcast_to(measured[:, :1], (len(angles), len(a), 1)))
    across = np.abs(response[:, 0, 0])
    if not across[0] > NO_RESPONSE:
        return math.nan
    below = np.flatnonzero(across < across[0] / math.sqrt(2.0))
    last = float(angles[below[0]]) if below.size else math.pi
    return last / (2.0 * math.pi * loop.period)


def _count_settling_cycles(loop: SampledLoop) -> float:
    outside = np.flatnonzero(~(np.abs(loop.simulate_step(MAX_CYCLES)[:, 0]) <= BAND))
    if not outside.size:
        return 0.0
    return float((outside[-1] + 1) * loop.period) if outside[-1] < MAX_CYCLES else math.inf
