"""Reading and writing of tables: file formats, and the transformation from the file's frame to the world frame."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lookup_tables.comsol import read_comsol
from lookup_tables.comsol_writer import write_comsol
from lookup_tables.errors import TableError
from lookup_tables.samples import FloatArray, Samples

FORMAT_VERSION = 1
"""Of the .npz file of a table."""
ROTATION_TOLERANCE = 1e-6
"""Rounding of an entry of a rotation by right angles."""


def read_samples(
    path: Path,
    current: float,
    names: Sequence[str] | None,
    origin: Sequence[float] | FloatArray,
    rotation: FloatArray | None,
) -> Samples:
    """Read samples at 1 A in the world frame, for `FieldTable.read`.

    Parameters
    ----------
    path : Path
    current : float, in A
        Current of each coil in the file.
    names : sequence of str, optional
        Names of the coils; by default the file's.
    origin : array_like, shape (3,), in m
        Position of the file's origin in the world frame.
    rotation : ndarray, shape (3, 3), optional
        Takes the file's vectors to world vectors; right angles only.

    Returns
    -------
    Samples

    Raises
    ------
    TableError
        If the file is missing or faulty, or a value cannot be used.
    """
    if not path.is_file():
        beside = sorted(p.name for p in path.parent.glob(f"*{path.suffix}"))[:10] if path.parent.is_dir() else []
        there = f"; that folder has {', '.join(beside)}" if beside else ""
        raise TableError(f"{path}: there is no such file{there}.")
    if not (np.isfinite(current) and current != 0.0):
        raise TableError(f"{path}: current must be a number other than 0, in A; got {current}.")
    samples = _read_npz(path) if path.suffix == ".npz" else read_comsol(path)
    if names is not None:
        if len(names) != len(samples.names):
            raise TableError(f"{path}: the table has {len(samples.names)} coils; got {len(names)} names.")
        samples = samples._replace(names=tuple(names))
    shift = np.asarray(origin, dtype=np.float64)
    if shift.shape != (3,) or not np.isfinite(shift).all():
        raise TableError(f"{path}: origin must be three finite numbers, in m; got {origin!r}.")
    if current != 1.0 or shift.any() or rotation is not None:
        samples = _to_world(samples._replace(field=samples.field / current, potential=None), shift, rotation, path)
    return samples


def write_samples(samples: Samples, path: Path, layout: str) -> None:
    """Write samples, for `FieldTable.write`.

    Parameters
    ----------
    samples : Samples
    path : Path
    layout : {"spreadsheet", "grid"}
        Of the text.

    Raises
    ------
    TableError
        If the file cannot be written.
    """
    try:
        if path.suffix == ".npz":
            _write_npz(samples, path)
        else:
            write_comsol(samples, path, layout)
    except OSError as error:
        raise TableError(f"{path}: the table cannot be written ({error.strerror or error}).") from error


def _write_npz(samples: Samples, path: Path) -> None:
    assert samples.potential is not None  # a table fits its potential when it is made
    np.savez_compressed(
        path,
        format=np.array(FORMAT_VERSION),
        x=samples.x,
        y=samples.y,
        z=samples.z,
        field=samples.field,
        names=np.array(samples.names),
        potential=samples.potential,
    )


def _read_npz(path: Path) -> Samples:
    try:
        with np.load(path, allow_pickle=False) as data:
            if int(data["format"]) != FORMAT_VERSION:
                raise TableError(f"{path}: format {data['format']} is not {FORMAT_VERSION}; build or import it again.")
            arrays = [np.asarray(data[key], dtype=np.float64) for key in ("x", "y", "z", "field", "potential")]
            names = tuple(str(name) for name in data["names"])
    except TableError:
        raise
    except (zipfile.BadZipFile, zlib.error, KeyError, ValueError, EOFError, OSError) as error:
        raise TableError(f"{path}: this is not a table that FieldTable.write wrote ({error}).") from error
    x, y, z, field, potential = arrays
    return Samples(x, y, z, field, names, potential)


def _to_world(samples: Samples, origin: FloatArray, rotation: FloatArray | None, path: Path) -> Samples:
    """Rotate and shift axes and vectors; a right-angle rotation permutes the axes and flips some."""
    turn = np.eye(3) if rotation is None else np.asarray(rotation, dtype=np.float64)
    if turn.shape != (3, 3):
        raise TableError(f"{path}: rotation must have shape (3, 3); got {turn.shape}.")
    rounded = np.round(turn)
    right_angles = np.array_equal(np.abs(rounded).sum(axis=0), np.ones(3)) and np.linalg.det(rounded) > 0
    if not right_angles or np.abs(turn - rounded).max() > ROTATION_TOLERANCE:
        raise TableError(
            f"{path}: rotation must turn by right angles only, so that the mesh stays along the world's axes (each "
            f"row and column one 1 or -1, determinant 1); got {np.round(turn, 6).tolist()}."
        )
    source = np.abs(rounded).argmax(axis=1)  # world axis i is the file's axis source[i]
    signs = rounded[range(3), source]
    axes: list[FloatArray] = []
    field = np.transpose(samples.field, (0, *(1 + source), 4))[..., source] * signs
    file_axes = (samples.x, samples.y, samples.z)
    for i in range(3):
        axis = signs[i] * file_axes[source[i]]
        if signs[i] < 0:
            axis, field = axis[::-1], np.flip(field, axis=1 + i)
        axes.append(axis + origin[i])
    return Samples(axes[0], axes[1], axes[2], np.ascontiguousarray(field), samples.names)
