"""The forward model in plain numpy: field of an oscillating device at each sensor (Eqs. S2 to S8)."""

from __future__ import annotations

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import matrix_from_quaternion
from smolbot.core.sensing import Device, SensorArray

MU0_OVER_4PI = 1e-7
"""In T·m/A."""


def compute_dipole_field(positions: FloatArray, moment: FloatArray) -> FloatArray:
    """Compute the magnetic flux density of a point dipole at the origin.

        B(r) = mu_0 / (4 pi |r|^3) * (3 n (n . m) - m),   n = r / |r|        (Eq. S5)

    Parameters
    ----------
    positions : ndarray, shape (..., 3), in m
        Points relative to the dipole, in the world frame.
    moment : ndarray, shape (..., 3), in A·m²

    Returns
    -------
    ndarray, shape (..., 3), in T
        Field in the world frame.

    Examples
    --------
    >>> b = compute_dipole_field(np.array([[0, 0, 0.01], [0, 0, 0.02]]), np.array([0, 0, 1e-3]))
    >>> print((b[:, 2] * 1e6).round(3))  # µT: twice as far, one eighth
    [200.  25.]
    """
    distance = np.linalg.norm(positions, axis=-1, keepdims=True)
    direction = positions / distance
    along = np.sum(direction * moment, axis=-1, keepdims=True)
    field: FloatArray = MU0_OVER_4PI / distance**3 * (3.0 * direction * along - moment)
    return field


def compute_envelope(device: Device, time: FloatArray) -> FloatArray:
    """Compute the envelope D(t) of the free oscillation.

        D(t) = 1 - eta t      (linear, Eq. S3)
        D(t) = exp(-eta t)    (exponential, Eq. S4)

    Parameters
    ----------
    device : Device
    time : ndarray, shape (n,), in s
        After the end of the drive.

    Returns
    -------
    ndarray, shape (n,)
        1 at t = 0, never negative.
    """
    if device.damping_model == "linear":
        return np.maximum(1.0 - device.damping * time, 0.0)
    return np.exp(-device.damping * time)


def compute_deflection(device: Device, time: FloatArray, amplitude: float, phase: float) -> FloatArray:
    """Compute the deflection angle of the free oscillation.

        theta(t) = A D(t) cos(2 pi f t + phi)        (Eq. S2)

    Parameters
    ----------
    device : Device
    time : ndarray, shape (n,), in s
        After the end of the drive.
    amplitude : float, in rad
        At the end of the drive.
    phase : float, in rad

    Returns
    -------
    ndarray, shape (n,), in rad
    """
    return amplitude * compute_envelope(device, time) * np.cos(2.0 * np.pi * device.frequency * time + phase)


def compute_sensor_field(
    sensors: SensorArray, device: Device, position: FloatArray, orientation: FloatArray, theta: FloatArray
) -> FloatArray:
    """Compute the field along each sensor's axis for given deflections, constant part included (Eqs. S5 to S8).

    Parameters
    ----------
    sensors : SensorArray
    device : Device
    position : ndarray, shape (3,), in m, world frame
        Rotation centre of the cantilever.
    orientation : ndarray, shape (4,)
        Unit quaternion, body to world.
    theta : ndarray, shape (n,), in rad

    Returns
    -------
    ndarray, shape (n_sensors, n), in T
    """
    rotation = matrix_from_quaternion(orientation)
    sine, cosine, zero = np.sin(theta), np.cos(theta), np.zeros_like(theta)
    magnet = position + device.l0 * np.stack([sine, zero, cosine], axis=-1) @ rotation.T  # Eqs. S6, S7
    mx, my, mz = device.moment * device.moment_in_body
    swung = np.stack([cosine * mx + sine * mz, zero + my, cosine * mz - sine * mx], axis=-1)  # Eqs. S8, S19
    moment = swung @ rotation.T
    field = compute_dipole_field(sensors.positions[:, None, :] - magnet[None], moment[None])
    return np.einsum("snk,sk->sn", field, sensors.responses)
