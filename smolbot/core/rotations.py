"""Rotations: unit quaternions, scalar first, that take body vectors to world vectors.

Compiled, since a control cycle calls them dozens of times; each for arrays of any layout, read-only or not.
"""

# mypy: disable-error-code="untyped-decorator"
from __future__ import annotations

import math

import numpy as np
from numba import njit, types

from smolbot.core.arrays import FloatArray

_VECTOR, _MATRIX = (types.Array(types.float64, n, "A", readonly=True) for n in (1, 2))
_SMALL_ANGLE = 1e-12  # rad: below it, sin(x) / x is its limit


@njit((types.float64,) * 4, cache=True, error_model="numpy")
def _make_quaternion(w: float, x: float, y: float, z: float) -> FloatArray:
    out = np.empty(4)  # compiles in a fifth of the time of an array made from a list
    out[0], out[1], out[2], out[3] = w, x, y, z
    return out


@njit((_VECTOR,), cache=True, error_model="numpy")
def matrix_from_quaternion(quaternion: FloatArray) -> FloatArray:
    """Compute the rotation matrix of a unit quaternion (Eq. S18).

    Parameters
    ----------
    quaternion : ndarray, shape (4,)
        Scalar first, of unit length.

    Returns
    -------
    ndarray, shape (3, 3)
        Takes body vectors to world vectors.
    """
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    out = np.empty((3, 3))
    out[0, 0], out[0, 1], out[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    out[1, 0], out[1, 1], out[1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    out[2, 0], out[2, 1], out[2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
    return out


@njit((_MATRIX,), cache=True, error_model="numpy")
def quaternion_from_matrix(matrix: FloatArray) -> FloatArray:
    """Compute the unit quaternion of a rotation matrix.

    Parameters
    ----------
    matrix : ndarray, shape (3, 3)

    Returns
    -------
    ndarray, shape (4,)
        Scalar first; the scalar part is not negative.
    """
    m = matrix
    xx, yy, zz = m[0, 0], m[1, 1], m[2, 2]
    # the largest component from a square root, the others by division by it: no loss of digits
    if xx + yy + zz >= max(xx, yy, zz):
        w, x, y, z = 1.0 + xx + yy + zz, m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    elif xx >= max(yy, zz):
        w, x, y, z = m[2, 1] - m[1, 2], 1.0 + xx - yy - zz, m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]
    elif yy >= zz:
        w, x, y, z = m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], 1.0 - xx + yy - zz, m[1, 2] + m[2, 1]
    else:
        w, x, y, z = m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], 1.0 - xx - yy + zz
    size = math.copysign(math.sqrt(w * w + x * x + y * y + z * z), 1.0 if w >= 0.0 else -1.0)
    return _make_quaternion(w / size, x / size, y / size, z / size)


@njit((_VECTOR, _VECTOR), cache=True, error_model="numpy")
def multiply_quaternions(a: FloatArray, b: FloatArray) -> FloatArray:
    """Multiply two quaternions (Hamilton product): the rotation `b` followed by the rotation `a`.

    Parameters
    ----------
    a, b : ndarray, shape (4,)

    Returns
    -------
    ndarray, shape (4,)
    """
    aw, ax, ay, az = a[0], a[1], a[2], a[3]
    bw, bx, by, bz = b[0], b[1], b[2], b[3]
    return _make_quaternion(
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


@njit((_VECTOR,), cache=True, error_model="numpy")
def quaternion_from_rotation_vector(vector: FloatArray) -> FloatArray:
    """Compute the unit quaternion exp(e) of a rotation vector e.

    Parameters
    ----------
    vector : ndarray, shape (3,), in rad

    Returns
    -------
    ndarray, shape (4,)
    """
    angle = np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    half = 0.5 * angle
    scale = 0.5 if angle < _SMALL_ANGLE else np.sin(half) / angle
    return _make_quaternion(np.cos(half), scale * vector[0], scale * vector[1], scale * vector[2])


@njit((_VECTOR,), cache=True, error_model="numpy")
def rotation_vector_from_quaternion(quaternion: FloatArray) -> FloatArray:
    """Compute the rotation vector of a unit quaternion.

    Parameters
    ----------
    quaternion : ndarray, shape (4,)

    Returns
    -------
    ndarray, shape (3,), in rad
        Of length pi at most.
    """
    sine = np.sqrt(quaternion[1] ** 2 + quaternion[2] ** 2 + quaternion[3] ** 2)
    scale = 2.0 if sine < _SMALL_ANGLE else 2.0 * np.arctan2(sine, abs(quaternion[0])) / sine
    out = np.empty(3)
    for i in range(3):
        out[i] = -scale * quaternion[1 + i] if quaternion[0] < 0.0 else scale * quaternion[1 + i]
    return out


@njit((_VECTOR, _VECTOR), cache=True, error_model="numpy")
def compute_rotation_error(estimate: FloatArray, truth: FloatArray) -> FloatArray:
    """Compute the rotation error e in the world frame, with R_estimate = exp(e) R_true.

    Parameters
    ----------
    estimate, truth : ndarray, shape (4,)
        Unit quaternions, body to world.

    Returns
    -------
    ndarray, shape (3,), in rad, world frame
    """
    return rotation_vector_from_quaternion(
        multiply_quaternions(estimate, _make_quaternion(truth[0], -truth[1], -truth[2], -truth[3]))
    )


def flip_orientation(quaternion: FloatArray) -> FloatArray:
    """Turn an orientation by 180° about body z.

    With a moment along body z, both orientations give the same signal at the sensors.

    Parameters
    ----------
    quaternion : ndarray, shape (4,)

    Returns
    -------
    ndarray, shape (4,)
    """
    w, x, y, z = quaternion
    return np.array([-z, y, -x, w])


def choose_nearer_orientation(quaternion: FloatArray, reference: FloatArray | None) -> FloatArray:
    """Choose between an orientation and the one turned by 180° about body z: the one nearer to a reference.

    Parameters
    ----------
    quaternion : ndarray, shape (4,)
    reference : ndarray, shape (4,), or None
        The reference; None keeps `quaternion`.

    Returns
    -------
    ndarray, shape (4,)
    """
    if reference is None:
        return quaternion
    flipped = flip_orientation(quaternion)
    return flipped if abs(flipped @ reference) > abs(quaternion @ reference) else quaternion


def quaternion_from_axes(first: FloatArray, second: FloatArray, order: str) -> FloatArray:
    """Compute the orientation whose body axes point along two world directions.

    Parameters
    ----------
    first, second : ndarray, shape (3,)
        World directions; `second` is made orthogonal to `first`.
    order : str
        Two of ``x``, ``y``, ``z``: the body axes that the directions belong to, for instance ``"zx"``.

    Returns
    -------
    ndarray, shape (4,)
        Unit quaternion, body to world.
    """
    index = ["xyz".index(letter) for letter in order]
    matrix = np.zeros((3, 3))
    matrix[:, index[0]] = first / np.linalg.norm(first)
    rest = second - (second @ matrix[:, index[0]]) * matrix[:, index[0]]
    matrix[:, index[1]] = rest / np.linalg.norm(rest)
    third = 3 - index[0] - index[1]
    sign = 1.0 if (index[1] - index[0]) % 3 == 1 else -1.0
    matrix[:, third] = sign * np.cross(matrix[:, index[0]], matrix[:, index[1]])
    return quaternion_from_matrix(matrix)


def compute_mean_rotation(quaternions: FloatArray) -> FloatArray:
    """Compute the mean rotation: the one with the least mean square distance to all.

    Parameters
    ----------
    quaternions : ndarray, shape (n, 4)

    Returns
    -------
    ndarray, shape (4,)
    """
    from scipy.spatial.transform import Rotation

    mean = Rotation.from_quat(quaternions, scalar_first=True).mean()
    return np.asarray(mean.as_quat(canonical=True, scalar_first=True))
