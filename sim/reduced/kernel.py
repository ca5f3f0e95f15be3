"""Compiled motion of the overdamped robot in a sampled tank: coil field, cantilever at rest, drag, surface.

Kernels that call each other share this file (numba's cache does not see a change in another one).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from sim.tank.carriers.hydrodynamics import (
    BUOYANCY,
    DRAG,
    FLOW_X,
    FLOW_Y,
    HEIGHT,
    MENISCUS,
    RIGHTING_X,
    RIGHTING_Z,
    SURFACE,
    SWIRL,
    TURN_DRAG,
    WEIGHT,
)  # fmt: skip
from sim.tank.magnetics.cantilever import (
    ETA,
    FRICTION,
    INERTIA,
    L0,
    MIDDLE,
    MOMENT,
    OMEGA_SQUARED,
    REST_X,
    REST_Z,
    THETA_MAX,
)  # fmt: skip
from smolbot.core.arrays import FloatArray

DRIVEN_STEP = 2e-3
"""Step while a coil is driven, in s: coils settle in 3 ms, the cantilever's period is 10 ms, alignment takes longer."""

DECAY_STEP = 4e-3
"""Step while currents decay, in s."""

IDLE_STEP = 3e-2
"""Step without currents, in s: the rest of the earth's field turns the robot by 1 degree per second."""

MIN_ACTUATION_CURRENT = 2e-2
"""Current, in A, below which a coil without a command moves nothing."""

ROUNDING, ROUNDED_STEPS = 1e-12, 1e-9
"""Time, in s, and share of a step that are rounding."""

# Entries of `state`: middle of the housing (3, m), orientation (4, scalar first), deflection at rest (rad), phasor (2,
# rad) of the oscillation about it: now, and a quarter of a period ago
DEFLECTION, NOW, QUARTER = 7, 8, 9
STATE_LENGTH = 10
STIFFER = 7  # entry of the rates: stiffness by the field, as a share of the spring's
OSCILLATION = slice(8, 10)
# Entries of `device` and `hull`: see `sim.tank.magnetics.cantilever` and `sim.tank.carriers.hydrodynamics.Hull`.
# Entries of `grid`: origin x, y (m), 1 / spacing (1/m), height of the plane (m)
ORIGIN_X, ORIGIN_Y, SCALE, PLANE_HEIGHT = range(4)
# Entries of `box`: walls of the container, half the housing's length and width (m)
LEFT, RIGHT, FRONT, BACK, HALF_AHEAD, HALF_SIDE = range(6)
SETTLE_STEPS, MIN_STIFFNESS = 3, 0.2  # Newton steps to the deflection at rest; least slope, as a share of the spring's
SLOWEST = 1.0  # rad²/s²: least squared frequency of the oscillation


@njit(cache=True, error_model="numpy")
def compute_plane_field(
    x: float, y: float, z: float, currents: FloatArray, grid: FloatArray, table: FloatArray
) -> tuple[float, float, float, float, float, float, float, float]:
    """Compute field and gradient of all sources near the plane: cubic B-splines in the plane, Maxwell across it.

        dBx/dz = dBz/dx,   dBy/dz = dBz/dy,   dBz/dz = -(dBx/dx + dBy/dy)

    Parameters
    ----------
    x, y, z : float, in m
        World frame.
    currents : ndarray, shape (n_sources,), in A
    grid : ndarray, shape (4,)
        Origin x, y (m), 1 / spacing (1/m), height of the plane (m).
    table : ndarray, shape (nx, ny, n_sources, 3), in T per A
        Spline coefficients.

    Returns
    -------
    tuple of 8
        Bx, By, Bz in T, then dBx/dx, dBx/dy, dBx/dz, dBy/dy, dBy/dz in T/m, world frame.
    """
    # weights of the cubic B-splines along x and y, and of their derivatives
    scale = grid[SCALE]
    u, v = (x - grid[ORIGIN_X]) * scale, (y - grid[ORIGIN_Y]) * scale
    i = max(1, min(math.floor(u), table.shape[0] - 3))
    j = max(1, min(math.floor(v), table.shape[1] - 3))
    t = min(max(u - i, 0.0), 1.0)
    s = 1.0 - t
    wx = (s**3 / 6.0, (4.0 - 6.0 * t**2 + 3.0 * t**3) / 6.0, (4.0 - 6.0 * s**2 + 3.0 * s**3) / 6.0, t**3 / 6.0)
    dx = (-0.5 * s**2 * scale, (1.5 * t**2 - 2.0 * t) * scale, (2.0 * s - 1.5 * s**2) * scale, 0.5 * t**2 * scale)
    t = min(max(v - j, 0.0), 1.0)
    s = 1.0 - t
    wy = (s**3 / 6.0, (4.0 - 6.0 * t**2 + 3.0 * t**3) / 6.0, (4.0 - 6.0 * s**2 + 3.0 * s**3) / 6.0, t**3 / 6.0)
    dy = (-0.5 * s**2 * scale, (1.5 * t**2 - 2.0 * t) * scale, (2.0 * s - 1.5 * s**2) * scale, 0.5 * t**2 * scale)
    bx = by = bz = xx = xy = yx = yy = zx = zy = 0.0
    n_sources = len(currents)
    for p in range(4):
        for q in range(4):
            cx = cy = cz = 0.0
            for n in range(n_sources):
                current = currents[n]
                if current != 0.0:
                    cx += current * table[i - 1 + p, j - 1 + q, n, 0]
                    cy += current * table[i - 1 + p, j - 1 + q, n, 1]
                    cz += current * table[i - 1 + p, j - 1 + q, n, 2]
            level, along_x, along_y = wx[p] * wy[q], dx[p] * wy[q], wx[p] * dy[q]
            bx += level * cx
            by += level * cy
            bz += level * cz
            xx += along_x * cx
            xy += along_y * cx
            yx += along_x * cy
            yy += along_y * cy
            zx += along_x * cz
            zy += along_y * cz
    # off the plane by curl B = 0 and div B = 0
    up, across = z - grid[PLANE_HEIGHT], 0.5 * (xy + yx)
    return bx + up * zx, by + up * zy, bz - up * (xx + yy), xx, across, zx, yy, zy


@njit(cache=True, error_model="numpy")
def _compute_rates(
    s: FloatArray,
    currents: FloatArray,
    grid: FloatArray,
    table: FloatArray,
    device: FloatArray,
    hull: FloatArray,
    float_height: float,
    swung: float,
    out: FloatArray,
) -> None:
    """Compute the rates of motion of a state.

    `out` (8,) receives velocity (3, m/s, world), change of the quaternion (4, 1/s), and the share by which the field
    stiffens the cantilever; `s[DEFLECTION]` receives the deflection.

    The cantilever rests where spring and field balance: ``k theta = m B . (y x m_dir) + F . (y x r)``, up to its stop.
    `swung`, in rad, is the mean over the step of its swing about there.
    """
    w, i, j, k = s[3], s[4], s[5], s[6]
    xx, xy, xz = 1 - 2 * (j * j + k * k), 2 * (i * j - k * w), 2 * (i * k + j * w)
    yx, yy, yz = 2 * (i * j + k * w), 1 - 2 * (i * i + k * k), 2 * (j * k - i * w)
    zx, zy, zz = 2 * (i * k - j * w), 2 * (j * k + i * w), 1 - 2 * (i * i + j * j)
    moment, rest_x, rest_z, l0, stop = (
        device[MOMENT],
        device[REST_X],
        device[REST_Z],
        device[L0],
        device[THETA_MAX],
    )
    stiffness = device[OMEGA_SQUARED] * device[INERTIA]
    theta = s[DEFLECTION]
    sine, cosine = math.sin(theta), math.cos(theta)
    # magnet from the housing's middle, body frame
    ax, ay, az = l0 * sine - device[MIDDLE], -device[MIDDLE + 1], l0 * cosine - device[MIDDLE + 2]
    wbx, wby, wbz, gxx, gxy, gxz, gyy, gyz = compute_plane_field(
        s[0] + xx * ax + xy * ay + xz * az,
        s[1] + yx * ax + yy * ay + yz * az,
        s[2] + zx * ax + zy * ay + zz * az,
        currents, grid, table,
    )  # fmt: skip
    gzz = -(gxx + gyy)
    bx, by, bz = xx * wbx + yx * wby + zx * wbz, xy * wbx + yy * wby + zy * wbz, xz * wbx + yz * wby + zz * wbz
    # columns of G R for body x and z (T/m): gradients of the field along the moment's possible directions
    px, py, pz = gxx * xx + gxy * yx + gxz * zx, gxy * xx + gyy * yx + gyz * zx, gxz * xx + gyz * yx + gzz * zx
    qx, qy, qz = gxx * xz + gxy * yz + gxz * zz, gxy * xz + gyy * yz + gyz * zz, gxz * xz + gyz * yz + gzz * zz
    bxx, bxz = xx * px + yx * py + zx * pz, xx * qx + yx * qy + zx * qz
    bzz = xz * qx + yz * qy + zz * qz
    # deflection at rest (Newton): torque of field and force against the spring
    mx = mz = 0.0
    for _ in range(SETTLE_STEPS):
        mx, mz = moment * (rest_x * cosine + rest_z * sine), moment * (rest_z * cosine - rest_x * sine)
        torque = bx * mz - bz * mx + l0 * (cosine * (bxx * mx + bxz * mz) - sine * (bxz * mx + bzz * mz))
        theta += (torque - stiffness * theta) / max(stiffness + bx * mx + bz * mz, MIN_STIFFNESS * stiffness)
        theta = min(max(theta, -stop), stop)
        sine, cosine = math.sin(theta), math.cos(theta)
    s[DEFLECTION] = theta
    out[STIFFER] = (bx * mx + bz * mz) / stiffness
    theta = min(max(theta + swung, -stop), stop)
    sine, cosine = math.sin(theta), math.cos(theta)
    mx, mz = moment * (rest_x * cosine + rest_z * sine), moment * (rest_z * cosine - rest_x * sine)
    ax, az = l0 * sine - device[MIDDLE], l0 * cosine - device[MIDDLE + 2]
    fwx, fwy, fwz = px * mx + qx * mz, py * mx + qy * mz, pz * mx + qz * mz  # grad(m . B), world frame
    fx, fy, fz = xx * fwx + yx * fwy + zx * fwz, xy * fwx + yy * fwy + zy * fwz, xz * fwx + yz * fwy + zz * fwz
    tx, ty, tz = -mz * by + ay * fz - az * fy, mz * bx - mx * bz + az * fx - ax * fz, mx * by + ax * fy - ay * fx
    wet = min(max((hull[SURFACE] - s[2]) / hull[HEIGHT] + 0.5, 0.0), 1.0)
    lift = hull[BUOYANCY] * wet - hull[WEIGHT]
    if 0.0 < wet < 1.0:
        lift -= hull[MENISCUS] * (s[2] - float_height)
        tx += hull[RIGHTING_X] * zz  # the surface turns body y upward
        tz -= hull[RIGHTING_Z] * zx
    # without inertia: velocity = force / drag, spin = torque / drag, body axes
    u, v, t = (fx + lift * zx) / hull[DRAG], (fy + lift * zy) / hull[DRAG + 1], (fz + lift * zz) / hull[DRAG + 2]
    out[0], out[1], out[2] = xx * u + xy * v + xz * t, yx * u + yy * v + yz * t, zx * u + zy * v + zz * t
    out[0] += hull[FLOW_X] - hull[SWIRL] * s[1]  # relative to a liquid that flows
    out[1] += hull[FLOW_Y] + hull[SWIRL] * s[0]
    p, q, r = tx / hull[TURN_DRAG], ty / hull[TURN_DRAG + 1], tz / hull[TURN_DRAG + 2]
    p, q, r = p + hull[SWIRL] * zx, q + hull[SWIRL] * zy, r + hull[SWIRL] * zz
    out[3] = 0.5 * (-i * p - j * q - k * r)
    out[4] = 0.5 * (w * p + j * r - k * q)
    out[5] = 0.5 * (w * q + k * p - i * r)
    out[6] = 0.5 * (w * r + i * q - j * p)


@njit(cache=True, error_model="numpy")
def compute_driving_field(
    state: FloatArray, device: FloatArray, currents: FloatArray, grid: FloatArray, table: FloatArray
) -> float:
    """Compute the field along y x m at the magnet: the part that drives the oscillation (Eq. S1).

    Parameters
    ----------
    state, device : ndarray
        As laid out at the top of this file.
    currents : ndarray, shape (n_sources,), in A
        Of the excitation coils.
    grid, table : ndarray
        As `compute_plane_field` takes them, for the excitation coils.

    Returns
    -------
    float, in T
    """
    w, i, j, k = state[3], state[4], state[5], state[6]
    xx, xz = 1 - 2 * (j * j + k * k), 2 * (i * k + j * w)
    yx, yz = 2 * (i * j + k * w), 2 * (j * k - i * w)
    zx, zz = 2 * (i * k - j * w), 1 - 2 * (i * i + j * j)
    ahead = device[L0] - device[MIDDLE + 2]
    field = compute_plane_field(
        state[0] + ahead * xz, state[1] + ahead * yz, state[2] + ahead * zz, currents, grid, table
    )  # fmt: skip
    along_x = field[0] * xx + field[1] * yx + field[2] * zx
    along_z = field[0] * xz + field[1] * yz + field[2] * zz
    return along_x * device[REST_Z] - along_z * device[REST_X]


@njit(cache=True, error_model="numpy")
def _advance_oscillation(state: FloatArray, drive: complex, stiffer: float, device: FloatArray, time: float) -> float:
    """Advance the oscillation by `time` s, up to the stops; return its mean over that time, in rad.

        c' = (i omega - eta) c + drive,   theta = Re c

    `drive` is the rate of growth from a current at resonance, with the phase of the step's end. For dry friction
    the amplitude falls linearly instead (Eq. S3).
    """
    eta, omega = device[ETA], math.sqrt(max(device[OMEGA_SQUARED] * (1.0 + stiffer) - device[ETA] ** 2, SLOWEST))
    now = complex(state[NOW], -state[QUARTER])
    if now == 0.0 and drive == 0.0:
        return 0.0
    rate = complex(-eta, omega)
    turned = now * np.exp(rate * time)
    mean = ((turned - now) / (rate * time)).real
    turned += drive * (-math.expm1(-eta * time) / eta if eta > 0.0 else time)
    size = abs(turned)
    left = min(size, device[THETA_MAX])
    if eta == 0.0:
        left = max(left - 2.0 * device[FRICTION] / (math.pi * omega) * time, 0.0)
    if size > 0.0:
        turned *= left / size
    state[NOW], state[QUARTER] = turned.real, -turned.imag
    return mean


@njit(cache=True, error_model="numpy")
def advance_motion(
    state: FloatArray,
    currents: FloatArray,
    commands: FloatArray,
    drives: FloatArray,
    lengths: FloatArray,
    constants: FloatArray,
    lags: FloatArray,
    grid: FloatArray,
    table: FloatArray,
    excitation: FloatArray,
    device: FloatArray,
    hull: FloatArray,
    float_height: float,
    box: FloatArray,
    start: float,
    times: FloatArray,
    poses: FloatArray,
    states: FloatArray,
) -> int:
    """Move the robot through windows of constant commands, by midpoint steps.

    Parameters
    ----------
    state : ndarray, shape (10,)
        As laid out at the top of this file; advanced in place.
    currents : ndarray, shape (n_sources,), in A
        Of the actuation coils, then of constant sources; advanced in place.
    commands : ndarray, shape (n_windows, n_coils), in A
        Constant in each window.
    drives : ndarray, shape (n_windows, n_excitation), in A
        Peaks of a sine at resonance.
    lengths : ndarray, shape (n_windows,), in s
    constants : ndarray, shape (n_coils,), in s
        Time constants of the actuation coils.
    lags : ndarray, shape (n_excitation,), in s
        Time constants of the excitation coils.
    grid, table, excitation : ndarray
        As `compute_plane_field` takes them; the last is the table of the excitation coils.
    device, hull : ndarray
        As laid out at the top of this file.
    float_height : float, in m
        See `sim.tank.carriers.hydrodynamics.Hull`.
    box : ndarray, shape (6,), in m
        Low x, high x, low y, high y of the container; half the housing's length and width.
    start : float, in s
        Time of the first window.
    times : ndarray, shape (k,), in s
        Receives the time at the start of each step, and at the end of the last.
    poses : ndarray, shape (k, 7)
        Receives rotation centre (m) and orientation at these times, world frame.
    states : ndarray, shape (n_windows, 10)
        Receives the state at the start of each window.

    Returns
    -------
    int
        Number of rows in `times` and `poses`.
    """
    n_coils = commands.shape[1]
    half, mean, rates, one = np.empty(STATE_LENGTH), currents.copy(), np.empty(8), np.zeros(drives.shape[1])
    omega = math.sqrt(device[OMEGA_SQUARED])
    rows = 0
    for window in range(len(lengths)):
        states[window] = state
        growth = 0.0 + 0.0j
        for n in range(drives.shape[1]):
            if drives[window, n] != 0.0:
                one[:] = 0.0
                one[n] = drives[window, n]
                lag = math.atan(omega * lags[n])
                field = compute_driving_field(state, device, one, grid, excitation)
                growth -= (
                    0.5 * device[MOMENT] * field / (device[INERTIA] * omega) * complex(math.cos(lag), -math.sin(lag))
                )
        at, duration = 0.0, lengths[window]
        while duration - at > ROUNDING:
            times[rows] = start + at
            write_pose(state, device, poses[rows])
            rows += 1
            live, longest = False, IDLE_STEP
            for n in range(n_coils):
                if abs(currents[n]) > MIN_ACTUATION_CURRENT:
                    live, longest = True, min(longest, DECAY_STEP)
                if commands[window, n] != 0.0:
                    live, longest = True, DRIVEN_STEP
            left = duration - at
            h = left / math.ceil(left / longest - ROUNDED_STEPS)
            for n in range(n_coils):
                if live:  # the exact mean of the exponential over the step, and its end
                    settled = 1.0 - math.exp(-h / constants[n]) if constants[n] > 0.0 else 1.0
                    off = currents[n] - commands[window, n]
                    mean[n] = commands[window, n] + off * settled * constants[n] / h
                    currents[n] = commands[window, n] + off * (1.0 - settled)
                else:
                    mean[n] = currents[n] = 0.0
            # midpoint rule; the deflection at rest is solved, not integrated
            _compute_rates(state, mean, grid, table, device, hull, float_height, 0.0, rates)
            turn = complex(math.cos(omega * (at + h)), math.sin(omega * (at + h)))
            swung = _advance_oscillation(state, growth * turn, rates[DEFLECTION], device, h)
            for n in range(DEFLECTION):
                half[n] = state[n] + 0.5 * h * rates[n]
            for n in range(DEFLECTION, STATE_LENGTH):
                half[n] = state[n]
            _compute_rates(half, mean, grid, table, device, hull, float_height, swung, rates)
            for n in range(DEFLECTION):
                state[n] += h * rates[n]
            state[DEFLECTION] = half[DEFLECTION]
            size = 1.0 / math.sqrt(state[3] ** 2 + state[4] ** 2 + state[5] ** 2 + state[6] ** 2)
            for n in range(3, 7):
                state[n] *= size
            _hold_inside(state, box)
            at += h
        start += duration
    times[rows] = start
    write_pose(state, device, poses[rows])
    return rows + 1


@njit(cache=True, error_model="numpy")
def _hold_inside(state: FloatArray, box: FloatArray) -> None:
    """Move a housing that overlaps a wall back beside it; it slides without friction, and is not turned."""
    w, i, j, k = state[3], state[4], state[5], state[6]
    ahead_x, ahead_y = abs(2 * (i * k + j * w)), abs(2 * (j * k - i * w))
    side_x, side_y = abs(1 - 2 * (j * j + k * k)), abs(2 * (i * j + k * w))
    x, y = ahead_x * box[HALF_AHEAD] + side_x * box[HALF_SIDE], ahead_y * box[HALF_AHEAD] + side_y * box[HALF_SIDE]
    state[0] = min(max(state[0], box[LEFT] + x), box[RIGHT] - x)
    state[1] = min(max(state[1], box[FRONT] + y), box[BACK] - y)


@njit(cache=True, error_model="numpy")
def write_pose(state: FloatArray, device: FloatArray, pose: FloatArray) -> None:
    """Compute the pose of a state.

    Parameters
    ----------
    state, device : ndarray
        As laid out at the top of this file.
    pose : ndarray, shape (7,)
        Receives rotation centre (m) and orientation (scalar first), world frame.
    """
    w, i, j, k = state[3], state[4], state[5], state[6]
    x, y, z = device[MIDDLE], device[MIDDLE + 1], device[MIDDLE + 2]
    pose[0] = state[0] - ((1 - 2 * (j * j + k * k)) * x + 2 * (i * j - k * w) * y + 2 * (i * k + j * w) * z)
    pose[1] = state[1] - (2 * (i * j + k * w) * x + (1 - 2 * (i * i + k * k)) * y + 2 * (j * k - i * w) * z)
    pose[2] = state[2] - (2 * (i * k - j * w) * x + 2 * (j * k + i * w) * y + (1 - 2 * (i * i + j * j)) * z)
    pose[3], pose[4], pose[5], pose[6] = w, i, j, k
