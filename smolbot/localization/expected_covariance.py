"""Expected accuracy of a pose: covariance of the ``paper`` estimator under a described noise."""

from __future__ import annotations

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.sensing import Device, SensorArray
from smolbot.localization import basis as time_functions
from smolbot.localization.chain import Taps
from smolbot.localization.noise.model import GRADIENT_ISOTROPY
from smolbot.localization.noise.room import NoiseLevels
from smolbot.localization.problem import make_paper_model

N_PHASES = 4
"""Phases of the oscillation, over half a turn, across which the covariance is averaged."""

LOW_BAND, LOW_POINTS = (0.5, 50.0), 40
"""Frequencies, in Hz, where 1/f noise dominates, and points there, evenly spaced in their logarithm."""

HIGH_START, HIGH_STEP = 55.0, 10.0
"""First of the frequencies above, and their spacing, in Hz."""

BANDWIDTHS, RATE_SHARE = 4.0, 0.45
"""Highest frequency: in bandwidths of the sensors, and as a share of the sample rate."""


def compute_expected_covariance(
    sensors: SensorArray,
    device: Device,
    noise: NoiseLevels,
    pose: Pose,
    half_periods: int,
    sample_rate: float,
    time_since_drive: float,
    amplitude: float | None = None,
) -> FloatArray:
    """Compute the covariance of the ``paper`` estimator at a pose, with phase and amplitude free.

    The noise of a fit is not white after the chain: mains lines have the same phase in all
    sensors and last the complete window. Their phase is uniform, their direction and gradient random.

    Parameters
    ----------
    sensors : SensorArray
    device : Device
    noise : NoiseLevels
    pose : Pose
    half_periods : int
        Length of the listening window.
    sample_rate : float, in Hz
    time_since_drive : float, in s
        From the end of the drive to the first sample.
    amplitude : float, optional, in rad
        At the end of the drive; `Device.theta_max` if not given.

    Returns
    -------
    ndarray, shape (6, 6)
        Of (position in m, rotation e in rad), averaged over four phases of the oscillation.
    """
    n_samples = round(half_periods * sample_rate / (2.0 * device.frequency))
    usable = np.ones(len(sensors), dtype=np.bool_).tobytes()
    model = make_paper_model(sensors, device, usable, n_samples, sample_rate, time_since_drive)
    size = (device.theta_max if amplitude is None else amplitude) / time_functions.REFERENCE_ANGLE
    parts = compute_noise_parts(sensors, noise, model.chain, sample_rate, model.mixing)
    covariances = []
    # linear propagation for each phase: pose covariance = (J^T J)^-1 J^T C J (J^T J)^-1
    for phase in np.pi * np.arange(N_PHASES) / N_PHASES:
        _, jacobian = model.compute_response(pose.position, pose.rotation, float(phase), size)
        scale = np.sqrt(np.sum(jacobian**2, axis=0))
        scaled = (jacobian / scale).reshape(len(model.mixing), -1, 8)
        gain = np.linalg.inv(np.einsum("qia,qib->ab", scaled, scaled))
        middle = np.zeros((8, 8))
        for space, time in parts:
            middle += np.einsum("qia,qr,ij,rjb->ab", scaled, space, time, scaled, optimize=True)
        covariances.append((gain @ middle @ gain) / np.outer(scale, scale))
    return np.mean(covariances, axis=0)[:6, :6]


def compute_noise_parts(
    sensors: SensorArray, noise: NoiseLevels, chain: Taps, sample_rate: float, mixing: FloatArray
) -> list[tuple[FloatArray, FloatArray]]:
    """Compute the noise covariance of the chain's output as a sum of Kronecker products.

    Parameters
    ----------
    sensors : SensorArray
    noise : NoiseLevels
    chain : Taps
    sample_rate : float, in Hz
    mixing : ndarray, shape (n_differences, n_sensors)

    Returns
    -------
    list of tuple of 2 ndarrays
        Covariance between channels (n_differences, n_differences), and between samples (n_out, n_out).
    """
    n = len(sensors)
    parts = [(mixing @ mixing.T, _compute_sensor_noise(noise, chain, sample_rate, sensors.bandwidth))]
    alignment = sensors.axes @ sensors.axes.T
    uniform = noise.mains**2 / 3.0 * alignment
    place, axes = sensors.positions, sensors.axes
    # isotropic symmetric trace-free gradient with Frobenius norm sqrt(3) g
    along = np.einsum("ja,ka->jk", axes, axes) * (place @ place.T)
    crossed = (axes @ place.T) * (axes @ place.T).T
    own = np.einsum("ja,ja->j", axes, place)
    gradient = GRADIENT_ISOTROPY * noise.mains_gradient**2 * (along + crossed - 2.0 / 3.0 * np.outer(own, own))
    for order, relative in {1: 1.0, **noise.harmonics}.items():
        space = relative**2 * (uniform + gradient).reshape(n, n)
        wave = _compute_line_response(chain, sample_rate, order * noise.mains_frequency)
        parts.append((mixing @ space @ mixing.T, 0.5 * np.real(np.outer(wave, wave.conj()))))
    return parts


def _compute_line_response(
    chain: Taps, sample_rate: float, frequency: float
) -> np.ndarray[tuple[int], np.dtype[np.complex128]]:
    time = (chain.first[:, None] + np.arange(chain.weights.shape[1])) / sample_rate
    return np.sum(chain.weights * np.exp(2j * np.pi * frequency * time), axis=1)


def _compute_sensor_noise(noise: NoiseLevels, chain: Taps, sample_rate: float, bandwidth: float) -> FloatArray:
    """Compute the covariance between output samples of one sensor's own noise."""
    top = min(BANDWIDTHS * bandwidth, RATE_SHARE * sample_rate)
    frequency = np.concatenate([np.geomspace(*LOW_BAND, LOW_POINTS), np.arange(HIGH_START, top, HIGH_STEP)])
    density = (noise.floor**2 + max(noise.at_1hz**2 - noise.floor**2, 0.0) / frequency) / (
        1.0 + (frequency / bandwidth) ** 2
    )
    width = np.gradient(frequency)
    time = (chain.first[:, None] + np.arange(chain.weights.shape[1])) / sample_rate
    total = np.zeros((len(chain.first), len(chain.first)))
    for f, power in zip(frequency, density * width, strict=True):
        wave = np.sum(chain.weights * np.exp(2j * np.pi * f * time), axis=1)
        total += power * np.real(np.outer(wave, wave.conj()))
    return total
