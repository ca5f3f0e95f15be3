"""Simulated pose fixes for rigs without sensor signals: they replace the localizer in the loop."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.rotations import choose_nearer_orientation
from smolbot.core.sensing import Device, Recording, SensorArray
from smolbot.errors import InputError
from smolbot.localization.cold_start import SearchVolume
from smolbot.localization.estimator import PoseEstimator, PoseEstimatorBase
from smolbot.localization.localizer import MAX_SIGMA, MIN_AMPLITUDE, MIN_R_SQUARED
from smolbot.localization.noise.model import NoiseModel


@dataclass(frozen=True, eq=False)
class SyntheticSwing:
    """Amplitude of the oscillation in rad, and its covariance (7, 7) with the pose; see `Oscillation`."""

    amplitude: float
    covariance: FloatArray

    def estimate_resonance_error(self) -> None:
        """Return None: there is no estimate."""

    def compute_array_terms(self, frames: FloatArray) -> None:
        """Return None: there is no information on the sensors.

        Parameters
        ----------
        frames : ndarray, shape (n_sensors, 2, 3)
        """

    def compute_energies(self, recording: Recording, noise: NoiseModel) -> None:
        """Return None: there are no residuals.

        Parameters
        ----------
        recording : Recording
        noise : NoiseModel
        """


@dataclass(frozen=True, eq=False)
class SyntheticFit:
    """Simulated outcome of a fit, before the checks that decide whether it is trusted.

    Attributes
    ----------
    position : ndarray, shape (3,), in m, world frame
        As estimated.
    orientation : ndarray, shape (4,)
        As estimated.
    amplitude : float, in rad
        As estimated, at the end of the drive.
    covariance : ndarray, shape (7, 7)
        As reported by the fit, of (position in m, rotation e in rad, amplitude in rad); infinite where
        undetermined.
    r_squared : float
    """

    position: FloatArray
    orientation: FloatArray
    amplitude: float
    covariance: FloatArray
    r_squared: float


@dataclass(frozen=True, eq=False)
class SyntheticRecording(Recording):
    """A recording without samples: it holds the fit that a localizer would have found.

    Attributes
    ----------
    time : float, in s
        Middle of the window, on the rig's clock.
    fit : SyntheticFit or None
        None if nothing was driven.
    """

    time: float = 0.0
    fit: SyntheticFit | None = None


class SyntheticLocalizer(PoseEstimatorBase):
    """Replaces `Localizer` for a rig that simulates pose fixes. It has no ground truth, only the simulated fixes.

    Parameters
    ----------
    sensors : SensorArray
        As the localizer assumes them.
    device : Device
        As the localizer assumes it.
    volume : SearchVolume, optional
    transients : tuple of float, in s
        Assumed time constants of the excitation coils: there is no signal to learn them from.
    """

    def __init__(
        self,
        sensors: SensorArray,
        device: Device,
        volume: SearchVolume | None = None,
        transients: tuple[float, ...] = (),
    ) -> None:
        super().__init__(sensors, device, volume)
        self.transients = transients

    def locate_swing(self, recording: Recording, prior: Pose | None = None) -> tuple[Pose, SyntheticSwing]:
        """Return pose and oscillation of a simulated fix, checked by the rules of `Localizer`.

        Parameters
        ----------
        recording : Recording
            A `SyntheticRecording`.
        prior : Pose, optional
            Of the two orientations that give the same signal, the one nearer to it is returned.

        Returns
        -------
        pose : Pose
        swing : SyntheticSwing

        Raises
        ------
        InputError
            If nothing was measured, as with a recording that has too few usable channels.
        """
        if not isinstance(recording, SyntheticRecording) or recording.fit is None:
            raise InputError("This recording holds no pose: nothing was driven before it.")
        fitted = recording.fit
        if not math.isfinite(fitted.covariance[0, 0]):
            raise InputError("This recording holds no pose: the swing was too small to measure.")
        orientation = choose_nearer_orientation(fitted.orientation, None if prior is None else prior.orientation)
        pose = Pose(
            recording.time,
            fitted.position,
            orientation,
            fitted.covariance[:6, :6],
            fitted.r_squared,
            trusted=self._is_trusted(fitted),
        )
        return pose, SyntheticSwing(fitted.amplitude, fitted.covariance)

    def _is_trusted(self, fitted: SyntheticFit) -> bool:
        variances = fitted.covariance.diagonal()
        certain = variances[:3].max() < MAX_SIGMA[0] ** 2 and variances[3:6].max() < MAX_SIGMA[1] ** 2
        loud = fitted.amplitude > MIN_AMPLITUDE * 1.1 * self.device.theta_max
        bounds = zip(self.volume.low, fitted.position, self.volume.high, strict=True)
        inside = all(low - 0.02 <= p <= high + 0.02 for low, p, high in bounds)
        return bool(certain and loud and inside and fitted.r_squared >= MIN_R_SQUARED)


@runtime_checkable
class SyntheticPoseRig(Protocol):
    """A rig that simulates no signals, but pose fixes with the errors that a localizer would have."""

    def make_synthetic_localizer(self, localizer: PoseEstimator) -> PoseEstimator:
        """Make the replacement of a localizer; from now on the rig simulates the errors of that localizer.

        Parameters
        ----------
        localizer : PoseEstimator

        Returns
        -------
        PoseEstimator

        Raises
        ------
        InputError
            If the rig has no error model of this localizer.
        """
