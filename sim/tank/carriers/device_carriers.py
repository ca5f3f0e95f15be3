"""Carriers of a device that does not move by itself: guided by an operator, or fixed where it was implanted."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np

from sim.tank.carriers.carrier import Carrier, Load, State
from sim.tank.carriers.endoscope_operator import EndoscopeOperator, OperatorParameters
from sim.tank.carriers.endoscope_shaft import EndoscopeShaft
from sim.tank.magnetics.tank_coils import MARGIN, find_magnet_volume
from sim.tank.settings import OperatorSection, PlaceSection, TankSettings
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import multiply_quaternions, quaternion_from_axes, quaternion_from_rotation_vector
from smolbot.core.shots import Window
from smolbot.errors import InputError

ZERO_VELOCITY = (0.0, 0.0, 0.0)
MAX_SIGMAS = 2.0  # standard deviations to which sampled values are clipped
STREAM = 4  # random stream of a seed for the place; the tank uses 0 to 3


def make_device_carrier(rig: RigConfig, robot: RobotConfig, settings: TankSettings, seed: int) -> Carrier:
    """Make the carrier of a bare device in this tank.

    Parameters
    ----------
    rig : RigConfig
    robot : RobotConfig
    settings : TankSettings
    seed : int

    Returns
    -------
    Carrier

    Raises
    ------
    InputError
        If the rig file has neither ``[tank.hand]`` nor ``[tank.place]``.
    """
    if settings.hand is not None:
        return ExternallyGuided(settings.hand, seed, robot.device.l0)
    if settings.place is not None:
        return Implanted(rig, settings.place, seed)
    raise InputError(
        f"{rig.name}: '{robot.name}' is a bare device, and this tank does not define what holds it; "
        "its rig file needs [tank.hand] or [tank.place]."
    )


class ExternallyGuided:
    """Moves the device as the operator guides it; an endoscope's shaft adds its magnetisation.

    Parameters
    ----------
    section : OperatorSection
    seed : int
    l0 : float, in m
        From the cantilever's rotation centre to the magnet.
    """

    def __init__(self, section: OperatorSection, seed: int, l0: float) -> None:
        self.parameters = OperatorParameters.sample(section, seed)
        self.operator = EndoscopeOperator(section, self.parameters)
        self.shaft = EndoscopeShaft.sample(section.shaft, seed, l0) if section.shaft is not None else None
        self.field_at_magnet: FloatArray = np.zeros(3) if self.shaft is None else self.shaft.compute_field_at_magnet(l0)
        self._time = 0.0

    def read_state(self) -> State:
        """Return the pose on the operator's track at the present time, with zero velocities.

        Returns
        -------
        State
        """
        x, y, z, w, i, j, k = self.operator.interpolate_pose(self._time).tolist()
        return (x, y, z), (w, i, j, k), ZERO_VELOCITY, ZERO_VELOCITY

    def begin_window(self, window: Window, time: float) -> None:
        """Do nothing: the operator's motion does not depend on the windows.

        Parameters
        ----------
        window : Window
        time : float, in s
        """

    def advance(self, state: State, magnetic: Load, time: float, step: float) -> None:
        """Advance along the track; magnetic forces are negligible against the operator's.

        Parameters
        ----------
        state : State
            Not used.
        magnetic : tuple of 6
            Not used.
        time : float, in s
            At the start of the step.
        step : float, in s
        """
        self._time = time + step

    def compute_sensor_field(
        self, clock: float, n: int, rate: float, delay: float, positions: FloatArray, axes: FloatArray
    ) -> FloatArray:
        """Compute the shaft's field along the sensors' axes.

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
        if self.shaft is None:
            return np.zeros((len(positions), n))
        return self.shaft.compute_sensor_field(self.operator, clock, n, rate, delay, positions, axes)

    def as_dict(self) -> dict[str, Any]:
        """Return the sampled parameters of operator and shaft.

        Returns
        -------
        dict
            Plain lists and numbers.
        """
        mismatches = {"hand": asdict(self.parameters)}
        if self.shaft is not None:
            mismatches["shaft"] = asdict(self.shaft)
        return _to_plain(mismatches)

    def close(self) -> None:
        """Do nothing: there is no resource to release."""


class Implanted:
    """Keeps the device at a fixed pose: near the requested position, with sampled heading, pitch and roll.

    Parameters
    ----------
    rig : RigConfig
    section : PlaceSection
    seed : int
    """

    def __init__(self, rig: RigConfig, section: PlaceSection, seed: int) -> None:
        rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence([seed, STREAM])))
        draws = np.clip(rng.standard_normal(5), -MAX_SIGMAS, MAX_SIGMAS)
        heading = float(rng.uniform(-math.pi, math.pi))
        if section.heading is not None:
            heading = section.heading
        low, high = find_magnet_volume(rig)
        position, pitch, roll = section.compute_placement(draws[:4])
        self.position = np.clip(position, low + MARGIN, high - MARGIN)
        ahead = np.array([math.cos(heading), math.sin(heading), math.tan(pitch)])
        level = quaternion_from_axes(ahead, np.array([0.0, 0.0, 1.0]), "zx")
        self.orientation = multiply_quaternions(level, quaternion_from_rotation_vector(np.array([0.0, 0.0, roll])))
        x, y, z = self.position.tolist()
        w, i, j, k = self.orientation.tolist()
        self._state: State = (x, y, z), (w, i, j, k), ZERO_VELOCITY, ZERO_VELOCITY

    def read_state(self) -> State:
        """Return the fixed pose, with zero velocities.

        Returns
        -------
        State
        """
        return self._state

    def begin_window(self, window: Window, time: float) -> None:
        """Do nothing: the pose is fixed.

        Parameters
        ----------
        window : Window
        time : float, in s
        """

    def advance(self, state: State, magnetic: Load, time: float, step: float) -> None:
        """Do nothing: tissue withstands the magnetic forces.

        Parameters
        ----------
        state : State
        magnetic : tuple of 6
        time : float, in s
        step : float, in s
        """

    def as_dict(self) -> dict[str, Any]:
        """Return the sampled pose.

        Returns
        -------
        dict
            Plain lists and numbers.
        """
        return _to_plain({"place": {"position": self.position, "orientation": self.orientation}})

    def close(self) -> None:
        """Do nothing: there is no resource to release."""


def _to_plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _to_plain(v) for key, v in value.items()}
    if isinstance(value, tuple):
        return [_to_plain(v) for v in value]
    return value.tolist() if isinstance(value, np.ndarray) else value
