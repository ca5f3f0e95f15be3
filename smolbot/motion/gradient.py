"""Overdamped motion of a gradient-pulled robot in the horizontal plane, as its controller models it."""

from __future__ import annotations

import math

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.motion.kernels import compute_displacement, propagate_turn_variance
from smolbot.motion.robot import Robot

MAX_STEP = 2e-3
"""Longest step of the integration, in s; alignment takes tens of ms."""

MAX_COARSE_STEP = 6e-3
"""Longest step, in s, where only the variance of a turn is computed."""

COIL_ERROR = 0.03
"""Relative error of a coil's field in its table: 2 % of gain, some tenths of a millimetre of position."""


def pack_robot(robot: Robot) -> FloatArray:
    """Pack a robot's parameters for the compiled kernels.

    Parameters
    ----------
    robot : Robot

    Returns
    -------
    ndarray, shape (7,)
        In the order of `smolbot.motion.kernels`.
    """
    return np.array(
        [
            robot.moment,
            robot.drag,
            robot.rotational_drag,
            robot.stiffness,
            robot.theta_max,
            robot.magnet_ahead,
            robot.center_ahead,
        ]
    )


def advance(
    robot: Robot,
    field: FloatArray,
    gradient: FloatArray,
    currents: FloatArray,
    heading: float,
    duration: float,
) -> tuple[FloatArray, float]:
    """Compute the motion under constant coil currents for one window.

    The moment turns into the field, first by bending the cantilever, then by turning the housing against viscous
    drag, and is pulled by grad(m . B) at the magnet. Momentum decays in less than a millisecond and is neglected.

    Parameters
    ----------
    robot : Robot
    field : ndarray, shape (n_coils, 3), in T per A
        At the robot, world frame.
    gradient : ndarray, shape (n_coils, 3, 3), in T per (A m)
        ``[..., i, j] = dB_i / dx_j``.
    currents : ndarray, shape (n_coils,), in A
    heading : float, in rad
        Of the cantilever in the horizontal plane, from x toward y.
    duration : float, in s

    Returns
    -------
    displacement : ndarray, shape (2,), in m
        Of the cantilever's rotation centre; the housing turns about its centre of drag.
    heading : float, in rad
        At the end of the window.
    """
    steps = max(math.ceil(duration / MAX_STEP), 1)
    x, y, after = compute_displacement(
        pack_robot(robot), field, gradient, currents, float(heading), float(duration), steps
    )
    return np.array([x, y]), after


def compute_turn_variance(
    robot: Robot,
    field: FloatArray,
    gradient: FloatArray,
    currents: FloatArray,
    heading: float,
    duration: float,
    heading_variance: float,
) -> float:
    """Compute the variance of a window's turn that errors of the coils' fields and of the heading add.

    A robot that points almost against the field may turn either way: the direction depends on errors smaller than
    the model's accuracy.

    Parameters
    ----------
    robot : Robot
    field : ndarray, shape (n_coils, 3), in T per A
        At the robot, world frame.
    gradient : ndarray, shape (n_coils, 3, 3), in T per (A m)
        ``[..., i, j] = dB_i / dx_j``.
    currents : ndarray, shape (n_coils,), in A
    heading : float, in rad
        Of the cantilever in the horizontal plane, from x toward y.
    duration : float, in s
    heading_variance : float, in rad²
        Of the heading.

    Returns
    -------
    float, in rad²
    """
    steps = max(math.ceil(duration / MAX_COARSE_STEP), 1)
    given = float(heading), float(duration), steps, COIL_ERROR, float(heading_variance)
    return float(propagate_turn_variance(pack_robot(robot), field, gradient, currents, *given))
