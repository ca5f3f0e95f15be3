"""Errors of a localizer without signals, from its own linear model, sampled noise and the true mismatches."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sim.reduced.linear_fit import compute_linear_fit
from smolbot.config.feasibility import make_noise_levels
from smolbot.config.rig import RigConfig
from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import matrix_from_quaternion, multiply_quaternions, quaternion_from_rotation_vector
from smolbot.core.sensing import Recording
from smolbot.localization import basis, kernels
from smolbot.localization.expected_covariance import compute_noise_parts
from smolbot.localization.localizer import Localizer
from smolbot.localization.noise.model import NoiseModel
from smolbot.localization.noise.spectra import ComplexArray
from smolbot.localization.noise.whitening import make_whitened_model
from smolbot.localization.problem import LinearModel, make_paper_model
from smolbot.localization.synthetic import SyntheticFit

N_PHASES = 4
"""Phases of the oscillation, over half a turn, of which one is sampled for each recording."""

MIN_AMPLITUDE = 1e-6
"""Smallest amplitude, in rad: the fit divides by it."""

SINCE_DIGITS = 9
"""Decimals, in s, of the time since the drive by which models are kept."""

REGULARISATION = 1e-12
"""Share of the mean variance added to a covariance before it is factored."""

DOUBT_SIGMAS = 4.0
"""Standard deviations by which the reduced chi-square must exceed 1 to scale the covariance."""


@dataclass(frozen=True, eq=False)
class SignalSource:
    """True source of the signals: sensors, magnet and ambient noise.

    Attributes
    ----------
    positions : ndarray, shape (n_sensors, 3), in m
        True positions, world frame.
    axes : ndarray, shape (n_sensors, 3)
        True sensitive directions, world frame; their length is the true over the assumed gain.
    moment : ndarray, shape (3,), in A·m²
        At rest, body frame.
    l0 : float, in m
    noise : NoiseModel
    """

    positions: FloatArray
    axes: FloatArray
    moment: FloatArray
    l0: float
    noise: NoiseModel


class FitErrors:
    """Samples the outcome of a fit around the true pose, linear in the data.

        x = x_true + (J^T J + P)^-1 (J^T (s_true - s(x_true) + e) + P (prior - x_true))

    J is the Jacobian of the localizer's own data vector s (whitened, or the paper's chain), e its noise, P its
    prior information on the amplitude. `s_true` is what the true sensors measure of the true magnet: that is the
    systematic part. Linear, since errors of some tenths of a mm are small against the 60 mm to the sensors.
    Resonance and damping are taken as known, for they are learned in flight.

    Parameters
    ----------
    localizer : Localizer
        With assumed sensors, device, estimator and transients.
    rig : RigConfig
    source : SignalSource
    rng : numpy.random.Generator
    """

    def __init__(self, localizer: Localizer, rig: RigConfig, source: SignalSource, rng: np.random.Generator) -> None:
        self._localizer, self._rig, self._source, self._rng = localizer, rig, source, rng
        self._models: dict[tuple[int, float], _Model] = {}

    def sample(
        self,
        position: FloatArray,
        orientation: FloatArray,
        amplitude: float,
        half_periods: int,
        time_since_drive: float,
    ) -> SyntheticFit:
        """Sample the outcome of one fit.

        Parameters
        ----------
        position : ndarray, shape (3,), in m
            True rotation centre, world frame.
        orientation : ndarray, shape (4,)
            True unit quaternion, scalar first.
        amplitude : float, in rad
            True amplitude at the end of the drive.
        half_periods : int
            Length of the recording.
        time_since_drive : float, in s
            From the end of the drive to its first sample.

        Returns
        -------
        SyntheticFit
        """
        key = half_periods, round(time_since_drive, SINCE_DIGITS)
        if key not in self._models:
            self._models[key] = _Model(self._localizer, self._rig, self._source, half_periods, time_since_drive)
        model = self._models[key]
        phase = int(N_PHASES * self._rng.random())
        white = self._rng.standard_normal(model.n_out)
        noise = white if model.noise_factor is None else model.noise_factor @ white
        rotation = matrix_from_quaternion(orientation)
        size = max(amplitude, MIN_AMPLITUDE) / basis.REFERENCE_ANGLE
        assumed, true = model.assumed, model.true
        kernels.compute_series(*assumed.magnet, *model.nodes, position, rotation, assumed.values, assumed.slopes)
        kernels.compute_series(*true.magnet, *model.nodes, position, rotation, true.values, true.slopes)
        change, spread, sse, total = compute_linear_fit(
            assumed.values, assumed.slopes, true.values, *model.waves[phase], size, noise, *model.belief,
            basis.REFERENCE_ANGLE,
        )  # fmt: skip
        turned = multiply_quaternions(quaternion_from_rotation_vector(change[3:6]), orientation)
        amplitude = (size + float(change[7])) * basis.REFERENCE_ANGLE
        spread *= model.compute_variance_factor(sse)
        return SyntheticFit(position + change[:3], turned, amplitude, spread, 1.0 - sse / total)


class _Series:
    """Sensors and a magnet, with memory for the channels' power series in the deflection and its derivatives."""

    def __init__(self, positions: FloatArray, axes: FloatArray, moment: FloatArray, l0: float) -> None:
        self.magnet = np.ascontiguousarray(positions), np.ascontiguousarray(axes), moment, l0
        powers = len(basis.compute_nodes())
        self.values, self.slopes = np.zeros((len(positions), powers)), np.zeros((len(positions), powers, 6))


class _Model:
    """A localizer's linear model for recordings of one kind, with its response at each of the sampled phases."""

    def __init__(
        self, localizer: Localizer, rig: RigConfig, source: SignalSource, half_periods: int, since: float
    ) -> None:
        rate, sensors, device = rig.sample_rate, localizer.sensors, localizer.device
        n_samples = round(half_periods * rate / (2.0 * device.frequency))
        everyone = np.ones(len(sensors), dtype=np.bool_).tobytes()
        model: LinearModel
        self.noise_factor: FloatArray | None = None
        if localizer.estimator == "whitened":
            trend = localizer.free_trend(Recording(np.zeros((len(sensors), n_samples)), rate, since))
            # the cached function would keep the noise of every seed
            build = make_whitened_model.__wrapped__
            model = build(sensors, device, source.noise, everyone, n_samples, rate, since, trend, localizer.transients)
        else:
            model = make_paper_model(sensors, device, everyone, n_samples, rate, since)
            parts = compute_noise_parts(sensors, make_noise_levels(rig), model.chain, rate, model.mixing)
            total = np.sum([np.kron(space, time) for space, time in parts], axis=0)
            self.noise_factor = np.linalg.cholesky(
                total + REGULARISATION * np.trace(total) / len(total) * np.eye(len(total))
            )
        self._white = model.white
        self.n_out = len(model.matrix)
        self.assumed = _Series(model.positions, model.axes, device.moment * device.moment_in_body, device.l0)
        self.true = _Series(source.positions, source.axes, source.moment, source.l0)
        self.nodes = basis.compute_nodes() * basis.REFERENCE_ANGLE, basis.compute_power_matrix()
        self.belief: tuple[float, float] = (float(model.amplitude_prior[0]), float(model.amplitude_prior[1]))
        self.waves = [_compute_responses(model, math.pi * k / N_PHASES) for k in range(N_PHASES)]

    def compute_variance_factor(self, sse: float) -> float:
        """Return the factor on a fit's covariance; white residuals change it only if they are significantly large."""
        freedom = max(self.n_out - kernels.N_PARAMETERS, 1)
        variance = sse / freedom
        if self._white and variance <= 1.0 + DOUBT_SIGMAS * math.sqrt(2.0 / freedom):
            return 1.0
        return variance


def _compute_responses(model: LinearModel, phase: float) -> tuple[FloatArray, FloatArray]:
    """Return the data's response to each channel's powers at one phase, and its derivative by the phase.

    Both have the shape (n_channels * powers, n_out).
    """
    n_out, _, n_channels = model.matrix.shape
    labels = basis.list_labels()
    n_powers = int(labels[:, 0].max())
    now, ahead = np.zeros((2, n_out, n_channels, n_powers))
    for f, (power, harmonic, sine) in enumerate(labels):
        turn, h = harmonic * phase, float(harmonic)
        value, slope = (-math.sin(turn), -h * math.cos(turn)) if sine else (math.cos(turn), -h * math.sin(turn))
        now[:, :, power - 1] += value * model.matrix[:, f]
        ahead[:, :, power - 1] += slope * model.matrix[:, f]
    return np.ascontiguousarray(now.reshape(n_out, -1).T), np.ascontiguousarray(ahead.reshape(n_out, -1).T)


def make_true_noise_model(rig: RigConfig, level: float, mains: float, phasors: ComplexArray) -> NoiseModel:
    """Build the noise model of the sampled tank, as an estimator knows it after long learning.

    Parameters
    ----------
    rig : RigConfig
    level, mains : float
        Sampled factors on the noise and on the mains frequency.
    phasors : ndarray of complex, shape (n_lines, n_sensors), in T
        Peak phasors of mains and harmonics, as the true sensors measure them.

    Returns
    -------
    NoiseModel
    """
    levels = make_noise_levels(rig)
    levels = replace(levels, floor=level * levels.floor, at_1hz=level * levels.at_1hz,
                     mains_frequency=mains * levels.mains_frequency)  # fmt: skip
    model = levels.make_model(rig.sensors)
    return replace(model, lines=phasors[:, :, None] * phasors[:, None, :].conj())
