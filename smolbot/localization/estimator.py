"""Protocol of pose estimators as the loop uses them, and a base class for your own."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Protocol, Self

from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.sensing import Device, Recording, SensorArray
from smolbot.localization.cold_start import SearchVolume
from smolbot.localization.noise.model import NoiseModel

if TYPE_CHECKING:
    from smolbot.localization.array.terms import ArrayTerms


class Oscillation(Protocol):
    """Protocol of what a fit estimates along with the pose. A method returns None where it has no estimate."""

    @property
    def amplitude(self) -> float:
        """Amplitude at the end of the drive, in rad."""

    @property
    def covariance(self) -> FloatArray:
        """Covariance (7, 7) of position in m, rotation e in rad, and amplitude in rad; the first six are the pose's."""

    def estimate_resonance_error(self) -> tuple[FloatArray, FloatArray] | None:
        """Estimate the error of the assumed frequency and damping.

        Returns
        -------
        ndarray, shape (2,)
            Estimated minus assumed frequency, in Hz, and damping, in 1/s.
        ndarray, shape (2, 2)
            Covariance of both.
        """

    def compute_array_terms(self, frames: FloatArray) -> ArrayTerms | None:
        """Compute the recording's information on the sensors.

        Parameters
        ----------
        frames : ndarray, shape (n_sensors, 2, 3)
            Directions of each sensor's tilts.

        Returns
        -------
        ArrayTerms or None
        """

    def compute_energies(self, recording: Recording, noise: NoiseModel) -> tuple[FloatArray, FloatArray] | None:
        """Compute the energy of the fit residuals of each sensor, and its expected value under a noise model.

        Parameters
        ----------
        recording : Recording
        noise : NoiseModel

        Returns
        -------
        tuple of ndarray, shape (n_sensors,), or None
            Energy and expected energy, in units of the noise.
        """


class PoseEstimator(Protocol):
    """Protocol of pose estimators. An entry point of ``smolbot.estimators`` names a class that implements it.

    An estimator is immutable: each value that a run learns needs a new one. `PoseEstimatorBase` has all methods
    but `locate`.

    Parameters
    ----------
    sensors : SensorArray
    device : Device
    volume : SearchVolume

    Attributes
    ----------
    learns : frozenset of str
        What it uses besides the device, an attribute of the class: ``noise`` (background noise is recorded before the
        first cycle), ``transients`` (so is the decay of the excitation coils), ``sensors`` (learned in flight).
    sensors : SensorArray
    device : Device
    volume : SearchVolume
        Where the robot can be.
    noise : NoiseModel or None
    transients : tuple of float, in s
        Time constants of the excitation coils; empty if they are not known.
    """

    learns: ClassVar[frozenset[str]]
    sensors: SensorArray
    device: Device
    volume: SearchVolume
    noise: NoiseModel | None
    transients: tuple[float, ...]

    def __init__(self, sensors: SensorArray, device: Device, *, volume: SearchVolume) -> None:
        """Make the estimator with which a flight begins."""

    def locate_swing(self, recording: Recording, prior: Pose | None = None) -> tuple[Pose, Oscillation | None]:
        """Estimate the pose at the middle of a recording, and what can be learned along with it.

        Parameters
        ----------
        recording : Recording
        prior : Pose, optional
            Predicted pose; None if the device must be searched for.

        Returns
        -------
        Pose
            ``trusted`` is false if the pose must not be used for control.
        Oscillation or None
            None if nothing can be learned.

        Raises
        ------
        InputError
            If no pose can be estimated; the recording then counts as missed.
        """

    def with_sensors(self, sensors: SensorArray) -> Self:
        """Return this estimator for another sensor array.

        Parameters
        ----------
        sensors : SensorArray
            As learned.

        Returns
        -------
        PoseEstimator
        """

    def with_device(self, device: Device) -> Self:
        """Return this estimator for another device.

        Parameters
        ----------
        device : Device
            As learned.

        Returns
        -------
        PoseEstimator
        """

    def with_noise(self, noise: NoiseModel) -> Self:
        """Return this estimator for another noise model.

        Parameters
        ----------
        noise : NoiseModel

        Returns
        -------
        PoseEstimator
        """

    def with_transients(self, transients: tuple[float, ...]) -> Self:
        """Return this estimator for other excitation coils.

        Parameters
        ----------
        transients : tuple of float, in s
            Learned time constants of the excitation coils.

        Returns
        -------
        PoseEstimator
        """

    def warm_up(self, half_periods: int, sample_rate: float, ring_down: float, frames: FloatArray | None) -> None:
        """Run everything once that is slow at its first call, so that the first cycles are as fast as the rest.

        Parameters
        ----------
        half_periods : int
            Length of a listening window.
        sample_rate : float, in Hz
        ring_down : float, in s
            From the end of a drive to the first sample.
        frames : ndarray, shape (n_sensors, 2, 3), or None
            Directions of each sensor's tilts, if sensors are learned; see `Oscillation.compute_array_terms`.
        """


class PoseEstimatorBase:
    """A `PoseEstimator` that learns nothing: a subclass needs `locate` alone.

    ``with_sensors`` and its siblings call the constructor; a subclass whose constructor takes other arguments, or
    that has more state, overrides `rebuild`.

    Parameters
    ----------
    sensors : SensorArray
    device : Device
    volume : SearchVolume, optional

    Examples
    --------
    >>> class Nowhere(PoseEstimatorBase):
    ...     def locate(self, recording, prior=None):
    ...         return prior
    >>> from smolbot.config.plugins import check_protocol
    >>> check_protocol(Nowhere, PoseEstimator, "Nowhere")  # raises nothing: it implements the protocol
    """

    learns: ClassVar[frozenset[str]] = frozenset()
    noise: NoiseModel | None = None
    transients: tuple[float, ...] = ()

    def __init__(self, sensors: SensorArray, device: Device, volume: SearchVolume | None = None) -> None:
        self.sensors = sensors
        self.device = device
        self.volume = volume or SearchVolume()

    def locate(self, recording: Recording, prior: Pose | None = None) -> Pose:
        """Estimate the pose at the middle of a recording.

        Parameters
        ----------
        recording : Recording
        prior : Pose, optional
            Predicted pose; None if the device must be searched for.

        Returns
        -------
        Pose
        """
        raise NotImplementedError(f"{type(self).__name__} has neither locate nor locate_swing.")

    def locate_swing(self, recording: Recording, prior: Pose | None = None) -> tuple[Pose, Oscillation | None]:
        """Estimate the pose by `locate`, and learn nothing along with it.

        Parameters
        ----------
        recording : Recording
        prior : Pose, optional

        Returns
        -------
        pose : Pose
        swing : None
        """
        return self.locate(recording, prior), None

    def with_sensors(self, sensors: SensorArray) -> Self:
        """Return this estimator for another sensor array.

        Parameters
        ----------
        sensors : SensorArray
            As learned.

        Returns
        -------
        PoseEstimatorBase
        """
        return self.rebuild(sensors, self.device, self.noise, self.transients)

    def with_device(self, device: Device) -> Self:
        """Return this estimator for another device.

        Parameters
        ----------
        device : Device
            As learned.

        Returns
        -------
        PoseEstimatorBase
        """
        return self.rebuild(self.sensors, device, self.noise, self.transients)

    def with_noise(self, noise: NoiseModel) -> Self:
        """Return this estimator for another noise model.

        Parameters
        ----------
        noise : NoiseModel

        Returns
        -------
        PoseEstimatorBase
        """
        return self.rebuild(self.sensors, self.device, noise, self.transients)

    def with_transients(self, transients: tuple[float, ...]) -> Self:
        """Return this estimator for other excitation coils.

        Parameters
        ----------
        transients : tuple of float, in s
            Learned time constants of the excitation coils.

        Returns
        -------
        PoseEstimatorBase
        """
        return self.rebuild(self.sensors, self.device, self.noise, transients)

    def rebuild(
        self, sensors: SensorArray, device: Device, noise: NoiseModel | None, transients: tuple[float, ...]
    ) -> Self:
        """Make an estimator like this one for other sensors, device, noise and transients.

        Parameters
        ----------
        sensors : SensorArray
        device : Device
        noise : NoiseModel or None
        transients : tuple of float, in s

        Returns
        -------
        PoseEstimatorBase
        """
        other = type(self)(sensors, device, volume=self.volume)
        other.noise, other.transients = noise, transients
        return other

    def warm_up(self, half_periods: int, sample_rate: float, ring_down: float, frames: FloatArray | None) -> None:
        """Do nothing: no call is slower the first time.

        Parameters
        ----------
        half_periods : int
        sample_rate : float, in Hz
        ring_down : float, in s
        frames : ndarray, shape (n_sensors, 2, 3), or None
        """
