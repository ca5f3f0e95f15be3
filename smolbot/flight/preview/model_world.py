"""The world of a preview: the controller's own model, as it is or with some of its parameters drawn around it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from smolbot.config.expected_errors import ExpectedErrors
from smolbot.config.feasibility import compute_states_along, compute_swimming_orientation
from smolbot.config.mission import Mission
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.rotations import multiply_quaternions, quaternion_from_rotation_vector
from smolbot.core.shots import Actuate, Shot
from smolbot.motion.controller import Setup
from smolbot.motion.gradient import advance

TINY = 1e-40
"""Least variance by which a covariance is scaled: without tolerances in the rig file, it is zero."""

LEARNED_RECORDINGS = 100
"""Number of recordings from which a flight has learned its sensors when their errors matter: a third of one."""

N_ERROR_POINTS = 9
"""Points of the path at which the covariance of a pose is computed; a pose between takes that of the nearest."""


@dataclass(frozen=True, eq=False)
class Perturbation:
    """How a world differs from the controller's model. Factors are on the model's values; SI units.

    Attributes
    ----------
    drag, rotational_drag, moment : float
        Factors.
    coil_gains : ndarray, shape (n_coils,), or None
        Factors on the field of each coil; None for 1.
    flow : float
        Factor on the speed of the liquid's flow that the rig file gives.
    start_offset : ndarray, shape (2,), in m
        From the requested start position.
    heading : float, in rad, or None
        Of the robot at the start, from x toward y; None for toward the path's start.
    pose_noise : float
        Factor on the noise of poses; 0 for poses without error.
    pose_bias : ndarray, shape (6,)
        Error that every pose has by sensors and device that are not as assumed, in standard deviations along its axes.
    missed : float
        Probability that a listening window gives no pose.
    """

    drag: float = 1.0
    rotational_drag: float = 1.0
    moment: float = 1.0
    coil_gains: FloatArray | None = None
    flow: float = 1.0
    start_offset: FloatArray = field(default_factory=lambda: np.zeros(2))
    heading: float | None = None
    pose_noise: float = 1.0
    pose_bias: FloatArray = field(default_factory=lambda: np.zeros(6))
    missed: float = 0.0


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Errors of poses along a path, computed once for all worlds of a preview.

    Attributes
    ----------
    points : ndarray, shape (n, 2), in m, world frame
    orientations : list of ndarray, shape (4,)
        Of a robot that heads along the path there.
    amplitudes : ndarray, shape (n,), in rad
        Of its device at the end of the excitation.
    expected : ExpectedErrors
        At these points.
    noise, bias : ndarray, shape (n, 6, 6)
        Cholesky factors of the covariances by noise, and by sensors and device once a flight has learned a little.
    """

    points: FloatArray
    orientations: list[FloatArray]
    amplitudes: FloatArray
    expected: ExpectedErrors
    noise: FloatArray
    bias: FloatArray

    @classmethod
    def expect(cls, mission: Mission) -> PoseErrors:
        """Compute the errors that the poses of a mission will have along its path.

        Parameters
        ----------
        mission : Mission

        Returns
        -------
        PoseErrors
        """
        arc = np.linspace(0.0, mission.path.length, N_ERROR_POINTS)
        states = compute_states_along(mission, mission.path, arc)
        expected = ExpectedErrors.expect(mission, *states)
        bias = expected.compute_sensor_part(LEARNED_RECORDINGS)
        return cls(states[0][:, :2], states[1], states[2], expected, _factorise(expected.noise), _factorise(bias))

    def find_nearest(self, position: FloatArray) -> int:
        """Find the point nearest to a position.

        Parameters
        ----------
        position : ndarray, shape (3,), in m

        Returns
        -------
        int
        """
        return int(np.argmin(np.sum((self.points - position[:2]) ** 2, axis=1)))


def _factorise(covariances: FloatArray) -> FloatArray:
    """Compute symmetric square roots of covariances (n, 6, 6), which may be singular."""
    scale = np.sqrt(np.maximum(np.einsum("nii->ni", covariances), TINY))
    values, vectors = np.linalg.eigh(covariances / (scale[:, :, None] * scale[:, None, :]))
    root = np.sqrt(np.maximum(values, 0.0))
    out: FloatArray = scale[:, :, None] * ((vectors * root[:, None, :]) @ np.swapaxes(vectors, 1, 2))
    return out


class ModelWorld:
    """A robot that obeys the controller's model, as far as it is not perturbed, and poses of it with their errors.

    Parameters
    ----------
    mission : Mission
    setup : Setup
        The controller's model.
    errors : PoseErrors
    perturbation : Perturbation
    seed : int
        Of the errors of poses.

    Attributes
    ----------
    position : ndarray, shape (3,), in m, world frame
    heading : float, in rad
    flow : ndarray, shape (2,), in m/s, world frame
        Of the liquid, at the speed that the rig file gives and in a direction of the world's own.
    """

    def __init__(
        self, mission: Mission, setup: Setup, errors: PoseErrors, perturbation: Perturbation, seed: int
    ) -> None:
        model = setup.robot
        self._table = setup.table
        self._robot = replace(
            model,
            drag=model.drag * perturbation.drag,
            rotational_drag=model.rotational_drag * perturbation.rotational_drag,
            moment=model.moment * perturbation.moment,
        )
        self._gains = np.ones(setup.table.n_coils) if perturbation.coil_gains is None else perturbation.coil_gains
        self._errors, self._perturbation = errors, perturbation
        self._rng = np.random.default_rng(seed)
        speed, way = perturbation.flow * mission.rig.sections.medium.flow, self._rng.uniform(-np.pi, np.pi)
        self.flow = speed * np.array([np.cos(way), np.sin(way)])
        self._along_x = compute_swimming_orientation(setup.device, np.array([1.0, 0.0, 0.0]))
        self.position = np.array([*(np.array(mission.start) + perturbation.start_offset), mission.rig.surface_z])
        start = mission.path.points[0] - self.position
        toward = float(np.arctan2(start[1], start[0]))
        self.heading = toward if perturbation.heading is None else perturbation.heading

    @property
    def inside(self) -> bool:
        """Whether the robot is inside the field table."""
        return bool(self._table.contains(self.position[None, :])[0])

    def play(self, shot: Shot, turnaround: float) -> None:
        """Move the robot by a shot and by the liquid's flow.

        Parameters
        ----------
        shot : Shot
        turnaround : float, in s
            Time that passes after it.
        """
        position = self.position.copy()
        position[:2] += self.flow * (shot.duration + turnaround)
        for window in shot.windows:
            if isinstance(window, Actuate) and any(window.currents):
                field_, gradient = self._table.field_and_gradient(self.position[None, :])
                currents = np.array(window.currents) * self._gains
                step, self.heading = advance(
                    self._robot, field_[:, 0], gradient[:, 0], currents, self.heading, window.duration
                )
                position[:2] += step
        self.position = position

    def locate(self, time: float) -> Pose | None:
        """Draw the pose that is located in a listening window.

        Parameters
        ----------
        time : float, in s
            Middle of the window.

        Returns
        -------
        Pose or None
            None for a window that gives no pose.
        """
        drawn = self._perturbation
        if drawn.missed > 0.0 and self._rng.random() < drawn.missed:
            return None
        at = self._errors.find_nearest(self.position)
        error = self._errors.noise[at] @ (drawn.pose_noise * self._rng.standard_normal(6))
        error = error + self._errors.bias[at] @ drawn.pose_bias
        turned = error[3:] + np.array([0.0, 0.0, self.heading])  # small errors: their order with the turn is no matter
        orientation = multiply_quaternions(quaternion_from_rotation_vector(turned), self._along_x)
        return Pose(time, self.position + error[:3], orientation, self._errors.expected.noise[at])
