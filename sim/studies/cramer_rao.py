"""The Cramer-Rao bound of a pose on a bench, from the tank's own model and its noise in closed form.

Nothing here comes from the localizer: derivatives are differences of what noiseless true sensors read, and the noise is
the one that is drawn. A constant in every channel, the phase and the amplitude are free.
"""

from __future__ import annotations

import numpy as np

from sim.tank.static_bench import StaticBench
from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import multiply_quaternions, quaternion_from_rotation_vector

BLOCKS, SMALLEST, LARGEST = 300, 3, 12
"""Number of blocks to which samples are averaged, and fewest and most samples of one (12 are 0.24 ms at 50 kS/s): the
bound grows by less than 0.5 % against single samples."""

STEPS = np.array([2e-5, 2e-5, 2e-5, 5e-4, 5e-4, 5e-4, 1e-3, 5e-4])
"""Steps of the difference quotients: position (m), rotation (rad), phase (rad), amplitude (rad)."""

N_PARAMETERS = len(STEPS)


def compute_bound(
    bench: StaticBench,
    position: FloatArray,
    orientation: FloatArray,
    half_periods: int,
    phase: float,
    time_since_drive: float = 0.02,
    amplitude: float | None = None,
) -> FloatArray:
    """Compute the Cramer-Rao bound of a pose on a bench.

    Parameters
    ----------
    bench : StaticBench
    position : ndarray, shape (3,), in m
    orientation : ndarray, shape (4,)
    half_periods : int
    phase : float, in rad
        At the end of the drive; the bound differs from phase to phase.
    time_since_drive : float, in s
    amplitude : float, optional, in rad
        The true stop if not given.

    Returns
    -------
    ndarray, shape (8, 8)
        Smallest covariance of position (m), rotation e (rad), phase (rad) and amplitude (rad).
    """
    n = bench.count_samples(half_periods)
    size = min(max(n // BLOCKS, SMALLEST), LARGEST)
    slopes = _differentiate_readings(bench, position, orientation, n, time_since_drive, phase, amplitude)
    count = n // size
    blocks = slopes[..., : count * size].reshape(*slopes.shape[:2], count, size).mean(axis=3)  # (8, channels, blocks)
    jacobian = np.moveaxis(blocks, 0, -1).reshape(-1, N_PARAMETERS)
    scale = np.linalg.norm(jacobian, axis=0)
    information = compute_whitened_gram(bench, jacobian / scale, count, size)
    inverse: FloatArray = np.linalg.inv(information) / np.outer(scale, scale)
    return inverse


def compute_whitened_gram(bench: StaticBench, columns: FloatArray, count: int, size: int) -> FloatArray:
    """Compute ``columns^T C^-1 columns`` with a free constant in each channel.

    Parameters
    ----------
    bench : StaticBench
    columns : ndarray
        Rows run over channels, then blocks of `size`.
    count : int
        Blocks.
    size : int
        Samples in a block.

    Returns
    -------
    ndarray, shape (k, k)
    """
    from scipy.linalg import solve_triangular

    n_channels = len(bench.sensors)
    factor = np.linalg.cholesky(compute_own_covariance(bench, count, size))
    lines = sample_line_waves(bench, count, size)

    def whiten(matrix: FloatArray) -> FloatArray:
        stacked = matrix.reshape(n_channels, count, -1).transpose(1, 0, 2).reshape(count, -1)
        solved = (
            solve_triangular(factor, stacked, lower=True, check_finite=False)
            .reshape(count, n_channels, -1)
            .transpose(1, 0, 2)
        )
        return np.ascontiguousarray(solved.reshape(n_channels * count, -1))

    # free constants of the channels are projected out; the lines of the mains by the Woodbury identity
    constants: FloatArray = whiten(np.kron(np.eye(n_channels), np.ones((count, 1))).astype(np.float64))
    constants /= np.linalg.norm(constants, axis=0)  # of different channels: already orthogonal
    white, loud = whiten(columns), whiten(lines)
    white -= constants @ (constants.T @ white)
    loud -= constants @ (constants.T @ loud)
    middle = np.eye(loud.shape[1]) + loud.T @ loud
    across = loud.T @ white
    gram: FloatArray = white.T @ white - across.T @ np.linalg.solve(middle, across)
    return gram


def compute_own_covariance(bench: StaticBench, count: int, size: int) -> FloatArray:
    """Compute the covariance of block means of one sensor's own noise and its converter's.

    Parameters
    ----------
    bench : StaticBench
    count : int
    size : int

    Returns
    -------
    ndarray, shape (count, count), in T²
    """
    corners, deviations = bench.true_sensors.sensor_noise.processes
    turn = 2 * np.pi * corners * size / bench.rate
    lags = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    # covariance of block means of an Ornstein-Uhlenbeck process: the same block, and at a distance
    inside = 2.0 * (turn + np.expm1(-turn)) / turn**2
    outside = 4.0 * np.sinh(0.5 * turn) ** 2 / turn**2
    total = np.zeros((count, count))
    for k in range(len(corners)):
        by_lag = np.concatenate([[inside[k]], outside[k] * np.exp(-turn[k] * np.arange(1, count))])
        total += deviations[k] ** 2 * by_lag[lags]
    # quantisation: step² / 12 per sample
    return total + np.eye(count) * bench.true_sensors.converter_step**2 / 12.0 / size


def sample_line_waves(bench: StaticBench, count: int, size: int) -> FloatArray:
    """Return cosine and sine of each mains line, averaged over blocks.

    Parameters
    ----------
    bench : StaticBench
    count : int
        Blocks.
    size : int
        Samples in a block.

    Returns
    -------
    ndarray, shape (count, 2 n_lines)
    """
    noise = bench.true_sensors.field_noise
    time = (np.arange(count) + 0.5) * size / bench.rate
    waves = []
    for frequency, phasors in zip(noise.frequencies, noise.amplitudes, strict=True):
        turned = np.sinc(frequency * size / bench.rate) * np.exp(2j * np.pi * frequency * time)
        wave = (phasors[:, None] * turned).reshape(-1)
        waves += [np.sqrt(0.5) * wave.real, np.sqrt(0.5) * wave.imag]
    return np.stack(waves, axis=1)


def _differentiate_readings(
    bench: StaticBench,
    position: FloatArray,
    orientation: FloatArray,
    n: int,
    since: float,
    phase: float,
    amplitude: float | None,
) -> FloatArray:
    """Central differences of the noiseless readings, shape (8, n_sensors, n)."""
    size = bench.true_device.theta_max if amplitude is None else amplitude

    def readings(step: FloatArray) -> FloatArray:
        turned = multiply_quaternions(quaternion_from_rotation_vector(step[3:6]), orientation)
        return bench.compute_clean_readings(
            position + step[:3], turned, n, since, size + float(step[7]), phase + float(step[6])
        )

    steps = np.diag(STEPS)
    return np.stack([(readings(s) - readings(-s)) / (2.0 * STEPS[i]) for i, s in enumerate(steps)])


def compute_position_bound(covariance: FloatArray) -> float:
    """Compute the root mean square of the bound over the three axes.

    Parameters
    ----------
    covariance : ndarray, shape (8, 8)

    Returns
    -------
    float, in m
    """
    return float(np.sqrt(np.trace(covariance[:3, :3]) / 3.0))
