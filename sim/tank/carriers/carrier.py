"""What holds the housing of a device and moves it: a liquid, a gel, a hand. The tank's clock and magnet do not mind."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

from smolbot.core.arrays import FloatArray
from smolbot.core.shots import Window

Triple = tuple[float, float, float]
Quadruple = tuple[float, float, float, float]
State = tuple[Triple, Quadruple, Triple, Triple]
"""Position (m), orientation (scalar first), velocity (m/s) and spin (rad/s) of the housing's middle, world frame."""

Magnetic = tuple[float, float, float, float, float, float]
"""Mean force (N) and torque about the housing's middle (N·m) of one step, body frame."""


class Carrier(Protocol):
    """Moves the housing through every physics step of a window."""

    def state(self) -> State:
        """Where the housing is now."""

    def begin(self, window: Window, time: float) -> None:
        """A window begins at `time` s; the coils' part in it is not this one's business."""

    def advance(self, state: State, magnetic: Magnetic, time: float, step: float) -> None:
        """One step of `step` s from `time` s on, from the state just read, under what the fields do to the robot."""

    def close(self) -> None:
        """Let go of everything; harmless when repeated."""


@runtime_checkable
class Turned(Carrier, Protocol):
    """Moved by a rotating magnet as well: takes mechanical windows in long strides, since nothing listens to them."""

    longest_step: float
    """Of a stride, in s."""

    def lasting(self, window: Window) -> float:
        """How long a mechanical window truly lasts, in s; asked once for each."""

    def turn(self, step: float, poses: FloatArray) -> None:
        """As many steps of `step` s as `poses` (n, 7) has rows, which receive rotation centre (m) and orientation."""

    def end(self, window: Window) -> None:
        """A mechanical window is over, or was cut short."""


@runtime_checkable
class Magnetised(Carrier, Protocol):
    """Brings a magnetism of its own along, which the device feels and the sensors hear."""

    field_at_magnet: FloatArray
    """Shape (3,), in T, body frame."""

    def heard(
        self, clock: float, n: int, rate: float, delay: float, positions: FloatArray, axes: FloatArray
    ) -> FloatArray:
        """Its field (n_sensors, n) in T along the sensors' axes, `n` samples from `clock` s on, `delay` s late."""


@runtime_checkable
class Drawn(Carrier, Protocol):
    """Was drawn from the seed, and can say how: for a run's provenance."""

    def as_dict(self) -> dict[str, Any]:
        """What was drawn, as plain lists and numbers."""
