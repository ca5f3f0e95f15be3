"""Excitation currents for the device: enough to reach its stops, not more.

Driving on against the stops costs heat and amplitude: each impact shifts the phase of the oscillation
against the drive, and the free amplitude that remains falls well below the stop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.sensing import Device

MIN_CURRENT_SHARE = 0.02
"""Smallest share of the maximum current that a burst uses."""

MIN_USEFUL_FIELD = 1e-12
"""Field across the moment, in T per A, below which no coil can drive the cantilever."""

NEGLIGIBLE_DECAY = 1e-6
"""Damping times duration below which the amplitude grows linearly: the closed form would divide by it."""


@dataclass(frozen=True)
class Drive:
    """Excitation currents and the amplitude that they should produce.

    Attributes
    ----------
    currents : ndarray, shape (n_exc,), in A
        Signed peak currents.
    amplitude : float, in rad
        Expected amplitude at the end of the burst.
    """

    currents: FloatArray
    amplitude: float


def compute_drive(
    fields_in_world: FloatArray,
    pose: Pose,
    device: Device,
    inertia: float,
    cycles: int,
    max_current: float,
    residual_swing: float = 0.0,
) -> Drive:
    """Compute the currents that bring a device of known orientation to its stops by the end of a burst.

    Only the torque about body y drives the oscillation, so only the field along y x m counts (Eq. S1). The
    combination that gives most of it for the least heat drives each coil in proportion to its own contribution. The
    amplitude grows as

        A' = m B / (2 I w) - eta A

    Parameters
    ----------
    fields_in_world : ndarray, shape (n_exc, 3), in T per A
        Of each excitation coil at the device, world frame.
    pose : Pose
    device : Device
    inertia : float, in kg·m²
        Of the magnet about the cantilever's rotation centre.
    cycles : int
        Length of the burst, in periods of the device.
    max_current : float, in A
        Peak, per coil.
    residual_swing : float
        Remaining oscillation at the start as a share of `theta_max`, in any phase; the current is increased to
        cancel it in the worst case.

    Returns
    -------
    Drive
        Full current in the first coil and amplitude 0 if no coil can drive the device in this orientation.
    """
    x, y, z = (pose.rotation @ device.drive_direction_in_body).tolist()
    useful = [bx * x + by * y + bz * z for bx, by, bz in fields_in_world.tolist()]
    largest = max(abs(field) for field in useful)
    if largest < MIN_USEFUL_FIELD:
        return Drive(max_current * np.eye(len(fields_in_world))[0], 0.0)
    mix = [field / largest for field in useful]
    per_ampere = sum(field * part for field, part in zip(useful, mix, strict=True))
    full = compute_amplitude_after_burst(max_current * per_ampere, device, inertia, cycles)
    share = min(max((1.0 + residual_swing) * device.theta_max / full, MIN_CURRENT_SHARE), 1.0)
    return Drive(max_current * share * np.array(mix), min(full, device.theta_max))


def compute_amplitude_after_burst(field: float, device: Device, inertia: float, cycles: int) -> float:
    """Compute the amplitude that a resonant field builds up in a burst, without the stops.

        A = m B / (2 I w) t                          (linear damping; decay neglected)
        A = m B / (2 I w eta) (1 - exp(-eta t))      (exponential damping)

    Parameters
    ----------
    field : float, in T
        Peak flux density along y x m.
    device : Device
    inertia : float, in kg·m²
        Of the magnet about the cantilever's rotation centre.
    cycles : int
        Length of the burst, in periods of the device.

    Returns
    -------
    float, in rad
    """
    omega = 2.0 * math.pi * device.frequency
    growth = device.moment * field / (2.0 * inertia * omega)
    time = cycles / device.frequency
    if device.damping_model == "linear" or device.damping * time < NEGLIGIBLE_DECAY:
        return growth * time
    return growth / device.damping * -math.expm1(-device.damping * time)
