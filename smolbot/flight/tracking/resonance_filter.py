"""Kalman filter of the device's resonance and damping during the mission."""

from __future__ import annotations

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.sensing import Device
from smolbot.flight.device_belief import DeviceBelief

START_STD = np.array([0.3, 3.0])
"""Initial standard deviation of frequency (Hz) and damping (1/s)."""

PROCESS_NOISE_DENSITY = np.array([0.01, 0.15])
"""Process noise of both per square root of a second: temperature, liquid, fields."""

MEASUREMENT_FLOOR = np.array([0.05, 0.5])
"""Standard deviation of every single estimate that is due to errors of the model."""

MIN_CHANGE = np.array([0.08, 0.06])
"""Change of frequency (Hz) and relative change of damping from which the device is replaced."""

MIN_SIGMAS = 4.0
"""Number of standard deviations by which a change must be significant."""


class ResonanceFilter:
    """A Kalman filter of the deviations of frequency and damping from the assumed device.

    Every recording gives an estimate of both along with its pose. Once a deviation is significant, the
    assumed device is retuned.

    Parameters
    ----------
    belief : DeviceBelief
    """

    def __init__(self, belief: DeviceBelief) -> None:
        self.belief = belief
        self._deviation = np.zeros(2)
        self._covariance = np.diag(START_STD**2)
        self._time: float | None = None

    @property
    def deviation(self) -> FloatArray:
        """Estimated deviation (2,) of frequency (Hz) and damping (1/s) from the device's."""
        return self._deviation.copy()

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations (2,) of `deviation`."""
        return np.sqrt(np.diag(self._covariance))

    def update(self, time: float, measured: FloatArray, covariance: FloatArray) -> Device | None:
        """Update with the estimate of one recording.

        Parameters
        ----------
        time : float, in s
        measured : ndarray, shape (2,)
            Deviation of frequency (Hz) and damping (1/s) from the device's.
        covariance : ndarray, shape (2, 2)

        Returns
        -------
        Device or None
            The retuned device; None if it was not retuned.
        """
        if not np.isfinite(covariance).all():
            return None
        if self._time is not None:
            self._covariance = self._covariance + np.diag(PROCESS_NOISE_DENSITY**2 * max(time - self._time, 0.0))
        self._time = time
        total = self._covariance + covariance + np.diag(MEASUREMENT_FLOOR**2)
        innovation = measured - self._deviation
        inverse = np.linalg.inv(total)
        if innovation @ inverse @ innovation > 25.0:
            return None
        gain = self._covariance @ inverse
        self._deviation = self._deviation + gain @ innovation
        self._covariance = (np.eye(2) - gain) @ self._covariance
        device = self.belief.device
        worthwhile = np.array([MIN_CHANGE[0], MIN_CHANGE[1] * max(device.damping, 1.0)])
        significant = (np.abs(self._deviation) > worthwhile) & (np.abs(self._deviation) > MIN_SIGMAS * self.sigma)
        if not significant.any():
            return None
        self.belief.retune(
            device.frequency + float(self._deviation[0]), max(device.damping + float(self._deviation[1]), 0.0)
        )
        self._deviation = np.zeros(2)
        return self.belief.device
