"""Compiled kernels of the fit. They call each other, so they share this file (numba's cache).

Parameters of the fit, in this order: position (3) in m, world rotation e (3) in rad, phase in rad, amplitude as a
fraction of the reference angle. Each kernel names its error model: one without it inherits that of its first
caller, which with fast mathematics changes the last bits.
"""

# mypy: disable-error-code="no-untyped-call,no-untyped-def"
from __future__ import annotations

import numpy as np
from numba import njit

N_PARAMETERS = 8
"""Of a fit: position (3), rotation error (3), phase, amplitude."""

_MU0_OVER_4PI = 1e-7
"""In T·m/A."""

_FIRST_DAMPING, _MIN_DAMPING, _DAMPING_UP, _DAMPING_DOWN = 1e-3, 1e-12, 10.0, 0.1
"""Levenberg-Marquardt damping: its start and smallest value, and its factors after a worse and a better step."""

_REFUSED_DAMPING, _WORSE_DAMPING = 1e-6, 1e-9
"""Damping from which it grows after a matrix that is not positive definite, and after a worse step."""

_ATTEMPTS = 8
"""Dampings that are tried in one iteration."""

_MAX_SHIFT, _MAX_TURN = 0.02, 0.7
"""Longest step of a fit, in m and rad: the linear model is not valid farther away."""

_STILL, _STILL_TURN = 1e-9, 1e-8
"""Step, in m and rad, below which a fit has converged."""

_MIN_AMPLITUDE = 0.02
"""Smallest amplitude of a fit, as a share of the largest."""

_SINGULAR = 1e-12
"""Share of its largest value below which a determinant is zero."""

_MAX_INVERSE = 1e11
"""Entry of a scaled inverse above which a direction carries no information."""

_RIDGE = 1e-9
"""Share of the trace added to a normal matrix, so that it can be inverted."""

_SMALL_ANGLE = 1e-14
"""Angle, in rad, below which a rotation is none."""

_TINY = 1e-30
"""Length, in m or rad, that keeps a quotient finite."""


@njit(cache=True, error_model="python", fastmath=True)
def compute_series(positions, axes, moment, l0, angles, powers, position, rotation, values, slopes):
    """Compute the power series in the deflection of each channel, and its derivatives for position and rotation.

    Parameters
    ----------
    positions : ndarray, shape (n_channels, 3), in m, world frame
        Of the sensors.
    axes : ndarray, shape (n_channels, 3), world frame
    moment : ndarray, shape (3,), in A·m², body frame
    l0 : float, in m
    angles : ndarray, shape (K,), in rad
        Nodes of the interpolation.
    powers : ndarray, shape (K, K)
        Coefficients of the power series from values at the nodes.
    position : ndarray, shape (3,), in m, world frame
        Of the rotation centre.
    rotation : ndarray, shape (3, 3)
        Body to world.
    values : ndarray, shape (n_channels, K), in T
        Filled.
    slopes : ndarray, shape (n_channels, K, 6), in T/m and T/rad
        Filled.
    """
    n_sensors, n_nodes = positions.shape[0], angles.shape[0]
    raw = np.empty((n_sensors, n_nodes, 7))
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
            # field along the sensor's axis; g: its gradient with respect to d = sensor - magnet, h: to the moment
            raw[j, node, 0] = f5 * dm * da - f3 * ma
            common = f5 * (ma - 5.0 * dm * da * inverse)
            gx = common * dx + f5 * (m[0] * da + ax * dm)
            gy = common * dy + f5 * (m[1] * da + ay * dm)
            gz = common * dz + f5 * (m[2] * da + az * dm)
            hx, hy, hz = f5 * da * dx - f3 * ax, f5 * da * dy - f3 * ay, f5 * da * dz - f3 * az
            # derivatives for the position, and for a rotation about the rotation centre (world frame): the magnet
            # moves by e x r2, its moment turns by e x m
            raw[j, node, 1] = -gx
            raw[j, node, 2] = -gy
            raw[j, node, 3] = -gz
            raw[j, node, 4] = -(r2[1] * gz - r2[2] * gy) + (m[1] * hz - m[2] * hy)
            raw[j, node, 5] = -(r2[2] * gx - r2[0] * gz) + (m[2] * hx - m[0] * hz)
            raw[j, node, 6] = -(r2[0] * gy - r2[1] * gx) + (m[0] * hy - m[1] * hx)
    # coefficients of the powers of the deflection
    for j in range(n_sensors):
        for k in range(n_nodes):
            for p in range(7):
                total = 0.0
                for node in range(n_nodes):
                    total += powers[k, node] * raw[j, node, p]
                if p == 0:
                    values[j, k] = total
                else:
                    slopes[j, k, p - 1] = total


@njit(cache=True, error_model="python", fastmath=True)
def evaluate_model(
    matrix, labels, positions, axes, moment, l0, angles, powers, position, rotation, phase, amplitude, out, jacobian
):
    """Fill the model's output and its Jacobian.

    Functions are in the order of their powers. Outputs come last so that every inner loop runs along memory.

    Parameters
    ----------
    matrix : ndarray, shape (n_functions, n_channels, n_out)
        Response of the linear chain to each time function in each channel.
    labels : ndarray of int, shape (n_functions, 3)
        Power and harmonic of a function, and 0 for cosine or 1 for sine.
    positions : ndarray, shape (n_channels, 3), in m, world frame
        Of the sensors.
    axes : ndarray, shape (n_channels, 3), world frame
    moment : ndarray, shape (3,), in A·m², body frame
    l0 : float, in m
    angles : ndarray, shape (K,), in rad
        Nodes of the interpolation; see `compute_series`.
    powers : ndarray, shape (K, K)
        Coefficients of the power series; see `compute_series`.
    position : ndarray, shape (3,), in m, world frame
        Of the rotation centre.
    rotation : ndarray, shape (3, 3)
        Body to world.
    phase : float, in rad
    amplitude : float
        As a fraction of the reference angle.
    out : ndarray, shape (n_out,)
        Filled.
    jacobian : ndarray, shape (8, n_out)
        Filled.
    """
    n_functions, n_channels, n_out = matrix.shape
    n_powers = angles.shape[0]
    values = np.empty((n_channels, n_powers))
    slopes = np.empty((n_channels, n_powers, 6))
    compute_series(positions, axes, moment, l0, angles, powers, position, rotation, values, slopes)
    size = np.empty(n_powers)
    size[0] = 1.0
    for k in range(1, n_powers):
        size[k] = size[k - 1] * amplitude
    turn = np.empty((n_functions, 2))
    for f in range(n_functions):
        h = labels[f, 1]
        if labels[f, 2] == 0:
            turn[f, 0], turn[f, 1] = np.cos(h * phase), -h * np.sin(h * phase)
        else:
            turn[f, 0], turn[f, 1] = -np.sin(h * phase), -h * np.cos(h * phase)
    out[:] = 0.0
    jacobian[:] = 0.0
    now = np.empty(n_out)  # contribution of one power of one channel, and its derivative for the phase
    ahead = np.empty(n_out)
    first = 0
    while first < n_functions:
        k = labels[first, 0]
        last = first
        while last < n_functions and labels[last, 0] == k:
            last += 1
        for j in range(n_channels):
            now[:] = 0.0
            ahead[:] = 0.0
            for f in range(first, last):
                c, d = turn[f, 0], turn[f, 1]
                for i in range(n_out):
                    now[i] += c * matrix[f, j, i]
                    ahead[i] += d * matrix[f, j, i]
            s0, s1, s2 = slopes[j, k, 0] * size[k], slopes[j, k, 1] * size[k], slopes[j, k, 2] * size[k]
            s3, s4, s5 = slopes[j, k, 3] * size[k], slopes[j, k, 4] * size[k], slopes[j, k, 5] * size[k]
            v, grown = values[j, k] * size[k], k * values[j, k] * size[k - 1]
            for i in range(n_out):
                w = now[i]
                out[i] += v * w
                jacobian[0, i] += s0 * w
                jacobian[1, i] += s1 * w
                jacobian[2, i] += s2 * w
                jacobian[3, i] += s3 * w
                jacobian[4, i] += s4 * w
                jacobian[5, i] += s5 * w
                jacobian[6, i] += v * ahead[i]
                jacobian[7, i] += grown * w
        first = last


def _make_solver(n):
    """Make a solver of n equations: a size known at compile time makes a fit some per cent faster."""

    @njit(cache=True, error_model="numpy")
    def solve_posdef(matrix, right):
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

    return solve_posdef


_solve_six, _solve_eight = _make_solver(6), _make_solver(8)


@njit(cache=True, error_model="numpy")
def rotate(rotation, e):
    """Compute exp(e) R for a world rotation vector e.

    Parameters
    ----------
    rotation : ndarray, shape (3, 3)
    e : ndarray, shape (3,), in rad

    Returns
    -------
    ndarray, shape (3, 3)
    """
    angle = np.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
    if angle < _SMALL_ANGLE:
        return rotation.copy()
    x, y, z = e[0] / angle, e[1] / angle, e[2] / angle
    s, c = np.sin(angle), np.cos(angle)
    v = 1.0 - c
    turn, out = np.empty((3, 3)), np.zeros((3, 3))
    turn[0, 0], turn[0, 1], turn[0, 2] = c + x * x * v, x * y * v - z * s, x * z * v + y * s
    turn[1, 0], turn[1, 1], turn[1, 2] = y * x * v + z * s, c + y * y * v, y * z * v - x * s
    turn[2, 0], turn[2, 1], turn[2, 2] = z * x * v - y * s, z * y * v + x * s, c + z * z * v
    for i in range(3):
        for j in range(3):
            for k in range(3):
                out[i, j] += turn[i, k] * rotation[k, j]
    return out


@njit(cache=True, error_model="python", fastmath=True)
def fill_normal_equations(data, out, jacobian, amplitude, amplitude_prior, normal, gradient):
    """Fill J^T J and J^T r, the prior of the amplitude included (Eq. S20).

    Parameters
    ----------
    data, out : ndarray, shape (n_out,)
        Measured and modelled.
    jacobian : ndarray, shape (8, n_out)
    amplitude : float
        As a fraction of the reference angle.
    amplitude_prior : ndarray, shape (2,)
        Prior of the amplitude: its mean and the inverse of its variance (0 without a prior).
    normal : ndarray, shape (8, 8)
        Filled.
    gradient : ndarray, shape (8,)
        Filled.

    Returns
    -------
    cost : float
        Sum squared error plus the prior's term.
    sse : float
        Sum squared error.
    """
    n_out = data.shape[0]
    left = np.empty(n_out)
    sse = 0.0
    for i in range(n_out):
        left[i] = data[i] - out[i]
        sse += left[i] * left[i]
    for a in range(N_PARAMETERS):
        total = 0.0
        for i in range(n_out):
            total += jacobian[a, i] * left[i]
        gradient[a] = total
        for b in range(a + 1):
            total = 0.0
            for i in range(n_out):
                total += jacobian[a, i] * jacobian[b, i]
            normal[a, b] = total
            normal[b, a] = total
    off = amplitude_prior[0] - amplitude
    normal[7, 7] += amplitude_prior[1]
    gradient[7] += amplitude_prior[1] * off
    return sse + amplitude_prior[1] * off * off, sse


@njit(cache=True, error_model="numpy")
def fit(
    data, matrix, labels, positions, axes, moment, l0, angles, powers,
    position, rotation, phase, amplitude, amplitude_max, amplitude_prior, iterations, tolerance,
):  # fmt: skip
    """Fit pose, phase and amplitude from one start by the Levenberg-Marquardt method.

    Parameters
    ----------
    data : ndarray, shape (n_out,)
    matrix : ndarray, shape (n_functions, n_channels, n_out)
        Response of the linear chain; see `evaluate_model`.
    labels : ndarray of int, shape (n_functions, 3)
        See `evaluate_model`.
    positions : ndarray, shape (n_channels, 3), in m, world frame
        Of the sensors.
    axes : ndarray, shape (n_channels, 3), world frame
    moment : ndarray, shape (3,), in A·m², body frame
    l0 : float, in m
    angles : ndarray, shape (K,), in rad
        See `compute_series`.
    powers : ndarray, shape (K, K)
        See `compute_series`.
    position : ndarray, shape (3,), in m, world frame
        Start.
    rotation : ndarray, shape (3, 3)
        Start, body to world.
    phase : float, in rad
        Start.
    amplitude : float
        Start, as a fraction of the reference angle.
    amplitude_max : float
        Upper bound, as a fraction of the reference angle.
    amplitude_prior : ndarray, shape (2,)
        Prior of the amplitude: its mean and the inverse of its variance (0 without a prior).
    iterations : int
        Largest number of accepted steps.
    tolerance : float
        Relative decrease of the cost below which the fit has converged.

    Returns
    -------
    position : ndarray, shape (3,), in m
    rotation : ndarray, shape (3, 3)
    phase : float, in rad
    amplitude : float
    sse : float
        Sum squared error.
    normal : ndarray, shape (8, 8)
        J^T J.
    converged : bool
    """
    n_out = data.shape[0]
    out = np.zeros(n_out)
    jacobian = np.zeros((N_PARAMETERS, n_out))
    normal = np.zeros((N_PARAMETERS, N_PARAMETERS))
    gradient = np.zeros(N_PARAMETERS)
    position, rotation = position.copy(), rotation.copy()
    evaluate_model(
        matrix, labels, positions, axes, moment, l0, angles, powers, position, rotation, phase, amplitude, out, jacobian
    )
    cost, sse = fill_normal_equations(data, out, jacobian, amplitude, amplitude_prior, normal, gradient)
    damping = _FIRST_DAMPING
    converged = False
    trial_normal, trial_gradient = np.zeros((N_PARAMETERS, N_PARAMETERS)), np.zeros(N_PARAMETERS)
    right, step = np.zeros((N_PARAMETERS, 1)), np.zeros(N_PARAMETERS)
    for _ in range(iterations):
        held = amplitude >= amplitude_max and gradient[7] > 0.0
        accepted = False
        for _attempt in range(_ATTEMPTS):
            system = normal.copy()
            for a in range(N_PARAMETERS):
                right[a, 0] = gradient[a]
                system[a, a] *= 1.0 + damping
            if held:  # the amplitude stays at its bound
                for a in range(N_PARAMETERS):
                    system[a, 7] = 0.0
                    system[7, a] = 0.0
                system[7, 7] = 1.0
                right[7, 0] = 0.0
            if not _solve_eight(system, right):
                damping = max(damping, _REFUSED_DAMPING) * _DAMPING_UP
                continue
            length = np.sqrt(right[0, 0] ** 2 + right[1, 0] ** 2 + right[2, 0] ** 2)
            turned = np.sqrt(right[3, 0] ** 2 + right[4, 0] ** 2 + right[5, 0] ** 2)
            shrink = min(1.0, _MAX_SHIFT / (length + _TINY), _MAX_TURN / (turned + _TINY))
            new_position = position.copy()
            for a in range(N_PARAMETERS):
                step[a] = right[a, 0] * shrink
                if a < 3:
                    new_position[a] += step[a]
            new_rotation = rotate(rotation, step[3:6])
            new_phase = phase + step[6]
            new_amplitude = min(max(amplitude + step[7], _MIN_AMPLITUDE * amplitude_max), amplitude_max)
            evaluate_model(
                matrix, labels, positions, axes, moment, l0, angles, powers,
                new_position, new_rotation, new_phase, new_amplitude, out, jacobian,
            )  # fmt: skip
            new_cost, new_sse = fill_normal_equations(
                data, out, jacobian, new_amplitude, amplitude_prior, trial_normal, trial_gradient
            )
            if new_cost < cost:
                gain = (cost - new_cost) / cost
                position, rotation, phase, amplitude = new_position, new_rotation, new_phase, new_amplitude
                cost, sse = new_cost, new_sse
                normal, trial_normal = trial_normal, normal
                gradient, trial_gradient = trial_gradient, gradient
                damping = max(damping * _DAMPING_DOWN, _MIN_DAMPING)
                accepted = True
                if gain < tolerance and shrink == 1.0:
                    converged = True
                break
            if length < _STILL and turned < _STILL_TURN:
                converged = True
                break
            damping = max(damping, _WORSE_DAMPING) * _DAMPING_UP
        if converged or not accepted:
            converged = converged or not accepted
            break
    return position, rotation, phase, amplitude, sse, normal, converged


@njit(cache=True, error_model="numpy")
def estimate_phase_and_amplitude(
    data, matrix, labels, positions, axes, moment, l0, angles, powers, position, rotation, guess
):
    """Compute the phase and amplitude that fit the data best at a fixed pose; exact for small amplitudes.

    Parameters
    ----------
    data : ndarray, shape (n_out,)
    matrix : ndarray, shape (n_functions, n_channels, n_out)
        Response of the linear chain; see `evaluate_model`.
    labels : ndarray of int, shape (n_functions, 3)
        See `evaluate_model`.
    positions : ndarray, shape (n_channels, 3), in m, world frame
        Of the sensors.
    axes : ndarray, shape (n_channels, 3), world frame
    moment : ndarray, shape (3,), in A·m², body frame
    l0 : float, in m
    angles : ndarray, shape (K,), in rad
        See `compute_series`.
    powers : ndarray, shape (K, K)
        See `compute_series`.
    position : ndarray, shape (3,), in m, world frame
    rotation : ndarray, shape (3, 3)
        Body to world.
    guess : float
        Amplitude at which the model is linearized, as a fraction of the reference angle.

    Returns
    -------
    phase : float, in rad
    amplitude : float
    """
    n_out = data.shape[0]
    first = np.zeros(n_out)
    jacobian = np.zeros((N_PARAMETERS, n_out))
    evaluate_model(
        matrix, labels, positions, axes, moment, l0, angles, powers, position, rotation, 0.0, guess, first, jacobian
    )
    aa, ab, bb, ay, by = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n_out):
        second = -jacobian[6, i]  # first harmonic, a quarter of a period later
        aa += first[i] * first[i]
        ab += first[i] * second
        bb += second * second
        ay += first[i] * data[i]
        by += second * data[i]
    determinant = aa * bb - ab * ab
    if determinant <= _SINGULAR * aa * bb:
        return 0.0, guess
    u, v = (bb * ay - ab * by) / determinant, (aa * by - ab * ay) / determinant
    return np.arctan2(-v, u), guess * np.sqrt(u * u + v * v)


@njit(cache=True, error_model="numpy")
def compute_covariance(normal, variance):
    """Compute the covariance of position, rotation, phase and amplitude.

    Parameters
    ----------
    normal : ndarray, shape (8, 8)
        J^T J.
    variance : float
        Of the data.

    Returns
    -------
    ndarray, shape (8, 8)
        Infinite where the data do not determine all parameters.
    """
    out = np.full((N_PARAMETERS, N_PARAMETERS), np.inf)
    scale = np.zeros(N_PARAMETERS)
    for a in range(N_PARAMETERS):
        if normal[a, a] <= 0.0:
            return out
        scale[a] = 1.0 / np.sqrt(normal[a, a])
    system = np.zeros((N_PARAMETERS, N_PARAMETERS))
    inverse = np.eye(N_PARAMETERS)
    for a in range(N_PARAMETERS):
        for b in range(N_PARAMETERS):
            system[a, b] = normal[a, b] * scale[a] * scale[b]
    if not _solve_eight(system, inverse):
        return out
    worst = 0.0
    for a in range(N_PARAMETERS):
        worst = max(worst, inverse[a, a])
    if worst > _MAX_INVERSE:
        return out
    for a in range(N_PARAMETERS):
        for b in range(N_PARAMETERS):
            out[a, b] = variance * inverse[a, b] * scale[a] * scale[b]
    return out


@njit(cache=True, error_model="numpy")
def find_varying_channels(field):
    """Find the channels whose samples are finite and not constant.

    Parameters
    ----------
    field : ndarray, shape (n_sensors, n)

    Returns
    -------
    ndarray of bool, shape (n_sensors,)
    """
    out = np.zeros(field.shape[0], dtype=np.bool_)
    if field.shape[1] == 0:
        return out
    for j in range(field.shape[0]):
        first, total, changes = field[j, 0], 0.0, False
        for i in range(field.shape[1]):
            total += field[j, i]
            changes |= field[j, i] != first
        out[j] = changes and np.isfinite(total)
    return out


@njit(cache=True, error_model="python", fastmath=True)
def apply_taps(field, first, weights):
    """Compute weighted sums of raw samples, each channel less its own first sample.

    The first sample is subtracted so that a large constant costs no precision.

    Parameters
    ----------
    field : ndarray, shape (n_sensors, n)
    first : ndarray of int, shape (n_out,)
        First sample of each sum.
    weights : ndarray, shape (n_out, width)

    Returns
    -------
    ndarray, shape (n_sensors, n_out)
    """
    n_sensors, n_out, width = field.shape[0], weights.shape[0], weights.shape[1]
    out = np.empty((n_sensors, n_out))
    for j in range(n_sensors):
        base = field[j, 0]
        for i in range(n_out):
            total = 0.0
            start = first[i]
            for w in range(width):
                total += weights[i, w] * (field[j, start + w] - base)
            out[j, i] = total
    return out


@njit(cache=True, error_model="python", fastmath=True)
def mix_channels(mixing, samples):
    """Multiply two matrices without the threads of a linear algebra library.

    Parameters
    ----------
    mixing : ndarray, shape (n_rows, n)
    samples : ndarray, shape (n, m)

    Returns
    -------
    ndarray, shape (n_rows * m,)
        Row by row.
    """
    n_rows, n, m = mixing.shape[0], samples.shape[0], samples.shape[1]
    out = np.zeros(n_rows * m)
    for q in range(n_rows):
        if m == 1:
            total = 0.0
            for j in range(n):
                total += mixing[q, j] * samples[j, 0]
            out[q] = total
        else:
            for j in range(n):
                weight = mixing[q, j]
                if weight != 0.0:
                    for i in range(m):
                        out[q * m + i] += weight * samples[j, i]
    return out


@njit(cache=True, error_model="numpy")
def fit_grid_moments(gram, right, positions, axes, grid, moments):
    """Fit an oscillating moment at each grid position.

    Parameters
    ----------
    gram : ndarray, shape (2n, 2n)
        Normal equations of the first harmonic: the in-phase part of all n channels first, then quadrature.
    right : ndarray, shape (2n,)
        Their right side.
    positions : ndarray, shape (n, 3), in m, world frame
        Of the sensors.
    axes : ndarray, shape (n, 3), world frame
    grid : ndarray, shape (n_grid, 3), in m, world frame
    moments : ndarray, shape (n_grid, 6), in A·m², world frame
        Filled: in phase, then quadrature.

    Returns
    -------
    ndarray, shape (n_grid,)
        Decrease of the sum squared error by the moment at each position.
    """
    n = positions.shape[0]
    lead = np.zeros((n, 3))
    half = np.zeros((2 * n, 6))
    normal = np.zeros((6, 6))
    solution = np.zeros((6, 1))
    gains = np.zeros(grid.shape[0])
    for g in range(grid.shape[0]):
        for j in range(n):
            dx, dy, dz = positions[j, 0] - grid[g, 0], positions[j, 1] - grid[g, 1], positions[j, 2] - grid[g, 2]
            inverse = 1.0 / (dx * dx + dy * dy + dz * dz)
            f3 = _MU0_OVER_4PI * inverse * np.sqrt(inverse)
            da = 3.0 * inverse * (dx * axes[j, 0] + dy * axes[j, 1] + dz * axes[j, 2])
            lead[j, 0] = f3 * (da * dx - axes[j, 0])
            lead[j, 1] = f3 * (da * dy - axes[j, 1])
            lead[j, 2] = f3 * (da * dz - axes[j, 2])
        for row in range(2 * n):
            for part in range(2):
                for i in range(3):
                    total = 0.0
                    for j in range(n):
                        total += gram[row, part * n + j] * lead[j, i]
                    half[row, 3 * part + i] = total
        for part in range(2):
            for i in range(3):
                total = 0.0
                for j in range(n):
                    total += right[part * n + j] * lead[j, i]
                solution[3 * part + i, 0] = total
                for k in range(6):
                    total = 0.0
                    for j in range(n):
                        total += half[part * n + j, k] * lead[j, i]
                    normal[3 * part + i, k] = total
        trace = 0.0
        for i in range(6):
            trace += normal[i, i]
        for i in range(6):
            normal[i, i] += _RIDGE * trace
        saved = solution.copy()
        if _solve_six(normal, solution):
            for i in range(6):
                gains[g] += saved[i, 0] * solution[i, 0]
                moments[g, i] = solution[i, 0]
    return gains
