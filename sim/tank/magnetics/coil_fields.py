"""The true coils: one fine table per coil shape in the coil's own frame, displaced, tilted and scaled.

The controller interpolates one table of all nominal coils on the rig's mesh. Here each shape is tabulated once in
its own frame (radius and height for round coils, three axes for flat ones), and each coil is an erroneous copy of
it.
"""

from __future__ import annotations

import hashlib
import json
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from lookup_tables.cache import get_default_cache_dir, mark_used, write_to_cache
from lookup_tables.coils import FlatCoil, RoundCoil
from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import matrix_from_quaternion, quaternion_from_rotation_vector

CACHE_VERSION = 1  # of the cached coefficients
ROUND, FLAT = 0.0, 1.0
MARGIN_CELLS = 4  # cells around the requested region: the spline's end conditions decay there
REGION = 4  # cells to whose multiples a table's region is rounded: neighbouring regions share one table
MARGIN = 4e-3  # m around the nominal region: more than any coil is displaced or tilted
SAME_DIGITS = 9  # decimals, in m, to which points are compared: equal ones are computed once
# Columns of a coil's row: kind, offset of its coefficients, counts (3), origin (3), 1/spacing, place (3), frame (9),
# gain
KIND, OFFSET, COUNTS, ORIGIN, SCALE, PLACE, FRAME, GAIN = 0, 1, 2, 5, 8, 9, 12, 21
ROW_LENGTH = 22
# Columns of `circuits`: current (A), constant command (A), amplitude of a sine command (A), time constant (s)
CURRENT, COMMAND, SINE, TIME_CONSTANT = range(4)


@dataclass(frozen=True, eq=False)
class ShapeTable:
    """Cubic B-spline coefficients of one coil shape in its own frame (z along the axis, x along the width).

    Attributes
    ----------
    kind : float
        `ROUND`: axes (radius, height), values (radial, axial); `FLAT`: axes and values (x, y, z).
    origin : ndarray, shape (2,) or (3,), in m
    spacing : float, in m
    coefficients : ndarray, shape (*counts, 2) or (*counts, 3), in T per A
    """

    kind: float
    origin: FloatArray
    spacing: float
    coefficients: FloatArray


def load_shape_table(coil: RoundCoil | FlatCoil, low: FloatArray, high: FloatArray, spacing: float) -> ShapeTable:
    """Tabulate a coil shape at the origin, with its axis along z; cached on disk.

    Parameters
    ----------
    coil : RoundCoil or FlatCoil
        Its centre, axis and width direction are not used.
    low, high : ndarray, shape (3,), in m
        Corners of the table in the coil's own frame, rounded outward to whole cells so that similar requests share
        a table.
    spacing : float, in m

    Returns
    -------
    ShapeTable
    """
    up, ahead = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    standing: RoundCoil | FlatCoil
    if isinstance(coil, FlatCoil):
        kind, standing = FLAT, replace(coil, center=np.zeros(3), axis=up, width_direction=ahead)
    else:
        kind, standing = ROUND, replace(coil, center=np.zeros(3), axis=up)
        reach = float(np.hypot(max(-low[0], high[0]), max(-low[1], high[1])))
        low, high = np.array([0.0, low[2]]), np.array([reach, high[2]])
    first = np.floor(low / (REGION * spacing)) * REGION - MARGIN_CELLS
    last = np.ceil(high / (REGION * spacing)) * REGION + MARGIN_CELLS
    origin, counts = first * spacing, (last - first).astype(int) + 1
    axes = [o + spacing * np.arange(n) for o, n in zip(origin, counts, strict=True)]
    path = _make_cache_path(standing.parameters() | {"name": ""}, origin, counts, spacing)
    with suppress(OSError, ValueError, KeyError, EOFError):
        return ShapeTable(kind, origin, spacing, _load_coefficients(path))
    mesh = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    coefficients = _fit_spline(
        _sample_round_coil(standing, mesh) if kind == ROUND else _sample_flat_coil(standing, mesh)
    )
    write_to_cache(path, lambda name: np.save(name, coefficients))
    return ShapeTable(kind, origin, spacing, coefficients)


def compute_coil_frame(coil: RoundCoil | FlatCoil) -> FloatArray:
    """Compute a coil's own axes in the world frame.

    Parameters
    ----------
    coil : RoundCoil or FlatCoil

    Returns
    -------
    ndarray, shape (3, 3)
        One axis per row, the last along the coil's axis: a rotation from world to coil frame.
    """
    axis = np.asarray(coil.axis) / np.linalg.norm(coil.axis)
    width = coil.width_direction if isinstance(coil, FlatCoil) else np.eye(3)[int(np.argmin(np.abs(axis)))]
    width = width - (width @ axis) * axis
    width /= np.linalg.norm(width)
    return np.array([width, np.cross(axis, width), axis])


@dataclass(frozen=True, eq=False)
class CoilSet:
    """Coils packed for the kernels of `sim.tank.magnetics.cantilever`.

    Attributes
    ----------
    rows : ndarray, shape (n_coils, 22)
        One coil per row, as laid out at the top of this file.
    coefficients : ndarray, shape (total,), in T per A
    """

    rows: FloatArray
    coefficients: FloatArray


def pack_coils(
    coils: tuple[RoundCoil | FlatCoil, ...],
    places: FloatArray,
    tilts: FloatArray,
    gains: FloatArray,
    low: FloatArray,
    high: FloatArray,
    spacing: float = 5e-4,
) -> CoilSet:
    """Pack nominal coils with their errors into arrays for the kernels.

    Parameters
    ----------
    coils : tuple of RoundCoil or FlatCoil
    places : ndarray, shape (n_coils, 3), in m
        Displacements, world frame.
    tilts : ndarray, shape (n_coils, 3), in rad
        Rotation vectors, world frame.
    gains : ndarray, shape (n_coils,)
    low, high : ndarray, shape (3,), in m
        Corners of the volume in which the field is needed, world frame.
    spacing : float, in m
        Of round coils' tables; flat coils, whose field is smooth above their bobbins, use twice as much.

    Returns
    -------
    CoilSet
    """
    corners = np.array([[(low, high)[(i >> k) & 1][k] for k in range(3)] for i in range(8)])
    frames = [
        compute_coil_frame(coil) @ matrix_from_quaternion(quaternion_from_rotation_vector(tilt)).T
        for coil, tilt in zip(coils, tilts, strict=True)
    ]
    shapes: dict[str, list[int]] = {}
    for index, coil in enumerate(coils):
        shape = {k: v for k, v in coil.parameters().items() if k not in ("name", "center", "axis", "width_direction")}
        shapes.setdefault(json.dumps(shape, sort_keys=True), []).append(index)
    rows = np.zeros((len(coils), ROW_LENGTH))
    blocks, offset = [], 0
    for members in shapes.values():
        # The region follows the nominal coils and a fixed margin: every seed uses the same table.
        local = [(corners - np.asarray(coils[i].center)) @ compute_coil_frame(coils[i]).T for i in members]
        points = np.concatenate(local)
        flat = isinstance(coils[members[0]], FlatCoil)
        step = 2 * spacing if flat else spacing
        table = load_shape_table(coils[members[0]], points.min(0) - MARGIN, points.max(0) + MARGIN, step)
        counts = np.ones(3)
        counts[: len(table.origin)] = table.coefficients.shape[:-1]
        origin = np.zeros(3)
        origin[: len(table.origin)] = table.origin
        for i in members:
            place = np.asarray(coils[i].center) + places[i]
            rows[i] = [table.kind, offset, *counts, *origin, 1 / step, *place, *frames[i].ravel(), gains[i]]
        blocks.append(table.coefficients.ravel())
        offset += blocks[-1].size
    return CoilSet(rows, np.concatenate(blocks) if blocks else np.zeros(1))


def _sample_round_coil(coil: RoundCoil | FlatCoil, mesh: FloatArray) -> FloatArray:
    radius, height = mesh[..., 0].ravel(), mesh[..., 1].ravel()
    field = coil.field(np.stack([np.abs(radius), np.zeros_like(radius), height], axis=1))
    radial = np.sign(radius) * field[:, 0]  # odd in the radius: the spline is smooth on the axis
    return np.stack([radial, field[:, 2]], axis=1).reshape(*mesh.shape[:2], 2)


def _sample_flat_coil(coil: RoundCoil | FlatCoil, mesh: FloatArray) -> FloatArray:
    # Symmetric about both middle planes, so only a quarter is computed.
    points = np.abs(mesh.reshape(-1, 3))
    unique, back = np.unique(points.round(SAME_DIGITS), axis=0, return_inverse=True)
    signs = np.sign(mesh.reshape(-1, 3))
    field = coil.field(unique)[back.ravel()]
    z = signs[:, 2]
    out = np.stack([field[:, 0] * signs[:, 0] * z, field[:, 1] * signs[:, 1] * z, field[:, 2]], axis=1)
    return out.reshape(mesh.shape)


def _fit_spline(values: FloatArray) -> FloatArray:
    from scipy.ndimage import spline_filter1d

    out = values
    for axis in range(values.ndim - 1):
        out = spline_filter1d(out, order=3, axis=axis, mode="mirror")
    return np.ascontiguousarray(out)


@lru_cache(maxsize=8)
def _load_coefficients(path: Path) -> FloatArray:
    """Read coefficients from the cache on disk, once per process; the array is read-only."""
    coefficients: FloatArray = np.load(path)
    coefficients.setflags(write=False)
    mark_used(path)
    return coefficients


def _make_cache_path(parameters: dict[str, object], origin: FloatArray, counts: object, spacing: float) -> Path:
    recipe = [CACHE_VERSION, parameters, origin.tolist(), np.asarray(counts).tolist(), spacing]
    key = hashlib.sha256(json.dumps(recipe, sort_keys=True).encode()).hexdigest()[:32]
    return get_default_cache_dir() / f"tank-coil-{key}.npy"
