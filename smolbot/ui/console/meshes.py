"""Triangles of what stands on a rig: hollow coils, round and square. In mm, in the world frame."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from smolbot.core.arrays import FloatArray

IntArray = npt.NDArray[np.int64]

AROUND = 48
"""Corners of a circle."""


def turned(axis: FloatArray) -> FloatArray:
    """Rotation (3, 3) whose third column is along `axis` (3,); the first lies level."""
    ahead = axis / np.linalg.norm(axis)
    level = np.array([-ahead[1], ahead[0], 0.0])
    level = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(level) < 1e-9 else level / np.linalg.norm(level)
    return np.column_stack([level, np.cross(ahead, level), ahead])


def tube(inner: FloatArray, outer: FloatArray, length: float) -> tuple[FloatArray, IntArray]:
    """What lies between two closed outlines (n, 2), `length` long about the origin along z: vertices and faces.

    Examples
    --------
    >>> vertices, faces = tube(circle(1.0), circle(2.0), 3.0)
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


def circle(radius: float) -> FloatArray:
    """Corners (n, 2) of a circle."""
    angle = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def rectangle(width: float, height: float) -> FloatArray:
    """Corners (4, 2) of a rectangle about the origin."""
    return 0.5 * np.array([[width, height], [-width, height], [-width, -height], [width, -height]])


def placed(vertices: FloatArray, center: FloatArray, axis: FloatArray) -> FloatArray:
    """Vertices (n, 3) with their z along `axis` and their origin at `center`."""
    return vertices @ turned(np.asarray(axis, dtype=float)).T + np.asarray(center)


def ribbon(points: FloatArray, half: float) -> tuple[FloatArray, IntArray]:
    """A level band along `points` (n, 3), `half` to each side: vertices and faces."""
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
