"""The interface between control software and the physical or simulated world.

A rig plays shots and returns recordings; a witness, if there is one, gives the true pose.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from smolbot.core.arrays import FloatArray
from smolbot.core.limits import Limits
from smolbot.core.pose import Pose
from smolbot.core.sensing import Recording, SensorArray
from smolbot.core.shots import Shot


@runtime_checkable
class Witness(Protocol):
    """Protocol of a source of the true pose. Recorder and report use it, never the loop's estimators.

    Examples
    --------
    >>> import numpy as np
    >>> import smolbot
    >>> class Resting:
    ...     def truth(self, time):
    ...         return smolbot.Pose(time, [0, 0, 0.06], [1, 0, 0, 0], np.zeros((6, 6)))
    >>> isinstance(Resting(), smolbot.Witness)
    True
    """

    def truth(self, time: float) -> Pose:
        """Return the true pose of the device at a time.

        Parameters
        ----------
        time : float, in s
            On the rig's clock; only times already played are available.

        Returns
        -------
        Pose
        """


class CalibrationStage(Protocol):
    """A holder that brings a device to known poses above a rig's sensors, where it is driven and recorded."""

    def record(self, position: FloatArray, orientation: FloatArray, half_periods: int) -> Recording:
        """Record the sensors after a drive, with the holder at a given pose.

        Parameters
        ----------
        position : ndarray, shape (3,), in m, world frame
        orientation : ndarray, shape (4,)
            Unit quaternion, scalar first, takes body vectors to world vectors.
        half_periods : int
            Length of the listening window.

        Returns
        -------
        Recording
        """


@runtime_checkable
class Rig(Protocol):
    """Protocol of a world that plays shots. The tank, the bench and the twin all implement it.

    A rig may also implement the protocols below, all of which are optional: `RecoveryCounter`, `StatusReporter`,
    `ProvenanceReporter`, `Checkable`.

    Examples
    --------
    >>> import smolbot
    >>> def noise_of(rig: smolbot.Rig, seconds: int) -> smolbot.NoiseModel:
    ...     shot = smolbot.Shot((smolbot.Listen(200, 100.0),), "quiet")
    ...     return smolbot.NoiseModel.learn([rig.play(shot) for _ in range(seconds)])
    """

    sensors: SensorArray
    limits: Limits
    witness: Witness | None

    def now(self) -> float:
        """Return the time on the rig's clock, in s: the earliest start of the next shot.

        Returns
        -------
        float, in s
        """

    def play(self, shot: Shot) -> Recording | None:
        """Play the windows of one shot in order and return the recording of its listening window.

        After an error, every output is at zero and every relay open.

        Parameters
        ----------
        shot : Shot

        Returns
        -------
        Recording or None
            None if the shot has no Listen window. None from a shot that listens means that the window was lost for
            a passing reason, such as one time-out, and that every output is at zero; the loop goes on, and ends the
            run when several windows in a row are lost.

        Raises
        ------
        InterlockError
            Before anything moves, if the shot breaks a limit.
        RigError
            If the rig fails while it plays.
        """

    def excitation_field(self, position: FloatArray) -> FloatArray:
        """Return the field of each excitation coil at a point.

        Parameters
        ----------
        position : ndarray, shape (3,), in m, world frame

        Returns
        -------
        ndarray, shape (n_exc, 3), in T per A, world frame
        """

    def stop(self) -> None:
        """Set every output to zero now. Safe from any thread, any number of times."""

    def close(self) -> None:
        """Stop, then release every device."""


@runtime_checkable
class RecoveryCounter(Protocol):
    """A rig that recovers from faults by itself, and counts them."""

    @property
    def recovered(self) -> Mapping[str, int]:
        """Number of recovered faults by kind, for the summary: ``{"read_timeouts": 1}``."""


@runtime_checkable
class StatusReporter(Protocol):
    """A rig that reports its state while a mission runs."""

    @property
    def status_line(self) -> str:
        """A few words on its state, shown beside the progress; empty if there is nothing to report."""


@runtime_checkable
class ProvenanceReporter(Protocol):
    """A rig, or a witness, that can describe itself for the record."""

    def provenance(self) -> dict[str, Any]:
        """Return what the run's ``provenance.json`` stores: devices and serial numbers, or seed and sampled values.

        Returns
        -------
        dict
            Values that JSON can hold.
        """


@dataclass(frozen=True)
class CheckItem:
    """One value read back from a device, compared with the rig file.

    Attributes
    ----------
    device : str
        Name given by its maker or the rig file: ``card Dev1``, ``magnet stage``, ``power supply``.
    what : str
        Quantity that was read back: ``product``, ``operator's button``.
    found : str
        Its value, in words or figures, with the unit.
    ok : bool
    limit : str
        Expected value; empty where any value is accepted.
    """

    device: str
    what: str
    found: str
    ok: bool = True
    limit: str = ""


@runtime_checkable
class Checkable(Protocol):
    """A rig whose devices can report their identity and state; used by ``smolbot check``."""

    def checks(self) -> Iterator[CheckItem]:
        """Read back every device without driving anything.

        Yields
        ------
        CheckItem
            Not ok for a device that does not answer.
        """
