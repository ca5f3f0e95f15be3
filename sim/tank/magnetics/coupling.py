"""Coupling of each coil's current into each sensor.

Only residual currents matter, so straight wires are exact enough.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sim.tank.magnetics.coil_fields import compute_coil_frame
from smolbot.core.arrays import FloatArray

if TYPE_CHECKING:
    from lookup_tables import FlatCoil, RoundCoil

MU_0 = 4e-7 * np.pi  # T·m/A
POLYGON_SIDES = 64  # of the polygon for a round winding: 0.2 % from a circle
WIRE_RADIUS = 5e-4  # m: radius of the wire; keeps the field inside a winding finite


def compute_coupling(
    coils: tuple[RoundCoil | FlatCoil, ...],
    places: FloatArray,
    rotations: FloatArray,
    gains: FloatArray,
    positions: FloatArray,
    axes: FloatArray,
) -> FloatArray:
    """Compute the reading of each sensor per ampere in each coil.

    Parameters
    ----------
    coils : tuple of RoundCoil or FlatCoil
        Nominal coils.
    places : ndarray, shape (n_coils, 3), in m
        Displacement of each, world frame.
    rotations : ndarray, shape (n_coils, 3, 3)
        Tilt of each.
    gains : ndarray, shape (n_coils,)
    positions, axes : ndarray, shape (n_sensors, 3)
        True positions (m) and sensitive directions with the gain as length, world frame.

    Returns
    -------
    ndarray, shape (n_coils, n_sensors), in T/A
    """
    out = np.zeros((len(coils), len(positions)))
    for c, coil in enumerate(coils) if len(positions) else ():
        start, end, turns = _list_wires(coil)
        frame = compute_coil_frame(coil) @ rotations[c].T
        local = (positions - np.asarray(coil.center) - places[c]) @ frame.T
        out[c] = gains[c] * np.einsum("ni,ni->n", compute_wire_field(local, start, end, turns) @ frame, axes)
    return out


def compute_wire_field(points: FloatArray, start: FloatArray, end: FloatArray, current: FloatArray) -> FloatArray:
    """Compute the field of straight wires that carry a current.

        B = mu_0 I / (4 pi) * (a x b) (|a| + |b|) / (|a| |b| (|a| |b| + a . b))

    with a and b from the wire's ends to the point.

    Parameters
    ----------
    points : ndarray, shape (n, 3), in m
    start, end : ndarray, shape (m, 3), in m
        Ends of the wires, in the frame of `points`.
    current : ndarray, shape (m,), in A

    Returns
    -------
    ndarray, shape (n, 3), in T
        Sum over all wires, in the frame of `points`.
    """
    # Biot-Savart for straight wires: mu_0 I / 4 pi * (|a| + |b|) / (|a| |b| (|a| |b| + a . b)) * a x b
    a, b = points[:, None] - start, points[:, None] - end
    la, lb = np.linalg.norm(a, axis=2), np.linalg.norm(b, axis=2)
    product = la * lb
    below = product * (product + np.einsum("nmi,nmi->nm", a, b))
    weight = MU_0 / (4 * np.pi) * current * (la + lb) / np.maximum(below, WIRE_RADIUS**2 * product)
    return np.asarray(np.einsum("nm,nmi->ni", weight, np.cross(a, b)))


def _list_wires(coil: RoundCoil | FlatCoil) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return starts, ends and ampere-turns of the wires of a coil at the origin with its axis along z."""
    from lookup_tables import FlatCoil

    loops: list[tuple[FloatArray, float, float]] = []
    if isinstance(coil, FlatCoil):
        half_width, half_height = 0.5 * coil.width + 0.5 * coil.build_up, 0.5 * coil.height + 0.5 * coil.build_up
        corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [half_width, half_height]
        heights, weights = np.polynomial.legendre.leggauss(coil.axial_loops)
        loops = [(corners, float(0.5 * coil.length * h), float(0.5 * w)) for h, w in zip(heights, weights, strict=True)]
    else:
        angles = 2 * np.pi * np.arange(POLYGON_SIDES) / POLYGON_SIDES
        circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        loops = [(radius * circle, height, share) for radius, height, share in coil.loops()]
    starts, ends, currents = [], [], []
    for corners, height, share in loops:
        ring = np.column_stack([corners, np.full(len(corners), height)])
        starts.append(ring)
        ends.append(np.roll(ring, -1, axis=0))
        currents.append(np.full(len(ring), coil.turns * share))
    return np.concatenate(starts), np.concatenate(ends), np.concatenate(currents)
