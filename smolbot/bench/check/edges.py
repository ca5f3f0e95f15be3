"""When a coil's field appears and vanishes, and the response of each sensor to it, from one recording."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.coil_probe import Probe

TIMING_LEVELS = (0.3, 0.8)
"""Shares of the full field at which its rise or fall is timed."""

MIN_SNR = 8.0
"""Ratio of a field to the noise before it above which the field counts as detected."""

AVERAGING_TIME = 0.02
"""Seconds before switch-off over which the field is averaged: a period of the mains."""


@dataclass(frozen=True, eq=False)
class Edges:
    """Measurements of a coil's probe.

    Attributes
    ----------
    response : ndarray, shape (n_sensors,), in T/A
        Field along each sensor's axis per ampere of requested current.
    detected : bool
        Whether a field was detected.
    closes : float or None, in s
        Delay from the command to close until the field begins to rise; None if it never does.
    opens : float or None, in s
        Delay from the command to open until the field begins to fall; None if it never does.
    rise : float or None, in s
        Time constant.
    fall : float or None, in s
        Time constant.
    """

    response: FloatArray
    detected: bool
    closes: float | None
    opens: float | None
    rise: float | None
    fall: float | None


def find_edges(probe: Probe, current: float, lag: float = 0.0, usable: np.ndarray | None = None) -> Edges:
    """Measure delays, time constants and sensor responses in the recording of a probe.

    Parameters
    ----------
    probe : Probe
    current : float, in A
        Requested current.
    lag : float, in s
        Time constant of the sensors' low pass.
    usable : ndarray of bool, shape (n_sensors,), optional
        Sensors to use; all unless given.

    Returns
    -------
    Edges
    """
    recording = probe.recording
    rate, field = recording.sample_rate, np.asarray(recording.field)
    on, off = round(probe.on * rate), round(probe.off * rate)
    before = field[:, :on]
    baseline = before.mean(axis=1, keepdims=True)
    settled = field[:, off - round(AVERAGING_TIME * rate) : off]
    response = (settled.mean(axis=1) - baseline[:, 0]) / current
    live = np.ones(len(field), np.bool_) if usable is None else usable
    pattern = np.where(live, response, 0.0)
    chance = float(np.linalg.norm(np.where(live, before.std(axis=1), 0.0)))
    if abs(current) * float(np.linalg.norm(pattern)) < MIN_SNR * max(chance, 1e-15):
        return Edges(response, False, None, None, None, None)
    share = pattern @ (field - baseline) / (current * (pattern @ pattern))
    closes, rise = _fit_edge(share[on:off], rate, lag)
    opens, fall = _fit_edge(1.0 - share[off:], rate, lag)
    return Edges(response, True, closes, opens, rise, fall)


def _fit_edge(share: FloatArray, rate: float, lag: float) -> tuple[float | None, float | None]:
    """Fit start and time constant of 1 - exp(-(t - start) / constant), measured through a low pass of `lag` s."""
    low, high = (_find_crossing(share, level) for level in TIMING_LEVELS)
    if low is None or high is None:
        return None, None
    early, late = (-math.log(1.0 - level) for level in TIMING_LEVELS)
    constant = (high - low) / rate / (late - early)
    start = low / rate - early * constant
    # Two low passes one after the other are, once the faster has settled, the slower one shifted by this.
    if 0.0 < lag < 0.7 * constant:
        start -= constant * math.log(constant / (constant - lag))
    elif lag:
        start -= lag
    return start, constant


def _find_crossing(share: FloatArray, level: float) -> float | None:
    """Find the sample from which on a rising curve stays above `level`; None if it does not."""
    below = np.flatnonzero(share < level)
    if len(below) == 0:
        return 0.0
    last = int(below[-1])
    if last == len(share) - 1:
        return None
    a, b = share[last], share[last + 1]
    return last + float((level - a) / (b - a))
