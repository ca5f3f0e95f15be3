"""The border between thinking and doing: a rig plays shots, a witness (if any) knows the truth."""

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
    """Knows where the device truly is. Held by recorder and report, never by the loop's estimators.

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
        """True pose at `time` s on the rig's clock; only times already played can be asked."""


class Stage(Protocol):
    """A device in a holder, which is brought to known places over the sensors of a rig, driven and heard."""

    def record(self, position: FloatArray, orientation: FloatArray, half_periods: int) -> Recording:
        """What the sensors hear after a drive, with the holder at `position` (3,) m and `orientation` (4,)."""


@runtime_checkable
class Rig(Protocol):
    """A world that plays shots. The tank, the bench and the twin keep the same promise.

    It may also keep the protocols below, which nothing depends on: `RecoveryCounter`, `StatusReporter`,
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
        """Time on the rig's clock, in s: the earliest start of the next shot."""

    def play(self, shot: Shot) -> Recording | None:
        """Play the windows of one shot in order; return what was heard, or None if it listened to nothing.

        None of a shot that listens means that the window was lost in a way that may pass, such as one time-out, and
        that every output is at zero: the loop goes on, and ends the run when windows are lost one after another.

        Raises ``InterlockError`` before anything moves if the shot breaks a limit, ``RigError`` if the
        world fails under it. After either, every output is at zero and every relay open.
        """

    def excitation_field(self, position: FloatArray) -> FloatArray:
        """Field of each excitation coil at `position` (3,) m, shape (n_exc, 3), in T per A, world frame."""

    def stop(self) -> None:
        """Bring every output to zero now. Safe from any thread, any number of times."""

    def close(self) -> None:
        """Stop, then let go of every device."""


@runtime_checkable
class RecoveryCounter(Protocol):
    """A rig that recovers from faults by itself, and counts them."""

    @property
    def recovered(self) -> Mapping[str, int]:
        """How often it recovered from what, by kind: ``{"read_timeouts": 1}``. Ends up in the summary."""


@runtime_checkable
class StatusReporter(Protocol):
    """A rig that has something to say of itself while a mission runs."""

    @property
    def status_line(self) -> str:
        """A few words on its state, shown beside the progress; empty if there is nothing to say."""


@runtime_checkable
class ProvenanceReporter(Protocol):
    """A rig, or a witness, that can say what it is and how it came to be so."""

    def provenance(self) -> dict[str, Any]:
        """What the run's ``provenance.json`` keeps of it: devices and their serial numbers, or seed and drawn values.

        Returns
        -------
        dict
            Values that JSON can hold.
        """


@dataclass(frozen=True)
class CheckItem:
    """One thing that a device says of itself, held against what the rig file says.

    Attributes
    ----------
    device : str
        As its maker or the rig file calls it: ``card Dev1``, ``magnet stage``, ``power supply``.
    what : str
        What was read back: ``product``, ``operator's button``.
    found : str
        In words or figures, with the unit.
    ok : bool
    limit : str
        What it should be; empty where anything will do.
    """

    device: str
    what: str
    found: str
    ok: bool = True
    limit: str = ""


@runtime_checkable
class Checkable(Protocol):
    """A rig with devices that can be asked what they are and how they are; ``smolbot check`` asks."""

    def checks(self) -> Iterator[CheckItem]:
        """Read back every device, nothing driven. A device that does not answer is an item that is not ok."""
