"""Compiled motion of a gradient-pulled robot, and the search for currents that move it along a path.

Kernels that call each other share this file, since numba's cache does not see a change in another one. Lengths in m,
angles in rad; a robot is an array `body`: moment, drag, rotational drag, stiffness, stop, places of magnet and centre
of drag along the cantilever (`smolbot.motion.robot.Robot`). A state is (x, y, heading) of the rotation centre.
"""

# mypy: disable-error-code="no-untyped-call,no-untyped-def"
from __future__ import annotations

import math

import numpy as np
from numba import njit

MOMENT, DRAG, ROTATIONAL_DRAG, STIFFNESS, STOP, MAGNET, CENTER = range(7)
BODY = 7
# Weights of a plan, per mm or rad: distance from the path, arc length that is missing, heading, push at the tail,
# currents, weakness of the field; the field (T) below which it is called weak, and the angle beyond which the cost of a
# wrong heading grows linearly
NEAR, FORWARD, HEADING, TAIL, HEAT, FIRM, WEAK, HUBER = range(8)
WEIGHTS = 8
RESIDUALS = 8  # for each window


@njit(cache=True, error_model="numpy", nogil=True)
def wrapped(angle):
    """The same angle within half a turn."""
    return angle - 2.0 * math.pi * round(angle / (2.0 * math.pi))


@njit(cache=True, error_model="numpy", nogil=True)
def deflection(off, torque, stiffness, theta_max):
    """Angle of the magnet toward a field `off` rad from the housing: k d = m B sin(off - d), up to the stop."""
    d = 0.0
    for _ in range(8):
        value = stiffness * d - torque * math.sin(off - d)
        step = value / (stiffness + torque * abs(math.cos(off - d)) + 1e-30)
        d -= step
        if abs(step) < 1e-4:
            break
    return min(max(d, -theta_max), theta_max)


@njit(cache=True, error_model="numpy", nogil=True)
def roll(body, field, gradient, x, y, heading, duration, steps):
    """One window of constant currents.

    Parameters
    ----------
    body : ndarray, shape (7,)
    field : ndarray, shape (2,), in T
        At the origin of the places; the field of all coils together.
    gradient : ndarray, shape (2, 2), in T/m
        ``dB_i / dx_j``.
    x, y, heading : float
        Of the rotation centre, at the start.
    duration : float, in s
    steps : int

    Returns
    -------
    x, y, heading : float
        At the end.
    middle_x, middle_y : float
        Half way through.
    tail : float, in m
        How far the robot was pushed tail first.
    """
    moment, stiffness = body[MOMENT], body[STIFFNESS]
    center, magnet = body[CENTER], body[MAGNET]
    c, s = math.cos(heading), math.sin(heading)
    px, py = x + center * c, y + center * s  # the centre of drag
    dt = duration / steps
    rigid = not math.isfinite(stiffness)
    tail, points = 0.0, heading
    middle_x, middle_y = x, y
    for k in range(steps):
        # the magnet, ahead of the rotation centre; where it pointed in the last step is near enough
        at_x = px - center * c + magnet * math.cos(points)
        at_y = py - center * s + magnet * math.sin(points)
        bx = field[0] + gradient[0, 0] * at_x + gradient[0, 1] * at_y
        by = field[1] + gradient[1, 0] * at_x + gradient[1, 1] * at_y
        size = math.sqrt(bx * bx + by * by)
        if size < 1e-15:
            break
        off = wrapped(math.atan2(by, bx) - heading)
        bent = 0.0 if rigid else deflection(off, moment * size, stiffness, body[STOP])
        # for a constant field tan(angle / 2) decays exponentially, which is stable at any step
        angle = off - bent
        half = min(max(0.5 * angle, -1.5707), 1.5707)
        after = 2.0 * math.atan(math.tan(half) * math.exp(-moment * size / body[ROTATIONAL_DRAG] * dt))
        points = heading + bent + 0.5 * (angle - after)
        ux, uy = math.cos(points), math.sin(points)
        fx = moment * (gradient[0, 0] * ux + gradient[1, 0] * uy)
        fy = moment * (gradient[0, 1] * ux + gradient[1, 1] * uy)
        lever = (magnet - center) * (c * fy - s * fx)
        heading += angle - after + dt * lever / body[ROTATIONAL_DRAG]
        c, s = math.cos(heading), math.sin(heading)
        px += dt * fx / body[DRAG]
        py += dt * fy / body[DRAG]
        tail += max(-(fx * ux + fy * uy), 0.0) * dt / body[DRAG]
        if 2 * (k + 1) <= steps:
            middle_x, middle_y = px - center * c, py - center * s
    return px - center * c, py - center * s, heading, middle_x, middle_y, tail


@njit(cache=True, error_model="numpy", nogil=True)
def nearest(points, arc, first, last, guess, x, y):
    """Arc length of the nearest place on the leg first..last, and the offset from it, along and across.

    Only the strand within some segments of arc length `guess` is looked at. The offset along is not zero before the
    start and beyond the end of the leg only.
    """
    low, high = first, last
    while low < last - 1 and arc[low + 1] < guess - 1e-3:
        low += 1
    while high > low + 1 and arc[high - 1] > guess + 2e-3:
        high -= 1
    best = 1e300
    s = across = along = 0.0
    for i in range(low, high):
        length = arc[i + 1] - arc[i]
        tx, ty = (points[i + 1, 0] - points[i, 0]) / length, (points[i + 1, 1] - points[i, 1]) / length
        dx, dy = x - points[i, 0], y - points[i, 1]
        t = dx * tx + dy * ty
        held = min(max(t, 0.0), length)
        beside, beyond = tx * dy - ty * dx, t - held
        away = beside * beside + beyond * beyond
        if away < best:
            best, s, across, along = away, arc[i] + held, beside, beyond
    return s, along, across


@njit(cache=True, error_model="numpy", nogil=True)
def _residuals(currents, b, g, high, body, state, drift, rest, duration, steps, route, leg, weights, out, ends):
    """Fill the residuals of a plan of one or more windows, and the states at their ends; return the cost."""
    points, arc, compass, spacing = route
    first, last, guess, stride, ahead, near = leg
    n = b.shape[0]
    x, y, heading = state[0], state[1], state[2]
    field, gradient = np.empty(2), np.empty((2, 2))
    goal, cost, row = guess, 0.0, 0
    for w in range(currents.shape[0]):
        for i in range(2):
            field[i] = gradient[i, 0] = gradient[i, 1] = 0.0
            for c in range(n):
                field[i] += currents[w, c] * b[c, i]
                gradient[i, 0] += currents[w, c] * g[c, i, 0]
                gradient[i, 1] += currents[w, c] * g[c, i, 1]
        at_x, at_y = x + body[MAGNET] * math.cos(heading), y + body[MAGNET] * math.sin(heading)
        bx = field[0] + gradient[0, 0] * at_x + gradient[0, 1] * at_y
        by = field[1] + gradient[1, 0] * at_x + gradient[1, 1] * at_y
        # where the coils nearly cancel, a robot goes where their errors send it
        out[row + 7] = weights[FIRM] * max(1.0 - math.sqrt(bx * bx + by * by) / weights[WEAK], 0.0)
        x, y, heading, mx, my, tail = roll(body, field, gradient, x, y, heading, duration, steps)
        x, y = x + drift[0] * duration, y + drift[1] * duration
        s, along, across = nearest(points, arc, first, last, guess, mx, my)
        out[row], out[row + 1] = 0.5e3 * weights[NEAR] * across, 0.5e3 * weights[NEAR] * along
        s, along, across = nearest(points, arc, first, last, guess, x, y)
        out[row + 2], out[row + 3] = 1e3 * weights[NEAR] * across, 1e3 * weights[NEAR] * along
        goal = min(goal + stride, arc[last])
        out[row + 4] = 1e3 * weights[FORWARD] * (goal - s - along)
        on = s + ahead
        if s < arc[last] - near:
            on = min(on, arc[last])  # no turning into the next leg before this one is done
        at = min(max((on - arc[first]) / spacing, 0.0), compass.shape[0] - 1.001)
        i = int(at)
        angle = compass[i] + (at - i) * wrapped(compass[i + 1] - compass[i])
        off = abs(wrapped(heading - angle))
        knee = weights[HUBER]
        out[row + 5] = weights[HEADING] * (off if off < knee else math.sqrt(knee * (2.0 * off - knee)))
        out[row + 6] = 1e3 * weights[TAIL] * tail
        row += RESIDUALS
        ends[w, 0], ends[w, 1], ends[w, 2] = x, y, heading
        x, y = x + drift[0] * rest, y + drift[1] * rest
    for w in range(currents.shape[0]):
        for c in range(n):
            out[row] = weights[HEAT] * currents[w, c] / high[c]
            row += 1
    for i in range(row):
        cost += out[i] * out[i]
    return cost


@njit(cache=True, error_model="numpy", nogil=True)
def _boxed_step(hessian, slope, z, low, high, step):
    """Minimise the quadratic model within the bounds, one current after the other."""
    n = z.shape[0]
    step[:] = 0.0
    for _ in range(30):
        moved = 0.0
        for i in range(n):
            pull = slope[i]
            for j in range(n):
                pull += hessian[i, j] * step[j]
            new = step[i] - pull / hessian[i, i]
            new = min(max(new, low[i] - z[i]), high[i] - z[i])
            moved = max(moved, abs(new - step[i]))
            step[i] = new
        if moved < 1e-3:
            break


@njit(cache=True, error_model="numpy", nogil=True)
def plan(b, g, low, high, body, state, drift, rest, duration, steps, route, leg, weights, starts, count, rounds):
    """Currents of the next window, or of the next two, that keep to the path and go forward.

    All starts are tried, and the best `count` of them are improved by Gauss-Newton steps within the bounds.

    Parameters
    ----------
    b, g : ndarray, shape (n_coils, 2), (n_coils, 2, 2)
        Horizontal field (T/A) at the origin of the places, and its gradient (T/(A m)).
    low, high : ndarray, shape (n_coils,), in A
    body : ndarray, shape (7,)
    state : ndarray, shape (3,)
        Place from the origin, and heading, when the window begins.
    drift : ndarray, shape (2,), in m/s
    rest, duration : float, in s
        Between two windows, and of one.
    steps : int
        Of the integration, per window.
    route : tuple of ndarray
        Points (k, 2) from the origin, their arc lengths (k,), headings (l,) from the leg's first vertex on, and the
        spacing of these in m.
    leg : tuple
        First and last vertex, arc length now, arc length that is wanted of each window, how far ahead the heading
        counts, and distance from its end at which the leg is done, in m.
    weights : ndarray, shape (8,)
    starts : ndarray, shape (m, windows, n_coils), in A
    count, rounds : int

    Returns
    -------
    cost : float
    currents : ndarray, shape (windows, n_coils), in A
    ends : ndarray, shape (windows, 3)
        States at the ends of the windows.
    """
    m, windows, n = starts.shape
    size = windows * n
    total = windows * RESIDUALS + size
    out, trial = np.empty(total), np.empty(total)
    jacobian, hessian, slope, step = np.empty((total, size)), np.empty((size, size)), np.empty(size), np.empty(size)
    ends, z = np.empty((windows, 3)), np.empty((windows, n))
    lows, highs = np.empty(size), np.empty(size)
    for i in range(size):
        lows[i], highs[i] = low[i % n], high[i % n]
    costs = np.empty(m)
    for k in range(m):
        costs[k] = _residuals(
            starts[k], b, g, high, body, state, drift, rest, duration, steps, route, leg, weights, out, ends
        )
    best, chosen = 1e300, starts[0].copy()
    for _ in range(min(count, m)):
        k = int(np.argmin(costs))
        if costs[k] >= 1e299:
            break
        z[:] = starts[k]
        costs[k] = 1e300
        flat = z.reshape(size)
        cost = _residuals(z, b, g, high, body, state, drift, rest, duration, steps, route, leg, weights, out, ends)
        damping = 1e-3
        for _round in range(rounds):
            for i in range(size):
                before = flat[i]
                nudge = 0.02 * highs[i] if before < 0.5 * (lows[i] + highs[i]) else -0.02 * highs[i]
                flat[i] = before + nudge
                _residuals(z, b, g, high, body, state, drift, rest, duration, steps, route, leg, weights, trial, ends)
                flat[i] = before
                for r in range(total):
                    jacobian[r, i] = (trial[r] - out[r]) / nudge
            for i in range(size):
                slope[i] = 0.0
                for r in range(total):
                    slope[i] += jacobian[r, i] * out[r]
                for j in range(i + 1):
                    value = 0.0
                    for r in range(total):
                        value += jacobian[r, i] * jacobian[r, j]
                    hessian[i, j] = hessian[j, i] = value
            better = False
            for _try in range(3):
                for i in range(size):
                    hessian[i, i] += damping
                _boxed_step(hessian, slope, flat, lows, highs, step)
                for i in range(size):
                    flat[i] += step[i]
                new = _residuals(
                    z, b, g, high, body, state, drift, rest, duration, steps, route, leg, weights, trial, ends
                )
                if new < cost:
                    better = True
                    break
                for i in range(size):
                    flat[i] -= step[i]
                damping *= 10.0
            if not better:
                break
            gained, cost = cost - new, new
            damping = max(0.2 * damping, 1e-6)
            out[:] = trial
            if gained < 1e-3 * cost:
                break
        if cost < best:
            best = cost
            chosen[:] = z
    _residuals(chosen, b, g, high, body, state, drift, rest, duration, steps, route, leg, weights, out, ends)
    return best, chosen, ends
