"""One coil driven faintly and switched by its relay, so that the sensors hear when the contacts close and open."""

from __future__ import annotations

import math

import numpy as np

from smolbot.bench.hardware.waveform import SETTLING, Waveform, line_bit
from smolbot.bench.hardware.wiring import BenchSection
from smolbot.core.coil_probe import AFTER, BEFORE, HELD
from smolbot.errors import InputError

LATEST = 3.0
"""How many times its opening time a relay may take before the output is taken to zero behind it."""

SPARE = 3e-3
"""Seconds on top of that."""


def relay_probe(section: BenchSection, coil: str, current: float, input_rate: float) -> tuple[Waveform, float, float]:
    """The waveform of a probe, and when its relay is told to close and to open, in s from the first sample.

    The output stands at the current from the moment the relay is told to close until well after it should have opened:
    what begins and ends the field is the relay alone. Until the contacts close, the amplifier drives nothing
    and may stand at its rail, which is why a probe asks for some ten mA only.

    Raises
    ------
    InputError
        For a coil that is not wired, or a current beyond its output's range.
    """
    names = [load.name for load in section.loads]
    if coil not in names:
        raise InputError(f"No coil '{coil}' is wired; wired are {', '.join(names)}.")
    load = section.loads[names.index(coil)]
    level = current / load.gain_a_per_v
    if abs(level) > section.outputs.range_v:
        raise InputError(f"{coil}: {current:g} A needs {level:.2f} V; the output gives ±{section.outputs.range_v:g} V.")
    rate, opening = section.outputs.rate_hz, section.relays.opening
    on, off = round(BEFORE * rate), round((BEFORE + HELD) * rate)
    end = off + math.ceil((LATEST * opening + SPARE) * rate)
    volts, lines = np.zeros((len(section.used_outputs), end + 2)), np.zeros(end + 2, np.uint32)
    volts[section.used_outputs.index(load.output), on:end] = level
    lines[on:end] = 1 << line_bit(section.outputs.enable)
    lines[on:off] |= np.uint32(1 << line_bit(load.relay))
    settled = math.ceil(((end + 2) / rate + opening + SETTLING) * input_rate)
    samples = max(round((BEFORE + HELD + AFTER) * input_rate), settled)
    return Waveform(volts, lines, 0.0, samples, (0, samples), None, settled), on / rate, off / rate
