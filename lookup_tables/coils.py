"""Air coils of finite winding cross-section, computed by magpylib.

A winding is a bundle of turns. A few current loops at the Gauss-Legendre nodes of its cross-section represent it,
with the weights of that rule, which converges much faster than equally spaced turns.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import lru_cache
from importlib import import_module
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from lookup_tables.errors import TableError

FloatArray = npt.NDArray[np.float64]
MU_0 = 4e-7 * np.pi
"""Magnetic constant, in T·m/A."""
CHUNK_SIZE = 40_000
"""Points of one call to magpylib: limits its memory."""
SAME_DIGITS = 13
"""Decimals, in m, to which radii and heights are compared: equal ones are computed once."""
ON_LOOP = 1e-9
"""Distance, in m, from a current loop up to which a point lies on it."""
PARALLEL = 1e-6
"""Sine below which the direction of the width is parallel to the axis."""


class Coil(Protocol):
    """Protocol of a coil from which a table can be built."""

    @property
    def name(self) -> str:
        """Name in rig files and tables."""

    def field(self, points: FloatArray) -> FloatArray:
        """Compute the flux density per ampere.

        Parameters
        ----------
        points : ndarray, shape (n, 3), in m, world frame

        Returns
        -------
        ndarray, shape (n, 3), in T/A, world frame
        """

    def parameters(self) -> dict[str, Any]:
        """Return all inputs of the field as plain values, from which the cache's key is made.

        Returns
        -------
        dict of str to plain values
        """


@dataclass(frozen=True, eq=False)
class RoundCoil:
    """A round coil with a rectangular winding cross-section, without a core.

    Attributes
    ----------
    name : str
        Name in rig files and tables, for instance ``+x``.
    center : ndarray, shape (3,), in m, world frame
        Middle of the winding.
    axis : ndarray, shape (3,), world frame
        Direction of the field at the centre for a positive current; of any length. An actuation coil's field at the
        workspace points toward the coil: the one at +x has the axis +x.
    inner_radius, outer_radius, length : float, in m
        The winding's cross-section is ``outer_radius - inner_radius`` by ``length``.
    turns : float
        Number of turns.
    radial_loops, axial_loops : int
        Current loops that represent the winding. For a cross-section of 20 x 20 mm, 18 mm away, 5 x 5 loops are
        within 5e-7 of the winding, 8 x 8 within 1e-10.

    Examples
    --------
    >>> coil = RoundCoil("+x", np.array([0.052, 0, 0]), np.array([1.0, 0, 0]), 0.015, 0.035, 0.02, 200)
    >>> print((coil.field(np.zeros((1, 3))) * 1e6).round(2))  # µT per A at the workspace centre
    [[424.21   0.     0.  ]]
    """

    name: str
    center: FloatArray
    axis: FloatArray
    inner_radius: float
    outer_radius: float
    length: float
    turns: float
    radial_loops: int = 5
    axial_loops: int = 5

    def __post_init__(self) -> None:
        _freeze_vectors(self, ("center", "axis"))
        _check_positive(self, ("inner_radius", "length", "turns", "radial_loops", "axial_loops"))
        if not self.outer_radius > self.inner_radius:
            raise TableError(
                f"Coil {self.name!r}: outer_radius must exceed inner_radius, {1e3 * self.inner_radius:g} mm; "
                f"got {1e3 * self.outer_radius:g} mm."
            )

    def loops(self) -> Iterator[tuple[float, float, float]]:
        """Iterate over the current loops.

        Yields
        ------
        radius : float, in m
        place : float, in m
            Along the axis, from the centre.
        share : float
            Of the ampere-turns.
        """
        middle, half = 0.5 * (self.inner_radius + self.outer_radius), 0.5 * (self.outer_radius - self.inner_radius)
        for radial, radial_share in _compute_nodes(self.radial_loops):
            for axial, axial_share in _compute_nodes(self.axial_loops):
                yield middle + half * radial, 0.5 * self.length * axial, radial_share * axial_share

    def source(self) -> Any:
        """Make magpylib's current loops, which carry 1 A.

        Returns
        -------
        magpylib.Collection
        """
        magpylib: Any = import_module("magpylib")
        from scipy.spatial.transform import Rotation

        turn = Rotation.from_matrix(_make_frame(self.axis).T)
        return magpylib.Collection(
            *(
                magpylib.current.Circle(
                    diameter=2 * radius,
                    current=self.turns * share,
                    position=self.center + along * self.axis,
                    orientation=turn,
                )
                for radius, along, share in self.loops()
            )
        )

    def field(self, points: FloatArray) -> FloatArray:
        """Compute the flux density per ampere, by magpylib's loops in the coil's own cylinder coordinates.

        Points with the same radius and height, as most of a mesh has by symmetry, are computed once. On a current loop
        its own field is left out, which is zero in the middle of a wire; in a winding the field is that of the loops.

        Parameters
        ----------
        points : ndarray, shape (n, 3), in m, world frame

        Returns
        -------
        ndarray, shape (n, 3), in T/A, world frame
        """
        from magpylib.core import current_circle_Hfield

        relative = as_points(points) - self.center
        along = relative @ self.axis
        across = relative - along[:, None] * self.axis
        radius = np.linalg.norm(across, axis=1)
        unique, back = np.unique(np.round(np.stack([radius, along]), SAME_DIGITS), axis=1, return_inverse=True)
        total = np.zeros((2, unique.shape[1]))
        for loop_radius, place, share in self.loops():
            off = np.hypot(unique[0] - loop_radius, unique[1] - place) > ON_LOOP  # magpylib would never end on it
            ones = np.ones(np.count_nonzero(off))
            field = current_circle_Hfield(
                r0=loop_radius * ones, r=unique[0, off], z=unique[1, off] - place, i0=MU_0 * self.turns * share * ones
            )
            total[:, off] += field[[0, 2]]
        radial, axial = total[:, back.ravel()]
        unit = across / np.where(radius > 0, radius, 1.0)[:, None]
        return np.asarray(radial[:, None] * unit + axial[:, None] * self.axis)

    def parameters(self) -> dict[str, Any]:
        """Return all inputs of the field as plain values.

        Returns
        -------
        dict of str to plain values
        """
        return _to_plain(self)


@dataclass(frozen=True, eq=False)
class FlatCoil:
    """A coil of rectangular turns on a flat bobbin, without a core.

    Attributes
    ----------
    name : str
        Name in rig files and tables.
    center : ndarray, shape (3,), in m, world frame
        Middle of the winding.
    axis : ndarray, shape (3,), world frame
        Direction of the field at the centre for a positive current; of any length.
    length : float, in m
        Extent of the winding along the axis.
    width, height : float, in m
        Sides of the innermost turn: `width` along `width_direction`, `height` across it and the axis.
    width_direction : ndarray, shape (3,), world frame
        Only its part perpendicular to the axis is used; of any length.
    turns : float
        Number of turns.
    build_up : float, in m
        Thickness of the winding, outward from the innermost turn; 0 for a single thin layer.
    axial_loops, build_loops : int
        Current loops that represent the winding, along the axis and through its thickness.
    """

    name: str
    center: FloatArray
    axis: FloatArray
    length: float
    width: float
    height: float
    width_direction: FloatArray
    turns: float
    build_up: float = 0.0
    axial_loops: int = 16
    build_loops: int = 3

    def __post_init__(self) -> None:
        _freeze_vectors(self, ("center", "axis", "width_direction"))
        _check_positive(self, ("length", "width", "height", "turns", "axial_loops", "build_loops"))
        if not self.build_up >= 0.0:
            raise TableError(f"Coil {self.name!r}: build_up must be at least 0; got {self.build_up!r}.")
        across = self.width_direction - (self.width_direction @ self.axis) * self.axis
        if np.linalg.norm(across) < PARALLEL:
            raise TableError(f"Coil {self.name!r}: width_direction must not be parallel to axis.")
        object.__setattr__(self, "width_direction", across)
        _freeze_vectors(self, ("width_direction",))

    def source(self) -> Any:
        """Make magpylib's rectangular current loops, which carry 1 A.

        Returns
        -------
        magpylib.Collection
        """
        magpylib: Any = import_module("magpylib")
        wide, high = self.width_direction, np.cross(self.axis, self.width_direction)
        build = _compute_nodes(self.build_loops) if self.build_up else [(0.0, 1.0)]
        turns = []
        for depth, depth_share in build:
            out = 0.5 * self.build_up * (1.0 + depth)
            w, h = (0.5 * self.width + out) * wide, (0.5 * self.height + out) * high
            corners = np.array([w + h, h - w, -w - h, w - h, w + h])  # right-handed about the axis
            for axial, axial_share in _compute_nodes(self.axial_loops):
                middle = self.center + 0.5 * self.length * axial * self.axis
                current = self.turns * depth_share * axial_share
                turns.append(magpylib.current.Polyline(current=current, vertices=corners, position=middle))
        return magpylib.Collection(*turns)

    def field(self, points: FloatArray) -> FloatArray:
        """Compute the flux density per ampere.

        Parameters
        ----------
        points : ndarray, shape (n, 3), in m, world frame

        Returns
        -------
        ndarray, shape (n, 3), in T/A, world frame
        """
        points, source = as_points(points), self.source()
        chunks = [source.getB(points[i : i + CHUNK_SIZE]).reshape(-1, 3) for i in range(0, len(points), CHUNK_SIZE)]
        return np.concatenate(chunks) if chunks else np.empty((0, 3))

    def parameters(self) -> dict[str, Any]:
        """Return all inputs of the field as plain values.

        Returns
        -------
        dict of str to plain values
        """
        return _to_plain(self)


def as_points(points: Any) -> FloatArray:
    """Return positions as floats of shape (n, 3).

    Parameters
    ----------
    points : array_like, shape (n, 3)

    Returns
    -------
    ndarray, shape (n, 3)

    Raises
    ------
    TableError
        For another shape; the message names it.
    """
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        hint = " For one point, pass positions[None, :]." if array.shape == (3,) else ""
        raise TableError(f"Input positions must have shape (n, 3); got {array.shape}.{hint}")
    return np.ascontiguousarray(array)


@lru_cache(maxsize=32)
def _compute_nodes(count: int) -> list[tuple[float, float]]:
    """Gauss-Legendre nodes on -1 to 1 with weights that sum to 1."""
    places, weights = np.polynomial.legendre.leggauss(count)
    return [(float(x), float(w) / 2) for x, w in zip(places, weights, strict=True)]


def _make_frame(axis: FloatArray) -> FloatArray:
    """Right-handed rows (3, 3) of unit vectors, the last along the unit vector `axis`."""
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    first = np.cross(helper, axis)
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(axis, first), axis])


def _freeze_vectors(coil: Any, names: tuple[str, ...]) -> None:
    for name in names:
        vector = np.array(getattr(coil, name), dtype=np.float64)
        if vector.shape != (3,) or not np.isfinite(vector).all():
            raise TableError(f"Coil {coil.name!r}: {name} must be three finite numbers; got {vector.tolist()!r}.")
        if name != "center":
            if not vector.any():
                raise TableError(f"Coil {coil.name!r}: {name} must not be zero.")
            vector /= np.linalg.norm(vector)
        vector.setflags(write=False)
        object.__setattr__(coil, name, vector)


def _check_positive(coil: Any, names: tuple[str, ...]) -> None:
    for name in names:
        if not getattr(coil, name) > 0:
            raise TableError(f"Coil {coil.name!r}: {name} must be positive; got {getattr(coil, name)!r}.")


def _to_plain(coil: Any) -> dict[str, Any]:
    values = {f.name: getattr(coil, f.name) for f in fields(coil)}
    plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in values.items()}
    return {"kind": type(coil).__name__, **plain}
