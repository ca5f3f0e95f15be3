"""What each sensor should hear of each coil, by the rig file's geometry, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from smolbot.bench.check.wiring import spread_of
from smolbot.core.arrays import FloatArray

if TYPE_CHECKING:
    from lookup_tables import FlatCoil, RoundCoil
    from smolbot.config.rig import RigConfig

STEP = 0.5e-3
"""m, between the points of which a coil's gradient is a difference."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """All coils by the rig file's geometry: names, responses and their spread (n_coils, n_sensors) in T/A, seconds."""

    names: tuple[str, ...]
    response: FloatArray
    spread: FloatArray
    constants: list[float]


def predict(config: RigConfig) -> Prediction:
    """What the believed sensors should hear of the nominal coils."""
    sensors = config.sensors
    flat = config.flat_coils()
    coils: list[RoundCoil | FlatCoil] = [*config.round_coils(), *flat]
    steps = STEP * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    points = (np.asarray(sensors.positions)[None] + steps[:, None]).reshape(-1, 3)
    around = np.array([coil.field(points).reshape(7, len(sensors), 3) for coil in coils])
    fields = around[:, 0]
    gradients = np.moveaxis((around[:, 1:4] - around[:, 4:7]) / (2 * STEP), 1, -1)
    return Prediction(
        names=config.driven,
        response=np.einsum("cni,ni->cn", fields, sensors.responses),
        spread=spread_of(fields, gradients, sensors.axes),
        constants=config.time_constants,
    )
