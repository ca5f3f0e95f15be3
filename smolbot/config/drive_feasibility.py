"""Check before anything moves that a rig's excitation coils make a mission's device swing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from smolbot.config.document import Fault
from smolbot.config.mission_base import MissionBase
from smolbot.core.arrays import FloatArray
from smolbot.core.drive import compute_drive
from smolbot.core.pose import Pose
from smolbot.motion.robot import compute_magnet_inertia

if TYPE_CHECKING:
    from lookup_tables import FlatCoil

MIN_AMPLITUDE = 0.02
"""Share of the stops that a burst must reach: a swing fifty times weaker than the largest is found by no search."""

N_TURNS = 12
"""Turns that stand for all of a coil: 5 mm apart on ours, whose wires are 30 mm from the robot."""


def find_drive_faults(mission: MissionBase, points: FloatArray, orientations: list[FloatArray]) -> list[Fault]:
    """Find that the device hardly swings at any of some poses.

    Parameters
    ----------
    mission : MissionBase
    points : ndarray, shape (n, 3), in m
        Places of the robot, in the world frame.
    orientations : list of ndarray, shape (4,)
        Unit quaternions, one for each point.

    Returns
    -------
    list of Fault
        Empty if there is none.
    """
    device, cycle = mission.robot.device, mission.cycle
    inertia = compute_magnet_inertia(device.moment, device.l0)
    fields = np.stack([compute_flat_coil_field(coil, points) for coil in mission.rig.flat_coils()], axis=1)
    amplitudes = [
        compute_drive(
            of_coils, Pose(0.0, point, turned, np.eye(6)), device, inertia, cycle.excite_cycles, cycle.excite_current
        ).amplitude
        for of_coils, point, turned in zip(fields, points, orientations, strict=True)
    ]
    largest = max(amplitudes) / device.theta_max
    if largest >= MIN_AMPLITUDE:
        return []
    message = (
        f"a burst of {cycle.excite_cycles} cycles at {cycle.excite_current:g} A makes the device swing to "
        f"{100.0 * largest:.2g} % of its stops at most; to be heard it needs {100.0 * MIN_AMPLITUDE:g} % somewhere on "
        "the path. Drive it with more current or cycles, or bring the coils nearer."
    )
    return [Fault(("cycle",), message)]


def compute_flat_coil_field(coil: FlatCoil, points: FloatArray) -> FloatArray:
    """Compute the flux density of a flat coil from a few of its turns, as four straight wires each.

        B = mu_0 I / (4 pi) (a x b) (|a| + |b|) / (|a| |b| (|a| |b| + a . b))

    with a and b from the point to the ends of a wire (Biot-Savart). `FlatCoil.field` does the same with magpylib, whose
    import would cost every reading of a mission a second.

    Parameters
    ----------
    coil : FlatCoil
    points : ndarray, shape (n, 3), in m
        In the world frame, outside the winding.

    Returns
    -------
    ndarray, shape (n, 3), in T/A
    """
    wide, high = 0.5 * coil.width * coil.width_direction, 0.5 * coil.height * np.cross(coil.axis, coil.width_direction)
    corners = np.array([wide + high, high - wide, -wide - high, wide - high])  # right-handed about the axis
    along = coil.length * ((np.arange(N_TURNS) + 0.5) / N_TURNS - 0.5)
    starts = (coil.center + corners[None, :, :] + along[:, None, None] * coil.axis).reshape(-1, 3)
    ends = (coil.center + np.roll(corners, -1, axis=0)[None, :, :] + along[:, None, None] * coil.axis).reshape(-1, 3)
    a, b = starts - points[:, None, :], ends - points[:, None, :]
    size_a, size_b = np.linalg.norm(a, axis=2), np.linalg.norm(b, axis=2)
    both = size_a * size_b
    weight = (size_a + size_b) / (both * (both + np.sum(a * b, axis=2)))
    total: FloatArray = np.sum(np.cross(a, b) * weight[..., None], axis=1)
    return 1e-7 * coil.turns / N_TURNS * total  # mu_0 / (4 pi)
