"""Protocols of the carriers that hold and move a device's housing: a liquid, a gel, an operator."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

from smolbot.core.arrays import FloatArray
from smolbot.core.shots import Window

Triple = tuple[float, float, float]
Quadruple = tuple[float, float, float, float]
State = tuple[Triple, Quadruple, Triple, Triple]
"""Position (m), orientation (scalar first), velocity (m/s) and spin (rad/s) of the housing's middle, world frame."""

Load = tuple[float, float, float, float, float, float]
"""Mean force (N) and torque about the housing's middle (N·m) of one step, body frame."""


class Carrier(Protocol):
    """Moves the housing through every physics step of a window."""

    def read_state(self) -> State:
        """Return the present state of the housing.

        Returns
        -------
        State
        """

    def begin_window(self, window: Window, time: float) -> None:
        """Begin a window; the tank itself applies the coils' commands.

        Parameters
        ----------
        window : Window
        time : float, in s
        """

    def advance(self, state: State, magnetic: Load, time: float, step: float) -> None:
        """Advance by one physics step.

        Parameters
        ----------
        state : State
            As just read.
        magnetic : tuple of 6
            Mean force (N) and torque about the housing's middle (N·m), body frame.
        time : float, in s
            At the start of the step.
        step : float, in s
        """

    def close(self) -> None:
        """Release all resources; harmless when repeated."""


@runtime_checkable
class Immersed(Carrier, Protocol):
    """A carrier in a liquid, whose drag and flow can change."""

    def scale_drag(self, translation: float, rotation: float) -> None:
        """Set the drag to a multiple of what it was at the start.

        Parameters
        ----------
        translation, rotation : float
            Factors on the drag against translation and against rotation.
        """

    def add_flow(self, x: float, y: float) -> None:
        """Set the liquid's flow to what it was at the start plus a uniform current.

        Parameters
        ----------
        x, y : float, in m/s
            World frame.
        """


@runtime_checkable
class MagnetDriven(Carrier, Protocol):
    """A carrier that a rotating magnet moves too.

    Mechanical windows are played in long steps, since nothing is recorded.

    Attributes
    ----------
    longest_step : float, in s
        Upper limit of a step in a mechanical window.
    """

    longest_step: float
    """Of a stride, in s."""

    def sample_duration(self, window: Window) -> float:
        """Return the true duration of a mechanical window; called once for each.

        Parameters
        ----------
        window : Window

        Returns
        -------
        float, in s
        """

    def advance_mechanical(self, step: float, poses: FloatArray) -> None:
        """Advance by as many steps as `poses` has rows.

        Parameters
        ----------
        step : float, in s
        poses : ndarray, shape (n, 7)
            Receives rotation centre (m) and orientation (scalar first), world frame.
        """

    def end_window(self, window: Window) -> None:
        """End a mechanical window, complete or cut short.

        Parameters
        ----------
        window : Window
        """


@runtime_checkable
class Magnetised(Carrier, Protocol):
    """A carrier with a magnetisation of its own, which acts on the device and on the sensors.

    Attributes
    ----------
    field_at_magnet : ndarray, shape (3,), in T
        Body frame.
    """

    field_at_magnet: FloatArray
    """Shape (3,), in T, body frame."""

    def compute_sensor_field(
        self, clock: float, n: int, rate: float, delay: float, positions: FloatArray, axes: FloatArray
    ) -> FloatArray:
        """Compute the carrier's field along the sensors' axes.

        Parameters
        ----------
        clock : float, in s
            Time of the first sample.
        n : int
            Number of samples.
        rate : float, in Hz
        delay : float, in s
            Of the sensors' low pass.
        positions, axes : ndarray, shape (n_sensors, 3)
            Positions (m) and sensitive directions, world frame.

        Returns
        -------
        ndarray, shape (n_sensors, n), in T
        """


@runtime_checkable
class Sampled(Carrier, Protocol):
    """A carrier with sampled mismatches."""

    def as_dict(self) -> dict[str, Any]:
        """Return all sampled values as plain lists and numbers, for a run's provenance.

        Returns
        -------
        dict
        """
