"""Compiled ray casting, one ray per pixel or part of it; the kernels call each other and so share this file."""

# mypy: disable-error-code="untyped-decorator"
from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from smolbot.core.arrays import FloatArray

Sheet = npt.NDArray[np.float32]
"""Grey levels of what is printed, (rows, columns, 3)."""

UNDISTORT_STEPS = 4
"""Fixed-point steps that invert a distortion of a few tenths of a percent to below 1e-9."""

# Entries of `lens`: place (3), axes (9, row by row), focal length, middle (2), distortion
PLACE, AXES, FOCAL, MIDDLE, BEND = 0, 3, 12, 13, 15
FAR = 1e30  # m: end of a ray
BEYOND = 1e9  # m: end of a ray below the surface, or at a post
LAST_CELL = 1.001  # from the end of a grid: the last point that still lies in a cell
PARALLEL = 1e-12  # part of a ray's direction along an axis below which it is parallel to a face
SIDE_TONE = 0.72  # brightness of a wall's side
GLARE_SIZE, GLARE = 0.05, 22.0  # of the lamp's reflection: share of the picture, grey level
MAGNET_TONE, RESIN_SIDE, BLADE_TONE, RESIN_LOSS = 52.0, 0.78, 0.6, 0.96  # grey of the magnet; factors on other surfaces
# The meniscus: position and width of its bright line (in decay lengths), brightness of its slope and of that line
LINE_AT, LINE_WIDTH, SLOPE_TONE, LINE_TONE = 1.6, 0.25, 0.5, 0.35


@njit(cache=True, error_model="numpy")
def compute_ray(u: float, v: float, lens: FloatArray) -> tuple[float, float, float]:
    """Compute the viewing direction of a pixel.

    Parameters
    ----------
    u, v : float, in pixels
    lens : ndarray, shape (16,)
        See `Camera.lens`.

    Returns
    -------
    tuple of 3
        Unit vector, world frame.
    """
    bx, by = (u - lens[MIDDLE]) / lens[FOCAL], (v - lens[MIDDLE + 1]) / lens[FOCAL]
    x, y = bx, by
    for _ in range(UNDISTORT_STEPS):
        grow = 1.0 + lens[BEND] * (x * x + y * y)
        x, y = bx / grow, by / grow
    dx = x * lens[AXES] + y * lens[AXES + 3] + lens[AXES + 6]
    dy = x * lens[AXES + 1] + y * lens[AXES + 4] + lens[AXES + 7]
    dz = x * lens[AXES + 2] + y * lens[AXES + 5] + lens[AXES + 8]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    return dx / length, dy / length, dz / length


@njit(cache=True, error_model="numpy")
def compute_rays(pixels: FloatArray, lens: FloatArray) -> FloatArray:
    """Compute the viewing directions of pixels.

    Parameters
    ----------
    pixels : ndarray, shape (n, 2)
    lens : ndarray, shape (16,)
        See `Camera.lens`.

    Returns
    -------
    ndarray, shape (n, 3)
        Unit vectors, world frame.
    """
    out = np.empty((len(pixels), 3))
    for i in range(len(pixels)):
        out[i] = compute_ray(pixels[i, 0], pixels[i, 1], lens)
    return out


@njit(cache=True, error_model="numpy")
def refract(dx: float, dy: float, index: float) -> tuple[float, float, float]:
    """Refract a unit ray that enters a liquid from above through its level surface (Snell).

    Parameters
    ----------
    dx, dy : float
        Horizontal components of the ray, world frame.
    index : float
        Refractive index of the liquid.

    Returns
    -------
    tuple of 3
        Unit vector, world frame.
    """
    x, y = dx / index, dy / index
    return x, y, -math.sqrt(1.0 - x * x - y * y)


@njit(cache=True, error_model="numpy")
def intersect_box(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, rotation_box_to_world: FloatArray,
    middle: FloatArray, half: FloatArray, first: float, last: float,
) -> tuple[float, int]:  # fmt: skip
    """Intersect a ray with a rotated box.

    Parameters
    ----------
    px, py, pz : float, in m
        Origin of the ray, world frame.
    dx, dy, dz : float
        Direction of the ray, world frame.
    rotation_box_to_world : ndarray, shape (3, 3)
        Rotation from box to world.
    middle : ndarray, shape (3,), in m
        World frame.
    half : ndarray, shape (3,), in m
        Half sides.
    first, last : float
        Limits of the ray's parameter.

    Returns
    -------
    length : float
        Of the ray inside the box, in units of the direction.
    face : int
        Box axis of the face through which it enters.
    """
    ox, oy, oz = px - middle[0], py - middle[1], pz - middle[2]
    enter, leave, face = -FAR, FAR, 0
    for k in range(3):
        start = rotation_box_to_world[0, k] * ox + rotation_box_to_world[1, k] * oy + rotation_box_to_world[2, k] * oz
        speed = rotation_box_to_world[0, k] * dx + rotation_box_to_world[1, k] * dy + rotation_box_to_world[2, k] * dz
        if abs(speed) < PARALLEL:
            if abs(start) > half[k]:
                return 0.0, 0
            continue
        a, b = (-half[k] - start) / speed, (half[k] - start) / speed
        near, far = min(a, b), max(a, b)
        if near > enter:
            enter, face = near, k
        leave = min(leave, far)
    return max(min(leave, last) - max(enter, first), 0.0), face


@njit(cache=True, error_model="numpy")
def render_empty(
    scale: float, width: int, height: int, lens: FloatArray, box: FloatArray, plate: Sheet, caps: Sheet,
    corner: FloatArray, posts: FloatArray, tones: FloatArray, shading: FloatArray, rays_per_side: int,
) -> FloatArray:  # fmt: skip
    """Render the scene without a robot.

    Parameters
    ----------
    scale : float, in pixels per m
        Of `plate` and `caps`.
    width, height : int, in pixels
        Of the picture.
    lens : ndarray, shape (16,)
        See `Camera.lens`.
    box : ndarray, shape (9,)
        Middle (2) and half sides (2) of the container's inside, floor, surface, top of the wall, its thickness
        (all m), refractive index.
    plate, caps : ndarray, shape (rows, columns, 3)
        What is printed on the floor and on the posts' tops.
    corner : ndarray, shape (2,), in m
        Lower left corner of `plate` and `caps`, world frame.
    posts : ndarray, shape (n, 6), in m
        Middle (3) and half sides (3) of each.
    tones : ndarray, shape (4, 3)
        See `Scene`.
    shading : ndarray, shape (5,)
        See `Scene`.
    rays_per_side : int
        Each pixel is the mean of `rays_per_side`² rays.

    Returns
    -------
    ndarray, shape (height, width, 3)
        Grey levels.
    """
    out = np.empty((height, width, 3))
    cx, cy, hx, hy, floor, surface, top, wall, index = box
    rows, columns = plate.shape[0], plate.shape[1]
    px, py, pz = lens[PLACE], lens[PLACE + 1], lens[PLACE + 2]
    colour = np.empty(3)
    upright = np.eye(3)
    for j in range(height):
        for i in range(width):
            out[j, i] = 0.0
            for part in range(rays_per_side * rays_per_side):
                u = i + (part % rays_per_side + 0.5) / rays_per_side - 0.5
                v = j + (part // rays_per_side + 0.5) / rays_per_side - 0.5
                dx, dy, dz = compute_ray(u, v, lens)
                t = (top - pz) / dz
                ax, ay = abs(px + t * dx - cx), abs(py + t * dy - cy)
                inside = ax < hx and ay < hy
                wet = False
                kind = 0  # plate, wall's top, wall's side
                t = (floor - pz) / dz
                gx, gy = px + t * dx, py + t * dy
                if inside:
                    t = (surface - pz) / dz
                    wx, wy = px + t * dx, py + t * dy
                    wet = abs(wx - cx) < hx and abs(wy - cy) < hy
                    kind = 2
                    if wet:
                        ex, ey, ez = refract(dx, dy, index)
                        gx, gy = wx + (floor - surface) / ez * ex, wy + (floor - surface) / ez * ey
                        kind = 0 if abs(gx - cx) < hx and abs(gy - cy) < hy else 2
                elif ax < hx + wall and ay < hy + wall:
                    kind = 1
                elif abs(gx - cx) < hx + wall and abs(gy - cy) < hy + wall:
                    kind = 2
                if not wet:
                    for n in range(len(posts)):
                        length, face = intersect_box(
                            px, py, pz, dx, dy, dz, upright, posts[n, :3], posts[n, 3:], 0.0, BEYOND
                        )
                        if length > 0:
                            kind = 3 if face == 2 else 2
                            t = (posts[n, 2] + posts[n, 5] - pz) / dz
                            gx, gy = px + t * dx, py + t * dy
                if kind == 0 or kind == 3:
                    sheet = plate if kind == 0 else caps
                    a = min(max((gx - corner[0]) * scale, 0.0), columns - LAST_CELL)
                    b = min(max((gy - corner[1]) * scale, 0.0), rows - LAST_CELL)
                    ia, ib = int(a), int(b)
                    fa, fb = a - ia, b - ib
                    for c in range(3):
                        colour[c] = (1 - fb) * ((1 - fa) * sheet[ib, ia, c] + fa * sheet[ib, ia + 1, c]) + fb * (
                            (1 - fa) * sheet[ib + 1, ia, c] + fa * sheet[ib + 1, ia + 1, c]
                        )
                else:
                    for c in range(3):
                        colour[c] = tones[2, c] * (1.0 if kind == 1 else SIDE_TONE)
                su, sv = u / width - 0.5, v / height - 0.5
                light = 1.0 + shading[0] * su + shading[1] * sv - shading[2] * (su * su + sv * sv)
                glare = math.exp(-((su - shading[3]) ** 2 + (sv - shading[4]) ** 2) / (2 * GLARE_SIZE**2))
                for c in range(3):
                    value = colour[c] * light
                    if wet:
                        value = value * tones[3, c] / 255.0 + GLARE * glare
                    out[j, i, c] += value / (rays_per_side * rays_per_side)
    return out


@njit(cache=True, error_model="numpy")
def render_robot(
    behind: FloatArray, u0: int, v0: int, rays_per_side: int, lens: FloatArray, surface: float, index: float,
    rotation_body_to_world: FloatArray, boxes: FloatArray, resin: FloatArray, clear: float, ring: FloatArray,
    lamp: FloatArray, upright: int,
) -> FloatArray:  # fmt: skip
    """Render a region of the picture with the robot in it.

    Parameters
    ----------
    behind : ndarray, shape (height, width, 3)
        The region without the robot.
    u0, v0 : int, in pixels
        First column and row of the region.
    rays_per_side : int
        Each pixel is the mean of `rays_per_side`² rays.
    lens : ndarray, shape (16,)
        See `Camera.lens`.
    surface : float, in m
        Height of the liquid's surface, world frame.
    index : float
        Refractive index of the liquid.
    rotation_body_to_world : ndarray, shape (3, 3)
        Rotation from body to world.
    boxes : ndarray, shape (3, 2, 3), in m
        Middle (world frame) and half sides of housing, magnet and blade.
    resin : ndarray, shape (3,)
        Colour of thick resin.
    clear : float, in m
        Thickness of resin that transmits 1/e of the light.
    ring : ndarray, shape (3,)
        Strength and width (m) of the meniscus, and asymmetry of its brightness.
    lamp : ndarray, shape (2,)
        Horizontal direction of the light.
    upright : int
        The vertical body axis.

    Returns
    -------
    ndarray, shape (height, width, 3)
        Grey levels.
    """
    height, width = behind.shape[0], behind.shape[1]
    out = np.empty((height, width, 3))
    px, py, pz = lens[PLACE], lens[PLACE + 1], lens[PLACE + 2]
    length, face = np.zeros(3), np.zeros(3, dtype=np.int64)
    brightness = math.sqrt(lamp[0] ** 2 + lamp[1] ** 2)
    for j in range(height):
        for i in range(width):
            out[j, i] = 0.0
            for part in range(rays_per_side * rays_per_side):
                u = u0 + i + (part % rays_per_side + 0.5) / rays_per_side - 0.5
                v = v0 + j + (part // rays_per_side + 0.5) / rays_per_side - 0.5
                dx, dy, dz = compute_ray(u, v, lens)
                down = (surface - pz) / dz
                wx, wy = px + down * dx, py + down * dy
                ex, ey, ez = refract(dx, dy, index)
                for k in range(3):
                    dry, side = intersect_box(
                        px, py, pz, dx, dy, dz, rotation_body_to_world, boxes[k, 0], boxes[k, 1], 0.0, down
                    )
                    under, low = intersect_box(
                        wx, wy, surface, ex, ey, ez, rotation_body_to_world, boxes[k, 0], boxes[k, 1], 0.0, BEYOND
                    )
                    length[k], face[k] = dry + under, side if dry > 0 else low
                # magnet, then resin with the blade in it, then the meniscus around the housing
                if length[1] > 0:
                    for c in range(3):
                        out[j, i, c] += MAGNET_TONE - 2.0 * c
                    continue
                if length[0] > 0:
                    kept = math.exp(-length[0] / clear)
                    tone = 1.0 if face[0] == upright else RESIN_SIDE
                    blade = BLADE_TONE if length[2] > 0 else 1.0
                    for c in range(3):
                        out[j, i, c] += blade * (RESIN_LOSS * kept * behind[j, i, c] + (1.0 - kept) * tone * resin[c])
                    continue
                ox, oy, oz = wx - boxes[0, 0, 0], wy - boxes[0, 0, 1], surface - boxes[0, 0, 2]
                away = 0.0
                for k in range(3):
                    if k != upright:
                        local = (
                            abs(
                                rotation_body_to_world[0, k] * ox
                                + rotation_body_to_world[1, k] * oy
                                + rotation_body_to_world[2, k] * oz
                            )
                            - boxes[0, 1, k]
                        )
                        away += max(local, 0.0) ** 2
                away = math.sqrt(away)
                facing = (ox * lamp[0] + oy * lamp[1]) / (max(math.sqrt(ox * ox + oy * oy), 1e-9) * brightness)
                slope = math.exp(-away / ring[1])
                thin = math.exp(-0.5 * ((away - LINE_AT * ring[1]) / (LINE_WIDTH * ring[1])) ** 2)
                factor = 1.0 + ring[0] * (ring[2] * facing * slope - SLOPE_TONE * slope + LINE_TONE * thin)
                for c in range(3):
                    out[j, i, c] += factor * behind[j, i, c]
            for c in range(3):
                out[j, i, c] /= rays_per_side * rays_per_side
    return out
