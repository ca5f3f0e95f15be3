"""The localizer: from one recording to one pose."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, get_args

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.rotations import choose_nearer_orientation, quaternion_from_axes, quaternion_from_matrix
from smolbot.core.sensing import Device, Recording, SensorArray
from smolbot.errors import InputError
from smolbot.localization import kernels
from smolbot.localization.ambiguity import choose_fit, compute_residual_variance, count_degrees_of_freedom
from smolbot.localization.array.consistency import ChannelCheck, check_channels
from smolbot.localization.array.terms import ArrayTerms, compute_array_terms
from smolbot.localization.basis import REFERENCE_ANGLE
from smolbot.localization.cold_start import SearchVolume, find_best_fits
from smolbot.localization.estimator import PoseEstimatorBase
from smolbot.localization.forward import compute_deflection, compute_sensor_field
from smolbot.localization.noise.excitation_transients import NEGLIGIBLE_AFTER
from smolbot.localization.noise.model import NoiseModel
from smolbot.localization.noise.residuals import compute_energies
from smolbot.localization.noise.whitening import prepare_whitened
from smolbot.localization.problem import DeviceChange, Fit, Problem, prepare_paper
from smolbot.localization.segments import SharedAmplitude, cut_segments, find_anchor

Estimator = Literal["whitened", "paper"]

MIN_R_SQUARED = 0.7
"""R² below which a fit explains too little of the signal to be trusted."""

MIN_AMPLITUDE = 0.05
"""Amplitude, as a share of that at the stops, below which a swing is not stronger than a mains line."""

TREND_HALF_PERIODS = (6.0, 10.0)
"""Length, in half-periods, from which a slope is fitted in every channel, and from which a curvature is too. Each costs
at most 1.5 % of the bound there. Passing tools, or motion of the device, cause such trends."""

FALLBACK_TREND = 1
"""Degree of the polynomial that is fitted to a short window whose misfit is large without it."""

MAX_MISFIT = 3.0
"""Variance of whitened residuals above which they contain more than noise."""

MAX_MISFIT_RATIO = 0.5
"""Misfit with a freer trend, relative to the one without, below which the freer fit is taken."""

MAX_START_MISFIT = 0.3
"""Share of the signal that a fit from the prior may leave unexplained before a cold start is tried as well."""

MAX_SIGMA = (3e-3, 0.2)
"""Standard deviations, in m and rad, above which a pose is not trusted."""

VOLUME_MARGIN = 0.02
"""Distance, in m, by which a trusted pose may lie outside the search volume."""

UNKNOWN_VARIANCES = [1e-2] * 3 + [10.0] * 3
"""Variances (m², rad²) of a pose whose fit determines nothing."""

RESIDUAL_SIGMAS = 4.0
"""Standard deviations by which the residual variance must exceed one to count as larger."""


_WITHOUT_PHASE = np.ix_([0, 1, 2, 3, 4, 5, 7], [0, 1, 2, 3, 4, 5, 7])

MAX_ROLL = 1.0
"""Standard deviation, in rad, of the turn about the moment above which a pose of consecutive segments is not trusted:
only the cantilever's length determines that turn."""


@dataclass(frozen=True, eq=False)
class Swing:
    """Oscillation found in one recording along with the pose.

    Attributes
    ----------
    amplitude, phase : float, in rad
        At the end of the drive.
    covariance : ndarray, shape (7, 7)
        Of (position in m, rotation e in rad, amplitude in rad); its first six are the pose's.
    """

    amplitude: float
    phase: float
    covariance: FloatArray
    _problem: Problem
    _fit: Fit
    _variance: float

    @classmethod
    def from_fit(cls, problem: Problem, fit: Fit, variance: float, spread: FloatArray | None) -> Swing:
        """Make the swing of a fit.

        Parameters
        ----------
        problem : Problem
        fit : Fit
        variance : float
            Of the residuals.
        spread : ndarray, shape (8, 8), or None
            Covariance in the fit's units, if it is known.

        Returns
        -------
        Swing
        """
        joint = np.full((7, 7), np.inf) if spread is None else spread[_WITHOUT_PHASE]
        joint[6] *= REFERENCE_ANGLE
        joint[:, 6] *= REFERENCE_ANGLE
        return cls(fit.amplitude * REFERENCE_ANGLE, float(fit.phase), joint, problem, fit, variance)

    @property
    def misfit(self) -> float:
        """Variance of the residuals: about 1 for whitened data if only noise is left."""
        return compute_residual_variance(self._problem, self._fit)

    @property
    def white(self) -> bool:
        """True if the data are whitened, so that the noise of each has unit variance."""
        return self._problem.model.white

    @property
    def degrees_of_freedom(self) -> int:
        """Degrees of freedom of the residuals."""
        return count_degrees_of_freedom(self._problem)

    def check_channels(
        self, frames: FloatArray, covariance: FloatArray, problem: Problem | None = None
    ) -> ChannelCheck:
        """Check whether each sensor agrees with the others.

        Parameters
        ----------
        frames : ndarray, shape (n_sensors, 2, 3)
            Directions of each sensor's tilts.
        covariance : ndarray, shape (6 * n_sensors + 2, 6 * n_sensors + 2)
            Of the deviations of sensors and device, see `ArrayPrior`.
        problem : Problem, optional
            The same recording with other sensors in use; the one that was fitted unless given.

        Returns
        -------
        ChannelCheck
        """
        return check_channels(self._problem if problem is None else problem, self._fit, frames, covariance)

    def compute_energies(
        self, recording: Recording, noise: NoiseModel, problem: Problem | None = None
    ) -> tuple[FloatArray, FloatArray] | None:
        """Compute the energy of the fit residuals of each channel, and its expected value under a noise model.

        Parameters
        ----------
        recording : Recording
        noise : NoiseModel
        problem : Problem, optional
            The same recording with other sensors in use; the one that was fitted unless given.

        Returns
        -------
        tuple of ndarray, shape (n_sensors,), or None
            Energy and expected energy, in units of the noise; None for a fit without a noise model.
        """
        model = (self._problem if problem is None else problem).model
        return compute_energies(model, self._fit, recording, noise) if model.white else None

    def compute_array_terms(self, frames: FloatArray) -> ArrayTerms | None:
        """Compute the recording's information on the sensors.

        Parameters
        ----------
        frames : ndarray, shape (n_sensors, 2, 3)
            Directions of each sensor's tilts.

        Returns
        -------
        ArrayTerms or None
            None if the recording gives none.
        """
        return compute_array_terms(self._problem, self._fit, frames)

    def estimate_resonance_error(self) -> tuple[FloatArray, FloatArray]:
        """Estimate the error of the assumed frequency and damping.

        Returns
        -------
        offset : ndarray, shape (2,), in Hz and 1/s
            Estimated minus assumed frequency and damping.
        covariance : ndarray, shape (2, 2)
        """
        return self._problem.estimate_resonance_error(self._fit, self._variance)

    def estimate_device_change(self) -> DeviceChange | None:
        """Estimate by how much frequency and damping differ from the device's, and how much that explains.

        Returns
        -------
        DeviceChange or None
            None where they are not determined.
        """
        return self._problem.estimate_device_change(self._fit)


class Localizer(PoseEstimatorBase):
    """Fits the six degrees of freedom of a SMOL device to a recording.

    Phase and amplitude are fitted along with the pose: the amplitude at the end of the drive is at
    most `Device.theta_max`, but not known.

    Parameters
    ----------
    sensors : SensorArray
    device : Device
        As assumed. A localizer is immutable: learned values of the device need a new one.
    noise : NoiseModel, optional
        Learned from recordings of background noise; without it a typical one is assumed. Only ``whitened`` uses it.
    estimator : {"whitened", "paper"}
        ``whitened``: generalised least squares under the noise model, all channels, a free constant in each.
        ``paper``: the paper's signal chain with an unweighted Levenberg-Marquardt fit (Eqs. S2 to S8, S20 to S23).
    volume : SearchVolume
        Where a cold start searches, and where a trusted pose may lie.
    transients : tuple of float, in s
        Learned time constants of the excitation coils' ring-down; ``whitened`` separates it from the signal
        if a recording starts before it is over.

    Notes
    -----
    `locate` depends on its arguments alone, so that a replay is exact. Adding a constant to a
    channel does not change a pose.

    Examples
    --------
    >>> import smolbot
    >>> device = smolbot.load_robot("gradient").device
    >>> localizer = smolbot.Localizer(smolbot.load_rig("tank").sensors, device, estimator="paper")
    >>> len(localizer.sensors), localizer.estimator
    (10, 'paper')
    """

    learns: ClassVar[frozenset[str]] = frozenset({"noise", "transients", "sensors"})

    def __init__(
        self,
        sensors: SensorArray,
        device: Device,
        noise: NoiseModel | None = None,
        estimator: Estimator = "whitened",
        volume: SearchVolume | None = None,
        transients: tuple[float, ...] = (),
    ) -> None:
        if estimator not in get_args(Estimator):
            raise InputError(f"estimator must be 'whitened' or 'paper'; got {estimator!r}.")
        super().__init__(sensors, device, volume)
        self.noise: NoiseModel = noise or NoiseModel.assumed(sensors)
        self.estimator = estimator
        self.transients = tuple(transients)
        if estimator == "paper":
            self.learns = frozenset()  # type: ignore[misc]  # `Paper` sets it for the class

    def rebuild(
        self, sensors: SensorArray, device: Device, noise: NoiseModel | None, transients: tuple[float, ...]
    ) -> Localizer:
        """Make a localizer like this one for other sensors, device, noise and transients.

        Parameters
        ----------
        sensors : SensorArray
        device : Device
        noise : NoiseModel or None
        transients : tuple of float, in s

        Returns
        -------
        Localizer
        """
        return Localizer(sensors, device, noise, self.estimator, self.volume, transients)

    def warm_up(self, half_periods: int, sample_rate: float, ring_down: float, frames: FloatArray | None) -> None:
        """Run every compiled kernel once, on a synthetic recording.

        Parameters
        ----------
        half_periods : int
            Length of a listening window.
        sample_rate : float, in Hz
        ring_down : float, in s
            From the end of a drive to the first sample.
        frames : ndarray, shape (n_sensors, 2, 3), or None
            Directions of each sensor's tilts, if sensors are learned.
        """
        device = self.device
        orientation = quaternion_from_axes(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), "zy")
        samples = round(half_periods * sample_rate / (2.0 * device.frequency))
        time_ = ring_down + np.arange(samples) / sample_rate
        theta = compute_deflection(device, time_, 0.5 * device.theta_max, 0.3)
        middle = 0.5 * np.add(self.volume.low, self.volume.high)
        field = compute_sensor_field(self.sensors, device, middle, orientation, theta)
        recording = Recording(field, sample_rate, ring_down)
        _, swing = self.locate_swing(recording, self.locate(recording))
        if frames is not None:
            swing.compute_array_terms(frames)

    def locate(self, recording: Recording, prior: Pose | None = None) -> Pose:
        """Estimate the pose at the middle of a recording, from all of its samples.

        Parameters
        ----------
        recording : Recording
        prior : Pose, optional
            Start of the fit; it also decides between poses that sensors can hardly distinguish. Its
            covariance is not used: fusion is the tracker's task. Without it the fit starts cold.

        Returns
        -------
        Pose
            `trusted` is false if the fit explains too little of the signal, if another pose explains the data as
            well, or if the fit ends outside the search volume.

        Raises
        ------
        InputError
            If the recording does not fit the sensors, or holds no half-period; the message names the channel.
        """
        return self.locate_swing(recording, prior)[0]

    def locate_swing(self, recording: Recording, prior: Pose | None = None) -> tuple[Pose, Swing]:
        """Estimate the pose as `locate` does, and return the oscillation that was fitted with it.

        Parameters
        ----------
        recording : Recording
        prior : Pose, optional
            See `locate`.

        Returns
        -------
        pose : Pose
        swing : Swing

        Raises
        ------
        InputError
            See `locate`.
        """
        first = self.free_trend(recording)
        pose, swing = self._locate_with_trend(recording, prior, first)
        if self.estimator == "whitened" and first < FALLBACK_TREND and swing.misfit > MAX_MISFIT:
            other = self._locate_with_trend(recording, prior, first + 1)
            if other[1].misfit < MAX_MISFIT_RATIO * swing.misfit:
                return other
        return pose, swing

    def _locate_with_trend(self, recording: Recording, prior: Pose | None, trend: int) -> tuple[Pose, Swing]:
        problem = self.prepare(recording, trend)
        if prior is None:
            fits = find_best_fits(problem, self.volume)
        else:
            fits = self._fit_from_prior(problem, np.asarray(prior.position), prior.rotation)
        return self._make_pose(problem, fits, recording, prior)

    def free_trend(self, recording: Recording) -> int:
        """Choose the degree of the polynomial that is fitted in every channel: the highest at a negligible cost.

        Parameters
        ----------
        recording : Recording

        Returns
        -------
        int
        """
        half_periods = 2.0 * self.device.frequency * recording.duration
        return int(np.searchsorted(TREND_HALF_PERIODS, half_periods + 0.01)) if self.estimator == "whitened" else 0

    def locate_segments(self, recording: Recording, half_periods: int, prior: Pose | None = None) -> tuple[Pose, ...]:
        """Estimate poses of consecutive segments of one recording (superfast mode).

        An incomplete last segment is left out.

        One drive causes the oscillation in all of them, so the amplitude estimate is updated from segment to segment.
        Each fit starts from the pose of the segment before; the first from `prior`, or cold if there is none or its
        fit fails. A device that moves within a segment changes its static field too; where that is detected, a slope
        is also fitted in every channel.

        Parameters
        ----------
        recording : Recording
        half_periods : int
            Length of a segment.
        prior : Pose, optional
            See `locate`.

        Returns
        -------
        tuple of Pose

        Raises
        ------
        InputError
            See `locate`; and if the recording is shorter than a segment.
        """
        shared = SharedAmplitude.from_device(self.device)
        poses: list[Pose] = []
        given = prior
        for segment in cut_segments(recording, self.device, half_periods):
            shared = shared.predict(self.device, segment.time_since_drive)
            pose, swing, share = self._locate_segment(segment, prior, shared, stale=prior is given)
            poses.append(pose)
            if pose.trusted:
                shared = shared.update(swing.amplitude / share, float(np.sqrt(swing.covariance[6, 6])) / share)
            if pose.trusted or (prior is not None and _is_near_prior(pose, prior)):
                prior = pose
        return tuple(poses)

    def _locate_segment(
        self, segment: Recording, prior: Pose | None, shared: SharedAmplitude, *, stale: bool
    ) -> tuple[Pose, Swing, float]:
        """Return a segment's pose, its swing at its model's start time, and the amplitude's share at that time.

        `stale`: the prior is older than this recording; if a fit from it explains little, a cold start is tried too.
        """
        ringing = NEGLIGIBLE_AFTER * max(self.transients, default=0.0)
        anchored, share = find_anchor(self.device, segment.time_since_drive, ringing)
        shifted = replace(segment, time_since_drive=anchored)
        outcomes: list[tuple[float, Pose, Swing]] = []
        lowest = self.free_trend(segment)
        for trend in range(lowest, max(lowest, FALLBACK_TREND if self.estimator == "whitened" else 0) + 1):
            problem = self.prepare(shifted, trend)
            problem = Problem(replace(problem.model, device=shared.scale_device(self.device, share)), problem.data)
            if prior is None:
                fits = find_best_fits(problem, self.volume)
            elif stale:
                fits = self._fit_from_prior(problem, np.asarray(prior.position), prior.rotation)
            else:
                phase, amplitude = problem.estimate_phase_and_amplitude(prior.position, prior.rotation)
                fits = [problem.fit(prior.position, prior.rotation, phase, amplitude)]
            pose, swing = self._make_pose(problem, fits, segment, prior, steady=True)
            outcomes.append((swing.misfit, pose, swing))
            if swing.misfit < MAX_MISFIT:
                break
        best = outcomes[-1] if outcomes[-1][0] < MAX_MISFIT_RATIO * outcomes[0][0] else outcomes[0]
        return best[1], best[2], share

    def prepare(self, recording: Recording, trend: int = 0) -> Problem:
        """Prepare the fit of a recording.

        Parameters
        ----------
        recording : Recording
        trend : int
            Degree of the polynomial that is fitted in every channel; see `make_whitened_model`.

        Returns
        -------
        Problem

        Raises
        ------
        InputError
            If the recording does not fit the sensors.
        """
        if self.estimator == "paper":
            return prepare_paper(recording, self.sensors, self.device)
        return prepare_whitened(recording, self.sensors, self.device, self.noise, trend, self.transients)

    def _fit_from_prior(self, problem: Problem, position: FloatArray, rotation: FloatArray) -> list[Fit]:
        """Fit from a known pose; phase and amplitude start from a linear solve at that pose."""
        phase, amplitude = problem.estimate_phase_and_amplitude(position, rotation)
        first = problem.fit(position, rotation, phase, amplitude)
        if first.sse > MAX_START_MISFIT * problem.total_sum_of_squares:
            return sorted([first, *find_best_fits(problem, self.volume)], key=lambda t: t.sse)
        return [first]

    def _make_pose(
        self, problem: Problem, fits: list[Fit], recording: Recording, prior: Pose | None, *, steady: bool = False
    ) -> tuple[Pose, Swing]:
        """Make a pose of the best fit; the 180° ambiguity is resolved by the least turn since the prior.

        A `steady` device is recorded again and again, so its turn about the moment needs to be known only roughly.
        """
        best, flip_margin, _, clear = choose_fit(problem, fits, self.device, prior)
        variance = (
            _estimate_variance(problem, best) if problem.model.white else compute_residual_variance(problem, best)
        )
        spread = kernels.compute_covariance(best.normal, variance)
        usable = math.isfinite(spread[0, 0]) and best.amplitude > MIN_AMPLITUDE * problem.model.amplitude_max
        total = problem.total_sum_of_squares
        r_squared = 1.0 - best.sse / total if total > 0 else 0.0
        known = usable and clear and self._is_determined(spread, best, steady)
        orientation = quaternion_from_matrix(best.rotation)
        if self.device.along_cantilever:
            orientation = choose_nearer_orientation(orientation, None if prior is None else prior.orientation)
        pose = Pose(
            time=recording.middle,
            position=best.position,
            orientation=orientation,
            covariance=spread[:6, :6] if usable else np.diag(UNKNOWN_VARIANCES),
            r_squared=float(r_squared),
            flip_margin=flip_margin,
            trusted=bool(best.converged and known and self._is_inside_volume(best) and r_squared >= MIN_R_SQUARED),
        )
        return pose, Swing.from_fit(problem, best, variance, spread if usable else None)

    def _is_determined(self, spread: FloatArray, fit: Fit, steady: bool) -> bool:
        """Return whether a fit of covariance `spread` determines position and direction well enough to be trusted."""
        placed = max(spread[0, 0], spread[1, 1], spread[2, 2]) < MAX_SIGMA[0] ** 2
        return bool(placed) and self._is_direction_determined(spread[3:6, 3:6], fit, steady)

    def _is_direction_determined(self, turn: FloatArray, fit: Fit, steady: bool) -> bool:
        """Return whether rotations of covariance `turn` are known well enough."""
        if not steady:
            return bool(max(turn[0, 0], turn[1, 1], turn[2, 2]) < MAX_SIGMA[1] ** 2)
        moment = fit.rotation @ self.device.moment_in_body
        across = np.eye(3) - np.outer(moment, moment)
        left = across @ turn @ across
        return bool(np.sqrt(np.diag(left).max()) < MAX_SIGMA[1] and moment @ turn @ moment < MAX_ROLL**2)

    def _is_inside_volume(self, fit: Fit) -> bool:
        bounds = zip(self.volume.low, fit.position, self.volume.high, strict=True)
        return all(low - VOLUME_MARGIN <= p <= high + VOLUME_MARGIN for low, p, high in bounds)


class Paper(Localizer):
    """Localizer with the ``paper`` estimator, under the name that missions use; ``whitened`` is `Localizer` itself.

    Parameters
    ----------
    sensors : SensorArray
    device : Device
    volume : SearchVolume, optional
    """

    learns: ClassVar[frozenset[str]] = frozenset()

    def __init__(self, sensors: SensorArray, device: Device, *, volume: SearchVolume | None = None) -> None:
        super().__init__(sensors, device, estimator="paper", volume=volume)


def _is_near_prior(pose: Pose, prior: Pose) -> bool:
    """Return whether the next fit may start from a pose, although it is not trusted."""
    vague = float(np.sqrt(np.diag(pose.covariance)[:3].max()))
    return vague < MAX_SIGMA[0] and float(np.linalg.norm(pose.position - prior.position)) < 2.0 * MAX_SIGMA[0]


def _estimate_variance(problem: Problem, fit: Fit) -> float:
    """Estimate the variance of whitened residuals: one, unless they are significantly larger."""
    variance = compute_residual_variance(problem, fit)
    return variance if variance > 1.0 + RESIDUAL_SIGMAS * math.sqrt(2.0 / count_degrees_of_freedom(problem)) else 1.0
