"""What finds poses in recordings: the protocol that the loop knows, and a base class for a lab's own."""

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
    """What a recording says of the oscillation, beside the pose. None: it says nothing of that."""

    @property
    def amplitude(self) -> float:
        """At the end of the drive, in rad."""

    @property
    def covariance(self) -> FloatArray:
        """Of (position in m, rotation e in rad, amplitude in rad), shape (7, 7); its first six are the pose's."""

    def estimate_resonance_error(self) -> tuple[FloatArray, FloatArray] | None:
        """Compute by how much the device's resonance differs from what was assumed.

        Returns
        -------
        ndarray, shape (2,)
            Difference of frequency, in Hz, and damping, in 1/s.
        ndarray, shape (2, 2)
            Its covariance.
        """

    def compute_array_terms(self, frames: FloatArray) -> ArrayTerms | None:
        """Compute what the recording says of the sensors.

        Parameters
        ----------
        frames : ndarray, shape (n_sensors, 2, 3)
            Directions of each sensor's tilts.
        """

    def compute_energies(self, recording: Recording, noise: NoiseModel) -> tuple[FloatArray, FloatArray] | None:
        """Compute the energy of the fit residuals of each sensor, and what the noise model predicts.

        Returns
        -------
        found, expected : ndarray, shape (n_sensors,)
            In units of the noise.
        """


class PoseEstimator(Protocol):
    """What finds poses in recordings. An entry point of ``smolbot.estimators`` names a class that keeps it.

    It is immutable: whatever a flight learns gives another one. `PoseEstimatorBase` has all of it but `locate`.

    Attributes
    ----------
    learns : frozenset of str
        What it can be told beside the device, an attribute of the class: ``noise`` (shots are listened to before the
        first cycle), ``transients`` (how excitation coils decay is learned then too), ``sensors`` (in flight).
    sensors : SensorArray
    device : Device
    volume : SearchVolume
        Where the robot can be.
    noise : NoiseModel or None
    transients : tuple of float, in s
        Time constants of the excitation coils; empty where they are not known.
    """

    learns: ClassVar[frozenset[str]]
    sensors: SensorArray
    device: Device
    volume: SearchVolume
    noise: NoiseModel | None
    transients: tuple[float, ...]

    def __init__(self, sensors: SensorArray, device: Device, *, volume: SearchVolume) -> None:
        """Make the estimator that a flight begins with."""

    def locate_swing(self, recording: Recording, prior: Pose | None = None) -> tuple[Pose, Oscillation | None]:
        """Find the pose at the middle of a recording, and what can be learned along with it.

        Parameters
        ----------
        recording : Recording
        prior : Pose, optional
            Where the device is expected; None where it has to be searched for.

        Returns
        -------
        Pose
            ``trusted`` is false where nobody should act on it.
        Oscillation or None
            None where nothing is to be learned.

        Raises
        ------
        InputError
            Where the recording holds no pose: it counts as a missed one.
        """

    def with_sensors(self, sensors: SensorArray) -> Self:
        """Return the same estimator for sensors as they were learned."""

    def with_device(self, device: Device) -> Self:
        """Return the same estimator for a device as it was learned."""

    def with_noise(self, noise: NoiseModel) -> Self:
        """Return the same estimator under another noise model."""

    def with_transients(self, transients: tuple[float, ...]) -> Self:
        """Return the same estimator for excitation coils whose decay was learned, time constants in s."""

    def warm_up(self, half_periods: int, sample_rate: float, ring_down: float, frames: FloatArray | None) -> None:
        """Do once whatever is slow the first time, so that the first cycles are as quick as the rest.

        Parameters
        ----------
        half_periods : int
            That a flight listens for.
        sample_rate : float, in Hz
        ring_down : float, in s
            From the end of a drive to the first sample.
        frames : ndarray, shape (n_sensors, 2, 3), optional
            Where the sensors are learned; see `Oscillation.compute_array_terms`.
        """


class PoseEstimatorBase:
    """A `PoseEstimator` that learns nothing: a subclass needs `locate` alone.

    What it is told by ``with_sensors`` and the like makes a new one by the constructor; a subclass that takes other
    arguments, or keeps more, overrides `rebuild`.

    Examples
    --------
    >>> class Nowhere(PoseEstimatorBase):
    ...     def locate(self, recording, prior=None):
    ...         return prior
    >>> from smolbot.config.plugins import check_protocol
    >>> check_protocol(Nowhere, PoseEstimator, "Nowhere")  # says nothing: it keeps the protocol
    """

    learns: ClassVar[frozenset[str]] = frozenset()
    noise: NoiseModel | None = None
    transients: tuple[float, ...] = ()

    def __init__(self, sensors: SensorArray, device: Device, volume: SearchVolume | None = None) -> None:
        self.sensors = sensors
        self.device = device
        self.volume = volume or SearchVolume()

    def locate(self, recording: Recording, prior: Pose | None = None) -> Pose:
        """Find the pose at the middle of a recording; see `PoseEstimator.locate_swing`."""
        raise NotImplementedError(f"{type(self).__name__} has neither locate nor locate_swing.")

    def locate_swing(self, recording: Recording, prior: Pose | None = None) -> tuple[Pose, Oscillation | None]:
        """Find the pose by `locate`, and learn nothing along with it."""
        return self.locate(recording, prior), None

    def with_sensors(self, sensors: SensorArray) -> Self:
        """Return the same estimator for sensors as they were learned."""
        return self.rebuild(sensors, self.device, self.noise, self.transients)

    def with_device(self, device: Device) -> Self:
        """Return the same estimator for a device as it was learned."""
        return self.rebuild(self.sensors, device, self.noise, self.transients)

    def with_noise(self, noise: NoiseModel) -> Self:
        """Return the same estimator under another noise model."""
        return self.rebuild(self.sensors, self.device, noise, self.transients)

    def with_transients(self, transients: tuple[float, ...]) -> Self:
        """Return the same estimator for excitation coils whose decay was learned, time constants in s."""
        return self.rebuild(self.sensors, self.device, self.noise, transients)

    def rebuild(
        self, sensors: SensorArray, device: Device, noise: NoiseModel | None, transients: tuple[float, ...]
    ) -> Self:
        """Make an estimator like this one from what it is told."""
        other = type(self)(sensors, device, volume=self.volume)
        other.noise, other.transients = noise, transients
        return other

    def warm_up(self, half_periods: int, sample_rate: float, ring_down: float, frames: FloatArray | None) -> None:
        """Nothing is slow the first time."""
