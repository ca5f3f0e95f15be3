"""Waveform that drives one coil weakly through its relay, to time when the contacts close and open."""

from __future__ import annotations

import math

import numpy as np

from smolbot.bench.hardware.waveform import RELAY_MARGIN, Waveform, get_line_bit
from smolbot.bench.hardware.wiring import BenchSection
from smolbot.core.coil_probe import BASELINE_DURATION, DECAY_DURATION, HOLD_DURATION
from smolbot.errors import InputError

MAX_OPENING_RATIO = 3.0
"""Longest time that a relay may take to open, as a multiple of its opening time, before the output is set to zero."""

HOLD_MARGIN = 3e-3
"""Seconds on top of `MAX_OPENING_RATIO`."""


def make_relay_probe(
    section: BenchSection, coil: str, current: float, input_rate: float
) -> tuple[Waveform, float, float]:
    """Build the waveform of a relay probe.

    The output holds its level from the command to close the relay until well after it should have opened,
    so that the relay alone starts and ends the field. Until the contacts close, the amplifier has no load and may
    be at its rail, which is why a probe uses only some ten mA.

    Parameters
    ----------
    section : BenchSection
    coil : str
        Name of the load: a coil, or ``excitation x``.
    current : float, in A
    input_rate : float, in Hz
        Sample rate of each input.

    Returns
    -------
    waveform : Waveform
    on : float, in s
        When the relay is switched to close, from the first sample on.
    off : float, in s
        When it is switched to open.

    Raises
    ------
    InputError
        If the coil is not wired, or the current is beyond its output's range.
    """
    names = [load.name for load in section.loads]
    if coil not in names:
        raise InputError(f"No coil '{coil}' is wired; wired are {', '.join(names)}.")
    load = section.loads[names.index(coil)]
    level = current / load.gain_a_per_v
    if abs(level) > section.outputs.range_v:
        raise InputError(f"{coil}: {current:g} A needs {level:.2f} V; the output gives ±{section.outputs.range_v:g} V.")
    rate, opening = section.outputs.rate_hz, section.relays.opening
    on, off = round(BASELINE_DURATION * rate), round((BASELINE_DURATION + HOLD_DURATION) * rate)
    end = off + math.ceil((MAX_OPENING_RATIO * opening + HOLD_MARGIN) * rate)
    volts, lines = np.zeros((len(section.used_outputs), end + 2)), np.zeros(end + 2, np.uint32)
    volts[section.used_outputs.index(load.output), on:end] = level
    lines[on:end] = 1 << get_line_bit(section.outputs.enable)
    lines[on:off] |= np.uint32(1 << get_line_bit(load.relay))
    settled = math.ceil(((end + 2) / rate + opening + RELAY_MARGIN) * input_rate)
    samples = max(round((BASELINE_DURATION + HOLD_DURATION + DECAY_DURATION) * input_rate), settled)
    return Waveform(volts, lines, 0.0, samples, (0, samples), None, settled), on / rate, off / rate
