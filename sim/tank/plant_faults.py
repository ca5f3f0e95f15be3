"""Faults of the tank's coils, liquid and device: they begin and end with a window."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sim.tank.faults import FaultSchedule
from sim.tank.magnetics.device_packing import pack_true_device
from sim.tank.mismatch import TankTruth
from sim.tank.settings import TankSettings
from sim.tank.tank_faults import find_channels
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.core.arrays import FloatArray

MILLI = 1e-3  # m/s per mm/s
LIQUID_FAULTS = ("drag", "rotation_drag", "viscosity", "flow")


class PlantFaults:
    """Computes what the present faults make of a tank's constants.

    Parameters
    ----------
    schedule : FaultSchedule
    rig, robot : RigConfig, RobotConfig
    settings : TankSettings
    truth : TankTruth
        The tank without faults.

    Raises
    ------
    InputError
        If the rig has no such coil.
    """

    def __init__(
        self, schedule: FaultSchedule, rig: RigConfig, robot: RobotConfig, settings: TankSettings, truth: TankTruth
    ) -> None:
        self._schedule, self._robot, self._settings, self._truth = schedule, robot, settings, truth
        self._channels = [find_channels(fault, rig) for fault in schedule.faults]
        self._n_actuation, self._n_coils = len(rig.sections.coils), len(rig.driven)

    @property
    def changes_liquid(self) -> bool:
        """Whether any fault, present or not, changes the liquid's drag or flow."""
        return any(fault.name in LIQUID_FAULTS for fault in self._schedule.faults)

    def compute_current_factors(self, time: float) -> FloatArray:
        """Compute by how much each coil's current differs from its command.

        Parameters
        ----------
        time : float, in s

        Returns
        -------
        ndarray, shape (n_coils,)
            Actuation coils, then excitation coils.
        """
        factors = np.ones(self._n_coils)
        for index, fault in enumerate(self._schedule.faults):
            if not self._schedule.is_active(index, time):
                continue
            channels = list(self._channels[index])
            if fault.name in ("coil_dead", "coil_gain"):
                factors[channels] *= fault.values[0] if fault.values else 0.0
            elif fault.name in ("excitation_lost", "excitation_gain"):
                factors[[self._n_actuation + i for i in channels]] *= fault.values[0] if fault.values else 0.0
        return factors

    def compute_drag_factors(self, time: float) -> tuple[float, float]:
        """Compute the factors on the drag against translation and against rotation.

        Parameters
        ----------
        time : float, in s

        Returns
        -------
        translation, rotation : float
        """
        return self._multiply(time, "drag", "viscosity"), self._multiply(time, "rotation_drag", "viscosity")

    def compute_flow(self, time: float) -> tuple[float, float]:
        """Compute by how much the liquid flows faster.

        Parameters
        ----------
        time : float, in s

        Returns
        -------
        x, y : float, in m/s
            World frame.
        """
        x = y = 0.0
        for index, fault in enumerate(self._schedule.faults):
            if fault.name == "flow" and self._schedule.is_active(index, time):
                speed, direction = MILLI * fault.values[0], math.radians(fault.values[1])
                x, y = x + speed * math.cos(direction), y + speed * math.sin(direction)
        return x, y

    def pack_device(self, time: float) -> FloatArray:
        """Pack the true device, as `sim.tank.magnetics.device_packing.pack_true_device` does, with its faults.

        Parameters
        ----------
        time : float, in s

        Returns
        -------
        ndarray
        """
        truth, faults = self._truth, enumerate(self._schedule.faults)
        shift = sum(f.values[0] for i, f in faults if f.name == "resonance_shift" and self._schedule.is_active(i, time))
        changed = replace(
            truth,
            frequency=truth.frequency + shift / self._robot.device.frequency,
            damping=truth.damping * self._multiply(time, "damping"),
            moment=truth.moment * self._multiply(time, "moment"),
        )
        return pack_true_device(self._robot, self._settings, changed)

    def _multiply(self, time: float, *names: str) -> float:
        product = 1.0
        for index, fault in enumerate(self._schedule.faults):
            if fault.name in names and self._schedule.is_active(index, time):
                product *= fault.values[0]
        return product
