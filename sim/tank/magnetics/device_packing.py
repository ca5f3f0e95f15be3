"""The true magnet on its cantilever, packed for the kernel that moves it."""

from __future__ import annotations

import math

import numpy as np

from sim.tank.mismatch import TankTruth
from sim.tank.settings import TankSettings
from smolbot.config.robot import RobotConfig
from smolbot.core.arrays import FloatArray

MAGNET_DENSITY, MAGNET_RADIUS, MAGNET_LENGTH = 7500.0, 0.5e-3, 1e-3  # NdFeB, in kg/m³ and m
MAGNET_MASS = MAGNET_DENSITY * math.pi * MAGNET_RADIUS**2 * MAGNET_LENGTH  # kg


def pack_true_device(robot: RobotConfig, settings: TankSettings, truth: TankTruth) -> FloatArray:
    """Pack the `device` array of `sim.tank.magnetics.cantilever` for a robot with the sampled errors.

    Parameters
    ----------
    robot : RobotConfig
    settings : TankSettings
    truth : TankTruth

    Returns
    -------
    ndarray
    """
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
    """Pack the `device` array of `sim.tank.magnetics.cantilever.advance_cantilever`.

    Linear damping (Eq. S3) models dry friction: the amplitude falls by ``eta theta_max`` each second, so the
    friction is ``eta theta_max omega² / (4 f)``. Exponential damping (Eq. S4) is viscous; omega0 is
    such that the damped oscillation has the given frequency.

    Parameters
    ----------
    moment : float, in A·m²
    direction : ndarray, shape (3,)
        Of the moment at rest, body frame; without y component.
    l0 : float, in m
        From the rotation centre to the magnet.
    theta_max : float, in rad
        Deflection at the stops.
    frequency : float, in Hz
    damping : float, in 1/s
        eta.
    damping_model : str
        ``linear`` or ``exponential``.
    restitution : float
        Of the stops.
    center : tuple of 3, in m
        Middle of the housing, from the rotation centre, body frame.
    magnet_mass : float, in kg

    Returns
    -------
    ndarray
    """
    omega = 2.0 * math.pi * frequency
    linear = damping_model == "linear"
    # dry friction that lowers the amplitude by damping * theta_max per s: 4 friction / omega² a period
    friction = damping * theta_max * omega**2 / (4.0 * frequency) if linear else 0.0
    eta = 0.0 if linear else damping
    values = [moment, direction[0], direction[2], l0, theta_max, omega**2 + eta**2, friction]
    return np.array([*values, eta, restitution, magnet_mass * l0**2, *center])
