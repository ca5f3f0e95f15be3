"""Time functions of the oscillation after any linear chain, ready for the fit.

A sensor's field is a smooth function of the deflection, so a low power series in it is exact to well below the
noise: b(theta) = sum_k c_k (theta / theta_ref)^k. With theta from Eq. S2,

    theta^k = A^k D(t)^k cos^k(w t + phi) = A^k sum_h w_kh D(t)^k cos(h (w t + phi)),

and each D^k exp(i h w t) passes through sensor and chain once, before the fit, independent of pose, phase
and amplitude. The fit then costs one field evaluation per sensor and node.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from math import comb

import numpy as np
import numpy.typing as npt

from smolbot.core.arrays import FloatArray
from smolbot.core.sensing import Device
from smolbot.localization.chain import Taps
from smolbot.localization.forward import compute_envelope

DEGREE = 6
"""Highest power of the deflection in the series; the rest is below 1e-6 of the signal at 30 degrees."""

REFERENCE_ANGLE = float(np.radians(30.0))
"""Deflection, in rad, that scales the power series; the series is valid up to 40 degrees."""

NODE_SPREAD = 1.3
"""Half range of the Chebyshev nodes, in units of the reference angle: 39 degrees."""

FREQUENCY_STEP, DAMPING_STEP = 0.02, 0.02
"""Steps, in Hz and 1/s, of the difference quotients for frequency and damping."""

ComplexArray = npt.NDArray[np.complex128]


def compute_nodes() -> FloatArray:
    """Compute the Chebyshev nodes at which the field is evaluated.

    Returns
    -------
    ndarray, shape (DEGREE + 1,)
        In units of `REFERENCE_ANGLE`.
    """
    spread: FloatArray = NODE_SPREAD * np.cos(np.pi * (np.arange(DEGREE + 1) + 0.5) / (DEGREE + 1))
    return spread


@lru_cache(maxsize=1)
def compute_power_matrix() -> FloatArray:
    """Compute the matrix that turns values at the nodes into power series coefficients.

    Returns
    -------
    ndarray, shape (DEGREE + 1, DEGREE + 1)
    """
    inverse: FloatArray = np.linalg.inv(np.vander(compute_nodes(), DEGREE + 1, increasing=True)).astype(np.float64)
    return inverse


def compute_harmonic_weight(power: int, harmonic: int) -> float:
    """Compute the weight w_kh of cos(h x) in cos(x)^k.

    Parameters
    ----------
    power, harmonic : int

    Returns
    -------
    float
    """
    if harmonic > power or (power - harmonic) % 2:
        return 0.0
    weight = comb(power, (power - harmonic) // 2) / 2.0**power
    return weight if harmonic == 0 else 2.0 * weight


def compute_time_basis(
    device: Device, chain: Taps, sample_rate: float, time_since_drive: float, bandwidth: float
) -> ComplexArray:
    """Compute each D^k exp(i h w t) after the sensors' low pass and the chain.

    Parameters
    ----------
    device : Device
    chain : Taps
        Weights of the chain's output samples.
    sample_rate : float, in Hz
    time_since_drive : float, in s
        From the end of the drive to the recording's first sample.
    bandwidth : float, in Hz
        Of the sensors' first-order low pass, whose transient has decayed.

    Returns
    -------
    ndarray of complex, shape (DEGREE + 1, DEGREE + 1, n_out)
        ``[k, h]``: its real part times exp(i h phi), summed over h, is the chain's output for
        (D cos(w t + phi))^k.
    """
    omega = 2.0 * np.pi * device.frequency
    width = chain.weights.shape[1]
    time = time_since_drive + (chain.first[:, None] + np.arange(width)) / sample_rate
    damping = compute_envelope(device, time)
    rate = device.damping / damping if device.damping_model == "linear" else np.full_like(time, device.damping)
    wave = np.exp(1j * omega * time)
    out = np.zeros((DEGREE + 1, DEGREE + 1, len(chain.first)), dtype=np.complex128)
    for k in range(1, DEGREE + 1):
        damped = np.where(damping > 0, damping, 0.0) ** k
        for h in range(k % 2, k + 1, 2):
            # first-order low pass of the sensors, for a wave exp((i h omega - k rate) t)
            lag = 1.0 + (1j * h * omega - k * np.where(damping > 0, rate, 0.0)) / (2.0 * np.pi * bandwidth)
            out[k, h] = compute_harmonic_weight(k, h) * np.sum(chain.weights * damped * wave**h / lag, axis=1)
    return out


def list_labels() -> npt.NDArray[np.int64]:
    """List every real time function.

    Returns
    -------
    ndarray of int, shape (n_functions, 3)
        Power, harmonic, and 0 for the real part or 1 for the imaginary part; powers ascending.
    """
    return np.array(
        [(k, h, part) for k in range(1, DEGREE + 1) for h in range(k % 2, k + 1, 2) for part in ((0, 1) if h else (0,))]
    )


def to_real_functions(basis: ComplexArray) -> FloatArray:
    """Convert the complex time basis to real functions.

    Parameters
    ----------
    basis : ndarray of complex, shape (K, K, n_out)

    Returns
    -------
    ndarray, shape (n_functions, n_out)
        In the order of `list_labels`.
    """
    return np.array([basis[k, h].imag if part else basis[k, h].real for k, h, part in list_labels()])


def compute_functions_and_slopes(
    device: Device, chain: Taps, sample_rate: float, time_since_drive: float, bandwidth: float
) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """Compute the real time functions, and their derivatives for frequency and damping.

    Parameters
    ----------
    device : Device
    chain : Taps
    sample_rate : float, in Hz
    time_since_drive : float, in s
        From the end of the drive to the recording's first sample.
    bandwidth : float, in Hz
        Of the sensors' first-order low pass.

    Returns
    -------
    functions : ndarray, shape (n_functions, n_out)
    slopes : tuple of 2 ndarrays, shape (n_functions, n_out)
        Change per Hz of frequency, and per 1/s of damping.
    """

    def of(frequency: float, damping: float) -> FloatArray:
        changed = replace(device, frequency=frequency, damping=damping)
        return to_real_functions(compute_time_basis(changed, chain, sample_rate, time_since_drive, bandwidth))

    df, dd = FREQUENCY_STEP, DAMPING_STEP
    f, d = device.frequency, max(device.damping, dd)
    by_frequency = (of(f + df, device.damping) - of(f - df, device.damping)) / (2.0 * df)
    by_damping = (of(f, d + dd) - of(f, d - dd)) / (2.0 * dd)
    return of(f, device.damping), (by_frequency, by_damping)
