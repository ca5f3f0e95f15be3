"""Kernels of the robot in the gel: the field of the rotating cube, and the reaction of gel and plates.

They call each other and so share this file (numba's cache does not see a change in another one).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from sim.tank.magnetics.cantilever import INERTIA, L0, MIDDLE, MOMENT, OMEGA_SQUARED, REST_X, REST_Z, THETA_MAX
from smolbot.core.arrays import FloatArray


@njit(cache=True, error_model="numpy")
def _compute_log_sum(u: float, rest: float, radius: float) -> float:
    """ln(u + radius) with radius² = u² + rest, without cancellation for u < 0."""
    return math.log(u + radius) if u > 0 else math.log(rest / (radius - u))


@njit(cache=True, error_model="numpy")
def compute_cuboid_field(
    x: float, y: float, z: float, half: float, remanence: float, b: FloatArray, g: FloatArray
) -> None:
    """Compute field and gradient of a cube magnetised along +z, at a point outside it, in the cube's frame.

    Two charged faces at z = ±a (half the side), integrated in closed form; with X = x ± a, Y = y ± a, Z = z - (±a),
    rho = |(X, Y, Z)| and signs s = ±1 for each:

        Bx = -Br / (4 pi) sum s ln(Y + rho),   By = -Br / (4 pi) sum s ln(X + rho),
        Bz =  Br / (4 pi) sum s atan(XY / (Z rho))

    The gradient is the derivative of these, symmetric and traceless.

    Parameters
    ----------
    x, y, z : float, in m
    half : float, in m
        Half the side.
    remanence : float, in T
    b : ndarray, shape (3,), in T
        Receives the field.
    g : ndarray, shape (3, 3), in T/m
        Receives the gradient, ``g[i, j] = dB_i / dx_j``.
    """
    bx = by = bz = xx = yy = xy = xz = yz = 0.0
    for k in range(2):
        cz = z - half if k == 0 else z + half
        for i in range(2):
            cx = x + half if i == 0 else x - half
            for j in range(2):
                cy = y + half if j == 0 else y - half
                sign = 1.0 if (i + j + k) % 2 == 0 else -1.0
                rho = math.sqrt(cx * cx + cy * cy + cz * cz)
                yz2, xz2 = cy * cy + cz * cz, cx * cx + cz * cz
                bx -= sign * _compute_log_sum(cy, xz2, rho)
                by -= sign * _compute_log_sum(cx, yz2, rho)
                bz += sign * math.atan(cx * cy / (cz * rho))
                xx -= sign * cx * (rho - cy) / (rho * xz2)
                yy -= sign * cy * (rho - cx) / (rho * yz2)
                xy -= sign / rho
                xz -= sign * cz * (rho - cy) / (rho * xz2)
                yz -= sign * cz * (rho - cx) / (rho * yz2)
    scale = remanence / (4.0 * math.pi)
    b[0], b[1], b[2] = scale * bx, scale * by, scale * bz
    g[0, 0], g[1, 1], g[2, 2] = scale * xx, scale * yy, -scale * (xx + yy)
    g[0, 1] = g[1, 0] = scale * xy
    g[0, 2] = g[2, 0] = scale * xz
    g[1, 2] = g[2, 1] = scale * yz


# Entries of `gel`: yield loads of the helix, each alone: force along the thread (N), force across the axis (N),
# torque about the axis, torque across it (N·m); rate of turn at which the viscous part is as large (rad/s); force
# that cuts a new channel at the nose (N), share of it on the way back; pitch / 2 pi (m/rad), radius, half the
# length (m); lowest and highest position of the axis between the plates (m), stiffness (N/m) and friction of the plates
THREAD, ACROSS, SPIN, TILT, RATE, CUT, BACK, LEAD, RADIUS, REACH, LOW, HIGH, PLATE, FRICTION = range(14)
GEL_LENGTH = 14
# Entries of `cube`: half the side (m), remanence (T), centre (3, m), columns of the stage's true rotation (9, row by
# row), angle of the pole from straight down at a turn of zero (rad)
HALF_SIDE, REMANENCE, CENTER, FRAME, HOME = 0, 1, 2, 5, 14
# Entries of `state`: middle of the housing (3, m), orientation (4, scalar first), deflection (rad), turn of the magnet
# and heading of its axis (rad), velocity (3, m/s) and spin (3, rad/s) in the last step, world frame
X, Q, DEFLECTION, TURN, STEER, V, W = 0, 3, 7, 8, 9, 10, 13
GEL_STATE_LENGTH = 16
STICK_SPEED = 1e-7  # m/s: a contact that slips more slowly than this sticks
SETTLE_STEPS = 4  # Newton steps to the deflection at equilibrium
STIFFNESS_POINTS = 5  # along the helix, at which the gel's stiffness is averaged
POINT_SPACING, POINT_WEIGHT = 0.5, 0.2  # of those points: in half lengths, and in the mean


@njit(cache=True, error_model="numpy")
def compute_magnet_field(
    point: FloatArray, cube: FloatArray, steer: float, turn: float, b: FloatArray, g: FloatArray, work: FloatArray
) -> None:
    """Compute field and gradient of the rotating cube at a world point, world frame.

    At a turn of zero its pole points straight down; it turns about a horizontal axis of heading `steer`.

    Parameters
    ----------
    point : ndarray, shape (3,), in m
        World frame.
    cube : ndarray
        As laid out above.
    steer, turn : float, in rad
    b : ndarray, shape (3,), in T
        Receives the field.
    g : ndarray, shape (3, 3), in T/m
        Receives the gradient, ``g[i, j] = dB_i / dx_j``.
    work : ndarray, shape (4, 3, 3)
        Scratch memory.
    """
    frame, own_g, half, own = work[0], work[1], work[2], work[3]
    angle = turn + cube[HOME]
    c, s, cs, ss = math.cos(angle), math.sin(angle), math.cos(steer), math.sin(steer)
    # columns in the stage's frame: along the axis, the third, along the magnetisation cos (-z) + sin (axis x -z)
    own[0, 0], own[1, 0], own[2, 0] = cs, ss, 0.0
    own[0, 2], own[1, 2], own[2, 2] = -s * ss, s * cs, -c
    own[0, 1] = own[1, 2] * own[2, 0] - own[2, 2] * own[1, 0]
    own[1, 1] = own[2, 2] * own[0, 0] - own[0, 2] * own[2, 0]
    own[2, 1] = own[0, 2] * own[1, 0] - own[1, 2] * own[0, 0]
    for r in range(3):
        for k in range(3):
            frame[r, k] = (
                cube[FRAME + 3 * r] * own[0, k]
                + cube[FRAME + 3 * r + 1] * own[1, k]
                + cube[FRAME + 3 * r + 2] * own[2, k]
            )
    dx, dy, dz = point[0] - cube[CENTER], point[1] - cube[CENTER + 1], point[2] - cube[CENTER + 2]
    x = frame[0, 0] * dx + frame[1, 0] * dy + frame[2, 0] * dz
    y = frame[0, 1] * dx + frame[1, 1] * dy + frame[2, 1] * dz
    z = frame[0, 2] * dx + frame[1, 2] * dy + frame[2, 2] * dz
    compute_cuboid_field(x, y, z, cube[HALF_SIDE], cube[REMANENCE], own[0], own_g)
    for r in range(3):
        b[r] = frame[r, 0] * own[0, 0] + frame[r, 1] * own[0, 1] + frame[r, 2] * own[0, 2]
        for k in range(3):
            half[r, k] = frame[r, 0] * own_g[0, k] + frame[r, 1] * own_g[1, k] + frame[r, 2] * own_g[2, k]
    for r in range(3):
        for k in range(3):
            g[r, k] = half[r, 0] * frame[k, 0] + half[r, 1] * frame[k, 1] + half[r, 2] * frame[k, 2]


@njit(cache=True, error_model="numpy")
def find_stiffness(x: float, y: float, inclusions: FloatArray) -> float:
    """Return the gel's strength at a position, as a multiple of its nominal strength.

    Parameters
    ----------
    x, y : float, in m
        World frame.
    inclusions : ndarray, shape (k, 4)
        Centre x, y (m), radius (m) and factor of each.

    Returns
    -------
    float
    """
    factor = 1.0
    for i in range(len(inclusions)):
        dx, dy = x - inclusions[i, 0], y - inclusions[i, 1]
        if dx * dx + dy * dy < inclusions[i, 2] ** 2:
            factor = max(factor, inclusions[i, 3])
    return factor


@njit(cache=True, error_model="numpy")
def find_equilibrium_deflection(theta: float, bx: float, bz: float, device: FloatArray) -> float:
    """Compute the deflection at which cantilever, stops and field are in equilibrium.

    Parameters
    ----------
    theta : float, in rad
        First guess.
    bx, bz : float, in T
        Field in the plane of oscillation, body frame.
    device : ndarray
        As laid out in `sim.tank.magnetics.cantilever`.

    Returns
    -------
    float, in rad
    """
    moment, rest_x, rest_z, theta_max = device[MOMENT], device[REST_X], device[REST_Z], device[THETA_MAX]
    spring = device[INERTIA] * device[OMEGA_SQUARED]
    for _ in range(SETTLE_STEPS):
        c, s = math.cos(theta), math.sin(theta)
        mx, mz = moment * (rest_x * c + rest_z * s), moment * (rest_z * c - rest_x * s)
        rest = bx * mz - bz * mx - spring * theta
        slope = spring + bx * mx + bz * mz
        theta = theta + rest / slope if slope > 0 else math.copysign(theta_max, rest)
        theta = min(max(theta, -theta_max), theta_max)
    return theta


@njit(cache=True, error_model="numpy")
def compute_gel_flow(
    forward: FloatArray, load: FloatArray, gel: FloatArray, factor: float, nose: float, out: FloatArray
) -> None:
    """Compute the helix's motion under a force and a torque: none below yield, plastic flow and viscous drag above.

    Slip along the thread, drift across the axis, spin and tilt share one yield surface, an ellipsoid over their own
    strengths S_i, with the flow at right angles to it and a viscous part that grows with the rate (Bingham):

        n² = sum (g_i / S_i)²,   q_i = lambda g_i / S_i²,   n = 1 + Gamma / Gamma_0,   lambda = S_spin Gamma / n

    so that a screw that turns also yields to a small force across it. The advance is ``lead * spin - slip``. The
    cutting force at the nose opposes the advance and prevents it below a threshold.

    Parameters
    ----------
    forward : ndarray, shape (3,)
        Axis of the helix, world frame.
    load : ndarray, shape (6,)
        Force (N) and torque about the middle (N·m), world frame.
    gel : ndarray
        As laid out above.
    factor, nose : float
        Strength of the gel along the body and at the nose, as multiples of its nominal strength.
    out : ndarray, shape (6,)
        Receives velocity (m/s) and spin (rad/s), world frame.
    """
    lead = gel[LEAD]
    thread, across, spin, tilt = gel[THREAD] * factor, gel[ACROSS] * factor, gel[SPIN] * factor, gel[TILT] * factor
    push = load[0] * forward[0] + load[1] * forward[1] + load[2] * forward[2]
    twist = load[3] * forward[0] + load[4] * forward[1] + load[5] * forward[2]
    rest = 0.0
    for r in range(3):
        rest += ((load[r] - push * forward[r]) / across) ** 2 + ((load[3 + r] - twist * forward[r]) / tilt) ** 2
    # the nose takes up to the cutting force: it holds the helix where it would not advance otherwise
    cut, advancing = gel[CUT] * nose, 0.0
    holding = -lead * twist / spin**2 / (1.0 / thread**2 + (lead / spin) ** 2)  # push (N) at which it does not advance
    held = min(max(holding, push - cut), push + gel[BACK] * cut)
    turn, slip = twist + lead * held, -held
    # yield surface: below 1 the gel holds, above it flows like a Bingham fluid, along the surface's normal
    n = math.sqrt(rest + (slip / thread) ** 2 + (turn / spin) ** 2)
    if n <= 1.0:
        for r in range(6):
            out[r] = 0.0
        return
    flowing = spin * gel[RATE] * (n - 1.0) / n
    rate = flowing * turn / spin**2
    advancing = lead * rate - flowing * slip / thread**2
    for r in range(3):
        out[r] = advancing * forward[r] + flowing * (load[r] - push * forward[r]) / across**2
        out[3 + r] = rate * forward[r] + flowing * (load[3 + r] - twist * forward[r]) / tilt**2


@njit(cache=True, error_model="numpy")
def compute_magnetic_load(
    rotation_body_to_world: FloatArray, theta: float, b: FloatArray, g: FloatArray, device: FloatArray, load: FloatArray
) -> float:
    """Compute force and torque of a field on the housing, and the deflection.

        F = grad(m . B),   T = m x B + a x F

    with a from the housing's middle to the magnet.

    Parameters
    ----------
    rotation_body_to_world : ndarray, shape (3, 3)
        From body to world.
    theta : float, in rad
        First guess of the deflection.
    b : ndarray, shape (3,), in T
        At the magnet, world frame.
    g : ndarray, shape (3, 3), in T/m
        ``g[i, j] = dB_i / dx_j``, world frame.
    device : ndarray
        As laid out in `sim.tank.magnetics.cantilever`.
    load : ndarray, shape (6,)
        Receives force (N) and torque about the housing's middle (N·m), world frame.

    Returns
    -------
    float, in rad
        The deflection.
    """
    bx = rotation_body_to_world[0, 0] * b[0] + rotation_body_to_world[1, 0] * b[1] + rotation_body_to_world[2, 0] * b[2]
    bz = rotation_body_to_world[0, 2] * b[0] + rotation_body_to_world[1, 2] * b[1] + rotation_body_to_world[2, 2] * b[2]
    theta = find_equilibrium_deflection(theta, bx, bz, device)
    c, s = math.cos(theta), math.sin(theta)
    u = device[MOMENT] * (device[REST_X] * c + device[REST_Z] * s)
    v = device[MOMENT] * (device[REST_Z] * c - device[REST_X] * s)
    ax, ay, az = device[L0] * s - device[MIDDLE], -device[MIDDLE + 1], device[L0] * c - device[MIDDLE + 2]
    m0, m1 = (
        rotation_body_to_world[0, 0] * u + rotation_body_to_world[0, 2] * v,
        rotation_body_to_world[1, 0] * u + rotation_body_to_world[1, 2] * v,
    )
    m2 = rotation_body_to_world[2, 0] * u + rotation_body_to_world[2, 2] * v
    a0 = rotation_body_to_world[0, 0] * ax + rotation_body_to_world[0, 1] * ay + rotation_body_to_world[0, 2] * az
    a1 = rotation_body_to_world[1, 0] * ax + rotation_body_to_world[1, 1] * ay + rotation_body_to_world[1, 2] * az
    a2 = rotation_body_to_world[2, 0] * ax + rotation_body_to_world[2, 1] * ay + rotation_body_to_world[2, 2] * az
    f0 = g[0, 0] * m0 + g[1, 0] * m1 + g[2, 0] * m2
    f1 = g[0, 1] * m0 + g[1, 1] * m1 + g[2, 1] * m2
    f2 = g[0, 2] * m0 + g[1, 2] * m1 + g[2, 2] * m2
    load[0], load[1], load[2] = f0, f1, f2
    load[3] = m1 * b[2] - m2 * b[1] + a1 * f2 - a2 * f1
    load[4] = m2 * b[0] - m0 * b[2] + a2 * f0 - a0 * f2
    load[5] = m0 * b[1] - m1 * b[0] + a0 * f1 - a1 * f0
    return theta


@njit(cache=True, error_model="numpy")
def add_plate_forces(state: FloatArray, forward: FloatArray, gel: FloatArray, load: FloatArray) -> None:
    """Add the contact forces of floor and plate at nose and tail: elastic normal force and Coulomb friction.

    Parameters
    ----------
    state : ndarray
        As laid out above.
    forward : ndarray, shape (3,)
        Axis of the helix, world frame.
    gel : ndarray
        As laid out above.
    load : ndarray, shape (6,)
        Force (N) and torque (N·m), world frame; changed in place.
    """
    for end in (-1.0, 1.0):
        arm0, arm1, arm2 = end * gel[REACH] * forward[0], end * gel[REACH] * forward[1], end * gel[REACH] * forward[2]
        height = state[2] + arm2
        push = gel[PLATE] * (max(gel[LOW] - height, 0.0) - max(height - gel[HIGH], 0.0))
        if push == 0.0:
            continue
        rim = arm2 - math.copysign(gel[RADIUS], push)
        u = state[V] + state[W + 1] * rim - state[W + 2] * arm1
        v = state[V + 1] + state[W + 2] * arm0 - state[W] * rim
        rub = -gel[FRICTION] * abs(push) / (math.sqrt(u * u + v * v) + STICK_SPEED)
        fx, fy = rub * u, rub * v
        load[0] += fx
        load[1] += fy
        load[2] += push
        load[3] += arm1 * push - rim * fy
        load[4] += rim * fx - arm0 * push
        load[5] += arm0 * fy - arm1 * fx


@njit(cache=True, error_model="numpy")
def advance_screw(
    state: FloatArray,
    device: FloatArray,
    gel: FloatArray,
    inclusions: FloatArray,
    cube: FloatArray,
    steer_to: float,
    steering_rate: float,
    turn_rate: float,
    step: float,
    poses: FloatArray,
) -> None:
    """Turn the magnet and move the helix for as many steps as `poses` has rows.

    Parameters
    ----------
    state, device, gel, inclusions, cube : ndarray
        As laid out above and in `sim.tank.magnetics.cantilever`; `state` is advanced in place.
    steer_to : float, in rad
        Target heading of the magnet's axis.
    steering_rate : float, in rad/s
        Speed of the axis toward it.
    turn_rate : float, in rad/s
        Of the magnet about its axis.
    step : float, in s
    poses : ndarray, shape (n, 7)
        Receives rotation centre (m) and orientation at the start of each step, world frame.
    """
    b, g, load, moved = np.empty(3), np.empty((3, 3)), np.empty(6), np.empty(6)
    rotation, forward, point, work = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty((4, 3, 3))
    for i in range(len(poses)):
        w, x, y, z = state[Q], state[Q + 1], state[Q + 2], state[Q + 3]
        rotation[0, 0], rotation[0, 1], rotation[0, 2] = (
            1 - 2 * (y * y + z * z),
            2 * (x * y - z * w),
            2 * (x * z + y * w),
        )
        rotation[1, 0], rotation[1, 1], rotation[1, 2] = (
            2 * (x * y + z * w),
            1 - 2 * (x * x + z * z),
            2 * (y * z - x * w),
        )
        rotation[2, 0], rotation[2, 1], rotation[2, 2] = (
            2 * (x * z - y * w),
            2 * (y * z + x * w),
            1 - 2 * (x * x + y * y),
        )
        theta = state[DEFLECTION]
        ax, ay, az = device[L0] * math.sin(theta), 0.0, device[L0] * math.cos(theta)
        for r in range(3):
            forward[r] = rotation[r, 2]
            center = (
                state[r]
                - rotation[r, 0] * device[MIDDLE]
                - rotation[r, 1] * device[MIDDLE + 1]
                - rotation[r, 2] * device[MIDDLE + 2]
            )
            poses[i, r] = center
            point[r] = center + rotation[r, 0] * ax + rotation[r, 1] * ay + rotation[r, 2] * az
        poses[i, 3], poses[i, 4], poses[i, 5], poses[i, 6] = w, x, y, z
        # the stage turns its axis and the magnet; the field is taken at the middle of the step
        left = steer_to - state[STEER]
        left -= 2.0 * math.pi * math.floor(left / (2.0 * math.pi) + 0.5)
        state[STEER] += math.copysign(min(abs(left), steering_rate * step), left)
        compute_magnet_field(point, cube, state[STEER], state[TURN] + 0.5 * turn_rate * step, b, g, work)
        state[TURN] += turn_rate * step
        state[DEFLECTION] = compute_magnetic_load(rotation, theta, b, g, device, load)
        add_plate_forces(state, forward, gel, load)
        factor = 0.0
        for k in range(STIFFNESS_POINTS):
            along = (POINT_SPACING * k - 1.0) * gel[REACH]
            factor += POINT_WEIGHT * find_stiffness(
                state[0] + along * forward[0], state[1] + along * forward[1], inclusions
            )
        tip = gel[REACH]
        nose = find_stiffness(state[0] + tip * forward[0], state[1] + tip * forward[1], inclusions)
        compute_gel_flow(forward, load, gel, factor, nose, moved)
        advance_pose(state, moved, step)


@njit(cache=True, error_model="numpy")
def advance_pose(state: FloatArray, moved: FloatArray, step: float) -> None:
    """Advance position and orientation in `state` by one step of constant velocity.

    Parameters
    ----------
    state : ndarray
        As laid out above; changed in place.
    moved : ndarray, shape (6,)
        Velocity (m/s) and spin (rad/s), world frame.
    step : float, in s
    """
    rate = math.sqrt(moved[3] ** 2 + moved[4] ** 2 + moved[5] ** 2)
    half = 0.5 * rate * step
    c, s = math.cos(half), (math.sin(half) / rate if rate > 0 else 0.0)
    i, j, k = s * moved[3], s * moved[4], s * moved[5]
    w, x, y, z = state[Q], state[Q + 1], state[Q + 2], state[Q + 3]
    state[Q], state[Q + 1] = c * w - i * x - j * y - k * z, c * x + i * w + j * z - k * y
    state[Q + 2], state[Q + 3] = c * y - i * z + j * w + k * x, c * z + i * y - j * x + k * w
    norm = math.sqrt(state[Q] ** 2 + state[Q + 1] ** 2 + state[Q + 2] ** 2 + state[Q + 3] ** 2)
    for r in range(4):
        state[Q + r] /= norm
    for r in range(3):
        state[r] += step * moved[r]
        state[V + r] = moved[r]
        state[W + r] = moved[3 + r]
