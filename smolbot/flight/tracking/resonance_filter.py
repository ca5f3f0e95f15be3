"""Kalman filter of the device's resonance and damping during the mission."""

from __future__ import annotations

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.sensing import Device
from smolbot.flight.device_belief import DeviceBelief
from smolbot.localization.problem import DeviceChange

START_STD = np.array([0.3, 3.0])
"""Initial standard deviation of frequency (Hz) and damping (1/s)."""

PROCESS_NOISE_DENSITY = np.array([0.01, 0.15])
"""Process noise of both per square root of a second: temperature, liquid, fields."""

MEASUREMENT_FLOOR = np.array([0.05, 0.5])
"""Standard deviation of every single estimate that is due to errors of the model."""

MIN_CHANGE = np.array([0.08, 0.06])
"""Change of frequency (Hz) and relative change of damping from which the device is replaced."""

GATE = 25.0
"""Squared Mahalanobis distance beyond which an estimate is an outlier."""

MIN_SIGMAS = 4.0
"""Number of standard deviations by which a change must be significant."""

MIN_MISFIT_SIGMAS = 4.0
"""Standard deviations by which the residuals of a fit must exceed the noise for the device to be doubted."""

MIN_EXPLAINED = 0.5
"""Share of the excess of the residuals that a changed device must explain; otherwise something else is wrong."""

MIN_CONTRADICTIONS = 2
"""Recordings in a row that contradict the device before it is learned anew: one may be disturbed by a passing tool."""

CHANGED_FREQUENCY_STD, CHANGED_DAMPING_SHARE = 2.0, 0.5
"""Standard deviations of a change: of the frequency, in Hz, and of the damping, relative to itself."""

RELEARNED_STD = 1.5
"""Standard deviation of the damping, in 1/s, from which poses are trusted again: over the 20 ms from the end of a drive
to the middle of a window it leaves 3 % of the amplitude unknown, about as much as drives differ from each other."""


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
        self._contradictions = 0  # recordings in a row
        self._changed = False  # whether the device is being learned anew

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
        if innovation @ inverse @ innovation > GATE:
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

    def check(self, change: DeviceChange, degrees_of_freedom: int) -> str:
        """Check whether a recording contradicts the assumed device, and learn it anew if several do.

        While it is learned, every recording replaces the device of the belief.

        Parameters
        ----------
        change : DeviceChange
            That the recording suggests.
        degrees_of_freedom : int
            Of its residuals.

        Returns
        -------
        str
            Why the pose of the recording is not to be trusted; empty if it may be.
        """
        contradicted = self._is_contradicted(change, degrees_of_freedom)
        self._contradictions = self._contradictions + 1 if contradicted else 0
        if not self._changed:
            if not contradicted:
                return ""
            if self._contradictions >= MIN_CONTRADICTIONS:
                self._changed = True
                damping = START_STD[1] + CHANGED_DAMPING_SHARE * self.belief.device.damping
                self._deviation = np.zeros(2)
                self._covariance = np.diag([CHANGED_FREQUENCY_STD**2, damping**2])
        elif not contradicted and self.sigma[1] < RELEARNED_STD:
            self._changed = False
            return ""
        if self._changed:
            self._relearn(change, degrees_of_freedom)
        frequency, damping = change.offset
        return (
            f"the device does not swing as assumed (frequency {frequency:+.1f} Hz, damping {damping:+.1f} 1/s): "
            "its poses are not trusted until that is learned"
        )

    @property
    def relearning(self) -> bool:
        """Whether the device was found to have changed, and is being learned anew."""
        return self._changed

    def _is_contradicted(self, change: DeviceChange, freedom: int) -> bool:
        excess = change.before - freedom
        if not excess > MIN_MISFIT_SIGMAS * np.sqrt(2.0 * freedom):
            return False
        explained = change.before - change.after
        if explained < MIN_EXPLAINED * excess:
            return False
        innovation = change.offset - self._deviation
        total = self._covariance + self._compute_noise(change, freedom)
        far = float(innovation @ np.linalg.solve(total, innovation)) > GATE
        return far or (change.held and explained > GATE)

    def _relearn(self, change: DeviceChange, freedom: int) -> None:
        gain = self._covariance @ np.linalg.inv(self._covariance + self._compute_noise(change, freedom))
        step = gain @ change.offset
        self._covariance = (np.eye(2) - gain) @ self._covariance
        device = self.belief.device
        self.belief.retune(device.frequency + float(step[0]), max(device.damping + float(step[1]), 0.0))

    @staticmethod
    def _compute_noise(change: DeviceChange, freedom: int) -> FloatArray:
        """Compute the covariance of a recording's offset."""
        variance = max(change.after / freedom, 1.0)
        return np.asarray(variance * change.covariance + np.diag(MEASUREMENT_FLOOR**2))
