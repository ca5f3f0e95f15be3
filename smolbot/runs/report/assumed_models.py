"""What the localizer assumed of sensors, device and coils at any time of a run, from the events of its record."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from smolbot.config.load import AnyMission
from smolbot.core.sensing import Device, SensorArray
from smolbot.localization.noise.actuation_decay import CoilDecay, CoilDecays
from smolbot.runs.run import Event


@dataclass(frozen=True)
class AssumedModels:
    """What the localizer assumes at one time.

    Attributes
    ----------
    sensors : SensorArray
    device : Device
    tails : CoilDecays
        Decay of the coil currents after actuation.
    transients : tuple of float, in s
        Time constants of the excitation coils' ring-down.
    """

    sensors: SensorArray
    device: Device
    tails: CoilDecays = field(default_factory=CoilDecays)
    transients: tuple[float, ...] = ()

    @classmethod
    def from_mission(cls, mission: AnyMission) -> AssumedModels:
        """Return what the mission's files state.

        Parameters
        ----------
        mission : Mission or Observation

        Returns
        -------
        AssumedModels
        """
        return cls(mission.rig.sensors, mission.robot.device)

    def with_event(self, event: Event) -> AssumedModels:
        """Return what is assumed after an event.

        Parameters
        ----------
        event : Event

        Returns
        -------
        AssumedModels
            Unchanged if the event concerns none of it.
        """
        detail: dict[str, Any] = event.detail
        if event.what == "array learned":
            gains = detail.get("gains")
            sensors = SensorArray(
                np.array(detail["positions_m"]), np.array(detail["axes"]), self.sensors.bandwidth,
                None if gains is None else np.array(gains),
            )  # fmt: skip
            return replace(
                self, sensors=sensors, device=replace(self.device, moment=detail["moment_a_m2"], l0=detail["l0_m"])
            )
        if event.what == "device retuned":
            device = replace(self.device, frequency=detail["frequency_hz"], damping=detail["damping_per_s"])
            return replace(self, device=device)
        if event.what == "ring-down learned":
            return replace(self, transients=tuple(1e-3 * t for t in detail["time_constants_ms"]))
        if event.what == "coil tails learned":
            sizes = iter(detail["sizes_t_per_a"])
            tails = tuple(
                None if t is None else CoilDecay(1e-3 * t, np.array(next(sizes))) for t in detail["time_constants_ms"]
            )
            return replace(self, tails=CoilDecays(tails))
        return self
