"""Fit of the scalar potential to field samples: the curl-free field nearest to the spline through them.

phi minimises the integral over the table's volume of |grad phi + B|^2, where B is the quintic spline through the
samples (a polynomial on axes of fewer than six). On a product mesh the normal equations are a sum of Kronecker
products of one-dimensional mass and stiffness matrices, which one generalised eigenproblem per axis makes diagonal
(fast diagonalisation; R. E. Lynch, J. R. Rice, D. H. Thomas, Numer. Math. 6, 185, 1964): exact, and well under a
second for 97 x 97 x 13 samples of four coils. Integrals rather than sums over the samples, because a sawtooth
potential has no slope at the samples and would be free.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lookup_tables.splines import DEGREE, compute_basis

FloatArray = npt.NDArray[np.float64]
PLACES_PER_SPLINE = 8
"""Points per spline at which a polynomial is fitted."""


class _Axis(NamedTuple):
    """Contribution of one axis of n samples to the fit, in cells; ``r`` modes diagonalise mass and stiffness."""

    modes: FloatArray  # (n + 4, r): B-spline coefficients of each mode
    stiffness: FloatArray  # (r,): integral of the squared slope of each mode, its mass being 1
    mass_of_samples: FloatArray  # (r, n): integral of mode times the spline through the samples
    slope_of_samples: FloatArray  # (r, n): integral of the mode's slope times that spline
    curvature_of_modes: FloatArray  # (r, r): integral of mode times the second derivative of another


def fit_potential(spacing: FloatArray, samples: FloatArray) -> FloatArray:
    """Fit the spline coefficients of the potential.

    Parameters
    ----------
    spacing : ndarray, shape (3,), in m
        Mesh width of each axis; any positive number for an axis of one sample.
    samples : ndarray, shape (n_coils, nx, ny, nz, 3), in T/A
        Field at the nodes. At most one axis has one sample.

    Returns
    -------
    ndarray, shape (nx + 4, ny + 4, nz + 4, n_coils), in T m / A
        For `lookup_tables.splines`. For one plane of samples, the potential off the plane is that of a field
        without curl and divergence to second order, so that the whole gradient is known on the plane.
        Linear algebra uses one thread, so that the last bits do not depend on the number of threads.
    """
    import scipy.linalg  # noqa: F401  (a library that is not loaded yet cannot be limited)
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        return _fit(spacing, samples)


def _fit(spacing: FloatArray, samples: FloatArray) -> FloatArray:
    counts = samples.shape[1:4]
    if 1 in counts:
        return _fit_plane(spacing, samples, counts.index(1))
    axes = [_make_axis(n) for n in counts]
    # right side of the normal equations: the samples projected on the gradient of every product of modes
    projected = 0.0
    for i in range(3):
        maps = [a.slope_of_samples if j == i else a.mass_of_samples for j, a in enumerate(axes)]
        projected = projected - _apply(maps, samples[..., i]) / spacing[i]
    return _to_coefficients(axes, _solve(axes, spacing, np.asarray(projected)))


def _fit_plane(spacing: FloatArray, samples: FloatArray, normal: int) -> FloatArray:
    """Fit one plane: phi = phi_0 - s B_n - s^2 / 2 laplace(phi_0), with height s above it and normal field B_n."""
    first, second = (i for i in range(3) if i != normal)
    a, b = _make_axis(samples.shape[1 + first]), _make_axis(samples.shape[1 + second])
    h = spacing[[first, second]]
    plane = np.moveaxis(samples.squeeze(1 + normal), -1, 0)  # (3, n_coils, n_first, n_second)
    projected = _apply([a.slope_of_samples, b.mass_of_samples], plane[first]) / h[0]
    projected = projected + _apply([a.mass_of_samples, b.slope_of_samples], plane[second]) / h[1]
    phi = _solve([a, b], h, -projected)
    # normal derivatives: the first from the samples, the second from the Laplace equation
    laplace = _apply([a.curvature_of_modes, np.eye(len(b.stiffness))], phi) / h[0] ** 2
    laplace = laplace + _apply([np.eye(len(a.stiffness)), b.curvature_of_modes], phi) / h[1] ** 2
    slope = -_apply([a.mass_of_samples, b.mass_of_samples], plane[normal]) * spacing[normal]
    terms = (phi, slope, -0.5 * laplace * spacing[normal] ** 2)
    powers = _fit_polynomials(1, 2)  # (6, 3)
    total = sum(_to_coefficients([a, b], term)[..., None] * powers[:, p] for p, term in enumerate(terms))
    # total is (n_first + 4, n_second + 4, n_coils, normal)
    return np.ascontiguousarray(np.moveaxis(np.moveaxis(np.asarray(total), 3, 2), 2, normal))


def _solve(axes: list[_Axis], spacing: FloatArray, projected: FloatArray) -> FloatArray:
    """Divide by the stiffness of each product of modes; the constant potential, which has none, is set to zero."""
    total = np.zeros(())
    for a, h in zip(axes, spacing, strict=True):
        total = total[..., None] + a.stiffness / h**2
    total[(0,) * len(axes)] = np.inf  # the constant mode has no field: its amplitude is 0
    return np.asarray(projected / total)


def _to_coefficients(axes: list[_Axis], amplitudes: FloatArray) -> FloatArray:
    """Convert amplitudes (n_coils, ...) of products of modes to B-spline coefficients, coils last."""
    return np.ascontiguousarray(np.moveaxis(_apply([a.modes for a in axes], amplitudes), 0, -1))


def _apply(maps: list[FloatArray], values: FloatArray) -> FloatArray:
    """Apply one matrix to each axis of values (n_coils, ...) but the first."""
    for i, matrix in enumerate(maps):
        values = np.moveaxis(np.tensordot(matrix, values, axes=(1, 1 + i)), 0, 1 + i)
    return values


def _make_axis(n: int) -> _Axis:
    from scipy.interpolate import make_interp_spline
    from scipy.linalg import eigh

    # Gauss-Legendre points of every cell, exact for products of two splines
    nodes, weights = np.polynomial.legendre.leggauss(DEGREE + 1)
    places = (np.arange(n - 1)[:, None] + 0.5 * (nodes + 1.0)).ravel()
    weights = np.tile(0.5 * weights, n - 1)
    through = make_interp_spline(np.arange(n), np.eye(n), k=min(DEGREE, n - 1))(places)
    splines = _compute_basis_matrices(places, n - 1)
    # With few samples the field is a polynomial of degree n - 1, so the potential is one of degree n.
    span = np.eye(n + DEGREE - 1) if n > DEGREE else _fit_polynomials(n - 1, min(n, DEGREE))
    value, slope, curvature = (matrix @ span for matrix in splines)
    # modes that diagonalise stiffness (slopes) and mass (values) together
    stiffness, modes = eigh(slope.T @ (weights[:, None] * slope), value.T @ (weights[:, None] * value))
    value, slope, curvature = ((matrix @ modes).T * weights for matrix in (value, slope, curvature))
    unweighted = splines[0] @ span @ modes
    return _Axis(span @ modes, stiffness, value @ through, slope @ through, (curvature @ unweighted).T)


def _fit_polynomials(cells: int, degree: int) -> FloatArray:
    """Fit B-spline coefficients (cells + 5, degree + 1) to the powers 0 to `degree` of the coordinate in cells."""
    places = np.linspace(0.0, cells, PLACES_PER_SPLINE * (cells + DEGREE))
    powers = places[:, None] ** np.arange(degree + 1)
    return np.asarray(np.linalg.lstsq(_compute_basis_matrices(places, cells)[0], powers, rcond=None)[0])


def _compute_basis_matrices(places: FloatArray, cells: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute values, first and second derivatives, each (n_places, cells + 5), of all B-splines."""
    out, weights = np.zeros((3, len(places), cells + DEGREE)), np.empty((3, DEGREE + 1))
    for row, place in enumerate(places):
        first = compute_basis(float(place), cells, weights)
        out[:, row, first : first + DEGREE + 1] = weights
    return out[0], out[1], out[2]
