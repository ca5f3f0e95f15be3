"""Predicted response of each sensor to each coil by the rig file's geometry, with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from smolbot.bench.check.response_match import compute_response_std
from smolbot.core.arrays import FloatArray

if TYPE_CHECKING:
    from lookup_tables import FlatCoil, RoundCoil
    from smolbot.config.rig import RigConfig

GRADIENT_STEP = 0.5e-3
"""Step, in m, of the finite differences of a coil's field."""


@dataclass(frozen=True, eq=False)
class PredictedResponses:
    """Predictions for all coils by the rig file's geometry.

    Attributes
    ----------
    names : tuple of str
        Names of the coils.
    response : ndarray, shape (n_coils, n_sensors), in T/A
    spread : ndarray, shape (n_coils, n_sensors), in T/A
        Standard deviation of the response.
    constants : list of float, in s
        Time constants of the coils.
    """

    names: tuple[str, ...]
    response: FloatArray
    spread: FloatArray
    constants: list[float]


def predict_responses(config: RigConfig) -> PredictedResponses:
    """Predict the response of each sensor to each coil.

    Parameters
    ----------
    config : RigConfig

    Returns
    -------
    PredictedResponses
    """
    sensors = config.sensors
    flat = config.flat_coils()
    coils: list[RoundCoil | FlatCoil] = [*config.round_coils(), *flat]
    steps = GRADIENT_STEP * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    points = (np.asarray(sensors.positions)[None] + steps[:, None]).reshape(-1, 3)
    around = np.array([coil.field(points).reshape(7, len(sensors), 3) for coil in coils])
    fields = around[:, 0]
    gradients = np.moveaxis((around[:, 1:4] - around[:, 4:7]) / (2 * GRADIENT_STEP), 1, -1)
    return PredictedResponses(
        names=config.driven,
        response=np.einsum("cni,ni->cn", fields, sensors.responses),
        spread=compute_response_std(fields, gradients, sensors.axes),
        constants=config.time_constants,
    )
