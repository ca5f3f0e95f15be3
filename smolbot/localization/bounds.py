"""The Cramer-Rao bound of a pose: the lowest covariance of any estimator under a given noise.

Data are averages over short blocks with the noise's own covariance C. With J the derivative of the
model for position, rotation, phase and amplitude, and a free polynomial in every channel projected
out (a constant at least), the bound is (J^T C^-1 J)^-1: eight unknowns, of which six are the pose.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from smolbot.core.arrays import FloatArray
from smolbot.core.sensing import Device, SensorArray
from smolbot.errors import InputError
from smolbot.localization import basis as time_functions
from smolbot.localization import kernels
from smolbot.localization.noise.model import NoiseModel
from smolbot.localization.noise.whitening import MAX_BLOCK, make_block_taps

N_PHASES = 4
"""Phases of the oscillation, over half a turn, across which a bound is averaged."""


@dataclass(frozen=True)
class ListeningWindow:
    """A listening window.

    Attributes
    ----------
    half_periods : float
    sample_rate : float, in Hz
    since : float, in s
        From the end of the drive to the first sample.
    """

    half_periods: float
    sample_rate: float
    since: float

    def count_samples(self, frequency: float) -> int:
        """Count the samples in the window.

        Parameters
        ----------
        frequency : float, in Hz
            Of the device.

        Returns
        -------
        int
        """
        return round(self.half_periods * self.sample_rate / (2.0 * frequency))


@dataclass(frozen=True, eq=False)
class Bound:
    """Lowest covariance at some poses.

    Attributes
    ----------
    covariance : ndarray, shape (n_poses, 8, 8)
        Of position (m), rotation e (rad), phase (rad) and amplitude (rad), averaged over phases.
    """

    covariance: FloatArray

    @property
    def position_rms(self) -> FloatArray:
        """Root mean square error per axis at each pose, shape (n_poses,), in m."""
        return np.sqrt(np.trace(self.covariance[:, :3, :3], axis1=1, axis2=2) / 3.0)

    @property
    def height_amplitude_correlation(self) -> FloatArray:
        """Correlation of z with the amplitude at each pose, shape (n_poses,)."""
        spread = np.sqrt(self.covariance[:, 2, 2] * self.covariance[:, 7, 7])
        correlation: FloatArray = self.covariance[:, 2, 7] / spread
        return correlation


def compute_pose_bound(
    sensors: SensorArray,
    device: Device,
    noise: NoiseModel,
    positions: npt.ArrayLike,
    rotations: npt.ArrayLike,
    window: ListeningWindow,
    *,
    amplitude: float | None = None,
    trend: int = 0,
    block: float = MAX_BLOCK,
) -> Bound:
    """Compute the Cramer-Rao bound at some poses, with phase, amplitude and a polynomial per channel free.

    Parameters
    ----------
    sensors : SensorArray
    device : Device
    noise : NoiseModel
        The true one.
    positions : array_like, shape (n_poses, 3), in m, world frame
    rotations : array_like, shape (n_poses, 3, 3)
        Rotation matrices, body to world.
    window : ListeningWindow
    amplitude : float, optional, in rad
        At the end of the drive; the device's stop if not given.
    trend : int
        Degree of the polynomial that is free in every channel: 0 for a constant, 1 for a constant and a slope.
    block : float, in s
        Samples are averaged over blocks of at most this length: by default the estimator's, which cost up to 3 %
        compared with far shorter ones.

    Returns
    -------
    Bound

    Raises
    ------
    InputError
        If the window holds too few blocks for the unknowns, or blocks are too short for the noise model.
    """
    return Response(sensors, device, noise, window, amplitude=amplitude, trend=trend, block=block).compute_bound(
        positions, rotations
    )


class Response:
    """Response of whitened data to the power series of the channels; one object serves many poses.

    Parameters
    ----------
    sensors : SensorArray
    device : Device
    noise : NoiseModel
        The true one.
    window : ListeningWindow
    amplitude : float, optional, in rad
        At the end of the drive; the device's stop if not given.
    trend : int
        Degree of the polynomial that is free in every channel.
    block : float, in s
        Longest block over which samples are averaged.

    Raises
    ------
    InputError
        If the window holds too few blocks for the unknowns, or blocks are too short for the noise model.
    """

    def __init__(
        self,
        sensors: SensorArray,
        device: Device,
        noise: NoiseModel,
        window: ListeningWindow,
        *,
        amplitude: float | None = None,
        trend: int = 0,
        block: float = MAX_BLOCK,
    ) -> None:
        chain = make_block_taps(window.count_samples(device.frequency), window.sample_rate, block)
        n_blocks, size = chain.weights.shape
        if len(sensors) * (n_blocks - 1 - trend) < kernels.N_PARAMETERS:
            raise InputError(f"A bound needs a longer window than {window.half_periods:g} half-periods of blocks.")
        self.sensors = sensors
        self.device = device
        self.amplitude = (device.theta_max if amplitude is None else amplitude) / time_functions.REFERENCE_ANGLE
        covariance = noise.covariance(n_blocks, size / window.sample_rate)
        free = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, n_blocks), trend + 1, increasing=True), mode="complete")[0]
        kept = free[:, trend + 1 :]  # complement of the free polynomials
        n = len(sensors)
        # noise of the blocks after the polynomials are removed, and the matrix that makes it white
        middle = np.einsum("ta,itju,ub->iajb", kept, covariance.reshape(n, n_blocks, n, n_blocks), kept, optimize=True)
        whiten = _invert_cholesky_factor(middle.reshape(n * kept.shape[1], -1), noise, size / window.sample_rate)
        self._whiten = np.einsum("mja,ta->mjt", whiten.reshape(len(whiten), n, -1), kept, optimize=True)
        self._basis = time_functions.compute_time_basis(
            device, chain, window.sample_rate, window.since, sensors.bandwidth
        )

    def with_amplitude(self, amplitude: float) -> Response:
        """Return the response of a device that swings less, or more.

        Parameters
        ----------
        amplitude : float, in rad
            At the end of the drive.

        Returns
        -------
        Response
        """
        other = copy.copy(self)
        other.amplitude = amplitude / time_functions.REFERENCE_ANGLE
        return other

    def compute_bound(self, positions: npt.ArrayLike, rotations: npt.ArrayLike) -> Bound:
        """Compute the bound at some poses, averaged over phases.

        Parameters
        ----------
        positions : array_like, shape (n_poses, 3), in m, world frame
        rotations : array_like, shape (n_poses, 3, 3)
            Rotation matrices, body to world.

        Returns
        -------
        Bound
        """
        values, slopes = self.compute_series(positions, rotations)
        covariances = []
        for phase in np.pi * np.arange(N_PHASES) / N_PHASES:
            jacobian = self.compute_jacobian(values, slopes, float(phase))
            covariances.append(_invert(np.swapaxes(jacobian, 1, 2) @ jacobian))
        covariance = np.mean(covariances, axis=0)
        covariance[:, 7] *= time_functions.REFERENCE_ANGLE
        covariance[:, :, 7] *= time_functions.REFERENCE_ANGLE
        return Bound(covariance)

    def compute_series(self, positions: npt.ArrayLike, rotations: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Compute the power series of the channels at each pose; see `compute_channel_series`.

        Parameters
        ----------
        positions : array_like, shape (n_poses, 3), in m, world frame
        rotations : array_like, shape (n_poses, 3, 3)
            Rotation matrices, body to world.

        Returns
        -------
        values : ndarray, shape (n_poses, n_sensors, K), in T
        slopes : ndarray, shape (n_poses, n_sensors, K, 6), in T/m and T/rad
        """
        return compute_channel_series(self.sensors, self.device, positions, rotations)

    def compute_waves(self, phase: float) -> tuple[FloatArray, FloatArray]:
        """Compute the whitened response to each power of each channel.

        Parameters
        ----------
        phase : float, in rad

        Returns
        -------
        now : ndarray, shape (n_data, n_sensors, K)
        ahead : ndarray, shape (n_data, n_sensors, K), per rad
            Its derivative for the phase.
        """
        harmonics = np.arange(self._basis.shape[1])
        turned = self._basis * np.exp(1j * harmonics * phase)[None, :, None]
        size = self.amplitude ** np.arange(len(turned))
        now = size[:, None] * np.real(turned.sum(axis=1))
        ahead = size[:, None] * np.real((1j * harmonics[None, :, None] * turned).sum(axis=1))
        return self._whiten @ now.T, self._whiten @ ahead.T

    def compute_jacobian(self, values: FloatArray, slopes: FloatArray, phase: float) -> FloatArray:
        """Compute the derivatives of whitened data.

        Parameters
        ----------
        values : ndarray, shape (n_poses, n_sensors, K), in T
        slopes : ndarray, shape (n_poses, n_sensors, K, 6), in T/m and T/rad
            Both from `compute_channel_series`.
        phase : float, in rad

        Returns
        -------
        ndarray, shape (n_poses, n_data, 8)
            For position, rotation e, phase, and amplitude as a fraction of the reference angle.
        """
        now, ahead = self.compute_waves(phase)
        n_data, n_poses = len(now), len(values)
        powers = np.arange(values.shape[2])
        coefficients = np.concatenate([slopes, (values * powers / self.amplitude)[..., None]], axis=3)
        flat = coefficients.transpose(1, 2, 0, 3).reshape(-1, n_poses * 7)
        out = np.empty((n_poses, n_data, 8))
        direct = (now.reshape(n_data, -1) @ flat).reshape(n_data, n_poses, 7).transpose(1, 0, 2)
        out[:, :, :6], out[:, :, 7] = direct[:, :, :6], direct[:, :, 6]
        out[:, :, 6] = (ahead.reshape(n_data, -1) @ values.reshape(n_poses, -1).T).T
        return out


def compute_channel_series(
    sensors: SensorArray, device: Device, positions: npt.ArrayLike, rotations: npt.ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Compute each channel as a power series in the deflection, at some poses.

    Parameters
    ----------
    sensors : SensorArray
    device : Device
    positions : array_like, shape (n_poses, 3), in m, world frame
    rotations : array_like, shape (n_poses, 3, 3)
        Rotation matrices, body to world.

    Returns
    -------
    values : ndarray, shape (n_poses, n_sensors, K), in T
    slopes : ndarray, shape (n_poses, n_sensors, K, 6)
        Derivatives for position (per m) and for e in exp(e) R (per rad).

    Raises
    ------
    InputError
        If there are not as many positions as rotations.
    """
    places = np.asarray(positions, dtype=np.float64).reshape(-1, 3)
    turns = np.asarray(rotations, dtype=np.float64).reshape(-1, 3, 3)
    if len(places) != len(turns):
        raise InputError(f"Bounds need as many positions as rotations; got {len(places)} and {len(turns)}.")
    angles = time_functions.compute_nodes() * time_functions.REFERENCE_ANGLE
    values = np.zeros((len(places), len(sensors), len(angles)))
    slopes = np.zeros((*values.shape, 6))
    array = (np.array(sensors.positions), np.array(sensors.responses))
    for i in range(len(places)):
        kernels.compute_series(
            *array, device.moment * device.moment_in_body, device.l0, angles,
            time_functions.compute_power_matrix(), places[i], np.ascontiguousarray(turns[i]), values[i], slopes[i],
        )  # fmt: skip
    return values, slopes


def _invert_cholesky_factor(covariance: FloatArray, noise: NoiseModel, block: float) -> FloatArray:
    """Compute the inverse Cholesky factor."""
    try:
        factor = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        raise InputError(
            f"Blocks of {block * 1e3:.3f} ms reach beyond the {noise.frequencies[-1]:.0f} Hz that the noise model "
            "describes; give longer blocks, or a model that goes further."
        ) from None
    return np.asarray(np.linalg.inv(factor), dtype=np.float64)


def _invert(information: FloatArray) -> FloatArray:
    """Invert symmetric positive matrices (n, 8, 8), scaled first so that units cost no precision."""
    scale = 1.0 / np.sqrt(np.einsum("nii->ni", information))
    outer = scale[:, :, None] * scale[:, None, :]
    inverse: FloatArray = np.linalg.inv(information * outer) * outer
    return inverse
