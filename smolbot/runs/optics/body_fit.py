"""Fit the outline of a body of known size to a picture: centre and heading to subpixel accuracy.

The body is a level box. Its visible outline is the convex hull of its eight projected corners, so that its sides
are included as a camera sees them. Along the hull's normals the steepest edge from body to background is searched;
Gauss-Newton then moves and turns the body until these edges lie on the hull.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from smolbot.core.arrays import BoolArray, FloatArray
from smolbot.runs.optics.view import View

SEARCH_DISTANCES = (0.9e-3, 0.9e-3, 0.6e-3, 0.6e-3, *[0.4e-3] * 8)
"""How far from the hull a step is sought, in m, pass by pass; the last ones until the body no longer moves."""

PARAMETER_SCALE = np.array([1e-3, 1e-3, 1.0])  # of a change in x, y (m) and heading (rad)
CONVERGED = (2e-6, 2e-4)  # m and rad

MAX_EDGE_DISTANCE = 0.2e-3  # m: a brightness step this near to the hull supports the fit
MIN_SHARPNESS = 0.08  # of the body's contrast, in a pixel: what ends more softly is a shadow
EDGE_SPAN = 4  # samples on either side that a step is made out from
SAMPLE_STEP = 0.5  # pixels between two samples of a profile
RIM_INSET = 0.3  # of the half sides: the rim whose colour counts as the body's
COLOR_NOISE = 3.0  # grey levels: noise of a colour, and what a codec makes of it
LIGHT_VARIATION = 0.1  # share of the light
CORNER_SHARE = 0.1  # of an edge, at each end, that is left out: printed corners are round


@dataclass(frozen=True, eq=False)
class Body:
    """The body to be found.

    Attributes
    ----------
    half : ndarray, shape (3,), in m
        Half its length ahead (body z), sideways (x) and upwards.
    center : ndarray, shape (2,), in m
        Its middle relative to the cantilever's rotation centre: ahead, and to the left.
    mark : float
        Position of the dark mark: +1 towards the head, -1 towards the tail, 0 without one.
    """

    half: FloatArray
    center: FloatArray
    mark: float


@dataclass(frozen=True)
class OutlineFit:
    """Fitted position and heading of a body, and the quality of the fit.

    Attributes
    ----------
    x, y : float, in m
        Middle of the body, in the world frame.
    heading : float, in rad
    share : float
        Fraction of the outline near which an edge was found.
    rms : float, in m
        Distance of these edges from the outline.
    sigma : float, in m
        Standard deviation of the middle.
    sharpness : float, in 1/pixel
        Steepness of these edges as a fraction of the body's contrast.
    """

    x: float
    y: float
    heading: float
    share: float
    rms: float
    sigma: float
    sharpness: float


def compute_hull(view: View, body: Body, x: float, y: float, heading: float, height: float) -> FloatArray:
    """Compute the corners, in order, of the silhouette of a level body.

    Parameters
    ----------
    view : View
    body : Body
    x, y : float, in m
        Middle of the body, in the world frame.
    heading : float, in rad
    height : float, in m
        z of the body's middle.

    Returns
    -------
    ndarray, shape (k, 2), in pixels
    """
    import cv2

    corners = view.project(_compute_corners(body, x, y, heading, height))
    return np.asarray(cv2.convexHull(corners.astype(np.float32))).reshape(-1, 2).astype(np.float64)


def fit_outline(
    signal: FloatArray, offset: tuple[int, int], view: View, body: Body, start: tuple[float, float, float],
    height: float, light: FloatArray,
) -> OutlineFit | None:  # fmt: skip
    """Fit the body to a patch of the picture.

    Parameters
    ----------
    signal : ndarray, shape (rows, columns, 3)
        Picture minus background.
    offset : tuple of int
        Pixel (u, v) of the first element of `signal`.
    view : View
    body : Body
    start : tuple of float
        Middle x, y (m) and heading (rad) to start from, within half a length and about 25 degrees of the solution.
    height : float, in m
        z of the body's middle.
    light : ndarray, shape (3,)
        Local colour of the background.

    Returns
    -------
    Fit or None
        None if there is no such outline near the start.
    """
    x, y, heading = start
    per_metre = view.compute_scale(np.array([x, y, height]))
    share, rms, sigma, sharpness = 0.0, math.inf, math.inf, 0.0
    for reach in SEARCH_DISTANCES:
        corners = compute_hull(view, body, x, y, heading, height)
        points, normals = _sample_hull(corners)
        tone = _measure_rim_color(signal, offset, view, body, (x, y, heading), height)
        if tone is None or np.dot(compute_color_weights(tone, light), tone) <= 0:
            return None
        found, at, steep = _find_edges(
            signal @ compute_color_weights(tone, light), offset, points, normals, reach * per_metre
        )
        if np.count_nonzero(found) < 0.25 * len(points):
            return None
        # how a point of the outline moves, in pixels, with x, y (m) and heading (rad)
        places = view.project_to_plane(points, height)
        jacobian = _compute_jacobian(view, np.array([x, y, height]))
        arm = np.column_stack([-(places[:, 1] - y), places[:, 0] - x])
        slopes = np.column_stack([normals @ jacobian, np.sum((arm @ jacobian.T) * normals, axis=1)])
        change, residuals = _solve_robustly(slopes[found], at[found], MAX_EDGE_DISTANCE * per_metre / 2)
        x, y, heading = x + change[0], y + change[1], heading + change[2]
        settled = max(abs(change[0]), abs(change[1])) < CONVERGED[0] and abs(change[2]) < CONVERGED[1]
        close = np.abs(residuals) < MAX_EDGE_DISTANCE * per_metre
        share = float(np.count_nonzero(close)) / len(points)
        if np.count_nonzero(close) < 8:
            return None
        sharpness = float(np.median(steep[found][close]))
        rms = float(np.sqrt(np.mean(residuals[close] ** 2))) / per_metre
        borne = slopes[found][close] * PARAMETER_SCALE
        squares = borne.T @ borne
        if np.linalg.cond(squares) > 1e6:  # edges of one direction alone
            return None
        spread = np.linalg.inv(squares) * np.outer(PARAMETER_SCALE, PARAMETER_SCALE)
        sigma = math.sqrt(0.5 * (spread[0, 0] + spread[1, 1])) * rms * per_metre
        if settled and reach == SEARCH_DISTANCES[-1]:
            break
    return OutlineFit(float(x), float(y), _wrap_angle(float(heading)), share, rms, sigma, sharpness)


def compute_color_weights(body_color: FloatArray, background_color: FloatArray) -> FloatArray:
    """Compute the weights of the colours that detect a body best against the usual disturbances.

    The disturbances are noise, `COLOR_NOISE` in each colour, and a relative change `LIGHT_VARIATION` of the
    background's brightness: shadows, a meniscus, the reflection of a lamp. Both colour and brightness are used, each
    as far as it separates body and disturbances.

    Parameters
    ----------
    body_color : ndarray, shape (3,)
        Colour of the body minus that of the background.
    background_color : ndarray, shape (3,)
        Colour of the background.

    Returns
    -------
    ndarray, shape (3,)
        Their product with `body_color` is 1.
    """
    weights = _whiten_colors(body_color, background_color)
    return np.asarray(weights / np.dot(weights, body_color))


def compute_color_distance(difference: FloatArray, background: FloatArray) -> FloatArray:
    """Compute how far colours differ from the background, in standard deviations of the disturbances of `telling`.

    Parameters
    ----------
    difference : ndarray, shape (..., 3)
        Colours minus those of the background.
    background : ndarray, shape (..., 3)

    Returns
    -------
    ndarray, shape (...)
    """
    squares = np.sum(difference * _whiten_colors(difference, background), axis=-1)
    return np.asarray(np.sqrt(np.maximum(squares, 0.0)))


def _whiten_colors(difference: FloatArray, light: FloatArray) -> FloatArray:
    """Multiply `difference` with the inverse covariance of the disturbances."""
    along = np.sum(difference * light, axis=-1, keepdims=True)
    uneven = LIGHT_VARIATION**2 / (COLOR_NOISE**2 + LIGHT_VARIATION**2 * np.sum(light * light, axis=-1, keepdims=True))
    return np.asarray((difference - uneven * along * light) / COLOR_NOISE**2)


def compute_mark_position(
    grey: FloatArray, offset: tuple[int, int], view: View, body: Body, fit: OutlineFit, height: float
) -> float:
    """Compute how far ahead of the middle the dark part of the body lies.

    Parameters
    ----------
    grey : ndarray, shape (rows, columns)
        The picture itself, not its difference from the background.
    offset : tuple of int
        Pixel (u, v) of the first element of `grey`.
    view : View
    body : Body
    fit : OutlineFit
    height : float, in m
        z of the body's middle.

    Returns
    -------
    float, in half lengths
        0 if nothing is dark.
    """
    ahead, left = np.meshgrid(np.linspace(-0.8, 0.8, 25), np.linspace(-0.7, 0.7, 17))
    values = _sample_image(grey, offset, _compute_inner_pixels(view, body, fit, height, ahead.ravel(), left.ravel()))
    dark = np.maximum(float(np.median(values)) - values - 8.0, 0.0)
    total = float(dark.sum())
    return float(dark @ ahead.ravel()) / total if total > 0 else 0.0


def _compute_corners(body: Body, x: float, y: float, heading: float, height: float) -> FloatArray:
    c, s = math.cos(heading), math.sin(heading)
    signs = np.array([[a, b, d] for a in (-1, 1) for b in (-1, 1) for d in (-1, 1)])
    ahead, aside, up = (signs * body.half).T
    return np.column_stack([x + c * ahead - s * aside, y + s * ahead + c * aside, height + up])


def _sample_hull(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sample points (n, 2) along the hull's edges, about 1.5 pixels apart, with outward normals (n, 2)."""
    middle = corners.mean(axis=0)
    longest = float(np.max(np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)))
    points, normals = [], []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        length = float(np.linalg.norm(b - a))
        if length < 0.2 * longest:  # the chamfer between two faces, as long as the body is high
            continue
        n = max(int(length * (1 - 2 * CORNER_SHARE) / 1.5), 4)
        t = np.linspace(CORNER_SHARE, 1.0 - CORNER_SHARE, n)[:, None]
        normal = np.array([b[1] - a[1], a[0] - b[0]]) / length
        normal *= np.sign((a - middle) @ normal)
        points.append(a + t * (b - a))
        normals.append(np.broadcast_to(normal, (n, 2)))
    return np.vstack(points), np.vstack(normals)


def _compute_inner_pixels(
    view: View, body: Body, pose: Any, height: float, ahead: FloatArray, aside: FloatArray
) -> FloatArray:
    """Compute pixels (n, 2) of points in the body, given in half lengths ahead and half widths to the left."""
    x, y, heading = (pose.x, pose.y, pose.heading) if isinstance(pose, OutlineFit) else pose
    c, s = math.cos(heading), math.sin(heading)
    a, b = ahead * body.half[0], aside * body.half[1]
    return view.project(np.column_stack([x + c * a - s * b, y + s * a + c * b, np.full(len(a), height)]))


def _measure_rim_color(
    signal: FloatArray, offset: tuple[int, int], view: View, body: Body, pose: tuple[float, float, float], height: float
) -> FloatArray | None:
    """Compute the colour (3,) of the body's rim minus the background; None if they do not differ."""
    t = np.linspace(-1.0 + RIM_INSET, 1.0 - RIM_INSET, 15)
    edge = np.full(15, 1.0 - RIM_INSET)
    ahead, aside = np.concatenate([t, t, edge, -edge]), np.concatenate([edge, -edge, t, t])
    values = np.column_stack(
        [
            _sample_image(signal[:, :, c], offset, _compute_inner_pixels(view, body, pose, height, ahead, aside))
            for c in range(3)
        ]
    )
    tone = np.median(values, axis=0)
    return None if float(np.linalg.norm(tone)) < 3.0 else tone


def _find_edges(
    value_at: FloatArray, offset: tuple[int, int], points: FloatArray, normals: FloatArray, reach: float
) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Find the edge of the body along each normal: found or not, position in pixels, steepness.

    `value_at` (rows, columns) is 1 on the body's rim and 0 on the background.
    """
    s = np.arange(-reach, reach + 0.5 * SAMPLE_STEP, SAMPLE_STEP)
    at = points[:, None] + s[None, :, None] * normals[:, None]
    value = _sample_image(value_at, offset, at.reshape(-1, 2)).reshape(at.shape[:2])
    # the mean over two pixels within less that over two without: blocks and noise of a codec are as steep as an edge
    sums = np.cumsum(np.pad(value, ((0, 0), (1, 0))), axis=1)
    span = sums[:, EDGE_SPAN:] - sums[:, :-EDGE_SPAN]
    fall = (span[:, :-EDGE_SPAN] - span[:, EDGE_SPAN:]) / EDGE_SPAN**2
    middles = s[EDGE_SPAN - 1 : len(s) - EDGE_SPAN] + 0.5 * SAMPLE_STEP
    weighed = fall * np.exp(-0.5 * (middles / (0.6 * reach)) ** 2)
    best = np.argmax(weighed, axis=1)
    peak = np.take_along_axis(fall, best[:, None], axis=1)[:, 0]
    near = np.abs(middles[None, :] - middles[best][:, None]) <= 2.5
    rise = np.where(near, np.maximum(fall - 0.5 * peak[:, None], 0.0), 0.0)
    place = rise @ middles / np.maximum(rise.sum(axis=1), 1e-9)
    steep = peak / SAMPLE_STEP
    found = (steep > MIN_SHARPNESS) & (best > 0) & (best < len(middles) - 1)
    return found, place, steep


def _solve_robustly(slopes: FloatArray, target: FloatArray, width: float) -> tuple[FloatArray, FloatArray]:
    """Solve ``slopes @ change = wanted`` with biweights; return the change and the residuals."""
    weights = np.ones(len(target))
    change = np.zeros(3)
    for _ in range(6):
        a = slopes * PARAMETER_SCALE * weights[:, None]
        change = PARAMETER_SCALE * np.linalg.lstsq(a, weights * target, rcond=None)[0]
        residuals = target - slopes @ change
        spread = max(1.5 * float(np.median(np.abs(residuals))), 0.3, 0.3 * width)
        weights = np.maximum(1.0 - (residuals / (4.7 * spread)) ** 2, 0.0)
    return change, target - slopes @ change


def _compute_jacobian(view: View, point: FloatArray) -> FloatArray:
    """Compute the derivative (2, 2) of pixels with respect to level steps (m) at a world point."""
    step = 1e-4
    moved = view.project(point + np.array([[0, 0, 0], [step, 0, 0], [0, step, 0]]))
    return np.asarray(((moved[1:] - moved[0]) / step).T)


def _sample_image(image: FloatArray, offset: tuple[int, int], pixels: FloatArray) -> FloatArray:
    """Interpolate an image linearly at pixels (n, 2); beyond its border the border's values count."""
    u = np.clip(pixels[:, 0] - offset[0], 0.0, image.shape[1] - 1.001)
    v = np.clip(pixels[:, 1] - offset[1], 0.0, image.shape[0] - 1.001)
    i, j = v.astype(int), u.astype(int)
    a, b = u - j, v - i
    return np.asarray(
        (1 - b) * ((1 - a) * image[i, j] + a * image[i, j + 1])
        + b * ((1 - a) * image[i + 1, j] + a * image[i + 1, j + 1])
    )


def _wrap_angle(angle: float) -> float:
    return math.remainder(angle, 2.0 * math.pi)
