"""`FieldTable`: the field of several coils on a mesh, and its interpolation between the nodes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lookup_tables.coils import as_points
from lookup_tables.errors import OutsideTableError, TableError
from lookup_tables.samples import FloatArray, Samples

BoolArray = npt.NDArray[np.bool_]
BOUNDS_SLACK = 1e-9  # m: rounding does not put a node outside
MAX_RESIDUAL = 0.05  # above it, samples are no curl-free field: swapped columns, wrong units, a winding inside
STEP_TOLERANCE = 1e-3  # share of a step by which the steps of an axis may differ
CHECKED_NODES = 25  # per axis, at which the residual is computed


class Spline(NamedTuple):
    """Spline of the potential.

    Attributes
    ----------
    coefficients : ndarray, shape (nx + 4, ny + 4, nz + 4, n_coils), in T m / A
    origin : ndarray, shape (3,), in m
        First node.
    spacing : ndarray, shape (3,), in m
        Mesh width.
    """

    coefficients: FloatArray
    origin: FloatArray
    spacing: FloatArray


class FieldTable:
    """Flux density of each coil at 1 A in a box of the world frame.

    Between the nodes the field is B = -grad phi, where phi is a quintic spline fitted to the samples
    (`lookup_tables.potential`). So the field has no curl, `gradient` is its exact derivative and symmetric, and
    noise of the samples that has a curl is averaged out. The divergence is not forced to zero; for coils it comes
    out below 1e-7 of the gradient. Measured for a round coil of 25 mm radius, 28 mm from the box: relative error of
    the field 3e-10 and of the gradient 6e-8 at worst with a mesh of 0.5 mm, 6e-6 and 1e-4 with one of 2 mm and four
    planes. One point of four coils takes the kernel 3 us, `field` about 10 us.

    Parameters
    ----------
    x, y, z : ndarray, shape (nx,), (ny,), (nz,), in m
        Equally spaced, world frame. One of them may have a single sample: along that axis the field is then assumed
        to be constant, while the gradient, known from div B = 0 and curl B = 0, is still complete.
    field : ndarray, shape (n_coils, nx, ny, nz, 3), in T/A
        Samples at the nodes, world frame.
    names : sequence of str
        One for each coil.
    potential : ndarray, shape (nx + 4, ny + 4, nz + 4, n_coils), optional
        Coefficients from an earlier fit; fitted here if not given.

    Raises
    ------
    TableError
        For shapes that do not match, meshes that are not equally spaced, samples that are not finite, and samples
        that deviate by more than 5 % of the largest field from every field without curl.
    """

    def __init__(
        self,
        x: FloatArray,
        y: FloatArray,
        z: FloatArray,
        field: FloatArray,
        names: Sequence[str],
        potential: FloatArray | None = None,
    ) -> None:
        from lookup_tables.splines import DEGREE, evaluate_points

        self.x, self.y, self.z = axes = [_make_even(axis, name) for axis, name in zip((x, y, z), "xyz", strict=True)]
        self.names = tuple(names)
        self.samples = np.ascontiguousarray(field, dtype=np.float64)
        shape = (len(self.names), *(len(a) for a in axes), 3)
        _check_samples(self.samples, self.names, shape)
        steps = [(a[-1] - a[0]) / (len(a) - 1) if len(a) > 1 else 0.0 for a in axes]
        spacing = np.array([step or max(steps) for step in steps])
        if potential is None:
            from lookup_tables.potential import fit_potential

            potential = fit_potential(spacing, self.samples)
        expected = (*(max(n, 2) + DEGREE - 1 for n in shape[1:4]), shape[0])
        if potential.shape != expected:
            raise TableError(f"potential must have shape {expected} for this mesh; got {potential.shape}.")
        self.spline = Spline(np.ascontiguousarray(potential), np.array([a[0] for a in axes]), spacing)
        self._single = np.array([len(a) == 1 for a in axes])
        ends = np.array([[a[0] - BOUNDS_SLACK for a in axes], [a[-1] + BOUNDS_SLACK for a in axes]])
        self._limits = np.where(self._single, [[-np.inf], [np.inf]], ends)
        self._kernel = evaluate_points
        self.residual = self._compute_residual()

    @property
    def n_coils(self) -> int:
        """Number of coils."""
        return len(self.names)

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest corner (3,) of the samples, in m, world frame."""
        axes = (self.x, self.y, self.z)
        return np.array([a[0] for a in axes]), np.array([a[-1] for a in axes])

    def contains(self, points: FloatArray) -> BoolArray:
        """Return whether the table covers each of some points.

        Parameters
        ----------
        points : ndarray, shape (n, 3), in m, world frame

        Returns
        -------
        ndarray of bool, shape (n,)
            An axis of one sample covers every value.
        """
        points = as_points(points)
        return np.asarray(((points >= self._limits[0]) & (points <= self._limits[1])).all(axis=1))

    def field(self, points: FloatArray) -> FloatArray:
        """Compute the flux density of each coil at 1 A.

        Parameters
        ----------
        points : ndarray, shape (n, 3), in m, world frame

        Returns
        -------
        ndarray, shape (n_coils, n, 3), in T/A, world frame

        Raises
        ------
        OutsideTableError
            Names the first point that the table does not cover, and the range it covers.
        """
        return self.field_and_gradient(points)[0]

    def gradient(self, points: FloatArray) -> FloatArray:
        """Compute the spatial derivative of the field of each coil at 1 A.

        Parameters
        ----------
        points : ndarray, shape (n, 3), in m, world frame

        Returns
        -------
        ndarray, shape (n_coils, n, 3, 3), in T/(A m)
            ``[c, n, i, j] = dB_i / dx_j``, symmetric.

        Raises
        ------
        OutsideTableError
            See `field`.
        """
        return self.field_and_gradient(points)[1]

    def field_and_gradient(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute both `field` and `gradient`, at the cost of one.

        Parameters
        ----------
        points : ndarray, shape (n, 3), in m, world frame

        Returns
        -------
        field : ndarray, shape (n_coils, n, 3), in T/A
        gradient : ndarray, shape (n_coils, n, 3, 3), in T/(A m)

        Raises
        ------
        OutsideTableError
            See `field`.
        """
        points = as_points(points)
        field = np.empty((len(self.names), len(points), 3))
        gradient = np.empty((len(self.names), len(points), 3, 3))
        held = np.array(points) if not self._single.any() else np.where(self._single, self.bounds[0], points)
        outside = self._kernel(*self.spline, self._limits, held, field, gradient)
        if outside >= 0:
            raise self._format_outside(points[outside])
        return field, gradient

    @classmethod
    def read(
        cls,
        path: str | os.PathLike[str],
        current: float = 1.0,
        names: Sequence[str] | None = None,
        origin: Sequence[float] | FloatArray = (0.0, 0.0, 0.0),
        rotation: FloatArray | None = None,
    ) -> FieldTable:
        """Read COMSOL's text export (spreadsheet or grid layout), or our own ``.npz``.

        Parameters
        ----------
        path : path
            The suffix ``.npz`` means ours; any other, COMSOL's text.
        current : float, in A
            Current of each coil in the export; the table holds field per ampere.
        names : sequence of str, optional
            Names of the coils; by default the file's.
        origin : array_like, shape (3,), in m
            Position of the file's origin in the world frame.
        rotation : ndarray, shape (3, 3), optional
            Takes the file's vectors to world vectors. Right angles only, so that the mesh stays along the axes.

        Returns
        -------
        FieldTable

        Raises
        ------
        TableError
            With one ``file:line: fault`` for each kind of fault.
        """
        from lookup_tables.files import read_samples

        samples = read_samples(Path(path), current, names, origin, rotation)
        try:
            return cls(*samples)
        except TableError as error:
            raise TableError(f"{Path(path)}: {error}") from error

    def write(self, path: str | os.PathLike[str], layout: str = "spreadsheet") -> None:
        """Write the samples: ``.npz`` with the fit, any other suffix as COMSOL's text at 1 A (mm and mT).

        Parameters
        ----------
        path : path
            Replaced if it exists.
        layout : {"spreadsheet", "grid"}
            Of the text. Numbers keep all their digits.

        Raises
        ------
        TableError
            If the file cannot be written.
        """
        from lookup_tables.files import write_samples

        held = Samples(self.x, self.y, self.z, self.samples, self.names, self.spline.coefficients)
        write_samples(held, Path(path), layout)

    def _compute_residual(self) -> FloatArray:
        """Compute each coil's largest deviation of samples from fit, relative to its largest field."""
        places = [np.linspace(0, len(a) - 1, min(len(a), CHECKED_NODES)) for a in (self.x, self.y, self.z)]
        axes = [a[np.unique(at.astype(int))] for a, at in zip((self.x, self.y, self.z), places, strict=True)]
        picked = [np.searchsorted(full, a) for full, a in zip((self.x, self.y, self.z), axes, strict=True)]
        nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        samples = self.samples[np.ix_(range(self.n_coils), *picked)].reshape(self.n_coils, -1, 3)
        miss = np.linalg.norm(self.field(nodes) - samples, axis=2)
        scale = np.linalg.norm(samples, axis=2).max(axis=1)
        residual = miss.max(axis=1) / np.where(scale > 0, scale, 1.0)
        worst = int(residual.argmax())
        if residual[worst] > MAX_RESIDUAL:
            where = _format_point(nodes[miss[worst].argmax()])
            raise TableError(
                f"The samples of coil {self.names[worst]!r} are not a magnetic field in free space: near {where} they "
                f"are {100 * residual[worst]:.0f} % of the largest field away from every field without curl "
                f"({100 * MAX_RESIDUAL:.0f} % are allowed). Swapped components, a wrong unit or sign of one of them, "
                "or a table that reaches into a winding or a magnet do this."
            )
        return np.asarray(residual)

    def _format_outside(self, point: FloatArray) -> OutsideTableError:
        ranges = [
            f"any {name}" if single else f"{name} {1e3 * low:.6g} to {1e3 * high:.6g}"
            for name, single, low, high in zip("xyz", self._single, *self.bounds, strict=True)
        ]
        return OutsideTableError(
            f"Point {_format_point(point)} is outside the table, which covers {', '.join(ranges)} mm.",
            point=tuple(point.tolist()), low=tuple(self.bounds[0].tolist()), high=tuple(self.bounds[1].tolist()),
        )  # fmt: skip


def _format_point(point: FloatArray) -> str:
    return f"({', '.join(f'{1e3 * v:.6g}' for v in point)}) mm"


def _make_even(axis: Any, name: str) -> FloatArray:
    """Remove the rounding of an axis, or raise an error if it does not ascend in equal steps."""
    samples = np.asarray(axis, dtype=np.float64)
    if samples.ndim != 1 or len(samples) == 0 or not np.isfinite(samples).all():
        raise TableError(f"Axis {name} must be finite numbers of shape (n{name},); got shape {samples.shape}.")
    if len(samples) == 1:
        return samples.copy()
    steps, step = np.diff(samples), (samples[-1] - samples[0]) / (len(samples) - 1)
    if not (step > 0 and np.abs(steps - step).max() <= STEP_TOLERANCE * step):
        at = int(np.abs(steps - np.median(steps)).argmax())
        raise TableError(
            f"Axis {name} must ascend in equal steps; got steps of {1e3 * steps.min():.6g} to {1e3 * steps.max():.6g} "
            f"mm, the odd one after {name} = {1e3 * samples[at]:.6g} mm."
        )
    return np.linspace(samples[0], samples[-1], len(samples))


def _check_samples(field: FloatArray, names: tuple[str, ...], shape: tuple[int, ...]) -> None:
    if not names or any(not isinstance(name, str) or not name.strip() for name in names):
        raise TableError(f"names must be one or more words; got {names!r}.")
    if len(set(names)) < len(names):
        raise TableError(f"names must differ from each other; got {', '.join(names)}.")
    if field.shape != shape:
        raise TableError(f"field must have shape (n_coils, nx, ny, nz, 3), here {shape}; got {field.shape}.")
    if shape[1:4].count(1) > 1:
        raise TableError(f"At most one axis may have a single sample; got {shape[1]} x {shape[2]} x {shape[3]}.")
    if not np.isfinite(field).all():
        c, i, j, k, b = (int(v) for v in np.argwhere(~np.isfinite(field))[0])
        raise TableError(f"field must be finite; B{'xyz'[b]} of coil {names[c]!r} is not at node ({i}, {j}, {k}).")
