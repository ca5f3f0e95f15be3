"""Overdamped motion of a gradient-pulled robot in the horizontal plane, as its controller believes it."""

# mypy: disable-error-code="no-untyped-call"
from __future__ import annotations

import numpy as np
from numba import njit

from smolbot.arrays import FloatArray
from smolbot.motion.robot import Robot


@njit(cache=True)
def _advance(field, gradient, moment, drag, rotational_drag, heading, duration, steps):  # type: ignore[no-untyped-def]
    """Displacement (2,) and heading after `duration`, in a field that varies linearly around the start."""
    x = np.zeros(2)
    dt = duration / steps
    for _ in range(steps):
        bx = field[0] + gradient[0, 0] * x[0] + gradient[0, 1] * x[1]
        by = field[1] + gradient[1, 0] * x[0] + gradient[1, 1] * x[1]
        size = np.sqrt(bx * bx + by * by)
        if size < 1e-15:
            break
        # alignment has a closed form for a constant field: tan(angle / 2) decays exponentially
        to_field = np.arctan2(by, bx)
        off = heading - to_field
        off -= 2.0 * np.pi * np.round(off / (2.0 * np.pi))
        shrink = np.exp(-moment * size / rotational_drag * dt)
        half = min(max(0.5 * off, -1.5707), 1.5707)
        after = 2.0 * np.arctan(np.tan(half) * shrink)
        middle = to_field + 0.5 * (off + after)
        heading = to_field + after
        mx, my = moment * np.cos(middle), moment * np.sin(middle)
        x[0] += dt * (gradient[0, 0] * mx + gradient[1, 0] * my) / drag
        x[1] += dt * (gradient[0, 1] * mx + gradient[1, 1] * my) / drag
    return x, heading


def advance(
    robot: Robot, field: FloatArray, gradient: FloatArray, currents: FloatArray, heading: float, duration: float
) -> tuple[FloatArray, float]:
    """Motion under constant coil currents for one window.

    The moment turns into the field against viscous drag, and is pulled by grad(m . B); momentum dies
    in under a millisecond and is left out.

    Parameters
    ----------
    robot : Robot
    field : ndarray, shape (n_coils, 3), in T per A
        At the robot, world frame.
    gradient : ndarray, shape (n_coils, 3, 3), in T per (A m)
        ``[..., i, j] = dB_i / dx_j``.
    currents : ndarray, shape (n_coils,), in A
    heading : float, in rad
        Of the moment in the horizontal plane, from x toward y.
    duration : float, in s

    Returns
    -------
    displacement : ndarray, shape (2,), in m
    heading : float, in rad
        At the end of the window.
    """
    total_field = np.ascontiguousarray(currents @ field)
    total_gradient = np.ascontiguousarray(np.tensordot(currents, gradient, axes=1))
    steps = max(int(np.ceil(duration / 2e-3)), 1)
    return _advance(
        total_field, total_gradient, robot.moment, robot.drag, robot.rotational_drag, float(heading), float(duration), steps
    )
