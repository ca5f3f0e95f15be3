"""Compiled search for the coil currents whose true force points in a requested direction.

The force on a moment that has aligned with the field B is F = |m| grad|B|. Along any given direction u of the
field, u = B / |B|,

    F_i / |m| = u . dB/dx_i = sum_c I_c (u . dB_c/dx_i)

is linear in the currents. So for each u the strongest force along d is a linear program (no field beside u, almost
no force across d, enough field along u, bounds), and the least heat for a requested force a quadratic one. What
remains is a search over the angle of u in the horizontal plane. A field out of the plane, where the robot is not in
the coils' own plane, is found by iteration: it tilts u.

Kernels that call each other share this file, since numba's cache does not notice a change in another one.
"""

# mypy: disable-error-code="no-untyped-call,no-untyped-def"
from __future__ import annotations

import math

import numpy as np
from numba import njit

BESIDE, FORCE, ACROSS, FIELD = 0, 1, 2, 3  # rows: field beside u, force along and across d, field along u
GOLDEN = 0.3819660112501051
REFINE_SHARE, REFINE_SHARE_AT_EDGES = (
    0.15,
    0.5,
)  # shares of the best by which an angle may be worse and still be refined
REFINEMENTS = 14  # of an angle: each narrows it to 0.62 of what it was
BOUND_TOLERANCE = 1e-9  # share of a bound by which a current may miss it before it is put on it


@njit(cache=True, error_model="numpy", nogil=True)
def _solve(matrix, right, size):
    """Solve in place by elimination with pivots; return False where the matrix is singular."""
    for i in range(size):
        pivot = i
        for r in range(i + 1, size):
            if abs(matrix[r, i]) > abs(matrix[pivot, i]):
                pivot = r
        if abs(matrix[pivot, i]) < 1e-11:
            return False
        if pivot != i:
            for c in range(size):
                matrix[i, c], matrix[pivot, c] = matrix[pivot, c], matrix[i, c]
            right[i], right[pivot] = right[pivot], right[i]
        for r in range(i + 1, size):
            share = matrix[r, i] / matrix[i, i]
            for c in range(i, size):
                matrix[r, c] -= share * matrix[i, c]
            right[r] -= share * right[i]
    for i in range(size - 1, -1, -1):
        for c in range(i + 1, size):
            right[i] -= matrix[i, c] * right[c]
        right[i] /= matrix[i, i]
    return True


@njit(cache=True, error_model="numpy", nogil=True)
def _maximize_force(rows, target, order, size, low, high, basis, matrix, work, multipliers, currents):
    """Maximize rows[FORCE] . I with rows[order] I = target[order], low <= I <= high; False without a solution.

    Every basis is tried. Its multipliers put every other current on one of its bounds, and the equations give the
    basic ones. A basis whose currents keep to their bounds is optimal.
    """
    n = low.shape[0]
    if size > n:
        return False  # fewer coils than equations
    for i in range(size):
        basis[i] = i
    while True:
        for i in range(size):
            for k in range(size):
                matrix[i, k] = rows[order[k], basis[i]]
            work[i] = rows[FORCE, basis[i]]
        if _solve(matrix, work, size):
            for c in range(n):
                left = rows[FORCE, c]
                for k in range(size):
                    left -= work[k] * rows[order[k], c]
                currents[c] = high[c] if left > 0.0 else low[c]
            for i in range(size):
                currents[basis[i]] = 0.0
                multipliers[i] = work[i]
            for k in range(size):
                work[k] = target[order[k]]
                for c in range(n):
                    work[k] -= rows[order[k], c] * currents[c]
                for i in range(size):
                    matrix[k, i] = rows[order[k], basis[i]]
            if _solve(matrix, work, size):
                fits = True
                for i in range(size):
                    c = basis[i]
                    slack = BOUND_TOLERANCE * (high[c] - low[c])
                    if not low[c] - slack <= work[i] <= high[c] + slack:
                        fits = False
                        break
                    currents[c] = min(max(work[i], low[c]), high[c])
                if fits:
                    return True
        at = size - 1
        while at >= 0 and basis[at] == n - size + at:
            at -= 1
        if at < 0:
            return False
        basis[at] += 1
        for i in range(at + 1, size):
            basis[i] = basis[i - 1] + 1


@njit(cache=True, error_model="numpy", nogil=True)
def _compute_dual_slope(rows, target, order, size, low, high, multipliers, step, share):
    """Compute the slope of `_minimize_heat`'s dual along `step`, after a share of it; it decreases along the step."""
    out = 0.0
    for k in range(size):
        out += step[k] * target[order[k]]
    for c in range(low.shape[0]):
        pull = along = 0.0
        for k in range(size):
            pull += (multipliers[k] + share * step[k]) * rows[order[k], c]
            along += step[k] * rows[order[k], c]
        out -= along * min(max(pull, low[c]), high[c])
    return out


@njit(cache=True, error_model="numpy", nogil=True)
def _minimize_heat(rows, target, order, size, low, high, matrix, work, multipliers, step, currents):
    """Minimize |I|² with rows[order] I = target[order] and low <= I <= high; return False if no solution was found.

    At the optimum I = clip(rows^T y); y follows by Newton steps on the concave dual, each as long as the dual
    rises.
    """
    n = low.shape[0]
    for k in range(size):
        multipliers[k] = 0.0
    for _ in range(40):
        for k in range(size):
            work[k] = target[order[k]]
            for j in range(size):
                matrix[k, j] = 0.0
        for c in range(n):
            pull = 0.0
            for k in range(size):
                pull += multipliers[k] * rows[order[k], c]
            current = min(max(pull, low[c]), high[c])
            currents[c] = current
            free = 1.0 if low[c] <= pull <= high[c] else 1e-7
            for k in range(size):
                work[k] -= rows[order[k], c] * current
                for j in range(size):
                    matrix[k, j] += free * rows[order[k], c] * rows[order[j], c]
        miss = 0.0
        for k in range(size):
            miss = max(miss, abs(work[k]))
        if miss < 1e-9:
            return True
        start = 0.0
        for k in range(size):
            matrix[k, k] += 1e-10
            step[k] = work[k]
        if not _solve(matrix, step, size):
            return False
        for k in range(size):
            start += work[k] * step[k]
        share, before, after = 1.0, 0.0, math.inf
        for _try in range(60):
            rise = _compute_dual_slope(rows, target, order, size, low, high, multipliers, step, share)
            if abs(rise) < 0.1 * start:
                break
            if rise > 0.0:
                before = share
            else:
                after = share
            share = 4.0 * share if after == math.inf else 0.5 * (before + after)
            if share > 1e9:
                return False  # it rises without end: nothing fits
        for k in range(size):
            multipliers[k] += share * step[k]
    return False


@njit(cache=True, error_model="numpy", nogil=True)
def _solve_with_rules(rows, target, cool, rules, side, low, high, order, basis, matrix, work, currents):
    """Solve with some rules (1: way, 2: field, 3: both) as equations; return their number, 0 without a solution."""
    n = low.shape[0]
    order[0], order[1], size = BESIDE, FORCE, 2 if cool else 1
    if rules & 1:
        for c in range(n):
            rows[ACROSS, c] = work[3, c] - side * rows[FORCE, c]
        order[size] = ACROSS
        size += 1
    if rules & 2:
        order[size] = FIELD
        size += 1
    if cool:
        fits = _minimize_heat(rows, target, order, size, low, high, matrix, work[0], work[1], work[2], currents)
    else:
        fits = _maximize_force(rows, target, order, size, low, high, basis, matrix, work[0], work[1], currents)
    return size if fits else 0


@njit(cache=True, error_model="numpy", nogil=True)
def _check_rules(rows, target, slack, work, currents):
    """Return the force across the way, or 0 where it is small enough, and whether the field is strong enough."""
    force = across = field = 0.0
    for c in range(currents.shape[0]):
        force += rows[FORCE, c] * currents[c]
        across += work[3, c] * currents[c]
        field += rows[FIELD, c] * currents[c]
    return across if abs(across) > slack * abs(force) + 1e-9 else 0.0, field >= target[FIELD] - 1e-9


@njit(cache=True, error_model="numpy", nogil=True)
def _solve_program(rows, target, cool, slack, low, high, order, basis, matrix, work, memory, currents):
    """Find the best currents for given rows: the inequality rules are added in turn, until all of them hold.

    The optimum with some of the rules left out, if it keeps to them, is the optimum. So is one with some of them
    as equations, if their multipliers have the right signs: the set that was right for the last direction is tried
    first. `memory` holds that set and side.
    """
    n = low.shape[0]
    for c in range(n):
        work[3, c] = rows[ACROSS, c]
    rules, side = int(memory[0]), memory[1]
    if rules > 0:
        size = _solve_with_rules(rows, target, cool, rules, side, low, high, order, basis, matrix, work, currents)
        if size:
            across, strong = _check_rules(rows, target, slack, work, currents)
            right = across == 0.0 and strong
            toward = -1.0 if cool else 1.0
            for k in range(size):
                if order[k] == ACROSS and toward * side * work[1, k] < -1e-12:
                    right = False
                if order[k] == FIELD and toward * work[1, k] > 1e-12:
                    right = False
            if right:
                return True
    memory[0] = -1.0
    for with_field in (0, 2):
        side = 0.0
        for with_way in (0, 1):
            rules = with_way + with_field
            if not _solve_with_rules(rows, target, cool, rules, side, low, high, order, basis, matrix, work, currents):
                return False
            across, strong = _check_rules(rows, target, slack, work, currents)
            if across == 0.0 and strong:
                memory[0], memory[1] = rules, side
                return True
            if with_way or across == 0.0:
                if with_field:
                    return False
                break  # only the field is too weak
            side = math.copysign(slack, across)
    return False


@njit(cache=True, error_model="numpy", nogil=True)
def _solve_at_angle(angle, way, size, rules, b, g, low, high, store, order, basis, currents):
    """Find the best currents for a field along `angle`; return their force along `way`, and minus their heat.

    Both are -1e300 where no solution exists.
    """
    least, steepest, slack = rules
    n = b.shape[0]
    rows, target, matrix, work = store[0], store[1, 0], store[2], store[3]
    warm, cold = store[1, 1], store[1, 2]  # what the last direction came to, of strongest and coolest currents
    ux, uy = math.cos(angle), math.sin(angle)
    tilt = side = 0.0
    for _ in range(12):
        cosine = 1.0 / math.sqrt(1.0 + tilt * tilt)
        vx, vy, vz = ux * cosine, uy * cosine, tilt * cosine
        for c in range(n):
            fx = vx * g[c, 0, 0] + vy * g[c, 1, 0] + vz * g[c, 2, 0]
            fy = vx * g[c, 0, 1] + vy * g[c, 1, 1] + vz * g[c, 2, 1]
            rows[FORCE, c] = way[0] * fx + way[1] * fy
            rows[ACROSS, c] = way[0] * fy - way[1] * fx
            rows[BESIDE, c] = ux * b[c, 1] - uy * b[c, 0]
            rows[FIELD, c] = ux * b[c, 0] + uy * b[c, 1] - side * b[c, 2]
        target[BESIDE] = target[ACROSS] = 0.0
        target[FIELD], target[FORCE] = least, size
        for cool in (False, True):
            if size < 0.0 if cool else size >= 0.0 and cold[0] >= 0.0:
                continue
            memory = cold if cool else warm
            if not _solve_program(rows, target, cool, slack, low, high, order, basis, matrix, work, memory, currents):
                return -1e300, -1e300
            if cool:
                continue
            force = 0.0
            for c in range(n):
                force += rows[FORCE, c] * currents[c]
                rows[ACROSS, c] = work[3, c]
            if force < size:
                return -1e300, -1e300
        field = up = 0.0
        for c in range(n):
            field += currents[c] * (ux * b[c, 0] + uy * b[c, 1])
            up += currents[c] * b[c, 2]
        before, tilt = tilt, up / max(field, 1e-30)
        side = math.copysign(1.0 / steepest, up)
        if abs(tilt - before) < 1e-4 and abs(tilt) <= steepest * (1.0 + 1e-6):
            force = heat = 0.0
            for c in range(n):
                force += rows[FORCE, c] * currents[c]
                heat += currents[c] ** 2
            return force, -heat
    return -1e300, -1e300


@njit(cache=True, error_model="numpy", nogil=True)
def compute_field_and_force(b, g, currents):
    """Compute the field of some coils, and grad|B|.

    Parameters
    ----------
    b : ndarray, shape (n, 3), in T per A
        Field of each coil.
    g : ndarray, shape (n, 3, 3), in T per (A m)
        Its gradient, ``g[c, i, j] = dB_i / dx_j``.
    currents : ndarray, shape (n,), in A

    Returns
    -------
    field : ndarray, shape (3,), in T
    slope : ndarray, shape (3,), in T/m
        grad|B|.
    """
    n = b.shape[0]
    field, force = np.zeros(3), np.zeros(3)
    for c in range(n):
        for i in range(3):
            field[i] += currents[c] * b[c, i]
    strength = math.sqrt(field[0] ** 2 + field[1] ** 2 + field[2] ** 2) + 1e-300
    for c in range(n):
        for j in range(3):
            for i in range(3):
                force[j] += currents[c] * field[i] / strength * g[c, i, j]
    return field, force


@njit(cache=True, error_model="numpy", nogil=True)
def search_currents(b, g, low, high, way, size, least, steepest, slack, head_first, steps):
    """Search the direction of the field for the currents whose grad|B| points along a given direction.

    Parameters
    ----------
    b : ndarray, shape (n_coils, 3), in T per A
        Field of each coil.
    g : ndarray, shape (n_coils, 3, 3), in T per (A m)
        Its gradient, ``g[c, i, j] = dB_i / dx_j``.
    low, high : ndarray, shape (n_coils,), in A
    way : ndarray, shape (2,)
        Unit vector in the horizontal plane.
    size : float, in T/m
        Requested grad|B|; negative for the strongest.
    least : float, in T
        The field must be this strong, or the moment would not align.
    steepest : float
        Largest tangent of the field's slope out of the plane, which a floating robot does not follow.
    slack : float
        Tangent of the angle by which the force may deviate from `way`. Where coils oppose each other, a value of 0
        would cost up to a quarter of the force.
    head_first : bool
        Whether the field must not point against `way`.
    steps : int
        Angles of the field tried per quarter turn before the best are refined.

    Returns
    -------
    value : float, in T/m
        grad|B| along `way`, or -1e300 where no solution exists.
    currents : ndarray, shape (n_coils,), in A
    """
    n = b.shape[0]
    strong = steep = 1e-30  # field and gradient of the strongest coil: the search works in these units
    for c in range(n):
        span = max(abs(low[c]), abs(high[c]))
        strong = max(strong, span * math.sqrt(b[c, 0] ** 2 + b[c, 1] ** 2))
        for i in range(3):
            for j in range(2):
                steep = max(steep, span * abs(g[c, i, j]))
    b, g, size, least = b / strong, g / steep, size / steep, least / strong
    rules = (least, steepest, slack)
    store, order, basis = np.full((4, 4, max(n, 4)), -1.0), np.empty(4, np.int64), np.empty(4, np.int64)
    middle = math.atan2(way[1], way[0])
    half = 0.5 * math.pi - 1.01 * slack if head_first else math.pi
    width = half / (steps if head_first else 2 * steps)
    count = 2 * steps + 1 if head_first else 4 * steps  # the requested direction itself is among them
    pick = 1 if size >= 0.0 else 0
    values, trial, currents = np.empty(count), np.empty(n), np.zeros(n)
    best, best_force = -1e300, -1e300
    for i in range(count):
        angle = middle - half + i * width
        found = _solve_at_angle(angle, way, size, rules, b, g, low, high, store, order, basis, trial)
        values[i] = found[pick]
        if values[i] > best:
            best, best_force = values[i], found[0]
            currents, trial = trial, currents
    if head_first:  # at a right angle to the way the force may miss it toward the field alone
        for hand in (-1.0, 1.0):
            along, aside = math.cos(0.5 * slack), hand * math.sin(0.5 * slack)
            beside = (along * way[0] - aside * way[1], aside * way[0] + along * way[1])
            angle = middle + hand * (0.5 * math.pi - 1e-6)
            narrow = (least, steepest, math.tan(0.5 * math.atan(slack)))
            found = _solve_at_angle(angle, beside, size, narrow, b, g, low, high, store, order, basis, trial)
            if found[pick] > best:
                best, best_force = found[pick], found[0]
                currents, trial = trial, currents
    if best <= -1e299:
        return -1e300, currents
    for i in range(count):
        left = values[i - 1] if i > 0 else (-1e300 if head_first else values[count - 1])
        right = values[i + 1] if i + 1 < count else (-1e300 if head_first else values[0])
        # at an edge of what fits the best may be a good deal better than the nearest angle tried
        edge = min(left, right) < -1e299
        share = REFINE_SHARE_AT_EDGES if edge else REFINE_SHARE
        if values[i] < best - share * abs(best) or (not edge and (values[i] < left or values[i] < right)):
            continue
        center = middle - half + i * width
        a, z, top = center - width, center + width, values[i]
        if head_first:
            a, z = max(a, middle - half), min(z, middle + half)
        for _ in range(REFINEMENTS):
            # probe the wider side of the best angle known, which always fits: beyond an edge nothing does
            angle = center - GOLDEN * (center - a) if center - a > z - center else center + GOLDEN * (z - center)
            found = _solve_at_angle(angle, way, size, rules, b, g, low, high, store, order, basis, trial)
            if found[pick] > best:
                best, best_force = found[pick], found[0]
                currents, trial = trial, currents
            if found[pick] > top:
                if angle < center:
                    z = center
                else:
                    a = center
                center, top = angle, found[pick]
            elif angle < center:
                a = angle
            else:
                z = angle
    return best_force * steep, currents


@njit(cache=True, error_model="numpy", nogil=True)
def compute_max_single_coil(b, g, high):
    """Compute the largest grad|B| of a single coil at its limit.

    Parameters
    ----------
    b : ndarray, shape (n_coils, 3), in T per A
        Field of each coil.
    g : ndarray, shape (n_coils, 3, 3), in T per (A m)
        Its gradient, ``g[c, i, j] = dB_i / dx_j``.
    high : ndarray, shape (n_coils,), in A
        Limits of the currents.

    Returns
    -------
    float, in T/m
    """
    most = 0.0
    for c in range(high.shape[0]):
        _, slope = compute_field_and_force(b[c : c + 1], g[c : c + 1], high[c : c + 1])
        most = max(most, math.sqrt(slope[0] ** 2 + slope[1] ** 2 + slope[2] ** 2))
    return most


@njit(cache=True, error_model="numpy", nogil=True)
def compute_forces_by_field(b, g, low, high, ways, angles, rules, head_first):
    """Compute the strongest grad|B| along a direction for every direction of the field, at many points.

    Parameters
    ----------
    b : ndarray, shape (m, n_coils, 3), in T per A
        Field of each coil at each point.
    g : ndarray, shape (m, n_coils, 3, 3), in T per (A m)
        Its gradient.
    low, high : ndarray, shape (n_coils,), in A
    ways : ndarray, shape (m, 2)
        Unit vectors.
    angles : ndarray, shape (k,), in rad
        Directions of the field.
    rules : tuple of 3 floats
        Least field in T, largest tangent of its slope out of the plane, and tangent of the angle by which the force
        may deviate from the way.
    head_first : bool
        Whether fields that point against the way are left out.

    Returns
    -------
    ndarray, shape (m, k), in T/m
        0 where no solution exists.
    """
    m, n = b.shape[0], b.shape[1]
    out = np.zeros((m, angles.shape[0]))
    store, order, basis = np.full((4, 4, max(n, 4)), -1.0), np.empty(4, np.int64), np.empty(4, np.int64)
    trial = np.empty(n)
    for i in range(m):
        strong = steep = 1e-30
        for c in range(n):
            span = max(abs(low[c]), abs(high[c]))
            strong = max(strong, span * math.sqrt(b[i, c, 0] ** 2 + b[i, c, 1] ** 2))
            for j in range(3):
                steep = max(steep, span * max(abs(g[i, c, j, 0]), abs(g[i, c, j, 1])))
        own_b, own_g = b[i] / strong, g[i] / steep
        own_rules = (rules[0] / strong, rules[1], rules[2])
        for k in range(angles.shape[0]):
            if head_first and ways[i, 0] * math.cos(angles[k]) + ways[i, 1] * math.sin(angles[k]) < -1e-9:
                continue
            force, _ = _solve_at_angle(
                angles[k], ways[i], -1.0, own_rules, own_b, own_g, low, high, store, order, basis, trial
            )
            out[i, k] = max(force, 0.0) * steep
    return out
