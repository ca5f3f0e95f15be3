"""Convert between pixels and world positions with a pinhole camera found from known points."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError

PIXEL_SIGMA = 0.3
"""Pixels, one standard deviation, to which a corner or a click is taken to be known."""

CLICK_SIGMA = 1.0  # pixels: of a click

HEIGHT_SIGMA = 3e-3  # m: of a camera height that was given
CENTER_SIGMA_SHARE = 0.01  # of the picture's shorter side: where the lens' axis may lie off its middle
LOG_FOCAL_SIGMA = math.log(2.0)  # spread of the focal length where nothing tells it, about three times the longer side


@dataclass(frozen=True, eq=False)
class View:
    """A camera found from known points. Lens distortion is ignored.

    Attributes
    ----------
    parameters : ndarray, shape (9,)
        Logarithm of the focal length (pixels), rotation vector, position (m), principal point (pixels).
    covariance : ndarray, shape (9, 9)
        Of `parameters`.
    rms : float, in pixels
        Rms of the residuals of the known points.
    """

    parameters: FloatArray
    covariance: FloatArray
    rms: float

    @property
    def position(self) -> FloatArray:
        """Position (3,) of the camera's entrance pupil in the world frame, in m."""
        return self.parameters[4:7]

    def project(self, points: FloatArray) -> FloatArray:
        """Project world points to pixels.

        Parameters
        ----------
        points : ndarray, shape (n, 3), in m
            In the world frame.

        Returns
        -------
        ndarray, shape (n, 2), in pixels
        """
        return _project(self.parameters, points)

    def project_to_plane(self, pixels: FloatArray, height: float) -> FloatArray:
        """Project pixels back to the plane z = `height`.

        Parameters
        ----------
        pixels : ndarray, shape (n, 2)
        height : float, in m

        Returns
        -------
        ndarray, shape (n, 2), in m
            x and y in the world frame.
        """
        return _project_to_plane(self.parameters, pixels, height)

    def compute_scale(self, point: FloatArray) -> float:
        """Compute the pixels per metre of level lengths at a world point.

        Parameters
        ----------
        point : ndarray, shape (3,), in m

        Returns
        -------
        float, in 1/m
        """
        step = 1e-3
        moved = self.project(point + np.array([[0, 0, 0], [step, 0, 0], [0, step, 0]]))
        return math.sqrt(abs(float(np.linalg.det(moved[1:] - moved[0])))) / step

    def compute_uncertainty(self, pixel: FloatArray, height: float) -> float:
        """Compute the standard deviation of a position on z = `height` from the uncertainty of the camera.

        Parameters
        ----------
        pixel : ndarray, shape (2,)
        height : float, in m

        Returns
        -------
        float, in m
        """
        steps = np.array([1e-6, *[1e-7] * 3, *[1e-7] * 3, 1e-3, 1e-3])
        pixels = np.asarray(pixel, dtype=np.float64)[None]
        jacobian = np.empty((2, 9))
        for i, step in enumerate(steps):
            up, down = self.parameters.copy(), self.parameters.copy()
            up[i] += step
            down[i] -= step
            jacobian[:, i] = (_project_to_plane(up, pixels, height) - _project_to_plane(down, pixels, height))[0] / (
                2 * step
            )
        return math.sqrt(float(np.trace(jacobian @ self.covariance @ jacobian.T)) / 2)


def find_view(
    pixels: FloatArray, points: FloatArray, size: tuple[int, int], camera_height: float | None = None, *,
    pixel_sigma: float = PIXEL_SIGMA, point_sigma: float = 0.0,
) -> View:  # fmt: skip
    """Find the most likely camera for known points and their pixels.

    The plane of the points determines the view of that plane. Points above it appear with parallax, for which the
    camera's position must be known: from its height above z = 0 if that is given, else as far as perspective
    determines it. Pixels are square, the principal point is near the middle of the picture, distortion is ignored.

    Parameters
    ----------
    pixels : ndarray, shape (n, 2)
        Of at least four points.
    points : ndarray, shape (n, 3), in m
        In the world frame.
    size : tuple of int
        Width and height of the picture in pixels.
    camera_height : float, optional, in m
        z of the lens, measured by ruler.
    pixel_sigma : float, in pixels
        Standard deviation of the pixels.
    point_sigma : float, in m
        Standard deviation of the points.

    Returns
    -------
    View

    Raises
    ------
    InputError
        If there are too few points, or they lie on a line.
    """
    from scipy.optimize import least_squares

    pixels, points = np.asarray(pixels, dtype=np.float64), np.asarray(points, dtype=np.float64)
    check_points(pixels, points)
    middle = 0.5 * (np.array(size, dtype=np.float64) - 1.0)
    log_focal = math.log(3.0 * max(size))
    sharp_middle = CENTER_SIGMA_SHARE * min(size)
    per_metre = math.sqrt(float(np.sum((pixels - pixels.mean(axis=0)) ** 2)))
    per_metre /= math.sqrt(float(np.sum((points[:, :2] - points[:, :2].mean(axis=0)) ** 2)))
    unsure = math.hypot(pixel_sigma, point_sigma * per_metre)

    def residuals(p: FloatArray) -> FloatArray:
        out = [((_project(p, points) - pixels) / unsure).ravel(), (p[7:9] - middle) / sharp_middle]
        if camera_height is not None:
            out.append(np.array([(p[6] - camera_height) / HEIGHT_SIGMA]))
        else:
            out.append(np.array([(p[0] - log_focal) / LOG_FOCAL_SIGMA]))
        return np.concatenate(out)

    best = None
    for start in _guess_starts(pixels, points, middle, log_focal, camera_height):
        found = least_squares(residuals, start, x_scale="jac", method="trf", max_nfev=300)
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    information = best.jac.T @ best.jac
    left = _project(best.x, points) - pixels
    rms = float(np.sqrt(np.mean(np.sum(left**2, axis=1))))
    scale = max(1.0, rms / (unsure * math.sqrt(2.0))) ** 2  # points that fit badly are known badly
    return View(best.x, scale * np.linalg.inv(information), rms)


def check_points(pixels: FloatArray, points: FloatArray) -> None:
    """Raise if points do not determine a plane: fewer than four, or on a line.

    Parameters
    ----------
    pixels : ndarray, shape (n, 2)
    points : ndarray, shape (n, 2) or (n, 3)
        Positions of the same points.

    Raises
    ------
    InputError
        With what is wrong.
    """
    if len(pixels) != len(points) or len(pixels) < 4:
        raise InputError(f"Four points or more are needed, each with its place; got {len(pixels)} and {len(points)}.")
    for name, values in (("pixels", pixels), ("places", points[:, :2])):
        if not np.all(np.isfinite(values)):
            raise InputError(f"The {name} of the known points must be finite numbers.")
        triples = (
            [(i, j, k) for i in range(len(values)) for j in range(i) for k in range(j)] if len(values) == 4 else []
        )
        spread = np.linalg.svd(values - values.mean(axis=0), compute_uv=False)
        reach = float(np.ptp(values, axis=0).max())
        on_line = spread[1] < 0.02 * spread[0] or reach <= 0
        for i, j, k in triples:
            (ax, ay), (bx, by) = values[j] - values[i], values[k] - values[i]
            on_line = on_line or abs(ax * by - ay * bx) < 0.01 * reach**2
        if on_line:
            raise InputError(
                f"The {name} of the known points are collinear (three of four on a line, or all); "
                "take the corners of something like a rectangle."
            )


def _guess_starts(
    pixels: FloatArray, points: FloatArray, middle: FloatArray, log_focal: float, camera_height: float | None
) -> list[FloatArray]:
    """List start parameters: upright cameras of some focal lengths, turned as the points are."""
    world = points[:, :2] - points[:, :2].mean(axis=0)
    centered = pixels - pixels.mean(axis=0)
    # seen from above, the picture's y runs against the world's: fit a turned and mirrored copy
    a = np.sum(world[:, 0] * centered[:, 0] - world[:, 1] * centered[:, 1])
    b = np.sum(world[:, 1] * centered[:, 0] + world[:, 0] * centered[:, 1])
    turn = math.atan2(b, a)
    scale = math.hypot(a, b) / float(np.sum(world**2))
    rotation = np.array(
        [[math.cos(turn), math.sin(turn), 0.0], [math.sin(turn), -math.cos(turn), 0.0], [0.0, 0.0, -1.0]]
    )
    ground = float(points[:, 2].mean())
    heights = [camera_height - ground] if camera_height is not None and camera_height > ground else []
    heights += [math.exp(log_focal) * k / scale for k in (1.0, 0.4)]
    out = []
    for height in heights:
        off = (middle - pixels.mean(axis=0)) / scale
        place = np.array([*(points[:, :2].mean(axis=0) + rotation[:2, :2].T @ off), ground + height])
        out.append(np.array([math.log(height * scale), *_as_rotation_vector(rotation), *place, *middle]))
    return out


def _as_rotation_vector(rotation: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_rotvec())


def _as_matrix(vector: FloatArray) -> FloatArray:
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross)


def _project(p: FloatArray, points: FloatArray) -> FloatArray:
    in_camera = (points - p[4:7]) @ _as_matrix(p[1:4]).T
    return np.asarray(math.exp(p[0]) * in_camera[:, :2] / in_camera[:, 2:] + p[7:9])


def _project_to_plane(p: FloatArray, pixels: FloatArray, height: float) -> FloatArray:
    rays = np.column_stack([(pixels - p[7:9]) / math.exp(p[0]), np.ones(len(pixels))]) @ _as_matrix(p[1:4])
    return np.asarray(p[4:6] + (height - p[6]) / rays[:, 2:] * rays[:, :2])
