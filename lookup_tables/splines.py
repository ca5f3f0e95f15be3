"""Compiled evaluation of quintic splines of the scalar potential: field and gradient in one pass.

The potential phi of coil c, for a current of 1 A, is a sum of products of quintic B-splines on equally spaced
knots,

    phi_c(x, y, z) = sum_ijk a[i, j, k, c] N_i(u) N_j(v) N_k(w),   (u, v, w) = (point - origin) / spacing,

so that B = -grad phi is free of curl and its gradient symmetric, for any coefficients. Kernels that call each
other share this file, since numba's cache does not notice a change in another one.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
DEGREE = 5
"""Of the splines of the potential: its second derivatives, the field's gradient, are smooth."""
_Function = TypeVar("_Function", bound=Callable[..., Any])


def compile_kernel(function: _Function) -> _Function:
    """Compile with numba's cache; without it, and with a warning, where no folder for it can be written.

    Parameters
    ----------
    function : callable

    Returns
    -------
    callable
    """
    try:
        return cast(_Function, numba.njit(cache=True, error_model="numpy", nogil=True)(function))
    except RuntimeError:  # numba found no folder that it may write
        message = f"{__name__} is compiled again in every process; set NUMBA_CACHE_DIR to a folder for its cache."
        warnings.warn(message, RuntimeWarning, stacklevel=1)
        return cast(_Function, numba.njit(error_model="numpy", nogil=True)(function))


@compile_kernel
def compute_basis(u: float, cells: int, weights: FloatArray) -> int:
    """Compute the six B-splines at a point, and their derivatives, by the recursion for equally spaced knots.

        N^k_j(t) = ((t + k - j) N^(k-1)_(j-1)(t) + (1 - t + j) N^(k-1)_j(t)) / k

    Parameters
    ----------
    u : float, in cells
        Coordinate on the axis; the samples are at 0, 1, ..., `cells`. Beyond the ends the end cell's polynomial is
        extrapolated.
    cells : int
        Number of cells of the axis.
    weights : ndarray, shape (3, 6)
        Filled with the values, first and second derivatives with respect to `u`.

    Returns
    -------
    int
        Index of the first of the six coefficients.
    """
    cell = min(max(int(np.floor(u)), 0), cells - 1)
    t = u - cell
    n = np.zeros(DEGREE + 1)
    n[0] = 1.0
    for k in range(1, DEGREE + 1):
        if k == DEGREE - 1:  # n holds degree 3
            for j in range(DEGREE + 1):
                value = n[j] if j < k else 0.0
                value -= 2.0 * n[j - 1] if 1 <= j <= k else 0.0
                value += n[j - 2] if 2 <= j <= k + 1 else 0.0
                weights[2, j] = value
        if k == DEGREE:  # n holds degree 4
            for j in range(DEGREE + 1):
                weights[1, j] = (n[j - 1] if j >= 1 else 0.0) - (n[j] if j < k else 0.0)
        for j in range(k, 0, -1):
            n[j] = ((t + k - j) * n[j - 1] + (1.0 - t + j) * n[j]) / k
        n[0] *= (1.0 - t) / k
    for j in range(DEGREE + 1):
        weights[0, j] = n[j]
    return cell


@compile_kernel
def _evaluate(
    coefficients: FloatArray,
    origin: FloatArray,
    spacing: FloatArray,
    point: FloatArray,
    field: FloatArray,
    gradient: FloatArray,
) -> None:
    n_coils = coefficients.shape[3]
    wx, wy, wz = np.empty((3, DEGREE + 1)), np.empty((3, DEGREE + 1)), np.empty((3, DEGREE + 1))
    i0 = compute_basis((point[0] - origin[0]) / spacing[0], coefficients.shape[0] - DEGREE, wx)
    j0 = compute_basis((point[1] - origin[1]) / spacing[1], coefficients.shape[1] - DEGREE, wy)
    k0 = compute_basis((point[2] - origin[2]) / spacing[2], coefficients.shape[2] - DEGREE, wz)
    hx, hy, hz = spacing[0], spacing[1], spacing[2]
    for c in range(n_coils):
        # derivatives of the potential per cell; rows 0, 1, 2 of the weights are value, slope, curvature
        px = py = pz = pxx = pyy = pzz = pxy = pxz = pyz = 0.0
        for i in range(DEGREE + 1):
            q = qy = qz = qyy = qyz = qzz = 0.0
            for j in range(DEGREE + 1):
                r = rz = rzz = 0.0
                for k in range(DEGREE + 1):
                    a = coefficients[i0 + i, j0 + j, k0 + k, c]
                    r += wz[0, k] * a
                    rz += wz[1, k] * a
                    rzz += wz[2, k] * a
                q += wy[0, j] * r
                qy += wy[1, j] * r
                qyy += wy[2, j] * r
                qz += wy[0, j] * rz
                qyz += wy[1, j] * rz
                qzz += wy[0, j] * rzz
            px += wx[1, i] * q
            pxx += wx[2, i] * q
            py += wx[0, i] * qy
            pxy += wx[1, i] * qy
            pyy += wx[0, i] * qyy
            pz += wx[0, i] * qz
            pxz += wx[1, i] * qz
            pyz += wx[0, i] * qyz
            pzz += wx[0, i] * qzz
        # B = -grad(potential), in T per A and T/(m A)
        field[c, 0], field[c, 1], field[c, 2] = -px / hx, -py / hy, -pz / hz
        gradient[c, 0, 0], gradient[c, 1, 1], gradient[c, 2, 2] = -pxx / hx**2, -pyy / hy**2, -pzz / hz**2
        gradient[c, 0, 1] = gradient[c, 1, 0] = -pxy / (hx * hy)
        gradient[c, 0, 2] = gradient[c, 2, 0] = -pxz / (hx * hz)
        gradient[c, 1, 2] = gradient[c, 2, 1] = -pyz / (hy * hz)


@compile_kernel
def evaluate_points(
    coefficients: FloatArray,
    origin: FloatArray,
    spacing: FloatArray,
    limits: FloatArray,
    points: FloatArray,
    field: FloatArray,
    gradient: FloatArray,
) -> int:
    """Compute field and gradient at some points.

    Parameters
    ----------
    coefficients : ndarray, shape (nx + 4, ny + 4, nz + 4, n_coils), in T m / A
    origin : ndarray, shape (3,), in m
        First node.
    spacing : ndarray, shape (3,), in m
        Mesh width.
    limits : ndarray, shape (2, 3), in m
        Lowest and highest coordinates inside; a nan is outside.
    points : ndarray, shape (n, 3), in m
    field : ndarray, shape (n_coils, n, 3), in T per A
        Filled.
    gradient : ndarray, shape (n_coils, n, 3, 3), in T per (A m)
        Filled.

    Returns
    -------
    int
        Index of the first point outside, or -1.
    """
    one_field, one_gradient = np.empty((field.shape[0], 3)), np.empty((field.shape[0], 3, 3))
    for n in range(points.shape[0]):
        for i in range(3):
            if not (limits[0, i] <= points[n, i] <= limits[1, i]):
                return n
        _evaluate(coefficients, origin, spacing, points[n], one_field, one_gradient)
        for c in range(field.shape[0]):
            for i in range(3):
                field[c, n, i] = one_field[c, i]
                for j in range(3):
                    gradient[c, n, i, j] = one_gradient[c, i, j]
    return -1
