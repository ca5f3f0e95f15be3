"""The magnet on its cantilever as it truly is, packed for the kernel that swings it."""

from __future__ import annotations

import math

import numpy as np

from sim.tank.mismatch import Truth
from sim.tank.settings import TankSettings
from smolbot.config.robot import RobotConfig
from smolbot.core.arrays import FloatArray

MAGNET_DENSITY, MAGNET_RADIUS, MAGNET_LENGTH = 7500.0, 0.5e-3, 1e-3  # NdFeB, in kg/m³ and m
MAGNET_MASS = MAGNET_DENSITY * math.pi * MAGNET_RADIUS**2 * MAGNET_LENGTH  # kg


def true_device(robot: RobotConfig, settings: TankSettings, truth: Truth) -> FloatArray:
    """The `device` array of `sim.tank.magnetics.cantilever.swing` for a robot with the drawn errors."""
    device = robot.device
    return pack_device(
        device.moment * truth.moment,
        device.moment_in_body,
        device.l0 * truth.l0,
        device.theta_max * truth.theta_max,
        device.frequency * truth.frequency,
        device.damping * truth.damping,
        device.damping_model,
        settings.stop_restitution,
        robot.center,
    )


def pack_device(
    moment: float,
    direction: FloatArray,
    l0: float,
    theta_max: float,
    frequency: float,
    damping: float,
    damping_model: str,
    restitution: float,
    center: tuple[float, float, float],
    magnet_mass: float = MAGNET_MASS,
) -> FloatArray:
    """The `device` array of `swing`, from SI values.

    Linear damping (Eq. S3) is what dry friction does: the amplitude falls by ``eta theta_max`` each second, so the
    friction is ``eta theta_max omega² / (4 f)``. Exponential damping (Eq. S4) is viscous; omega0 is
    such that the damped oscillation has the given frequency.
    """
    omega = 2.0 * math.pi * frequency
    linear = damping_model == "linear"
    # dry friction that lowers the amplitude by damping * theta_max per s: 4 friction / omega² a period
    friction = damping * theta_max * omega**2 / (4.0 * frequency) if linear else 0.0
    eta = 0.0 if linear else damping
    values = [moment, direction[0], direction[2], l0, theta_max, omega**2 + eta**2, friction]
    return np.array([*values, eta, restitution, magnet_mass * l0**2, *center])
