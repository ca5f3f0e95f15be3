"""Overdamped motion of a gradient-pulled robot in the horizontal plane, as its controller believes it."""

# mypy: disable-error-code="no-untyped-call,no-untyped-def"
from __future__ import annotations

import numpy as np
from numba import njit

from smolbot.arrays import FloatArray
from smolbot.motion.robot import Robot

STEP = 2e-3
"""Longest step of the integration, in s; alignment takes tens of ms."""


@njit(cache=True)
def _deflection(off, torque, stiffness, theta_max):
    """Angle of the magnet toward a field `off` rad from the housing: k d = m B sin(off - d), up to the stop."""
    d = 0.0
    for _ in range(8):
        value = stiffness * d - torque * np.sin(off - d)
        d -= value / (stiffness + torque * abs(np.cos(off - d)) + 1e-30)
    return min(max(d, -theta_max), theta_max)


@njit(cache=True)
def _advance(
    field, gradient, moment, drag, rotational_drag, stiffness, theta_max, magnet, center, heading, duration, steps
):
    """Displacement (2,) of the rotation centre, and heading, after `duration`; the field varies linearly."""
    x = np.zeros(2)
    begin = heading
    dt = duration / steps
    for _ in range(steps):
        bx = field[0] + gradient[0, 0] * x[0] + gradient[0, 1] * x[1]
        by = field[1] + gradient[1, 0] * x[0] + gradient[1, 1] * x[1]
        size = np.sqrt(bx * bx + by * by)
        if size < 1e-15:
            break
        to_field = np.arctan2(by, bx)
        off = to_field - heading
        off -= 2.0 * np.pi * np.round(off / (2.0 * np.pi))
        bent = _deflection(off, moment * size, stiffness, theta_max) if np.isfinite(stiffness) else 0.0
        # for a constant field tan(angle / 2) decays exponentially, which is stable at any step
        angle = off - bent
        half = min(max(0.5 * angle, -1.5707), 1.5707)
        after = 2.0 * np.arctan(np.tan(half) * np.exp(-moment * size / rotational_drag * dt))
        points = heading + bent + 0.5 * (angle - after)
        mx, my = moment * np.cos(points), moment * np.sin(points)
        fx, fy = gradient[0, 0] * mx + gradient[1, 0] * my, gradient[0, 1] * mx + gradient[1, 1] * my
        lever = (magnet - center) * (np.cos(heading) * fy - np.sin(heading) * fx)
        heading += angle - after + dt * lever / rotational_drag
        x[0] += dt * fx / drag
        x[1] += dt * fy / drag
    x[0] -= center * (np.cos(heading) - np.cos(begin))
    x[1] -= center * (np.sin(heading) - np.sin(begin))
    return x, heading


def advance(
    robot: Robot, field: FloatArray, gradient: FloatArray, currents: FloatArray, heading: float, duration: float
) -> tuple[FloatArray, float]:
    """Motion under constant coil currents for one window.

    The moment turns into the field, first by bending the cantilever, then by turning the housing
    against viscous drag, and is pulled by grad(m . B). Momentum dies in under a millisecond and is
    left out.

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
    total_field = currents @ field
    total_gradient = (currents @ gradient.reshape(len(currents), 9)).reshape(3, 3)
    steps = max(int(np.ceil(duration / STEP)), 1)
    return _advance(
        total_field,
        total_gradient,
        robot.moment,
        robot.drag,
        robot.rotational_drag,
        robot.stiffness,
        robot.theta_max,
        robot.magnet_ahead,
        robot.center_ahead,
        float(heading),
        float(duration),
        steps,
    )
