"""Compiled kernels of the fit. They call each other, so they share this file (numba's cache).

Parameters of the fit, in this order: position (3) in m, world rotation e (3) in rad, phase in rad,
amplitude as a fraction of the reference angle.
"""

# mypy: disable-error-code="no-untyped-call,no-untyped-def"
from __future__ import annotations

import numpy as np
from numba import njit

N_PARAMETERS = 8
_MU0_OVER_4PI = 1e-7


@njit(cache=True, fastmath=False)
def series(positions, axes, mixing, moment, l0, angles, powers, position, rotation, values, slopes):
    """Power series in the deflection of each mixed channel, and its derivatives for position and rotation.

    `values` (n_mixed, K) and `slopes` (n_mixed, K, 6) are filled. `mixing` (n_mixed, n_sensors).
    """
    n_sensors, n_nodes, n_mixed = positions.shape[0], angles.shape[0], mixing.shape[0]
    raw = np.zeros((n_sensors, n_nodes, 7))
    m = np.empty(3)
    r2 = np.empty(3)
    for node in range(n_nodes):
        s, c = np.sin(angles[node]), np.cos(angles[node])
        bx, bz = c * moment[0] + s * moment[2], c * moment[2] - s * moment[0]
        for i in range(3):
            m[i] = rotation[i, 0] * bx + rotation[i, 1] * moment[1] + rotation[i, 2] * bz
            r2[i] = l0 * (rotation[i, 0] * s + rotation[i, 2] * c)
        for j in range(n_sensors):
            dx = positions[j, 0] - position[0] - r2[0]
            dy = positions[j, 1] - position[1] - r2[1]
            dz = positions[j, 2] - position[2] - r2[2]
            ax, ay, az = axes[j, 0], axes[j, 1], axes[j, 2]
            inverse = 1.0 / (dx * dx + dy * dy + dz * dz)
            f3 = _MU0_OVER_4PI * inverse * np.sqrt(inverse)
            f5 = 3.0 * f3 * inverse
            dm = dx * m[0] + dy * m[1] + dz * m[2]
            da = dx * ax + dy * ay + dz * az
            ma = m[0] * ax + m[1] * ay + m[2] * az
            # field along the axis; g its gradient for d = sensor - magnet; h its gradient for the moment
            raw[j, node, 0] = f5 * dm * da - f3 * ma
            common = f5 * (ma - 5.0 * dm * da * inverse)
            gx = common * dx + f5 * (m[0] * da + ax * dm)
            gy = common * dy + f5 * (m[1] * da + ay * dm)
            gz = common * dz + f5 * (m[2] * da + az * dm)
            hx, hy, hz = f5 * da * dx - f3 * ax, f5 * da * dy - f3 * ay, f5 * da * dz - f3 * az
            raw[j, node, 1] = -gx
            raw[j, node, 2] = -gy
            raw[j, node, 3] = -gz
            raw[j, node, 4] = -(r2[1] * gz - r2[2] * gy) + (m[1] * hz - m[2] * hy)
            raw[j, node, 5] = -(r2[2] * gx - r2[0] * gz) + (m[2] * hx - m[0] * hz)
            raw[j, node, 6] = -(r2[0] * gy - r2[1] * gx) + (m[0] * hy - m[1] * hx)
    mixed = np.zeros((n_nodes, 7))
    for q in range(n_mixed):
        mixed[:] = 0.0
        for j in range(n_sensors):
            weight = mixing[q, j]
            if weight != 0.0:
                for node in range(n_nodes):
                    for p in range(7):
                        mixed[node, p] += weight * raw[j, node, p]
        for k in range(n_nodes):
            for p in range(7):
                total = 0.0
                for node in range(n_nodes):
                    total += powers[k, node] * mixed[node, p]
                if p == 0:
                    values[q, k] = total
                else:
                    slopes[q, k, p - 1] = total


@njit(cache=True)
def project(basis, phase, wave, wave_slope):
    """Fill the real time functions (K, n_out) of each power for one phase, and their phase derivatives."""
    n_powers, n_out = basis.shape[0], basis.shape[2]
    wave[:] = 0.0
    wave_slope[:] = 0.0
    for k in range(1, n_powers):
        for h in range(k % 2, k + 1, 2):
            c, s = np.cos(h * phase), np.sin(h * phase)
            for i in range(n_out):
                re, im = basis[k, h, i].real, basis[k, h, i].imag
                wave[k, i] += re * c - im * s
                wave_slope[k, i] -= h * (re * s + im * c)


@njit(cache=True)
def model(
    basis, positions, axes, mixing, moment, l0, angles, powers, position, rotation, phase, amplitude, out, jacobian
):
    """Fill the model's output (n_mixed, n_out) and its Jacobian (n_mixed, n_out, 8)."""
    n_powers, n_out, n_mixed = basis.shape[0], basis.shape[2], mixing.shape[0]
    values = np.zeros((n_mixed, n_powers))
    slopes = np.zeros((n_mixed, n_powers, 6))
    wave = np.zeros((n_powers, n_out))
    wave_slope = np.zeros((n_powers, n_out))
    series(positions, axes, mixing, moment, l0, angles, powers, position, rotation, values, slopes)
    project(basis, phase, wave, wave_slope)
    for q in range(n_mixed):
        for i in range(n_out):
            out[q, i] = 0.0
            for p in range(8):
                jacobian[q, i, p] = 0.0
        scale = 1.0
        for k in range(1, n_powers):
            slope_scale = k * scale
            scale *= amplitude
            for i in range(n_out):
                w = scale * wave[k, i]
                out[q, i] += values[q, k] * w
                for p in range(6):
                    jacobian[q, i, p] += slopes[q, k, p] * w
                jacobian[q, i, 6] += values[q, k] * scale * wave_slope[k, i]
                jacobian[q, i, 7] += values[q, k] * slope_scale * wave[k, i]


@njit(cache=True)
def solve_posdef(matrix, right, n):
    """Solve in place for a symmetric positive definite `matrix` by Cholesky; False where it is not."""
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if total <= 0.0:
                    return False
                matrix[i, i] = np.sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    for column in range(right.shape[1]):
        for i in range(n):
            total = right[i, column]
            for k in range(i):
                total -= matrix[i, k] * right[k, column]
            right[i, column] = total / matrix[i, i]
        for i in range(n - 1, -1, -1):
            total = right[i, column]
            for k in range(i + 1, n):
                total -= matrix[k, i] * right[k, column]
            right[i, column] = total / matrix[i, i]
    return True


@njit(cache=True)
def rotate(rotation, e):
    """exp(e) R for a world rotation vector `e`."""
    angle = np.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
    if angle < 1e-14:
        return rotation.copy()
    x, y, z = e[0] / angle, e[1] / angle, e[2] / angle
    s, c = np.sin(angle), np.cos(angle)
    v = 1.0 - c
    turn = np.array(
        [
            [c + x * x * v, x * y * v - z * s, x * z * v + y * s],
            [y * x * v + z * s, c + y * y * v, y * z * v - x * s],
            [z * x * v - y * s, z * y * v + x * s, c + z * z * v],
        ]
    )
    out = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                out[i, j] += turn[i, k] * rotation[k, j]
    return out


@njit(cache=True)
def normal_equations(data, out, jacobian, normal, gradient):
    """Fill J^T J and J^T r; return the sum squared error (Eq. S20)."""
    normal[:] = 0.0
    gradient[:] = 0.0
    sse = 0.0
    for q in range(data.shape[0]):
        for i in range(data.shape[1]):
            r = data[q, i] - out[q, i]
            sse += r * r
            for a in range(8):
                ja = jacobian[q, i, a]
                gradient[a] += ja * r
                for b in range(a + 1):
                    normal[a, b] += ja * jacobian[q, i, b]
    for a in range(8):
        for b in range(a):
            normal[b, a] = normal[a, b]
    return sse


@njit(cache=True)
def fit(
    data,
    basis,
    positions,
    axes,
    mixing,
    moment,
    l0,
    angles,
    powers,
    position,
    rotation,
    phase,
    amplitude,
    amplitude_max,
    iterations,
    tolerance,
):
    """Unweighted Levenberg-Marquardt from one start.

    Returns position, rotation, phase, amplitude, sum squared error, J^T J (8, 8) and whether it converged.
    """
    n_mixed, n_out = data.shape
    out = np.zeros((n_mixed, n_out))
    jacobian = np.zeros((n_mixed, n_out, 8))
    normal = np.zeros((8, 8))
    gradient = np.zeros(8)
    position, rotation = position.copy(), rotation.copy()
    model(
        basis, positions, axes, mixing, moment, l0, angles, powers, position, rotation, phase, amplitude, out, jacobian
    )
    sse = normal_equations(data, out, jacobian, normal, gradient)
    damping = 1e-3
    converged = False
    trial_normal = np.zeros((8, 8))
    trial_gradient = np.zeros(8)
    for _ in range(iterations):
        held = amplitude >= amplitude_max and gradient[7] > 0.0
        accepted = False
        for _attempt in range(8):
            system = normal.copy()
            right = gradient.copy().reshape(8, 1)
            for a in range(8):
                system[a, a] *= 1.0 + damping
            if held:
                for a in range(8):
                    system[a, 7] = 0.0
                    system[7, a] = 0.0
                system[7, 7] = 1.0
                right[7, 0] = 0.0
            if not solve_posdef(system, right, 8):
                damping = max(damping, 1e-6) * 10.0
                continue
            step = right[:, 0].copy()
            length = np.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
            turn = np.sqrt(step[3] ** 2 + step[4] ** 2 + step[5] ** 2)
            shrink = min(1.0, 0.02 / (length + 1e-30), 0.7 / (turn + 1e-30))
            step *= shrink
            new_position = position + step[:3]
            new_rotation = rotate(rotation, step[3:6])
            new_amplitude = min(max(amplitude + step[7], 0.02 * amplitude_max), amplitude_max)
            model(
                basis,
                positions,
                axes,
                mixing,
                moment,
                l0,
                angles,
                powers,
                new_position,
                new_rotation,
                phase + step[6],
                new_amplitude,
                out,
                jacobian,
            )
            new_sse = normal_equations(data, out, jacobian, trial_normal, trial_gradient)
            if new_sse < sse:
                gain = (sse - new_sse) / sse
                position, rotation, phase, amplitude, sse = (
                    new_position,
                    new_rotation,
                    phase + step[6],
                    new_amplitude,
                    new_sse,
                )
                normal[:] = trial_normal
                gradient[:] = trial_gradient
                damping = max(damping * 0.1, 1e-12)
                accepted = True
                if gain < tolerance and shrink == 1.0:
                    converged = True
                break
            if length < 1e-9 and turn < 1e-8:
                converged = True
                break
            damping = max(damping, 1e-9) * 10.0
        if converged or not accepted:
            converged = converged or not accepted
            break
    return position, rotation, phase, amplitude, sse, normal, converged


@njit(cache=True)
def linear_start(data, basis, positions, axes, mixing, moment, l0, angles, powers, position, rotation, guess):
    """Phase and amplitude that fit `data` best at a fixed pose; exact for small amplitudes."""
    first = np.zeros(data.shape)
    second = np.zeros(data.shape)
    jacobian = np.zeros((data.shape[0], data.shape[1], 8))
    model(basis, positions, axes, mixing, moment, l0, angles, powers, position, rotation, 0.0, guess, first, jacobian)
    model(
        basis,
        positions,
        axes,
        mixing,
        moment,
        l0,
        angles,
        powers,
        position,
        rotation,
        -0.5 * np.pi,
        guess,
        second,
        jacobian,
    )
    aa, ab, bb, ay, by = 0.0, 0.0, 0.0, 0.0, 0.0
    for q in range(data.shape[0]):
        for i in range(data.shape[1]):
            a, b, y = first[q, i], second[q, i], data[q, i]
            aa += a * a
            ab += a * b
            bb += b * b
            ay += a * y
            by += b * y
    determinant = aa * bb - ab * ab
    if determinant <= 1e-12 * aa * bb:
        return 0.0, guess
    u, v = (bb * ay - ab * by) / determinant, (aa * by - ab * ay) / determinant
    return np.arctan2(-v, u), guess * np.sqrt(u * u + v * v)


@njit(cache=True)
def covariance(normal, variance):
    """Covariance (6, 6) of position and rotation, phase and amplitude free; infinite where undetermined."""
    out = np.full((6, 6), np.inf)
    scale = np.zeros(8)
    for a in range(8):
        if normal[a, a] <= 0.0:
            return out
        scale[a] = 1.0 / np.sqrt(normal[a, a])
    system = np.zeros((8, 8))
    inverse = np.eye(8)
    for a in range(8):
        for b in range(8):
            system[a, b] = normal[a, b] * scale[a] * scale[b]
    if not solve_posdef(system, inverse, 8):
        return out
    worst = 0.0
    for a in range(8):
        worst = max(worst, inverse[a, a])
    if worst > 1e11:  # a direction with no information to speak of
        return out
    for a in range(6):
        for b in range(6):
            out[a, b] = variance * inverse[a, b] * scale[a] * scale[b]
    return out


@njit(cache=True)
def chain_output(field, first, weights, mixing):
    """Chain's output (n_mixed, n_out) of raw samples (n_sensors, n)."""
    n_sensors, n_out, width = field.shape[0], weights.shape[0], weights.shape[1]
    mixed = np.zeros((mixing.shape[0], n_out))
    for j in range(n_sensors):
        used = False
        for q in range(mixing.shape[0]):
            if mixing[q, j] != 0.0:
                used = True
        if not used:
            continue
        base = field[j, 0]
        for i in range(n_out):
            total = 0.0
            start = first[i]
            for w in range(width):
                total += weights[i, w] * (field[j, start + w] - base)
            for q in range(mixing.shape[0]):
                mixed[q, i] += mixing[q, j] * total
    return mixed


@njit(cache=True)
def grid_residuals(amplitudes, positions, axes, mixing, grid, moments):
    """Sum squared error of the best oscillating moment at each grid position; moments (n_grid, 3) are filled."""
    n_grid, n_mixed, n_sensors = grid.shape[0], mixing.shape[0], positions.shape[0]
    errors = np.zeros(n_grid)
    lead = np.zeros((n_sensors, 3))
    mixed = np.zeros((n_mixed, 3))
    normal = np.zeros((3, 3))
    right = np.zeros((3, 1))
    energy = np.sum(amplitudes * amplitudes)
    for g in range(n_grid):
        for j in range(n_sensors):
            dx, dy, dz = positions[j, 0] - grid[g, 0], positions[j, 1] - grid[g, 1], positions[j, 2] - grid[g, 2]
            inverse = 1.0 / (dx * dx + dy * dy + dz * dz)
            f3 = _MU0_OVER_4PI * inverse * np.sqrt(inverse)
            da = 3.0 * inverse * (dx * axes[j, 0] + dy * axes[j, 1] + dz * axes[j, 2])
            lead[j, 0] = f3 * (da * dx - axes[j, 0])
            lead[j, 1] = f3 * (da * dy - axes[j, 1])
            lead[j, 2] = f3 * (da * dz - axes[j, 2])
        mixed[:] = 0.0
        for q in range(n_mixed):
            for j in range(n_sensors):
                if mixing[q, j] != 0.0:
                    for i in range(3):
                        mixed[q, i] += mixing[q, j] * lead[j, i]
        for i in range(3):
            right[i, 0] = 0.0
            for k in range(3):
                normal[i, k] = 0.0
        for q in range(n_mixed):
            for i in range(3):
                right[i, 0] += mixed[q, i] * amplitudes[q]
                for k in range(3):
                    normal[i, k] += mixed[q, i] * mixed[q, k]
        saved = right.copy()
        if solve_posdef(normal, right, 3):
            explained = 0.0
            for i in range(3):
                explained += saved[i, 0] * right[i, 0]
                moments[g, i] = right[i, 0]
            errors[g] = energy - explained
        else:
            errors[g] = energy
    return errors
