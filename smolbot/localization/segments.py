"""Superfast mode: one oscillation cut into segments that share a model and an amplitude."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from smolbot.core.sensing import Device, Recording
from smolbot.errors import InputError
from smolbot.localization.chain import whole_half_periods

STEP = 0.95
"""Ratio of amplitudes between neighbouring models of a linear damping."""

LEAST = 1e-3
"""Share of the amplitude below which an oscillation has ended, and no new model is built."""

DAMPING_ERROR = 0.05
"""Relative standard deviation of the damping: it makes an early amplitude uncertain later."""

AMPLITUDE_FLOOR = 0.002
"""Smallest relative standard deviation of an amplitude: sensors are not exactly where they should be."""

GATE = 4.0
"""Standard deviations above which an amplitude is rejected; the standard deviation is widened instead."""

WIDENING = 2.0
"""Factor on the standard deviation after a rejected amplitude."""

ROUNDED_SAMPLES = 1e-6
"""Share of a sample that is rounding."""


def cut(recording: Recording, device: Device, half_periods: int) -> Iterator[Recording]:
    """Consecutive segments of equal length, as many as the recording holds.

    Raises
    ------
    InputError
        If it holds none, or `half_periods` is not positive.
    """
    n, rate = recording.field.shape[1], recording.sample_rate
    total = whole_half_periods(n, rate, device.frequency)
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


def remaining(device: Device, time: float) -> float:
    """Share of the amplitude that is left `time` s after the end of the drive, at least `LEAST`."""
    if device.damping_model == "linear":
        return max(1.0 - device.damping * time, LEAST)
    return max(math.exp(-device.damping * time), LEAST)


def anchor(device: Device, time: float, earliest: float = 0.0) -> tuple[float, float]:
    """The time after the drive whose model serves a segment at `time`, and the amplitude's share from there to here.

    Under exponential damping a shift in time is a change of amplitude and phase, so that one model serves
    all. Under linear damping the rate of decay, seen from the segment, grows as the amplitude falls: models
    are made anew every 5 %, which leaves 0.1 % of the signal. Before `earliest` s, while coils may still
    ring, each segment has a model of its own.
    """
    if time < earliest:
        return time, 1.0
    left = remaining(device, time)
    if device.damping_model == "exponential" or device.damping == 0.0:
        return earliest, left / remaining(device, earliest)
    step = min(STEP ** round(math.log(left) / math.log(STEP)), remaining(device, earliest))
    return (1.0 - step) / device.damping, left / step


@dataclass(frozen=True)
class SharedAmplitude:
    """What is known at `time` s of the amplitude at the end of the drive: mean and standard deviation, in rad."""

    mean: float
    std: float
    time: float

    @classmethod
    def of(cls, device: Device) -> SharedAmplitude:
        """What is known before anything was heard."""
        return cls(*device.amplitude_prior, 0.0)

    def at(self, device: Device, time: float) -> SharedAmplitude:
        """The same at a later time, less sure by as much as the damping may be off."""
        loss = DAMPING_ERROR * device.damping * self.mean
        return replace(self, std=math.hypot(self.std, loss * math.sqrt(max(time - self.time, 0.0))), time=time)

    def narrowed(self, amplitude: float, std: float) -> SharedAmplitude:
        """After a segment whose fit, this belief included, found `amplitude` with `std`."""
        if not math.isfinite(std):
            return self
        if abs(amplitude - self.mean) > GATE * self.std:
            return replace(self, std=WIDENING * self.std)
        return replace(self, mean=amplitude, std=max(std, AMPLITUDE_FLOOR * amplitude))

    def scaled(self, device: Device, share: float) -> Device:
        """The device as a model sees it of whose amplitude this share is left."""
        return replace(
            device, theta_max=share * device.theta_max, amplitude=share * self.mean, amplitude_std=share * self.std
        )
