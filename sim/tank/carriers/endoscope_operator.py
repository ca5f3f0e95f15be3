"""Model of an operator who guides a flexible endoscope's tip: in along a route, out again, in along the next."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sim.tank.carriers.routes import SplineRoute
from sim.tank.settings import OperatorSection
from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import quaternion_from_matrix

MAX_ACCELERATION = 40e-3  # m/s²: acceleration and deceleration of a careful operator
SPACING = 5e-5  # m: between two points of the time plan
POSE_STEP = 1e-3  # s: between two computed poses; linear between them
TREMOR_FREQUENCY_RATIOS = np.array(
    [0.9, 1.0, 1.1]
)  # frequencies relative to the tremor's: it is a narrow band, not a line
TORSION_PERIOD = 16.0  # s: of the wrist that follows the view
GRIP_FADE_TIME = 0.5  # s: in which tremor and torsion begin and fade
LAST_STEP = 1.001  # ticks from the end: the last time that still has a pose after it
MAX_SIGMAS = 2.0  # standard deviations to which sampled values are clipped
STREAM = 4  # random stream of a seed for the operator; the tank uses 0 to 3


@dataclass(frozen=True, eq=False)
class OperatorParameters:
    """Sampled parameters of one operator and of the organ.

    Attributes
    ----------
    shifts : tuple of ndarray, shape (n_points, 3), in m
        Displacements of each route's points, world frame; zero for the first, where the tip starts.
    pace : float
        Factor on speed and turn rate.
    roll : float, in rad
        Of the device about the tip's axis, as it was taped on.
    phases : ndarray, shape (6, 3), in rad
        Of the tremor: along and about the world's axes.
    torsion : float, in rad
        Phase of the slow torsion.
    """

    shifts: tuple[FloatArray, ...]
    pace: float
    roll: float
    phases: FloatArray
    torsion: float

    @classmethod
    def sample(cls, section: OperatorSection, seed: int) -> OperatorParameters:
        """Sample an operator; not affected by the mismatches' scale.

        Parameters
        ----------
        section : OperatorSection
        seed : int

        Returns
        -------
        OperatorParameters
        """
        rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence([seed, STREAM])))
        shifts = []
        for route in section.routes:
            shift = section.scatter * np.clip(rng.standard_normal(route.points.shape), -MAX_SIGMAS, MAX_SIGMAS)
            shift[0] = 0.0
            shifts.append(shift)
        return cls(
            shifts=tuple(shifts),
            pace=float(np.exp(section.pace_scatter * np.clip(rng.standard_normal(), -MAX_SIGMAS, MAX_SIGMAS))),
            roll=float(section.roll_scatter * np.clip(rng.standard_normal(), -MAX_SIGMAS, MAX_SIGMAS)),
            phases=rng.uniform(-np.pi, np.pi, (6, 3)),
            torsion=float(rng.uniform(-np.pi, np.pi)),
        )


class EndoscopeOperator:
    """Pose of an externally guided device over time.

    Parameters
    ----------
    section : OperatorSection
    parameters : OperatorParameters
        Sampled parameters.

    Attributes
    ----------
    routes : tuple of SplineRoute
    start_time, end_time : float, in s
        The tip is at rest before and after.
    """

    def __init__(self, section: OperatorSection, parameters: OperatorParameters) -> None:
        self._section, self._parameters = section, parameters
        self.routes = build_routes(section, parameters)
        self.start_time = section.rest_s
        self._plan = [self._plan_times(route, section.routes[i].dwell_s) for i, route in enumerate(self.routes)]
        self.end_time = self.start_time + sum(float(times[-1]) for times, _ in self._plan)
        ticks = np.arange(self.start_time, self.end_time + 2 * POSE_STEP, POSE_STEP)
        self._poses = self._compute_poses(ticks)

    def interpolate_poses(self, times: FloatArray) -> FloatArray:
        """Return the device's poses at given times.

        Parameters
        ----------
        times : ndarray, shape (n,), in s
            On the tank's clock.

        Returns
        -------
        ndarray, shape (n, 7)
            Rotation centre (m) and orientation (scalar first), world frame.
        """
        return np.array([self.interpolate_pose(float(t)) for t in times])

    def interpolate_pose(self, time: float) -> FloatArray:
        """Return the device's pose at one time; fast, for a thousand calls per second.

        Parameters
        ----------
        time : float, in s
            On the tank's clock.

        Returns
        -------
        ndarray, shape (7,)
            Rotation centre (m) and orientation (scalar first), world frame.
        """
        ticks = min(max((time - self.start_time) / POSE_STEP, 0.0), len(self._poses) - LAST_STEP)
        first = int(ticks)
        share = ticks - first
        found = (1.0 - share) * self._poses[first] + share * self._poses[first + 1]
        found[3:] /= math.sqrt(found[3:] @ found[3:])
        return found

    def compute_shaft_positions(self, times: FloatArray, distances: FloatArray) -> FloatArray:
        """Return positions on the shaft's axis, which lies along the route behind the tip.

        Parameters
        ----------
        times : ndarray, shape (n,), in s
            On the tank's clock.
        distances : ndarray, shape (k,), in m
            Behind the tip.

        Returns
        -------
        ndarray, shape (n, k, 3), in m
            World frame.
        """
        leg, arc = self._find_route_and_arc(times)
        out = np.empty((len(times), len(distances), 3))
        for index, route in enumerate(self.routes):
            chosen = leg == index
            if chosen.any():
                along = (arc[chosen, None] - distances).ravel()
                out[chosen] = route.interpolate_positions(along).reshape(-1, len(distances), 3)
        return out + self._compute_tremor(times)[0][:, None]

    def _compute_poses(self, times: FloatArray) -> FloatArray:
        leg, arc = self._find_route_and_arc(times)
        places, frames = np.empty((len(times), 3)), np.empty((len(times), 3, 3))
        for index, route in enumerate(self.routes):
            chosen = leg == index
            places[chosen], frames[chosen] = (
                route.interpolate_positions(arc[chosen]),
                route.interpolate_rotations(arc[chosen]),
            )
        slow = np.sin(2 * np.pi * (times - self.start_time) / TORSION_PERIOD + self._parameters.torsion)
        roll = self._parameters.roll + self._section.torsion * self._compute_grip(times) * slow
        shaken, turned = self._compute_tremor(times)
        rotations = _rotations_from_vectors(turned) @ frames @ _compute_rolls(roll)
        quaternions = np.array([quaternion_from_matrix(r) for r in rotations])
        flips = np.sign(np.sum(quaternions[1:] * quaternions[:-1], axis=1))
        quaternions[1:] *= np.cumprod(flips)[:, None]  # the same sign throughout: they are interpolated
        return np.concatenate([places + shaken, quaternions], axis=1)

    def _find_route_and_arc(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the route's index (n,) and the arc length (n,) in m on it."""
        left = np.clip(times - self.start_time, 0.0, self.end_time - self.start_time)
        leg, arc = np.zeros(len(times)), np.zeros(len(times))
        begun = 0.0
        for index, (known, along) in enumerate(self._plan):
            chosen = left >= begun
            leg[chosen] = index
            arc[chosen] = np.interp(left[chosen] - begun, known, along)
            begun += float(known[-1])
        return leg, arc

    def _plan_times(self, route: SplineRoute, dwell: float) -> tuple[FloatArray, FloatArray]:
        """Return times (n,) in s and arc lengths (n,) in m of one motion: in, dwell at the end, and out."""
        n = max(int(np.ceil(route.length / SPACING)), 2)
        step = route.length / n
        middle = (np.arange(n) + 0.5) * step
        speed = self._section.speed * self._parameters.pace
        turning = self._section.turn_rate * self._parameters.pace
        # time per length: forward speed, and bends at the rate at which the tip turns; the end is braked for
        pace = 1.0 / (1.0 / speed + np.interp(middle, *route.bends) / turning)
        from_end = np.minimum(middle, route.length - middle)
        pace = np.minimum(pace, np.sqrt(2.0 * MAX_ACCELERATION * from_end))
        way = np.concatenate([[0.0], np.cumsum(step / pace)])
        arc = np.linspace(0.0, route.length, n + 1)
        back = way[-1] + dwell + (way[-1] - way[::-1])
        return np.concatenate([way, back]), np.concatenate([arc, arc[::-1]])

    def _compute_grip(self, times: FloatArray) -> FloatArray:
        """Return the scale (n,) of tremor and torsion: 0 while the tip is at rest, 1 while the operator holds it."""
        near = np.minimum(times - self.start_time, self.end_time - times) / GRIP_FADE_TIME
        return np.asarray(np.sin(0.5 * np.pi * np.clip(near, 0.0, 1.0)) ** 2)

    def _compute_tremor(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the tremor's displacement (n, 3) in m and rotation vector (n, 3) in rad, world frame."""
        waves = 2 * np.pi * self._section.tremor_hz * np.multiply.outer(times, TREMOR_FREQUENCY_RATIOS)
        each = np.sin(waves[:, None, :] + self._parameters.phases).sum(axis=2) * self._compute_grip(times)[:, None]
        share = np.sqrt(2.0 / 3.0) / np.sqrt(len(TREMOR_FREQUENCY_RATIOS))  # root mean square of the sum is 1
        return self._section.tremor * share * each[:, :3], self._section.tremor_turn * share * each[:, 3:]


def build_routes(section: OperatorSection, parameters: OperatorParameters | None = None) -> tuple[SplineRoute, ...]:
    """Build an operator's routes. All begin in one direction.

    Parameters
    ----------
    section : OperatorSection
    parameters : OperatorParameters, optional
        Sampled displacements; without them the routes are those of the rig file.

    Returns
    -------
    tuple of SplineRoute
    """
    points = [route.points for route in section.routes]
    first = np.mean([p[1] - p[0] for p in points], axis=0)
    if parameters is not None:
        points = [p + shift for p, shift in zip(points, parameters.shifts, strict=True)]
    return tuple(SplineRoute(p, first) for p in points)


def _compute_rolls(angles: FloatArray) -> FloatArray:
    """Return rotation matrices (n, 3, 3) about z."""
    out = np.zeros((len(angles), 3, 3))
    out[:, 0, 0] = out[:, 1, 1] = np.cos(angles)
    out[:, 1, 0] = np.sin(angles)
    out[:, 0, 1] = -out[:, 1, 0]
    out[:, 2, 2] = 1.0
    return out


def _rotations_from_vectors(vectors: FloatArray) -> FloatArray:
    """Return the rotation matrices (n, 3, 3) of rotation vectors (n, 3) in rad (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    cross = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -z, y, -x
    cross[:, 1, 0], cross[:, 2, 0], cross[:, 2, 1] = z, -y, x
    half = np.sinc(angle / (2 * np.pi))
    return np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * half**2 * (cross @ cross)
