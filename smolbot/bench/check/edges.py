"""When a coil's field comes and goes, and what each sensor says of it, from a recording of both."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.coil_probe import Probe

LEVELS = (0.3, 0.8)
"""Shares of its full size at which a field that comes or goes is timed."""

AUDIBLE = 8.0
"""A field is heard if it is this many times as large as what the sensors say before it."""

SETTLED = 0.02
"""Seconds before the coil goes, over which its field is averaged: a period of the mains."""


@dataclass(frozen=True, eq=False)
class Edges:
    """What a coil's probe says.

    Attributes
    ----------
    response : ndarray, shape (n_sensors,), in T/A
        Field along each sensor's axis per ampere that was asked for.
    heard : bool
        Whether there was a field at all.
    closes, opens : float or None, in s
        From being told to, to the start of a rise or fall; None if it never came.
    rise, fall : float or None, in s
        Time constants.
    """

    response: FloatArray
    heard: bool
    closes: float | None
    opens: float | None
    rise: float | None
    fall: float | None


def find_edges(probe: Probe, current: float, lag: float = 0.0, used: np.ndarray | None = None) -> Edges:
    """Measure a probe.

    Parameters
    ----------
    current : float, in A
        That was asked for.
    lag : float, in s
        Time constant of the sensors' low pass.
    used : ndarray of bool, shape (n_sensors,)
        Sensors that may be relied on; all without it.
    """
    recording = probe.recording
    rate, field = recording.sample_rate, np.asarray(recording.field)
    on, off = round(probe.on * rate), round(probe.off * rate)
    before = field[:, :on]
    baseline = before.mean(axis=1, keepdims=True)
    settled = field[:, off - round(SETTLED * rate) : off]
    response = (settled.mean(axis=1) - baseline[:, 0]) / current
    live = np.ones(len(field), np.bool_) if used is None else used
    pattern = np.where(live, response, 0.0)
    chance = float(np.linalg.norm(np.where(live, before.std(axis=1), 0.0)))
    if abs(current) * float(np.linalg.norm(pattern)) < AUDIBLE * max(chance, 1e-15):
        return Edges(response, False, None, None, None, None)
    share = pattern @ (field - baseline) / (current * (pattern @ pattern))
    closes, rise = _edge(share[on:off], rate, lag)
    opens, fall = _edge(1.0 - share[off:], rate, lag)
    return Edges(response, True, closes, opens, rise, fall)


def _edge(share: FloatArray, rate: float, lag: float) -> tuple[float | None, float | None]:
    """Start and time constant of 1 - exp(-(t - start) / constant), seen through a low pass of `lag` s."""
    low, high = (_crossing(share, level) for level in LEVELS)
    if low is None or high is None:
        return None, None
    early, late = (-math.log(1.0 - level) for level in LEVELS)
    constant = (high - low) / rate / (late - early)
    start = low / rate - early * constant
    # Two low passes one after the other are, once the faster has settled, the slower one shifted by this.
    if 0.0 < lag < 0.7 * constant:
        start -= constant * math.log(constant / (constant - lag))
    elif lag:
        start -= lag
    return start, constant


def _crossing(share: FloatArray, level: float) -> float | None:
    """First place, in samples, from which on a rising curve stays above `level`; None if it does not."""
    below = np.flatnonzero(share < level)
    if len(below) == 0:
        return 0.0
    last = int(below[-1])
    if last == len(share) - 1:
        return None
    a, b = share[last], share[last + 1]
    return last + float((level - a) / (b - a))
