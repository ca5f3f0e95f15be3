"""Superfast mode: one oscillation cut into segments that share a model and an amplitude."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from smolbot.core.sensing import Device, Recording
from smolbot.errors import InputError
from smolbot.localization.chain import count_half_periods

MODEL_SPACING = 0.95
"""Ratio of amplitudes between neighbouring models of a linear damping."""

MIN_AMPLITUDE_SHARE = 1e-3
"""Share of the amplitude below which an oscillation has ended, and no new model is built."""

DAMPING_ERROR = 0.05
"""Relative standard deviation of the damping: it makes an early amplitude uncertain later."""

AMPLITUDE_FLOOR = 0.002
"""Smallest relative standard deviation of an amplitude, due to errors of the sensor array."""

MAX_SIGMAS = 4.0
"""Standard deviations above which an amplitude is rejected; the standard deviation is widened instead."""

WIDENING = 2.0
"""Factor on the standard deviation after a rejected amplitude."""

ROUNDED_SAMPLES = 1e-6
"""Share of a sample that is rounding."""


def cut_segments(recording: Recording, device: Device, half_periods: int) -> Iterator[Recording]:
    """Cut a recording into consecutive segments of equal length, as many as it holds.

    Parameters
    ----------
    recording : Recording
    device : Device
    half_periods : int
        Length of a segment.

    Yields
    ------
    Recording

    Raises
    ------
    InputError
        If the recording holds no segment, or `half_periods` is not positive.
    """
    n, rate = recording.field.shape[1], recording.sample_rate
    total = count_half_periods(n, rate, device.frequency)
    if not 1 <= half_periods <= total:
        raise InputError(f"half_periods must lie within 1 to {total}, what the recording holds; got {half_periods}.")
    length = half_periods * rate / (2.0 * device.frequency)
    size = min(int(length + ROUNDED_SAMPLES), n)
    for i in range(total // half_periods):
        first = min(round(i * length), n - size)
        offset = first / rate
        yield replace(
            recording,
            field=recording.field[:, first : first + size],
            time_since_drive=recording.time_since_drive + offset,
            clock=recording.clock + offset,
        )


def compute_remaining_share(device: Device, time: float) -> float:
    """Compute the share of the amplitude that is left after a time.

    Parameters
    ----------
    device : Device
    time : float, in s
        After the end of the drive.

    Returns
    -------
    float
        At least `MIN_AMPLITUDE_SHARE`.
    """
    if device.damping_model == "linear":
        return max(1.0 - device.damping * time, MIN_AMPLITUDE_SHARE)
    return max(math.exp(-device.damping * time), MIN_AMPLITUDE_SHARE)


def find_anchor(device: Device, time: float, earliest: float = 0.0) -> tuple[float, float]:
    """Find the time after the drive whose model serves a segment, so that few models are needed.

    Under exponential damping a shift in time is a change of amplitude and phase, so that one model serves
    all. Under linear damping the relative rate of decay grows as the amplitude falls: a new model is
    made every 5 %, which leaves an error of 0.1 % of the signal. Before `earliest`, while coils may still
    ring, each segment has a model of its own.

    Parameters
    ----------
    device : Device
    time : float, in s
        Start of the segment after the end of the drive.
    earliest : float, in s

    Returns
    -------
    anchor : float, in s
    share : float
        Amplitude at `time` over that at the anchor.
    """
    if time < earliest:
        return time, 1.0
    left = compute_remaining_share(device, time)
    if device.damping_model == "exponential" or device.damping == 0.0:
        return earliest, left / compute_remaining_share(device, earliest)
    step = min(
        MODEL_SPACING ** round(math.log(left) / math.log(MODEL_SPACING)), compute_remaining_share(device, earliest)
    )
    return (1.0 - step) / device.damping, left / step


@dataclass(frozen=True)
class SharedAmplitude:
    """Estimate of the amplitude at the end of the drive, shared by all segments.

    Attributes
    ----------
    mean, std : float, in rad
    time : float, in s
        After the end of the drive; the time for which the estimate holds.
    """

    mean: float
    std: float
    time: float

    @classmethod
    def from_device(cls, device: Device) -> SharedAmplitude:
        """Make the prior estimate from a device.

        Parameters
        ----------
        device : Device

        Returns
        -------
        SharedAmplitude
        """
        return cls(*device.amplitude_prior, 0.0)

    def predict(self, device: Device, time: float) -> SharedAmplitude:
        """Predict the estimate at a later time, with the uncertainty that an error of the damping adds.

        Parameters
        ----------
        device : Device
        time : float, in s
            After the end of the drive.

        Returns
        -------
        SharedAmplitude
        """
        loss = DAMPING_ERROR * device.damping * self.mean
        return replace(self, std=math.hypot(self.std, loss * math.sqrt(max(time - self.time, 0.0))), time=time)

    def update(self, amplitude: float, std: float) -> SharedAmplitude:
        """Update with a segment whose fit included this estimate as a prior.

        Parameters
        ----------
        amplitude, std : float, in rad
            Found by the fit. An outlier doubles the uncertainty instead.

        Returns
        -------
        SharedAmplitude
        """
        if not math.isfinite(std):
            return self
        if abs(amplitude - self.mean) > MAX_SIGMAS * self.std:
            return replace(self, std=WIDENING * self.std)
        return replace(self, mean=amplitude, std=max(std, AMPLITUDE_FLOOR * amplitude))

    def scale_device(self, device: Device, share: float) -> Device:
        """Scale the amplitudes of a device, for a model that starts later in the oscillation.

        Parameters
        ----------
        device : Device
        share : float
            Of the amplitude that is left.

        Returns
        -------
        Device
        """
        return replace(
            device, theta_max=share * device.theta_max, amplitude=share * self.mean, amplitude_std=share * self.std
        )
