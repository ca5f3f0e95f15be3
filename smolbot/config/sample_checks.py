"""Check that samples are plausible volts of a rig, and find the channels of a shot that cannot be used."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from smolbot.core.arrays import BoolArray, FloatArray
from smolbot.errors import InputError
from smolbot.localization.problem import MIN_OUTPUTS

if TYPE_CHECKING:
    from smolbot.config.rig import RigConfig

SATURATION_SHARE = 0.999
"""Share of the range beyond which a sample counts as saturated."""

MIN_SWING_STEPS = 0.1
"""Share of a step of the converter: a file whose values vary by less does not hold volts."""

MAX_CONSTANT_TIME = 3e-4
"""A channel that moves stands still for at most so long, in s, or as long as the crest of a slow wave lasts."""

MIN_STEPS = 30.0
"""A channel that moves by fewer of its least steps may well stand still."""

MIN_JUMP_STEPS = 8.0
"""Steps at once by which a channel comes unstuck."""

CREST_FACTOR_AND_FREQUENCY = (2.5, 100.0)
"""So many times as long as a sine of this frequency, in Hz, stays within a step of the converter at its crest."""


def check_units(path: Path, volts: FloatArray, rig: RigConfig) -> None:
    """Raise if the samples cannot be volts of this rig.

    Refused is a file with too few unsaturated channels, with only dead channels, or in which no channel changes by
    a converter step.

    Parameters
    ----------
    path : Path
        Used in messages.
    volts : ndarray, shape (n_shots, n_channels, n), in V
    rig : RigConfig

    Raises
    ------
    InputError
        With the channel, its value, and the unit that it may have.
    """
    section = rig.sections.sensors
    full = _compute_saturation_voltage(rig)
    largest, swing = np.abs(volts).max(axis=2), np.ptp(volts, axis=2)
    rule = f"{path}: volts must be in V, at {section.sensitivity_v_per_ut:g} V/µT as rig '{rig.name}' says"
    free = np.sum(largest < full, axis=1)
    if np.all(free < MIN_OUTPUTS):
        typical = int(np.argsort(largest.min(axis=0))[largest.shape[1] // 2])
        raise InputError(
            f"{rule}: at most {free.max()} of {largest.shape[1]} channels are not saturated; channel {typical} reaches "
            f"{largest[:, typical].min():.4g} V, the range is {full / SATURATION_SHARE:.4g} V. "
            "Are they in mV, nT or counts, or is the constant field not nulled?",
            channel=str(typical),
        )
    if volts.shape[2] < 2:
        return
    if not swing.any():
        raise InputError(f"{path}: every channel is dead: constant, channel 0 at {volts[0, 0, 0]:g} V.", channel="0")
    step = 2.0 * section.adc_range_v / 2.0**section.adc_bits
    if swing.max() < MIN_SWING_STEPS * step:
        channel = int(np.argmax(swing.max(axis=0)))
        raise InputError(
            f"{rule}: channel {channel} moves most, by {swing.max():.2g} V, less than a step of the converter, "
            f"{step:.2g} V. Are they in T?",
            channel=str(channel),
        )


def find_invalid_channels(volts: FloatArray, rate: float, rig: RigConfig) -> dict[str, BoolArray]:
    """Find the channels of one shot that cannot be used, by reason.

    Parameters
    ----------
    volts : ndarray, shape (n_channels, n), in V
    rate : float, in Hz
        Sample rate.
    rig : RigConfig

    Returns
    -------
    dict of str to ndarray of bool, shape (n_channels,)
        For each reason, True where a channel is excluded by it.
    """
    saturated: BoolArray = np.max(np.abs(volts), axis=1) >= _compute_saturation_voltage(rig)
    dead: BoolArray = ~saturated & (np.ptp(volts, axis=1) == 0.0)
    stuck = np.array([_is_stuck(values, rate) for values in volts]) & ~saturated & ~dead
    return {"saturated": saturated, "dead (constant)": dead, "stuck (constant for a while)": stuck}


def _compute_saturation_voltage(rig: RigConfig) -> float:
    section = rig.sections.sensors
    return SATURATION_SHARE * min(section.range_ut * section.sensitivity_v_per_ut, section.adc_range_v)


def _is_stuck(values: FloatArray, rate: float) -> bool:
    """Return whether a changing channel holds one value too long, at the edge of its range or between jumps.

    A decayed oscillation is constant too, but in the middle of its range, which it reaches step by step.
    """
    change = np.abs(np.diff(values))
    moves = np.flatnonzero(change)
    steps = float(np.ptp(values)) / float(change[moves].min()) if len(moves) else 0.0
    if steps < MIN_STEPS:
        return False
    edges = np.concatenate([[-1], moves, [len(change)]])
    first = int(np.argmax(np.diff(edges)))
    begin, end = int(edges[first]), int(edges[first + 1])  # the changes before and after the longest stand
    crest = np.sqrt(4.0 / steps) / (np.pi * CREST_FACTOR_AND_FREQUENCY[1])
    if end - begin <= rate * max(MAX_CONSTANT_TIME, CREST_FACTOR_AND_FREQUENCY[0] * crest):
        return False
    jump = max(change[begin] if begin >= 0 else 0.0, change[end] if end < len(change) else 0.0)
    at_edge = values[end] in (values.min(), values.max())
    return bool(at_edge or jump > MIN_JUMP_STEPS * change[moves].min())
