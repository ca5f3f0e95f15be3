"""Compiled motion of a helix between plates, averaged over turns, and the search for the axis that follows a path.

Kernels that call each other share this file, since numba's cache does not notice a change in another one. Lengths
in m, angles in rad. A state is (x, y, z) of the rotation centre, heading and pitch (up) of the axis, and the course
of the magnet's axis: the heading about which the field turns straight below the magnet; nan while the axis is free.
"""

# mypy: disable-error-code="no-untyped-call,no-untyped-def"
from __future__ import annotations

import math

import numpy as np
from numba import njit

# Entries of `body`: advance per turn (m), housing and magnet ahead of the rotation centre (m), actuation magnet's
# centre (3, m), moment times the weakest field of a turn (N·m) at a distance (m), steering rate (rad/s), torque about
# the axis and across it (N·m) and force across it (N) at which the gel yields, viscous rate (rad/s), stiffness
# (N·m/rad) and stop (rad) of the cantilever, half the length (m), lowest and highest place of the axis between the
# plates (m)
ADVANCE, HOUSING_AHEAD, MAGNET_LEVER, MAGNET, TORQUE, DISTANCE = 0, 1, 2, 3, 6, 7
STEERING, SPIN, TILT, ACROSS, VISCOUS = 8, 9, 10, 11, 12
STIFFNESS, STOP, HALF_LENGTH, LOW, HIGH = 13, 14, 15, 16, 17
X, Y, Z, HEADING, PITCH, COURSE = range(6)
# Factors that are learned: on advance and steering; offset of the axis (rad), drift to the left per turn (m)
ADVANCE_FACTOR, STEERING_FACTOR, AXIS_OFFSET, LEFT_DRIFT = range(4)
SUBSTEPS = 6  # of a turn
PHASES = 16  # of a turn, to average over


@njit(cache=True, error_model="numpy", nogil=True)
def wrap_angle(angle):
    """Wrap an angle to within half a turn of zero.

    Parameters
    ----------
    angle : float, in rad

    Returns
    -------
    float, in rad
        Within -pi to pi.
    """
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


@njit(cache=True, error_model="numpy", nogil=True)
def compute_mean_torque(body, heading, pitch, course, sense, load, rx, ry, rz, out):
    """Compute the torque across the robot's axis, averaged over one turn of the magnet.

    The field is that of a dipole at (rx, ry, rz) from the actuation magnet; it is twice as strong along the
    vertical as across. The moment lags behind it as the load requires. Between its stops the magnet follows the
    field by bending the cantilever, and only the cantilever's stiffness turns the housing; at the stops the field
    does.

    Parameters
    ----------
    body : ndarray, shape (18,)
    heading, pitch : float, in rad
        Of the robot's axis.
    course : float, in rad
        Of the magnet's axis.
    sense : float
        1 where the field turns like a robot that moves forward along `course`, -1 against it.
    load : float, in N·m
        About the axis.
    rx, ry, rz : float, in m
        Position relative to the actuation magnet, world frame.
    out : ndarray, shape (2,), in N·m
        Receives the mean torque that turns the axis to the left, and up.
    """
    ch, sh, cp, sp = math.cos(heading), math.sin(heading), math.cos(pitch), math.sin(pitch)
    ax, ay = -sense * math.cos(course), -sense * math.sin(course)
    away = math.sqrt(rx * rx + ry * ry + rz * rz)
    ux, uy, uz = rx / away, ry / away, rz / away
    size = body[TORQUE] * (body[DISTANCE] / away) ** 3
    left_sum = up_sum = 0.0
    for k in range(PHASES):
        phase = 2.0 * math.pi * (k + 0.5) / PHASES
        c, s = math.cos(phase), math.sin(phase)
        px, py, pz = -s * ay, s * ax, -c
        along = 3.0 * (px * ux + py * uy + pz * uz)
        bx, by, bz = size * (along * ux - px), size * (along * uy - py), size * (along * uz - pz)
        left = -sh * bx + ch * by
        up = -sp * (ch * bx + sh * by) + cp * bz
        ahead = cp * (ch * bx + sh * by) + sp * bz
        strength = math.sqrt(left * left + up * up)
        sine = min(load / strength, 0.95)
        cosine = math.sqrt(1.0 - sine * sine)
        mx = (left * cosine + sense * up * sine) / strength  # the moment, turned back by the lag
        my = (up * cosine - sense * left * sine) / strength
        pull = strength * cosine
        bend = 0.0
        for _ in range(5):
            cb, sb = math.cos(bend), math.sin(bend)
            value = pull * sb + ahead * cb + body[STIFFNESS] * bend
            slope = pull * cb - ahead * sb + body[STIFFNESS]
            bend = bend - value / slope if slope > 0.0 else math.copysign(body[STOP], -value)
            bend = min(max(bend, -body[STOP]), body[STOP])
        cb, sb = math.cos(bend), math.sin(bend)
        left_sum += -sb * left - cb * mx * ahead
        up_sum += -(cb * my * ahead + sb * up)
    out[0], out[1] = left_sum / PHASES, up_sum / PHASES


@njit(cache=True, error_model="numpy", nogil=True)
def advance_screw(body, factors, state, course, sense, turns, frequency):
    """Compute the state after some turns of the magnet.

    While it turns in a gel that has yielded, the robot yields across its axis to the mean torque and to the
    magnet's pull, each in proportion to the square of (yield torque about the axis / strength across it) over the
    load. The plates limit nose and tail: an end that would penetrate them is turned and pushed back, in the ratio
    in which the gel lets the housing turn and drift.

    Parameters
    ----------
    body : ndarray, shape (18,)
    factors : ndarray, shape (4,)
        Learned: on advance and steering, offset of the axis (rad), drift to the left per turn (m).
    state : ndarray, shape (6,)
    course : float, in rad
        Target of the magnet's axis.
    sense : float
        1 forward, -1 back.
    turns : float
        Of the magnet.
    frequency : float, in Hz

    Returns
    -------
    ndarray, shape (6,)
    """
    out = state.copy()
    if math.isnan(out[COURSE]):
        out[COURSE] = course
    steps = max(math.ceil(SUBSTEPS * turns - 1e-9), 1)
    share = turns / steps
    load = body[SPIN] * (1.0 + 2.0 * math.pi * frequency / body[VISCOUS])
    turning = 2.0 * math.pi * share * body[SPIN] ** 2 / load
    slew = body[STEERING] * share / frequency
    torque = np.empty(2)
    for _ in range(steps):
        left = wrap_angle(course - out[COURSE])
        out[COURSE] += math.copysign(min(abs(left), slew), left)
        rx, ry, rz = out[X] - body[MAGNET], out[Y] - body[MAGNET + 1], out[Z] - body[MAGNET + 2]
        compute_mean_torque(
            body, out[HEADING] - factors[AXIS_OFFSET], out[PITCH], out[COURSE], sense, load, rx, ry, rz, torque
        )
        squared = rx * rx + ry * ry + rz * rz
        pull = -3.0 * 1.542 * body[TORQUE] * body[DISTANCE] ** 3 / squared**2.5  # N per m of distance
        yielding = turning / body[TILT] ** 2
        yaw = yielding * factors[STEERING_FACTOR] * torque[0]
        rise = yielding * (factors[STEERING_FACTOR] * torque[1] + body[MAGNET_LEVER] * pull * rz)
        middle, tip = out[HEADING] + 0.5 * yaw, out[PITCH] + 0.5 * rise
        c, s = math.cos(middle), math.sin(middle)
        give = turning / body[ACROSS] ** 2 * pull
        drift = share * factors[LEFT_DRIFT] + give * (ry * c - rx * s) - body[HOUSING_AHEAD] * yaw
        ahead = share * sense * factors[ADVANCE_FACTOR] * body[ADVANCE]
        out[X] += ahead * math.cos(tip) * c - drift * s
        out[Y] += ahead * math.cos(tip) * s + drift * c
        out[Z] += ahead * math.sin(tip) + give * rz - body[HOUSING_AHEAD] * rise
        out[HEADING] += yaw
        out[PITCH] += rise
        # a push at an end turns the housing by four parts and moves it by one: (half length)² (ACROSS / TILT)²
        turned = (body[HALF_LENGTH] * body[ACROSS] / body[TILT]) ** 2
        for _ in range(2):
            for end in (-1.0, 1.0):
                sine = math.sin(out[PITCH])
                height = out[Z] + (body[HOUSING_AHEAD] + end * body[HALF_LENGTH]) * sine
                over = max(height - body[HIGH], 0.0) - max(body[LOW] - height, 0.0)
                lean = end * over * turned / (1.0 + turned) / body[HALF_LENGTH]
                out[PITCH] -= lean
                out[Z] -= over / (1.0 + turned) - body[HOUSING_AHEAD] * lean
    return out


@njit(cache=True, error_model="numpy", nogil=True)
def find_nearest(points, arc, x, y, near, window):
    """Find the nearest place on a polyline.

    Parameters
    ----------
    points : ndarray, shape (n, 2), in m
    arc : ndarray, shape (n,), in m
        Arc length at each point.
    x, y : float, in m
        The point.
    near : float, in m
        Arc length near which to search.
    window : float, in m
        Only segments within this distance of `near` are searched.

    Returns
    -------
    s : float, in m
        Arc length of the nearest place.
    side : float, in m
        Signed distance to it, positive to the left of the path.
    heading : float, in rad
        Of the path there.
    """
    best, place, side, heading = math.inf, near, 0.0, 0.0
    for i in range(len(arc) - 1):
        if arc[i + 1] < near - window or arc[i] > near + window:
            continue
        dx, dy = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
        length = arc[i + 1] - arc[i]
        u, v = x - points[i, 0], y - points[i, 1]
        along = min(max((u * dx + v * dy) / length, 0.0), length)
        ex, ey = u - along * dx / length, v - along * dy / length
        distance = math.sqrt(ex * ex + ey * ey)
        if distance < best:
            best, place = distance, arc[i] + along
            side = math.copysign(distance, dx * v - dy * u)
            heading = math.atan2(dy, dx)
    return place, side, heading


@njit(cache=True, error_model="numpy", nogil=True)
def compute_course_cost(body, factors, state, course, turns, frequency, points, arc, near, weight):
    """Compute the cost of holding a course.

        J = mean(distance to the path)² + (weight * error of the last heading)²

    Parameters
    ----------
    body : ndarray, shape (18,)
    factors : ndarray, shape (4,)
    state : ndarray, shape (6,)
    course : float, in rad
        Of the magnet's axis.
    turns : float
        Of the magnet.
    frequency : float, in Hz
    points : ndarray, shape (n, 2), in m
        Of the path.
    arc : ndarray, shape (n,), in m
        Arc length at each point.
    near : float, in m
        Arc length near which to search for the nearest place.
    weight : float, in m/rad

    Returns
    -------
    float, in m²
    """
    cost, at, heading = 0.0, state, 0.0
    pieces = max(math.ceil(3.0 * turns - 1e-9), 1)
    for _ in range(pieces):
        at = advance_screw(body, factors, at, course, 1.0, turns / pieces, frequency)
        near, side, heading = find_nearest(points, arc, at[X], at[Y], near, 5e-3)
        cost += side * side / pieces
    off = weight * wrap_angle(at[HEADING] - heading)
    return cost + off * off


@njit(cache=True, error_model="numpy", nogil=True)
def find_best_course(body, factors, state, max_tilt, max_course_change, turns, frequency, points, arc, near, weight):
    """Find the course with the least cost, within limits of tilt and steering.

    Parameters
    ----------
    body : ndarray, shape (18,)
    factors : ndarray, shape (4,)
    state : ndarray, shape (6,)
    max_tilt : float, in rad
        Largest angle from the robot's heading.
    max_course_change : float, in rad
        Largest angle from the present course of the magnet's axis.
    turns : float
        Of the magnet.
    frequency : float, in Hz
    points : ndarray, shape (n, 2), in m
        Of the path.
    arc : ndarray, shape (n,), in m
        Arc length at each point.
    near : float, in m
        Arc length near which to search for the nearest place.
    weight : float, in m/rad
        Of the heading's error; see `compute_course_cost`.

    Returns
    -------
    float, in rad
        If both limits cannot be kept, as near to the robot's heading as the axis can come.
    """
    low, high = state[HEADING] - max_tilt, state[HEADING] + max_tilt
    if not math.isnan(state[COURSE]):
        now = state[HEADING] + wrap_angle(state[COURSE] - state[HEADING])
        low, high = max(low, now - max_course_change), min(high, now + max_course_change)
        if low > high:  # the axis is far off: as near as it can come
            low = high = now + math.copysign(max_course_change, state[HEADING] - now)
    count = 17
    best = 0.0
    for _ in range(2):  # the second time, finely around the best of the first
        costs = np.empty(count)
        for i in range(count):
            course = low + (high - low) * i / (count - 1)
            costs[i] = compute_course_cost(body, factors, state, course, turns, frequency, points, arc, near, weight)
        i = int(np.argmin(costs))
        best, step = low + (high - low) * i / (count - 1), (high - low) / (count - 1)
        low, high = max(low, best - step), min(high, best + step)
    return best
