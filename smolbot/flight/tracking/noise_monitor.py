"""Monitor of each sensor's noise level during the mission."""

from __future__ import annotations

import numpy as np

from smolbot.core.arrays import FloatArray

MIN_DEGREES_OF_FREEDOM = 400.0
"""Degrees of freedom of a sensor's residuals before it is evaluated: their energy is then known to 7 %."""

MIN_POWER_RATIO = 1.4
"""Ratio of a sensor's noise power to the model's from which the noise model is updated."""

MIN_SIGMAS = 4.0
"""Number of standard deviations by which a change must be significant."""

POWER_RATIO_RANGE = (0.25, 16.0)
"""Smallest and largest ratio of noise power that one update applies."""


class NoiseMonitor:
    """Compares the fit residuals of each channel with the prediction of the noise model.

    Background noise is recorded at the start only. After that, the fit residuals show whether a sensor has become
    noisier or quieter.

    Parameters
    ----------
    n_sensors : int
    """

    def __init__(self, n_sensors: int) -> None:
        self._found = np.zeros(n_sensors)
        self._expected = np.zeros(n_sensors)

    def update(self, measured: FloatArray, expected: FloatArray) -> FloatArray | None:
        """Add the residuals of one recording, and check whether the noise model should change.

        Parameters
        ----------
        measured : ndarray, shape (n_sensors,)
            Energy of the residuals, in units of the noise model.
        expected : ndarray, shape (n_sensors,)
            Its expected value, the degrees of freedom; 0 for channels that were left out.

        Returns
        -------
        ndarray, shape (n_sensors,), or None
            Noise power over that of the model; None if the model should stay.
        """
        self._found += measured
        self._expected += expected
        known = self._expected > 0.0
        if not known.any() or self._expected[known].min() < MIN_DEGREES_OF_FREEDOM:
            return None
        ratios = np.ones(len(known))
        ratios[known] = self._found[known] / self._expected[known]
        spread = np.zeros(len(known))
        spread[known] = np.sqrt(2.0 / self._expected[known])
        self._found[:] = self._expected[:] = 0.0
        changed = np.abs(np.log(np.maximum(ratios, 1e-9))) > np.log(MIN_POWER_RATIO)
        if not (changed & (np.abs(ratios - 1.0) > MIN_SIGMAS * spread)).any():
            return None
        return np.clip(ratios, *POWER_RATIO_RANGE)
