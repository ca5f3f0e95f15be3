"""Kernels of one physics step: true coil fields at the magnet, coil currents, and the oscillating cantilever.

They call each other and so share this file (numba's cache does not see a change in another one). All work in the
body frame: x sideways, y the axis of oscillation, z along the cantilever.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from sim.tank.magnetics.coil_fields import (
    COMMAND,
    COUNTS,
    CURRENT,
    FRAME,
    GAIN,
    KIND,
    OFFSET,
    ORIGIN,
    PLACE,
    ROUND,
    SCALE,
    SINE,
    TIME_CONSTANT,
)  # fmt: skip
from smolbot.core.arrays import FloatArray

Triple = tuple[float, float, float]
Quad = tuple[float, float, float, float]

# Entries of `device`: moment (A·m²), its direction at rest (body x, z), l0, theta_max, squared angular frequency, dry
# friction (rad/s²), damping (1/s), restitution of the stops, inertia (kg·m²), middle of the housing from the
# rotation centre (3)
MOMENT, REST_X, REST_Z, L0, THETA_MAX, OMEGA_SQUARED, FRICTION, ETA, RESTITUTION, INERTIA, MIDDLE = range(11)
# Entries of `state`: deflection (rad), rate (rad/s), time in the window (s), angular frequency of the drive (rad/s)
DEFLECTION, RATE, TIME, DRIVE = range(4)
STATE_LENGTH = 4
ON_AXIS = 1e-9  # m: radius below which the field has no radial part
MIN_ACTUATION_CURRENT = 1e-5  # A: below it a coil moves nothing: its field is below 1e-8 T
MIN_MEASURABLE_CURRENT = 1e-12  # A: below it no sensor measures its field


@njit(cache=True, error_model="numpy")
def _find_cell(x: float, origin: float, scale: float, count: int) -> tuple[int, Quad, Quad]:
    """Return the first coefficient of the cell that holds x, the four cubic B-spline weights and their derivatives.

    Beyond the table the outermost cell is used.
    """
    # weights of four cubic B-splines, and of their derivatives
    u = (x - origin) * scale
    i = max(1, min(math.floor(u), count - 3))
    t = min(max(u - i, 0.0), 1.0)
    s = 1.0 - t
    value = (s**3 / 6.0, (4.0 - 6.0 * t**2 + 3.0 * t**3) / 6.0, (4.0 - 6.0 * s**2 + 3.0 * s**3) / 6.0, t**3 / 6.0)
    slope = (-0.5 * s**2 * scale, (1.5 * t**2 - 2.0 * t) * scale, (2.0 * s - 1.5 * s**2) * scale, 0.5 * t**2 * scale)
    return i - 1, value, slope


@njit(cache=True, error_model="numpy")
def _compute_round_field(
    x: float, y: float, z: float, row: FloatArray, table: FloatArray, b: FloatArray, g: FloatArray
) -> None:
    """Compute field (T per A) and gradient (T per (A·m)) of a round coil at a point, both in the coil's own frame."""
    radius = math.sqrt(x * x + y * y)
    n_heights = int(row[COUNTS + 1])
    i, wr, dr = _find_cell(radius, row[ORIGIN], row[SCALE], int(row[COUNTS]))
    j, wh, dh = _find_cell(z, row[ORIGIN + 1], row[SCALE], n_heights)
    start = int(row[OFFSET])
    br = bz = brr = brz = bzr = bzz = 0.0
    for p in range(4):
        at = start + 2 * ((i + p) * n_heights + j)
        radial = axial = radial_slope = axial_slope = 0.0
        for q in range(4):
            radial += table[at + 2 * q] * wh[q]
            axial += table[at + 2 * q + 1] * wh[q]
            radial_slope += table[at + 2 * q] * dh[q]
            axial_slope += table[at + 2 * q + 1] * dh[q]
        br += wr[p] * radial
        bz += wr[p] * axial
        brr += dr[p] * radial
        bzr += dr[p] * axial
        brz += wr[p] * radial_slope
        bzz += wr[p] * axial_slope
    if radius > ON_AXIS:
        c, s, across = x / radius, y / radius, br / radius
    else:
        c, s, across = 1.0, 0.0, brr
    b[0], b[1], b[2] = br * c, br * s, bz
    g[0, 0] = brr * c * c + across * s * s
    g[0, 1] = g[1, 0] = (brr - across) * c * s
    g[1, 1] = brr * s * s + across * c * c
    g[0, 2], g[1, 2] = brz * c, brz * s
    g[2, 0], g[2, 1], g[2, 2] = bzr * c, bzr * s, bzz


@njit(cache=True, error_model="numpy")
def _compute_flat_field(
    x: float, y: float, z: float, row: FloatArray, table: FloatArray, b: FloatArray, g: FloatArray
) -> None:
    """Compute field (T per A) and gradient (T per (A·m)) of a flat coil at a point, both in the coil's own frame."""
    ny, nz = int(row[COUNTS + 1]), int(row[COUNTS + 2])
    i, wx, dx = _find_cell(x, row[ORIGIN], row[SCALE], int(row[COUNTS]))
    j, wy, dy = _find_cell(y, row[ORIGIN + 1], row[SCALE], ny)
    k, wz, dz = _find_cell(z, row[ORIGIN + 2], row[SCALE], nz)
    start = int(row[OFFSET])
    b[:] = 0.0
    g[:, :] = 0.0
    for p in range(4):
        for q in range(4):
            at = start + 3 * (((i + p) * ny + j + q) * nz + k)
            level, along_x, along_y = wx[p] * wy[q], dx[p] * wy[q], wx[p] * dy[q]
            for c in range(3):
                value = slope = 0.0
                for r in range(4):
                    value += table[at + 3 * r + c] * wz[r]
                    slope += table[at + 3 * r + c] * dz[r]
                b[c] += level * value
                g[c, 0] += along_x * value
                g[c, 1] += along_y * value
                g[c, 2] += level * slope


@njit(cache=True, error_model="numpy")
def compute_coil_field(
    point: FloatArray,
    row: FloatArray,
    table: FloatArray,
    rotation_result_to_world: FloatArray,
    b: FloatArray,
    g: FloatArray,
    work: FloatArray,
) -> None:
    """Compute field and gradient of one coil at a world point.

    The result is in the frame whose axes are the columns of `rotation_result_to_world`.

    Parameters
    ----------
    point : ndarray, shape (3,), in m
        World frame.
    row : ndarray, shape (22,)
        The coil's row of `sim.tank.magnetics.coil_fields.CoilSet`.
    table : ndarray
        The coefficients of `sim.tank.magnetics.coil_fields.CoilSet`.
    rotation_result_to_world : ndarray, shape (3, 3)
        From the result's frame to the world frame; the identity for a result in the world frame.
    b : ndarray, shape (3,), in T per A
        Receives the field.
    g : ndarray, shape (3, 3), in T per (A·m)
        Receives the gradient, ``g[i, j] = dB_i / dx_j``.
    work : ndarray, shape (4, 3, 3)
        Scratch memory: an allocation costs as much as a field.
    """
    turn, half, own_g, own_b = work[0], work[1], work[2], work[3, 0]
    dx, dy, dz = point[0] - row[PLACE], point[1] - row[PLACE + 1], point[2] - row[PLACE + 2]
    for r in range(3):
        fx, fy, fz = row[FRAME + 3 * r], row[FRAME + 3 * r + 1], row[FRAME + 3 * r + 2]
        work[3, 1, r] = fx * dx + fy * dy + fz * dz
        for c in range(3):
            turn[r, c] = (
                fx * rotation_result_to_world[0, c]
                + fy * rotation_result_to_world[1, c]
                + fz * rotation_result_to_world[2, c]
            )
    x, y, z = work[3, 1, 0], work[3, 1, 1], work[3, 1, 2]
    if row[KIND] == ROUND:
        _compute_round_field(x, y, z, row, table, own_b, own_g)
    else:
        _compute_flat_field(x, y, z, row, table, own_b, own_g)
    gain = row[GAIN]
    for r in range(3):
        for c in range(3):
            half[r, c] = gain * (own_g[r, 0] * turn[0, c] + own_g[r, 1] * turn[1, c] + own_g[r, 2] * turn[2, c])
    for r in range(3):
        b[r] = gain * (own_b[0] * turn[0, r] + own_b[1] * turn[1, r] + own_b[2] * turn[2, r])
        for c in range(3):
            g[r, c] = turn[0, r] * half[0, c] + turn[1, r] * half[1, c] + turn[2, r] * half[2, c]


@njit(cache=True, error_model="numpy")
def compute_fields(points: FloatArray, rows: FloatArray, table: FloatArray) -> FloatArray:
    """Compute the field of every coil at world points.

    Parameters
    ----------
    points : ndarray, shape (n, 3), in m
        World frame.
    rows, table : ndarray
        Of `sim.tank.magnetics.coil_fields.CoilSet`.

    Returns
    -------
    ndarray, shape (n_coils, n, 3), in T per A
        World frame.
    """
    out = np.empty((len(rows), len(points), 3))
    g, world, work = np.empty((3, 3)), np.eye(3), np.empty((4, 3, 3))
    for c in range(len(rows)):
        for i in range(len(points)):
            compute_coil_field(points[i], rows[c], table, world, out[c, i], g, work)
    return out


@njit(cache=True, error_model="numpy")
def advance_cantilever(
    position: Triple,
    quaternion: Quad,
    device: FloatArray,
    earth: FloatArray,
    rows: FloatArray,
    table: FloatArray,
    circuits: FloatArray,
    state: FloatArray,
    poses: FloatArray,
    index: int,
    trace: FloatArray,
    used: int,
    step: float,
    substeps: int,
    commands: FloatArray,
    at: int,
) -> tuple[float, float, float, float, float, float]:
    """Advance coil currents and cantilever by one physics step and return the mean load on the robot.

        theta'' = -2 eta theta' - friction sign(theta') - omega0² theta + Q / I
        Q = m B . (y x m_dir) + F . (y x r),   F = grad(m . B),   I = m_mag l0²

    The field is expanded to first order around the magnet's position at the start of the step.

    Parameters
    ----------
    position : tuple of 3, in m
        Middle of the housing, world frame.
    quaternion : tuple of 4
        Orientation of the housing, scalar first.
    device : ndarray
        As laid out at the top of this file.
    earth : ndarray, shape (3,), in T
        Uniform field, world frame.
    rows, table : ndarray
        Of `sim.tank.magnetics.coil_fields.CoilSet`; as many rows as `circuits`.
    circuits, state : ndarray
        As laid out at the top of this file; `state` and the currents are advanced in place.
    poses : ndarray, shape (k, 7)
        Row `index` receives the rotation centre (m) and the orientation at the start of the step, world frame.
    index : int
    trace : ndarray, shape (l, 1 + n_coils)
        Rows from `used` on receive deflection (rad) and currents (A) at the end of each substep.
    used : int
    step : float, in s
    substeps : int
    commands : ndarray, shape (m, n), in A
        Sampled commands of the first n coils, one row per substep from row `at` on; empty if the commands of
        `circuits` apply.
    at : int

    Returns
    -------
    tuple of 6
        Mean force (N) and mean torque about the middle of the housing (N·m), body frame.
    """
    w, x, y, z = quaternion
    scratch = np.empty((7, 3, 3))
    rotation, work, point, e = scratch[0], scratch[1:5], scratch[5, 0], scratch[5, 1]
    pose = poses[index]
    rotation[0, 0], rotation[0, 1], rotation[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    rotation[1, 0], rotation[1, 1], rotation[1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    rotation[2, 0], rotation[2, 1], rotation[2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
    moment, rest_x, rest_z, l0 = device[MOMENT], device[REST_X], device[REST_Z], device[L0]
    theta_max, omega2, friction = device[THETA_MAX], device[OMEGA_SQUARED], device[FRICTION]
    eta, restitution, agility = device[ETA], device[RESTITUTION], 1.0 / device[INERTIA]
    theta, rate = state[DEFLECTION], state[RATE]
    start_x, start_z = l0 * math.sin(theta), l0 * math.cos(theta)
    for r in range(3):
        center = position[r]
        for c in range(3):
            center -= rotation[r, c] * device[MIDDLE + c]
        pose[r] = center
        point[r] = center + rotation[r, 0] * start_x + rotation[r, 2] * start_z
    pose[3], pose[4], pose[5], pose[6] = quaternion

    # fields and gradients per A at the magnet, body frame; coils without current are left out
    n_coils = len(rows)
    h = step / substeps
    live, idle = np.empty(n_coils, np.int64), np.empty(n_coils, np.int64)
    n_live = n_idle = 0
    b, g = np.empty((n_coils + 1, 3)), np.empty((n_coils + 1, 3, 3))
    keep, gain = np.empty(n_coils), np.empty(n_coils)
    n_sampled = commands.shape[1] if len(commands) > 0 else 0
    for c in range(n_coils):
        sounding = False
        if c < n_sampled:
            for k in range(substeps):
                if commands[at + k, c] != 0.0:
                    sounding = True
                    break
        keep[c], gain[c] = 0.0, 1.0
        if circuits[c, TIME_CONSTANT] > 0:
            keep[c] = math.exp(-h / circuits[c, TIME_CONSTANT])
            # the amplifier compensates the attenuation by the coil
            gain[c] = math.sqrt(1.0 + (state[DRIVE] * circuits[c, TIME_CONSTANT]) ** 2)
        if (
            abs(circuits[c, CURRENT]) > MIN_ACTUATION_CURRENT
            or circuits[c, COMMAND] != 0.0
            or circuits[c, SINE] != 0.0
            or sounding
        ):
            compute_coil_field(point, rows[c], table, rotation, b[n_live], g[n_live], work)
            live[n_live] = c
            n_live += 1
        elif abs(circuits[c, CURRENT]) > MIN_MEASURABLE_CURRENT:
            idle[n_idle] = c
            n_idle += 1
        else:
            circuits[c, CURRENT] = 0.0
    for r in range(3):
        e[r] = rotation[0, r] * earth[0] + rotation[1, r] * earth[1] + rotation[2, r] * earth[2]

    damp, push = math.exp(-2.0 * eta * h), h * math.exp(-eta * h)  # frequency and decay are right to 2nd order
    slip = friction * h
    moments = np.zeros((n_live + 1, 2))  # sums of current times moment (A²·m²): mean force and torque
    sum_x = sum_z = 0.0
    sine, cosine = math.sin(theta), math.cos(theta)
    for k in range(substeps):
        wave = math.sin(state[DRIVE] * (state[TIME] + (k + 0.5) * h)) if state[DRIVE] > 0 else 0.0
        bx, bz, gxx, gxz, gzx, gzz = e[0], e[2], 0.0, 0.0, 0.0, 0.0
        for n in range(n_live):
            q = live[n]
            command = (
                commands[at + k, q] if q < n_sampled else circuits[q, COMMAND] + circuits[q, SINE] * gain[q] * wave
            )
            current = command + (circuits[q, CURRENT] - command) * keep[q]
            circuits[q, CURRENT] = current
            bx += current * b[n, 0]
            bz += current * b[n, 2]
            gxx += current * g[n, 0, 0]
            gxz += current * g[n, 0, 2]
            gzx += current * g[n, 2, 0]
            gzz += current * g[n, 2, 2]
        # torque about the rotation centre: moment in the field, and force on the magnet times its lever
        dx, dz = l0 * sine - start_x, l0 * cosine - start_z
        mx = moment * (rest_x * cosine + rest_z * sine)
        mz = moment * (rest_z * cosine - rest_x * sine)
        torque = (bx + gxx * dx + gxz * dz) * mz - (bz + gzx * dx + gzz * dz) * mx
        torque += l0 * (cosine * (gxx * mx + gzx * mz) - sine * (gxz * mx + gzz * mz))
        rate = rate * damp + push * (torque * agility - omega2 * theta)
        rate = 0.0 if abs(rate) <= slip else rate - math.copysign(slip, rate)
        turn = h * rate
        theta += turn
        if abs(theta) > theta_max:
            theta = math.copysign(theta_max, theta)
            if rate * theta > 0:
                rate = -restitution * rate
            sine, cosine = math.sin(theta), math.cos(theta)
        else:  # of a few mrad: the series is exact to rounding, at a tenth of the cost
            ds, dc = turn - turn**3 / 6.0, 1.0 - 0.5 * turn**2 + turn**4 / 24.0
            sine, cosine = sine * dc + cosine * ds, cosine * dc - sine * ds
        for n in range(n_live):
            moments[n, 0] += circuits[live[n], CURRENT] * mx
            moments[n, 1] += circuits[live[n], CURRENT] * mz
        moments[n_live, 0] += mx
        moments[n_live, 1] += mz
        sum_x += dx
        sum_z += dz
        row = trace[used + k]
        row[0] = theta
        for n in range(n_idle):
            circuits[idle[n], CURRENT] *= keep[idle[n]]  # too weak to move the magnet, but measurable
        for c in range(n_coils):
            row[1 + c] = circuits[c, CURRENT]
    state[DEFLECTION], state[RATE] = theta, rate
    state[TIME] += step

    # mean force (N) and torque (N·m) of the step about the housing's middle, body frame
    dx, dz = sum_x / substeps, sum_z / substeps
    g[n_live] = 0.0
    for r in range(3):
        b[n_live, r] = e[r]
    fx = fy = fz = tx = ty = tz = 0.0
    for n in range(n_live + 1):
        mx, mz = moments[n, 0] / substeps, moments[n, 1] / substeps
        fx += g[n, 0, 0] * mx + g[n, 2, 0] * mz
        fy += g[n, 0, 1] * mx + g[n, 2, 1] * mz
        fz += g[n, 0, 2] * mx + g[n, 2, 2] * mz
        bx = b[n, 0] + g[n, 0, 0] * dx + g[n, 0, 2] * dz
        by = b[n, 1] + g[n, 1, 0] * dx + g[n, 1, 2] * dz
        bz = b[n, 2] + g[n, 2, 0] * dx + g[n, 2, 2] * dz
        tx += -mz * by
        ty += mz * bx - mx * bz
        tz += mx * by
    ax, ay, az = start_x + dx - device[MIDDLE], -device[MIDDLE + 1], start_z + dz - device[MIDDLE + 2]
    return fx, fy, fz, tx + ay * fz - az * fy, ty + az * fx - ax * fz, tz + ax * fy - ay * fx
