"""The border between thinking and doing: a rig plays shots, a witness (if any) knows the truth."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from smolbot.arrays import FloatArray
from smolbot.limits import Limits
from smolbot.poses import Pose
from smolbot.sensing import Recording, SensorArray
from smolbot.shots import Shot


@runtime_checkable
class Witness(Protocol):
    """Knows where the device truly is. Held by recorder and report, never by the loop's estimators."""

    def truth(self, time: float) -> Pose:
        """True pose at `time` s on the rig's clock; only times already played can be asked."""


class Stage(Protocol):
    """A device in a holder, which is brought to known places over the sensors of a rig, driven and heard."""

    def record(self, position: FloatArray, orientation: FloatArray, half_periods: int) -> Recording:
        """What the sensors hear after a drive, with the holder at `position` (3,) m and `orientation` (4,)."""


@runtime_checkable
class Rig(Protocol):
    """A world that plays shots. The tank, the bench and the twin keep the same promise."""

    sensors: SensorArray
    limits: Limits
    witness: Witness | None

    def now(self) -> float:
        """Time on the rig's clock, in s: the earliest start of the next shot."""

    def play(self, shot: Shot) -> Recording | None:
        """Play the windows of one shot in order; return what was heard, or None if it listened to nothing.

        Raises ``InterlockError`` before anything moves if the shot breaks a limit, ``RigError`` if the
        world fails under it. After either, every output is at zero and every relay open.
        """

    def excitation_field(self, position: FloatArray) -> FloatArray:
        """Field of each excitation coil at `position` (3,) m, shape (n_exc, 3), in T per A, world frame."""

    def stop(self) -> None:
        """Bring every output to zero now. Safe from any thread, any number of times."""

    def close(self) -> None:
        """Stop, then let go of every device."""
