"""A helix in gel between plates under a rotating magnet, as its controller models it: averaged over turns."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import matrix_from_quaternion, multiply_quaternions, quaternion_from_rotation_vector
from smolbot.core.shots import MoveMagnet, Rotate, Window
from smolbot.motion import helix_kernels as kernels
from smolbot.motion.robot import compute_magnet_inertia

MEAN_OF_ELLIPSE = 1.5420
"""Mean over a turn of ``sqrt(4 cos² + sin²)``: the field of a dipole beside its axis, in units of its weakest."""

BEARING_CAPACITY_FACTOR = 7.0
"""Pressure, in yield stresses, that a gel supports on the projected area of a cylinder pushed across its axis."""


@dataclass(frozen=True)
class Helix:
    """Model parameters of a screw in a gel, and of the magnet that turns it. SI units.

    Attributes
    ----------
    advance : float, in m
        Per turn, after slip.
    moment : float, in A·m²
    stiffness : float, in N·m/rad
        Of the cantilever between magnet and housing.
    theta_max : float, in rad
        Stop of its deflection.
    spin_yield, tilt_yield : float, in N·m
        Torque about the axis, and across it, at which the gel yields.
    across_yield : float, in N
        Force across the axis at which the gel yields.
    viscous_rate : float, in rad/s
        Rate of turn at which viscous drag is as large as the yield stress.
    center_ahead, magnet_ahead : float, in m
        Positions of the housing's middle and of the oscillating magnet from the rotation centre, along the axis.
    half_length : float, in m
    low, high : float, in m
        Lowest and highest position of the axis between the plates.
    magnet : tuple of 3 floats, in m, world frame
        Centre of the actuation magnet.
    field : float, in T
        Mean over a turn, straight below the magnet at `distance`.
    distance : float, in m
    steering_rate : float, in rad/s
        Of the magnet's axis about the vertical.
    steering : float
        Ratio of the measured turn of the axis to the computed one.
    drift : float, in m
        Measured displacement to the left, per turn.
    """

    advance: float
    moment: float
    stiffness: float
    theta_max: float
    spin_yield: float
    tilt_yield: float
    across_yield: float
    viscous_rate: float
    center_ahead: float
    magnet_ahead: float
    half_length: float
    low: float
    high: float
    magnet: tuple[float, float, float]
    field: float
    distance: float
    steering_rate: float
    steering: float = 1.0
    drift: float = 0.0

    @classmethod
    def in_gel(
        cls,
        *,
        pitch: float,
        slip: float,
        diameter: float,
        length: float,
        center_ahead: float,
        moment: float,
        l0: float,
        theta_max: float,
        frequency: float,
        yield_stress: float,
        viscosity: float,
        magnet: tuple[float, float, float],
        field: float,
        distance: float,
        steering_rate: float,
        floor: float,
        plate: float,
        steering: float = 1.0,
        drift: float = 0.0,
    ) -> Helix:
        """Make a helix of a cylinder's size in a yield-stress gel.

        The cantilever's stiffness follows from its resonance: k = I (2 pi f)², I = m_magnet l0².

        Parameters
        ----------
        pitch : float, in m
            Of the screw, per turn.
        slip : float
            Share of the pitch that is lost.
        diameter, length : float, in m
            Of the cylinder.
        center_ahead : float, in m
            Position of the housing's middle along the axis, from the rotation centre.
        moment : float, in A·m²
        l0 : float, in m
            From the rotation centre to the magnet.
        theta_max : float, in rad
            Stop of the deflection.
        frequency : float, in Hz
            Resonance of the cantilever.
        yield_stress : float, in Pa
        viscosity : float, in Pa·s
        magnet : tuple of 3 floats, in m, world frame
            Centre of the actuation magnet.
        field : float, in T
            Mean over a turn, straight below the magnet at `distance`.
        distance : float, in m
        steering_rate : float, in rad/s
            Of the magnet's axis about the vertical.
        floor, plate : float, in m
            Heights of the lower and the upper plate.
        steering : float
            Ratio of the measured turn of the axis to the computed one.
        drift : float, in m
            Measured displacement to the left, per turn.

        Returns
        -------
        Helix
        """
        radius = 0.5 * diameter
        return cls(
            advance=pitch * (1.0 - slip),
            moment=moment,
            stiffness=compute_magnet_inertia(moment, l0) * (2.0 * np.pi * frequency) ** 2,
            theta_max=theta_max,
            spin_yield=yield_stress * np.pi * radius**2 * (2.0 * length + 4.0 / 3.0 * radius),
            tilt_yield=yield_stress * BEARING_CAPACITY_FACTOR * diameter * length**2 / 4.0,
            across_yield=yield_stress * BEARING_CAPACITY_FACTOR * diameter * length,
            viscous_rate=yield_stress / (2.0 * viscosity),
            center_ahead=center_ahead,
            magnet_ahead=l0,
            half_length=0.5 * length,
            low=floor + radius,
            high=plate - radius,
            magnet=magnet,
            field=field,
            distance=distance,
            steering_rate=steering_rate,
            steering=steering,
            drift=drift,
        )

    def load(self, frequency: float) -> float:
        """Compute the torque that it takes to turn in the gel.

            T = spin_yield (1 + 2 pi f / viscous_rate)

        Parameters
        ----------
        frequency : float, in Hz
            Of the robot's rotation.

        Returns
        -------
        float, in N·m
        """
        return self.spin_yield * (1.0 + 2.0 * math.pi * frequency / self.viscous_rate)

    def torque_margin(self, position: FloatArray, frequency: float) -> float:
        """Compute the smallest torque of the field in a turn over the largest torque that the gel requires.

        Where the field is weakest it turns twice as fast as the magnet. Below 1 the robot steps out.

        Parameters
        ----------
        position : ndarray, shape (3,), in m, world frame
        frequency : float, in Hz
            Of the magnet's rotation.

        Returns
        -------
        float
        """
        away = float(np.linalg.norm(position - np.array(self.magnet)))
        weakest = self.field / MEAN_OF_ELLIPSE * (self.distance / away) ** 3
        return self.moment * weakest / self.load(2.0 * frequency)

    @cached_property
    def body(self) -> FloatArray:
        """Parameters (18,) in the order of `smolbot.motion.helix_kernels`."""
        weakest = self.moment * self.field / MEAN_OF_ELLIPSE
        return np.array(
            [self.advance, self.center_ahead, self.magnet_ahead - self.center_ahead, *self.magnet, weakest,
             self.distance, self.steering_rate, self.spin_yield, self.tilt_yield, self.across_yield, self.viscous_rate,
             self.stiffness, self.theta_max, self.half_length, self.low, self.high]
        )  # fmt: skip

    @cached_property
    def factors(self) -> FloatArray:
        """Learned factors (4,) of the kernels, at their values measured beforehand."""
        return np.array([1.0, self.steering, 0.0, self.drift])

    def turning(self, tilt: float, frequency: float, turns: int = 4) -> float:
        """Compute the turn of the robot's axis per turn of the robot, straight below the magnet.

        Parameters
        ----------
        tilt : float, in rad
            Angle from the robot's axis to the axis of the rotating field.
        frequency : float, in Hz
        turns : int
            Number of turns to reach the steady state.

        Returns
        -------
        float, in rad
        """
        state = np.array([self.magnet[0], self.magnet[1], 0.5 * (self.low + self.high), 0.0, 0.0, np.nan])
        for _ in range(turns):
            state[: kernels.Z] = self.magnet[:2]
            before = state[kernels.HEADING]
            state[kernels.COURSE] = np.nan
            state = kernels.advance_screw(self.body, self.factors, state, before + tilt, 1.0, 1.0, frequency)
        return float(state[kernels.HEADING] - before)

    def tightest(self, frequency: float, tilt: float) -> float:
        """Compute the radius of the tightest possible bend.

        Parameters
        ----------
        frequency : float, in Hz
        tilt : float, in rad
            Largest angle from the robot's axis to the axis of the rotating field.

        Returns
        -------
        float, in m
            ``inf`` if the robot cannot be steered.
        """
        most = max(self.turning(t, frequency) for t in np.linspace(0.5 * tilt, tilt, 5))
        return self.advance / most if most > 0 else math.inf

    def carry(
        self, windows: tuple[Window, ...], position: FloatArray, orientation: FloatArray
    ) -> tuple[FloatArray, FloatArray, float, float]:
        """Predict the motion through the windows of a mechanical shot.

        Parameters
        ----------
        windows : tuple of Window
        position : ndarray, shape (3,), in m, world frame
            Of the rotation centre.
        orientation : ndarray, shape (4,)
            Unit quaternion, body to world.

        Returns
        -------
        position : ndarray, shape (3,), in m, world frame
            At the end.
        orientation : ndarray, shape (4,)
            At the end; the roll is not predicted but left unchanged.
        turns : float
            Of the magnet, in either direction.
        turned : float, in rad
            Sum of the absolute turns of the robot's axis.
        """
        state = make_state(position, orientation)
        heading, pitch, turns, turned = state[kernels.HEADING], state[kernels.PITCH], 0.0, 0.0
        for window in windows:
            if isinstance(window, MoveMagnet):
                state[kernels.COURSE] = np.nan  # the axis is free while the magnet is away
            elif isinstance(window, Rotate):
                before = state[kernels.HEADING]
                course, sense = compute_course(window, before)
                state = kernels.advance_screw(
                    self.body, self.factors, state, course, sense, window.turns, window.frequency
                )
                turns += window.turns
                turned += abs(state[kernels.HEADING] - before)
        left = np.array([-math.sin(heading), math.cos(heading), 0.0])
        tipped = quaternion_from_rotation_vector((pitch - state[kernels.PITCH]) * left)
        yawed = quaternion_from_rotation_vector(np.array([0.0, 0.0, state[kernels.HEADING] - heading]))
        return state[:3].copy(), multiply_quaternions(yawed, multiply_quaternions(tipped, orientation)), turns, turned


def make_state(position: FloatArray, orientation: FloatArray) -> FloatArray:
    """Convert a pose to a state of the kernels, with the magnet's axis free.

    Parameters
    ----------
    position : ndarray, shape (3,), in m, world frame
    orientation : ndarray, shape (4,)
        Unit quaternion, body to world.

    Returns
    -------
    ndarray, shape (6,)
        As described in `smolbot.motion.helix_kernels`.
    """
    ahead = matrix_from_quaternion(orientation)[:, 2]
    heading, pitch = math.atan2(ahead[1], ahead[0]), math.asin(min(max(ahead[2], -1.0), 1.0))
    return np.array([*position, heading, pitch, np.nan])


def compute_course(window: Rotate, heading: float) -> tuple[float, float]:
    """Compute the line along which a window drives the robot, and the direction along it.

    The robot turns against the magnet, so a magnet's axis that points back drives it forward.

    Parameters
    ----------
    window : Rotate
    heading : float, in rad
        Of the robot's axis.

    Returns
    -------
    course : float, in rad
        Heading of the line along which the robot is driven; within 90° of `heading`.
    sense : float
        1 forward along it, -1 back.
    """
    course = math.atan2(-window.axis[1], -window.axis[0])
    if math.cos(course - heading) >= 0.0:
        return course, 1.0
    return course + math.pi, -1.0


def make_rotate_window(course: float, sense: float, frequency: float, turns: float) -> Rotate:
    """Make the window that drives the robot along a line.

    Parameters
    ----------
    course : float, in rad
        Heading of the line.
    sense : float
        1 forward along it, -1 back.
    frequency : float, in Hz
    turns : float

    Returns
    -------
    Rotate
    """
    return Rotate((-sense * math.cos(course), -sense * math.sin(course), 0.0), frequency, turns)
