"""Meshes of the parts of a rig, such as hollow coils. In mm, in the world frame."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from smolbot.core.arrays import FloatArray

IntArray = npt.NDArray[np.int64]

CIRCLE_POINTS = 48
"""Number of corners of a circle."""


def make_rotation(axis: FloatArray) -> FloatArray:
    """Compute a rotation whose third column is along an axis; its first column is horizontal.

    Parameters
    ----------
    axis : ndarray, shape (3,)

    Returns
    -------
    ndarray, shape (3, 3)
    """
    ahead = axis / np.linalg.norm(axis)
    level = np.array([-ahead[1], ahead[0], 0.0])
    level = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(level) < 1e-9 else level / np.linalg.norm(level)
    return np.column_stack([level, np.cross(ahead, level), ahead])


def make_tube(inner: FloatArray, outer: FloatArray, length: float) -> tuple[FloatArray, IntArray]:
    """Build the mesh between two closed outlines, extruded along z and centered at the origin.

    Parameters
    ----------
    inner : ndarray, shape (n, 2), in mm
    outer : ndarray, shape (n, 2), in mm
    length : float, in mm

    Returns
    -------
    vertices : ndarray, shape (4 n, 3), in mm
    faces : ndarray of int, shape (8 n, 3)

    Examples
    --------
    >>> vertices, faces = make_tube(make_circle(1.0), make_circle(2.0), 3.0)
    >>> vertices.shape, faces.shape
    ((192, 3), (384, 3))
    """
    n, half = len(inner), 0.5 * length
    rings = [(outer, -half), (outer, half), (inner, half), (inner, -half)]
    vertices = np.vstack([np.column_stack([ring, np.full(n, z)]) for ring, z in rings])
    here, after = np.arange(n), (np.arange(n) + 1) % n
    faces = []
    for ring in range(4):
        a, b = ring * n, (ring + 1) % 4 * n
        faces += [np.column_stack([a + here, a + after, b + after]), np.column_stack([a + here, b + after, b + here])]
    return vertices, np.vstack(faces)


def make_circle(radius: float) -> FloatArray:
    """Build the outline of a circle about the origin.

    Parameters
    ----------
    radius : float, in mm

    Returns
    -------
    ndarray, shape (AROUND, 2), in mm
    """
    angle = np.linspace(0.0, 2.0 * np.pi, CIRCLE_POINTS, endpoint=False)
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def make_rectangle(width: float, height: float) -> FloatArray:
    """Build the outline of a rectangle about the origin.

    Parameters
    ----------
    width : float, in mm
    height : float, in mm

    Returns
    -------
    ndarray, shape (4, 2), in mm
    """
    return 0.5 * np.array([[width, height], [-width, height], [-width, -height], [width, -height]])


def place_vertices(vertices: FloatArray, center: FloatArray, axis: FloatArray) -> FloatArray:
    """Rotate vertices so that z is along an axis, and shift their origin.

    Parameters
    ----------
    vertices : ndarray, shape (n, 3), in mm
    center : ndarray, shape (3,), in mm
    axis : ndarray, shape (3,)

    Returns
    -------
    ndarray, shape (n, 3), in mm
    """
    return vertices @ make_rotation(np.asarray(axis, dtype=float)).T + np.asarray(center)


def make_ribbon(points: FloatArray, half: float) -> tuple[FloatArray, IntArray]:
    """Build the mesh of a horizontal band along a line.

    Parameters
    ----------
    points : ndarray, shape (n, 3), in mm
    half : float, in mm
        Half width.

    Returns
    -------
    vertices : ndarray, shape (2 n, 3), in mm
    faces : ndarray of int, shape (2 n - 2, 3)
    """
    steps = np.gradient(points[:, :2], axis=0)
    aside = np.column_stack([-steps[:, 1], steps[:, 0]])
    aside /= np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-12)
    left, right = points.copy(), points.copy()
    left[:, :2] += half * aside
    right[:, :2] -= half * aside
    n = len(points)
    here = np.arange(n - 1)
    return np.vstack([left, right]), np.vstack(
        [np.column_stack([here, here + 1, n + here + 1]), np.column_stack([here, n + here + 1, n + here])]
    )
