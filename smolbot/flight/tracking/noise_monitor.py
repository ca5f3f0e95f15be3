"""Follows how noisy each sensor is while the mission runs."""

from __future__ import annotations

import numpy as np

from smolbot.core.arrays import FloatArray

ENOUGH = 400.0
"""Residuals (degrees of freedom) of a sensor before it is judged: their energy is then known to 7 %."""

WORTHWHILE = 1.4
"""Change of a sensor's noise power from which a new noise model is worth its making."""

SURE = 4.0
"""Standard deviations that a change must stand out by."""

RANGE = (0.25, 16.0)
"""Smallest and largest change of noise power that is taken in at once."""


class NoiseWatch:
    """Compares what fits leave in each channel with what the noise model foretells.

    Quiet shots are played at the start only; after that, what is left of a recording once the device's signal
    is taken out tells whether a sensor has become noisier, or quieter.
    """

    def __init__(self, n_sensors: int) -> None:
        self._found = np.zeros(n_sensors)
        self._expected = np.zeros(n_sensors)

    def update(self, found: FloatArray, expected: FloatArray) -> FloatArray | None:
        """Take in one recording's energies (n_sensors,); return ratios of noise power if the model should change."""
        self._found += found
        self._expected += expected
        known = self._expected > 0.0
        if not known.any() or self._expected[known].min() < ENOUGH:
            return None
        ratios = np.ones(len(known))
        ratios[known] = self._found[known] / self._expected[known]
        spread = np.zeros(len(known))
        spread[known] = np.sqrt(2.0 / self._expected[known])
        self._found[:] = self._expected[:] = 0.0
        changed = np.abs(np.log(np.maximum(ratios, 1e-9))) > np.log(WORTHWHILE)
        if not (changed & (np.abs(ratios - 1.0) > SURE * spread)).any():
            return None
        return np.clip(ratios, *RANGE)
