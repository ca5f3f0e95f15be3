"""Compiled motion of a gradient-pulled robot, and the search for currents that move it along a path.

Kernels that call each other share this file, since numba's cache does not notice a change in another one. Lengths
in m, angles in rad. A robot is an array `body`: moment, drag, rotational drag, stiffness, stop, positions of magnet
and centre of drag along the cantilever (`smolbot.motion.robot.Robot`). A state is (x, y, heading) of the rotation
centre.
"""

# mypy: disable-error-code="no-untyped-call,no-untyped-def"
from __future__ import annotations

import math

import numpy as np
from numba import njit

MOMENT, DRAG, ROTATIONAL_DRAG, STIFFNESS, STOP, MAGNET, CENTER = range(7)
# Weights of a plan, per mm or rad: distance from the path, arc length that is missing, heading, push at the tail,
# currents, weakness of the field; the field (T) below which it is called weak, and the angle beyond which the cost of a
# wrong heading grows linearly
PATH_DISTANCE, MISSING_PROGRESS, HEADING, TAIL_PUSH, CURRENT_COST, FIELD_WEAKNESS, WEAK_FIELD, HUBER_ANGLE = range(8)
RESIDUALS_PER_WINDOW = 8  # for each window
SEARCH_BACK, SEARCH_AHEAD = 1e-3, 2e-3  # m: range of arc lengths around the last one in which a robot is searched


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
    return angle - 2.0 * math.pi * round(angle / (2.0 * math.pi))


@njit(cache=True, error_model="numpy", nogil=True)
def compute_deflection(field_angle, torque, stiffness, theta_max):
    """Compute the angle by which the magnet bends toward a field, up to the stop.

        k d = m B sin(off - d)

    Parameters
    ----------
    field_angle : float, in rad
        Angle from the housing to the field.
    torque : float, in N·m
        Moment times flux density.
    stiffness : float, in N·m/rad
    theta_max : float, in rad
        Stop.

    Returns
    -------
    float, in rad
    """
    d = 0.0
    for _ in range(8):
        value = stiffness * d - torque * math.sin(field_angle - d)
        step = value / (stiffness + torque * abs(math.cos(field_angle - d)) + 1e-30)
        d -= step
        if abs(step) < 1e-4:
            break
    return min(max(d, -theta_max), theta_max)


@njit(cache=True, error_model="numpy", nogil=True)
def simulate_window(body, field, gradient, x, y, heading, duration, steps):
    """Simulate one window of constant currents.

    Parameters
    ----------
    body : ndarray, shape (7,)
    field : ndarray, shape (2,), in T
        At the origin of the coordinates; the field of all coils together.
    gradient : ndarray, shape (2, 2), in T/m
        ``dB_i / dx_j``.
    x, y : float, in m
        Of the rotation centre, at the start.
    heading : float, in rad
        At the start.
    duration : float, in s
    steps : int
        Integration steps.

    Returns
    -------
    x, y : float, in m
        At the end.
    heading : float, in rad
        At the end.
    middle_x, middle_y : float, in m
        At half of the window.
    tail : float, in m
        Distance by which the robot was pushed tail first.
    """
    none = np.empty((0, 0))
    return _simulate_with_derivatives(body, field, gradient, x, y, heading, duration, steps, none, none, none.shape[1])


@njit(cache=True, error_model="numpy", nogil=True)
def compute_displacement(body, b, g, currents, heading, duration, steps):
    """Compute displacement and heading after one window of coil currents; see `smolbot.motion.gradient.advance`.

    Parameters
    ----------
    body : ndarray, shape (7,)
    b : ndarray, shape (n_coils, 3), in T per A
        Field of the coils at the rotation centre.
    g : ndarray, shape (n_coils, 3, 3), in T per (A m)
        Its gradient, ``[..., i, j] = dB_i / dx_j``.
    currents : ndarray, shape (n_coils,), in A
    heading : float, in rad
        At the start.
    duration : float, in s
    steps : int
        Integration steps.

    Returns
    -------
    x, y : float, in m
        Displacement.
    heading : float, in rad
        At the end.
    """
    field, gradient = np.zeros(2), np.zeros((2, 2))
    for c in range(currents.shape[0]):
        for i in range(2):
            field[i] += currents[c] * b[c, i]
            gradient[i, 0] += currents[c] * g[c, i, 0]
            gradient[i, 1] += currents[c] * g[c, i, 1]
    none = np.empty((0, 0))
    x, y, after, _, _, _ = _simulate_with_derivatives(
        body, field, gradient, 0.0, 0.0, heading, duration, steps, none, none, none.shape[1]
    )
    return x, y, after


@njit(cache=True, error_model="numpy", nogil=True)
def propagate_turn_variance(body, b, g, currents, heading, duration, steps, field_error, variance):
    """Compute the variance of a window's turn, for coil fields with a relative error each and an uncertain heading.

    A robot that points almost against the field may turn either way: the direction depends on errors smaller than
    the model's accuracy.

    Parameters
    ----------
    body : ndarray, shape (7,)
    b : ndarray, shape (n_coils, 3), in T per A
        Field of the coils at the rotation centre.
    g : ndarray, shape (n_coils, 3, 3), in T per (A m)
        Its gradient, ``[..., i, j] = dB_i / dx_j``.
    currents : ndarray, shape (n_coils,), in A
    heading : float, in rad
        At the start.
    duration : float, in s
    steps : int
        Integration steps.
    field_error : float
        Relative error of each coil's field.
    variance : float, in rad²
        Of the heading.

    Returns
    -------
    float, in rad²
    """
    total, apart = np.zeros(3), 0.0
    for c in range(currents.shape[0]):
        for i in range(3):
            total[i] += currents[c] * b[c, i]
            apart += (currents[c] * b[c, i]) ** 2
    size = math.sqrt(total[0] ** 2 + total[1] ** 2 + total[2] ** 2)
    aside, doubt = math.atan2(field_error * math.sqrt(apart), size), math.sqrt(max(variance, 0.0))
    nudge = max(aside, doubt)
    low = compute_displacement(body, b, g, currents, heading - nudge, duration, steps)[2] + nudge
    high = compute_displacement(body, b, g, currents, heading + nudge, duration, steps)[2] - nudge
    slope = (high - low) / (2.0 * nudge)  # of the turn for the heading; the field's direction counts the other way
    return (slope * aside) ** 2 + max((1.0 + slope) ** 2 - 1.0, 0.0) * variance


@njit(cache=True, error_model="numpy", nogil=True)
def _solve_deflection(sine, cosine, torque, stiffness, stop, bent):
    """Compute the deflection toward a field whose angle from the housing has a sine, not below 0, and a cosine.

    Newton's method from a guess `bent`, between nothing and the stop; see `compute_deflection`. Between 0 and `stop`,
    spring and field balance at one angle only.
    """
    if torque * (sine * math.cos(stop) - cosine * math.sin(stop)) >= stiffness * stop:
        return stop
    d = min(max(bent, 0.0), stop)
    for _ in range(8):
        c, s = math.cos(d), math.sin(d)
        along, across = cosine * c + sine * s, sine * c - cosine * s
        step = (stiffness * d - torque * across) / (stiffness + torque * abs(along) + 1e-30)
        d = min(max(d - step, 0.0), stop)
        if abs(step) < 1e-4:
            break
    return d


@njit(cache=True, error_model="numpy", nogil=True)
def _simulate_with_derivatives(body, field, gradient, x, y, heading, duration, steps, inputs, slopes, count):
    """Simulate one window as `simulate_window` does, with the derivatives of its results by `count` variables.

    Angles are kept as unit vectors, (c, s) for the housing, so that a step takes an exponential and square roots
    but hardly any trigonometric function.

    Parameters
    ----------
    inputs : ndarray, shape (6, n)
        Derivatives of the field (x, y), and of the gradient (xx, xy, yx, yy).
    slopes : ndarray, shape (7, n)
        Derivatives of x, y and heading at the start in the first three rows; they are replaced by those of x, y,
        heading, middle_x, middle_y and tail. The last row is work space.
    """
    moment, stiffness, stop = body[MOMENT], body[STIFFNESS], body[STOP]
    center, magnet = body[CENTER], body[MAGNET]
    arm, slip, turn_slip = magnet - center, 1.0 / body[DRAG], 1.0 / body[ROTATIONAL_DRAG]
    gxx, gxy, gyx, gyy = gradient[0, 0], gradient[0, 1], gradient[1, 0], gradient[1, 1]
    c, s = math.cos(heading), math.sin(heading)
    first_c, first_s = c, s
    px, py = x + center * c, y + center * s  # the centre of drag
    for j in range(count):
        slopes[0, j] -= center * s * slopes[2, j]
        slopes[1, j] += center * c * slopes[2, j]
        slopes[3, j] = slopes[4, j] = slopes[5, j] = 0.0
        slopes[6, j] = slopes[2, j]
    dt = duration / steps
    rigid = not math.isfinite(stiffness)
    ux, uy = c, s  # where the moment points
    tail = guess = 0.0
    middle_x, middle_y = x, y
    for k in range(steps):
        # the magnet, ahead of the rotation centre; where it pointed in the last step is near enough
        at_x, at_y = px - center * c + magnet * ux, py - center * s + magnet * uy
        bx = field[0] + gxx * at_x + gxy * at_y
        by = field[1] + gyx * at_x + gyy * at_y
        size = math.sqrt(bx * bx + by * by)
        if size < 1e-15:
            break
        wx, wy = bx / size, by / size
        torque = moment * size
        sine, cosine = c * wy - s * wx, c * wx + s * wy  # of the angle from the housing to the field
        side = 1.0 if sine >= 0.0 else -1.0
        sine = abs(sine)
        bent = 0.0 if rigid else _solve_deflection(sine, cosine, torque, stiffness, stop, guess)
        guess = bent
        free = not rigid and 0.0 < bent < stop
        cb, sb = math.cos(bent), math.sin(bent)
        sine, cosine = sine * cb - cosine * sb, cosine * cb + sine * sb  # of the angle from the moment to the field
        # for a constant field tan(angle / 2) decays exponentially, which is stable at any step
        before = sine / (1.0 + cosine) if cosine > 0.0 else (1.0 - cosine) / max(sine, 1e-4)
        decay = math.exp(-torque * turn_slip * dt)
        after = before * decay
        hc, hs = 1.0 + before * after, before - after  # half of the turn
        size_of_half = 1.0 / math.sqrt(hc * hc + hs * hs)
        hc, hs = hc * size_of_half, side * hs * size_of_half
        vx, vy = c * cb - s * side * sb, s * cb + c * side * sb
        old_x, old_y = ux, uy
        ux, uy = vx * hc - vy * hs, vy * hc + vx * hs
        fx, fy = moment * (gxx * ux + gyx * uy), moment * (gxy * ux + gyy * uy)
        push = -(fx * ux + fy * uy)
        lean = 0.5 * dt * turn_slip * arm * (c * fy - s * fx)  # half of what the pull at the magnet turns
        for j in range(count):
            dx, dy, dh, dm = slopes[0, j], slopes[1, j], slopes[2, j], slopes[6, j]
            ax = dx + center * s * dh - magnet * old_y * dm
            ay = dy - center * c * dh + magnet * old_x * dm
            dbx = inputs[0, j] + inputs[2, j] * at_x + inputs[3, j] * at_y + gxx * ax + gxy * ay
            dby = inputs[1, j] + inputs[4, j] * at_x + inputs[5, j] * at_y + gyx * ax + gyy * ay
            grown = moment * (wx * dbx + wy * dby)
            off = (wx * dby - wy * dbx) / size - dh
            bend = 0.0
            if free:
                bend = (side * sine * grown + torque * cosine * off) / max(stiffness + torque * cosine, 0.1 * stiffness)
            angle = off - bend
            left = ((1.0 + before * before) * decay * angle - 2.0 * side * after * dt * turn_slip * grown) / (
                1.0 + after * after
            )
            turned = angle - left
            dm = dh + bend + 0.5 * turned
            dux, duy = -uy * dm, ux * dm
            dfx = moment * (inputs[2, j] * ux + inputs[4, j] * uy + gxx * dux + gyx * duy)
            dfy = moment * (inputs[3, j] * ux + inputs[5, j] * uy + gxy * dux + gyy * duy)
            if push > 0.0:
                slopes[5, j] -= dt * slip * (dfx * ux + fx * dux + dfy * uy + fy * duy)
            slopes[2, j] = dh + turned + dt * turn_slip * arm * (c * dfy - s * dfx - (s * fy + c * fx) * dh)
            slopes[0, j] = dx + dt * slip * dfx
            slopes[1, j] = dy + dt * slip * dfy
            slopes[6, j] = dm
        # the whole turn, then the lean, as a rotation that keeps lengths
        tc, ts = hc * hc - hs * hs, 2.0 * hc * hs
        c, s = c * tc - s * ts, s * tc + c * ts
        whole = 1.0 / (1.0 + lean * lean)
        tc, ts = (1.0 - lean * lean) * whole, 2.0 * lean * whole
        c, s = c * tc - s * ts, s * tc + c * ts
        px += dt * slip * fx
        py += dt * slip * fy
        tail += max(push, 0.0) * dt * slip
        if 2 * (k + 1) <= steps:
            middle_x, middle_y = px - center * c, py - center * s
            for j in range(count):
                slopes[3, j] = slopes[0, j] + center * s * slopes[2, j]
                slopes[4, j] = slopes[1, j] - center * c * slopes[2, j]
    for j in range(count):
        slopes[0, j] += center * s * slopes[2, j]
        slopes[1, j] -= center * c * slopes[2, j]
    heading += math.atan2(first_c * s - first_s * c, first_c * c + first_s * s)
    return px - center * c, py - center * s, heading, middle_x, middle_y, tail


@njit(cache=True, error_model="numpy", nogil=True)
def find_nearest(points, arc, first, last, guess, x, y, back=SEARCH_BACK, ahead=SEARCH_AHEAD):
    """Find the nearest place on one leg of a path.

    Only the part from `back` before to `ahead` beyond the arc length `guess` is searched.

    Parameters
    ----------
    points : ndarray, shape (k, 2), in m
    arc : ndarray, shape (k,), in m
        Arc length at each point.
    first, last : int
        Vertices at which the leg begins and ends.
    guess : float, in m
        Arc length near which to search.
    x, y : float, in m
        The point.
    back, ahead : float, in m

    Returns
    -------
    s : float, in m
        Arc length of the nearest place.
    along : float, in m
        Offset of the point along the leg; not zero only before its start and beyond its end.
    across : float, in m
        Offset of the point across the leg, positive to its left.
    """
    s, along, across, _ = _find_nearest_segment(points, arc, first, last, guess, x, y, back, ahead)
    return s, along, across


@njit(cache=True, error_model="numpy", nogil=True)
def _find_nearest_segment(points, arc, first, last, guess, x, y, back, ahead):
    """Find the nearest place as `find_nearest` does, and the segment that it is on."""
    low, high = first, last
    while low < last - 1 and arc[low + 1] < guess - back:
        low += 1
    while high > low + 1 and arc[high - 1] > guess + ahead:
        high -= 1
    best, found = 1e300, low
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
            best, found, s, across, along = away, i, arc[i] + held, beside, beyond
    return s, along, across, found


@njit(cache=True, error_model="numpy", nogil=True)
def _differentiate_place(points, i, offsets, dx, dy):
    """Compute the change of `find_nearest`'s offsets across and along, and arc length, as the point moves (dx, dy)."""
    x, y = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
    length = math.sqrt(x * x + y * y)
    tx, ty = x / length, y / length
    further = tx * dx + ty * dy
    beyond = offsets != 0.0  # of the segment's end: then the nearest place stays where it is
    return tx * dy - ty * dx, further if beyond else 0.0, 0.0 if beyond else further


@njit(cache=True, error_model="numpy", nogil=True)
def _compute_residuals(
    currents, b, g, high, body, state, drift, rest, duration, steps, route, leg, weights, out, ends, work
):
    """Fill the residuals of a plan of one or more windows, and the states at their ends; return the cost.

    The cost is the sum of their squares, J of `controllers.predictive`. Of each window, in mm: half the distance across
    and along half way, both at the end, the missing arc length, then the heading, the push at the tail and the weakness
    of the field; after those of all windows, each coil's share of its highest current.

    `work`: Jacobian (total, windows * n_coils) of the residuals, or (0, 0) if it is not needed; and buffers for
    the derivatives of the coils' field (6, ...) and of the state (7, ...), as `_simulate_with_derivatives` takes them.
    """
    points, arc, headings, spacing = route
    first, last, guess, stride, ahead, near = leg
    jacobian, inputs, slopes, field, gradient = work
    n, windows = b.shape[0], currents.shape[0]
    with_jacobian = jacobian.shape[0] > 0
    x, y, heading = state[0], state[1], state[2]
    goal, cost, row = guess, 0.0, 0
    if with_jacobian:
        jacobian[:] = 0.0
        slopes[:] = 0.0
    for w in range(windows):
        for i in range(2):
            field[i] = gradient[i, 0] = gradient[i, 1] = 0.0
            for c in range(n):
                field[i] += currents[w, c] * b[c, i]
                gradient[i, 0] += currents[w, c] * g[c, i, 0]
                gradient[i, 1] += currents[w, c] * g[c, i, 1]
        count = 0
        if with_jacobian:
            count = (w + 1) * n  # later windows change nothing of this one
            for j in range(count):
                own = 1.0 if j >= w * n else 0.0
                c = j % n
                for i in range(2):
                    inputs[i, j] = own * b[c, i]
                    inputs[2 + 2 * i, j], inputs[3 + 2 * i, j] = own * g[c, i, 0], own * g[c, i, 1]
        ch, sh = body[MAGNET] * math.cos(heading), body[MAGNET] * math.sin(heading)
        bx = field[0] + gradient[0, 0] * (x + ch) + gradient[0, 1] * (y + sh)
        by = field[1] + gradient[1, 0] * (x + ch) + gradient[1, 1] * (y + sh)
        # c^2 max(0, 1 - |B| / B_least)^2: where the coils' fields nearly cancel, their errors decide the motion
        strength = math.sqrt(bx * bx + by * by)
        out[row + 7] = weights[FIELD_WEAKNESS] * max(1.0 - strength / weights[WEAK_FIELD], 0.0)
        if out[row + 7] > 0.0 and strength > 0.0:
            for j in range(count):
                dx, dy = slopes[0, j] - sh * slopes[2, j], slopes[1, j] + ch * slopes[2, j]
                dbx = inputs[0, j] + inputs[2, j] * (x + ch) + inputs[3, j] * (y + sh)
                dby = inputs[1, j] + inputs[4, j] * (x + ch) + inputs[5, j] * (y + sh)
                dbx += gradient[0, 0] * dx + gradient[0, 1] * dy
                dby += gradient[1, 0] * dx + gradient[1, 1] * dy
                jacobian[row + 7, j] = -weights[FIELD_WEAKNESS] / weights[WEAK_FIELD] * (bx * dbx + by * dby) / strength
        x, y, heading, mx, my, tail = _simulate_with_derivatives(
            body, field, gradient, x, y, heading, duration, steps, inputs, slopes, count
        )
        x, y = x + drift[0] * duration, y + drift[1] * duration
        # n^2 d^2 / 4 half way
        s, along, across, i = _find_nearest_segment(points, arc, first, last, guess, mx, my, SEARCH_BACK, SEARCH_AHEAD)
        half = 0.5e3 * weights[PATH_DISTANCE]
        out[row], out[row + 1] = half * across, half * along
        for j in range(count):
            beside, beyond, _ = _differentiate_place(points, i, along, slopes[3, j], slopes[4, j])
            jacobian[row, j], jacobian[row + 1, j] = half * beside, half * beyond
        # n^2 d^2 and f^2 (s* - s)^2 at the end
        s, along, across, i = _find_nearest_segment(points, arc, first, last, guess, x, y, SEARCH_BACK, SEARCH_AHEAD)
        full = 1e3 * weights[PATH_DISTANCE]
        out[row + 2], out[row + 3] = full * across, full * along
        goal = min(goal + stride, arc[last])
        out[row + 4] = 1e3 * weights[MISSING_PROGRESS] * (goal - s - along)
        # h^2 rho(psi - psi_path), the path's heading interpolated a little ahead
        on, moves = s + ahead, 1.0
        if s < arc[last] - near and on > arc[last]:
            on, moves = arc[last], 0.0  # do not turn into the next leg before this one is done
        at = (on - arc[first]) / spacing
        if not 0.0 <= at <= headings.shape[0] - 1.001:
            at, moves = min(max(at, 0.0), headings.shape[0] - 1.001), 0.0
        k = int(at)
        bend = wrap_angle(headings[k + 1] - headings[k])
        off = wrap_angle(heading - headings[k] - (at - k) * bend)
        knee, size = weights[HUBER_ANGLE], abs(off)
        out[row + 5] = weights[HEADING] * (size if size < knee else math.sqrt(knee * (2.0 * size - knee)))
        steep = weights[HEADING] * (1.0 if size < knee else knee / math.sqrt(knee * (2.0 * size - knee)))
        steep = -steep if off < 0.0 else steep
        # p^2 tail^2
        out[row + 6] = 1e3 * weights[TAIL_PUSH] * tail
        for j in range(count):
            beside, beyond, further = _differentiate_place(points, i, along, slopes[0, j], slopes[1, j])
            jacobian[row + 2, j], jacobian[row + 3, j] = full * beside, full * beyond
            jacobian[row + 4, j] = -1e3 * weights[MISSING_PROGRESS] * (further + beyond)
            jacobian[row + 5, j] = steep * (slopes[2, j] - moves * further * bend / spacing)
            jacobian[row + 6, j] = 1e3 * weights[TAIL_PUSH] * slopes[5, j]
        row += RESIDUALS_PER_WINDOW
        ends[w, 0], ends[w, 1], ends[w, 2] = x, y, heading
        x, y = x + drift[0] * rest, y + drift[1] * rest
    # q^2 (I / I_max)^2
    for w in range(windows):
        for c in range(n):
            out[row] = weights[CURRENT_COST] * currents[w, c] / high[c]
            if with_jacobian:
                jacobian[row, w * n + c] = weights[CURRENT_COST] / high[c]
            row += 1
    for i in range(row):
        cost += out[i] * out[i]
    return cost


@njit(cache=True, error_model="numpy", nogil=True)
def _solve_bounded_step(hessian, slope, z, low, high, step):
    """Minimize the quadratic model within the bounds, one current after the other."""
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
def plan_currents(
    b, g, low, high, body, state, drift, rest, duration, steps, route, leg, weights, starts, count, rounds
):
    """Plan currents of the next window, or of the next two, that keep to the path and move the robot forward.

    All starts are evaluated, and the best `count` of them are improved by Gauss-Newton steps within the bounds.

    Parameters
    ----------
    b : ndarray, shape (n_coils, 2), in T per A
        Horizontal field at the origin of the coordinates.
    g : ndarray, shape (n_coils, 2, 2), in T per (A m)
        Its gradient.
    low, high : ndarray, shape (n_coils,), in A
        Bounds of the currents.
    body : ndarray, shape (7,)
    state : ndarray, shape (3,)
        Position (m) from the origin, and heading (rad), when the window begins.
    drift : ndarray, shape (2,), in m/s
    rest, duration : float, in s
        Between two windows, and of one.
    steps : int
        Of the integration, per window.
    route : tuple of ndarray
        Points (k, 2) from the origin, their arc lengths (k,), headings (l,) from the leg's first vertex on, and the
        spacing of these in m.
    leg : tuple
        First and last vertex, present arc length, arc length requested of each window, how far ahead of the robot
        the target heading is taken, and distance from its end at which the leg is done, in m.
    weights : ndarray, shape (8,)
        Of the cost, in the order of the constants above.
    starts : ndarray, shape (m, windows, n_coils), in A
        Initial guesses.
    count : int
        Number of starts to improve.
    rounds : int
        Largest number of Gauss-Newton steps.

    Returns
    -------
    cost : float
    currents : ndarray, shape (windows, n_coils), in A
    ends : ndarray, shape (windows, 3)
        States at the ends of the windows.
    """
    m, windows, n = starts.shape
    size = windows * n
    total = windows * RESIDUALS_PER_WINDOW + size
    out, step, slope = np.empty(total), np.empty(size), np.empty(size)
    jacobian, hessian, none = np.empty((total, size)), np.empty((size, size)), np.empty((0, 0))
    inputs, slopes, field, gradient = np.empty((6, size)), np.empty((7, size)), np.empty(2), np.empty((2, 2))
    rough, full = (none, inputs, slopes, field, gradient), (jacobian, inputs, slopes, field, gradient)
    ends = np.empty((windows, 3))
    lows, highs = np.empty(size), np.empty(size)
    for i in range(size):
        lows[i], highs[i] = low[i % n], high[i % n]
    costs = np.empty(m)
    for k in range(m):
        costs[k] = _compute_residuals(
            starts[k], b, g, high, body, state, drift, rest, duration, steps, route, leg, weights, out, ends, rough
        )
    best, chosen = 1e300, starts[0].copy()
    for _ in range(min(count, m)):
        k = int(np.argmin(costs))
        if costs[k] >= 1e299:
            break
        z = starts[k].copy()
        cost, damping = costs[k], 1e-3
        costs[k] = 1e300
        flat = z.reshape(size)
        for _round in range(rounds):
            _compute_residuals(
                z, b, g, high, body, state, drift, rest, duration, steps, route, leg, weights, out, ends, full
            )
            _fill_normal_equations(jacobian, out, hessian, slope)
            better, new = False, cost
            for _try in range(3):
                for i in range(size):
                    hessian[i, i] += damping
                _solve_bounded_step(hessian, slope, flat, lows, highs, step)
                for i in range(size):
                    flat[i] += step[i]
                new = _compute_residuals(
                    z, b, g, high, body, state, drift, rest, duration, steps, route, leg, weights, out, ends, rough
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
            if gained < 1e-3 * cost:
                break
        if cost < best:
            best = cost
            chosen = z
    _compute_residuals(
        chosen, b, g, high, body, state, drift, rest, duration, steps, route, leg, weights, out, ends, rough
    )
    return best, chosen, ends


@njit(cache=True, error_model="numpy", nogil=True)
def _fill_normal_equations(jacobian, out, hessian, slope):
    """Fill J^T J and J^T r."""
    total, size = jacobian.shape
    slope[:] = 0.0
    hessian[:] = 0.0
    for r in range(total):
        for i in range(size):
            left = jacobian[r, i]
            if left == 0.0:
                continue
            slope[i] += left * out[r]
            for j in range(size):
                hessian[i, j] += left * jacobian[r, j]
