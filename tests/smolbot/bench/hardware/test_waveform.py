"""A shot as the card plays it: relays before currents, never two loads on one output, zero at its end."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smolbot.bench.hardware.waveform import WaveformCompiler, get_line_bit
from smolbot.bench.hardware.wiring import BenchSection
from smolbot.config.document import validate
from smolbot.config.rig import load_rig
from smolbot.core.shots import Actuate, Excite, Listen, MoveMagnet, Rest, RingDown, Shot
from smolbot.errors import InputError, InterlockError

RATE = 50_000.0
CLOSE = OPEN = 1e-3


def bench() -> tuple[BenchSection, tuple[str, ...]]:
    rig = load_rig("bench")
    section, faults = validate(BenchSection, rig.raw_section("bench"), ("bench",))
    assert section is not None, faults
    return section, rig.coil_names


SECTION, COILS = bench()
GAIN = SECTION.loads[0].gain_a_per_v
NAMES = [load.name for load in SECTION.loads]
BITS = [get_line_bit(load.relay) for load in SECTION.loads]
ENABLE = get_line_bit(SECTION.outputs.enable)
OUTPUT = [SECTION.used_outputs.index(load.output) for load in SECTION.loads]


def compiler(**constants: float) -> WaveformCompiler:
    return WaveformCompiler(SECTION, COILS, RATE, constants)


def cycle(currents, excite=(6.0, -4.0), pull=0.03, frequency=103.5):
    return Shot((Actuate(currents, pull), Excite(excite, frequency, 5), RingDown(0.02), Listen(2, frequency)))


def closed(waveform, load):
    return (waveform.lines >> BITS[load]) & 1 > 0


ampere = st.one_of(st.just(0.0), st.floats(0.1, 8.0))
peak = st.one_of(st.just(0.0), st.floats(-8.0, -0.1), st.floats(0.1, 8.0))


@given(st.tuples(ampere, ampere, ampere, ampere), st.tuples(peak, peak), st.floats(0.005, 0.1))
def test_no_current_flows_before_its_relay_has_closed_nor_through_two_relays(currents, excite, pull):
    waveform = compiler().compile(cycle(currents, excite, pull))
    lag, ahead = round(CLOSE * RATE), round(OPEN * RATE)
    for output in range(len(SECTION.used_outputs)):
        loads = [k for k in range(len(NAMES)) if OUTPUT[k] == output]
        driven = np.abs(waveform.volts[output]) > 1e-9
        ready = np.zeros((len(loads), waveform.outputs), np.bool_)
        maybe = np.zeros_like(ready)
        for row, load in enumerate(loads):
            told = closed(waveform, load)
            for n in range(lag + 1):  # contacts are closed where they were told to for the closing time
                ready[row] = told if n == 0 else ready[row] & np.roll(told, n)
            for n in range(ahead + 1):  # and may be closed until the opening time has passed
                maybe[row] |= np.roll(told, n)
        assert np.all(ready.any(axis=0)[driven])
        assert np.all(maybe.sum(axis=0)[driven] == 1)


@given(st.tuples(ampere, ampere, ampere, ampere), st.tuples(peak, peak))
def test_a_waveform_ends_at_zero_with_every_relay_told_to_open(currents, excite):
    waveform = compiler().compile(cycle(currents, excite))
    if waveform.outputs:
        assert not waveform.volts[:, -1].any()
        assert waveform.lines[-1] == 0
        assert waveform.settled <= waveform.samples
        assert waveform.settled / RATE >= waveform.outputs / RATE + OPEN


def test_a_window_keeps_its_place_and_its_size():
    waveform = compiler().compile(cycle((8.0, 0.0, 3.0, 0.0), (0.0, 5.0)))
    start = round(waveform.lead * RATE)
    assert waveform.lead == pytest.approx(CLOSE)
    for output, current in ((0, 8.0), (2, 3.0)):
        assert np.all(waveform.volts[output, start : start + 1500] == current / GAIN)
    time = (np.arange(waveform.outputs) - start) / RATE - 0.03
    inside = (time > 2 * CLOSE) & (time < 5 / 103.5 - 1e-4)
    expected = 5.0 / GAIN * np.sin(2 * math.pi * 103.5 * time[inside])
    assert np.abs(waveform.volts[1, inside] - expected).max() < 1e-9


def test_of_a_shared_output_at_most_the_relays_times_are_blanked():
    waveform = compiler().compile(cycle((8.0, 0.0, 0.0, 0.0), (6.0, 0.0)))
    start = round((waveform.lead + 0.03) * RATE)
    blank = np.abs(waveform.volts[0, start:]) < 1e-9
    first = int(np.flatnonzero(~blank)[0])
    assert first == pytest.approx((OPEN + CLOSE) * RATE, abs=2)


def test_listening_begins_with_the_first_sample_after_its_window_opens():
    shot = cycle((8.0, 0.0, 0.0, 0.0))
    waveform = compiler().compile(shot)
    first, count = waveform.listen
    begins = waveform.lead + 0.03 + 5 / 103.5 + 0.02
    assert 0 <= first / RATE - begins < 1.0 / RATE
    assert count == round(shot.listen.duration * RATE)
    assert first + count <= waveform.samples
    assert waveform.drive_end == pytest.approx(waveform.lead + 0.03 + 5 / 103.5, abs=0.5 / RATE)


def test_amplifiers_are_enabled_from_the_first_relay_to_the_last_current():
    waveform = compiler().compile(cycle((8.0, 0.0, 0.0, 0.0)))
    enabled = (waveform.lines >> ENABLE) & 1 > 0
    driven = np.abs(waveform.volts).max(axis=0) > 1e-9
    assert np.all(enabled[driven])
    assert np.flatnonzero(enabled)[-1] - np.flatnonzero(driven)[-1] <= 1


def test_a_sine_makes_up_for_the_lag_of_its_coil():
    constant, frequency = 1e-3, 181.0
    shot = Shot((Excite((0.0, 3.0), frequency, 20),))
    plain = compiler().compile(shot).volts[1]
    raised = compiler(**{"excitation y": constant}).compile(shot).volts[1]
    current = np.zeros(len(raised))
    keep = math.exp(-1 / RATE / constant)
    for k in range(1, len(raised)):  # a coil of that time constant, with the command held for a sample
        current[k] = keep * current[k - 1] + (1 - keep) * raised[k - 1]
    steady = current[len(current) // 2 :]
    assert np.abs(steady).max() == pytest.approx(np.abs(plain).max(), rel=5e-3)


def test_a_shot_that_only_listens_drives_nothing():
    waveform = compiler().compile(Shot((Rest(0.01), Listen(20, 103.5))))
    assert waveform.outputs == 0
    assert waveform.drive_end is None
    assert waveform.listen[0] == 500


def test_a_current_beyond_the_output_is_refused():
    with pytest.raises(InterlockError, match=r"21\.00 A needs 10\.50 V"):
        compiler().compile(Shot((Excite((21.0, 0.0), 100.0, 2),)))


def test_the_card_does_not_move_magnets():
    with pytest.raises(InputError, match="magnet stage"):
        compiler().compile(Shot((MoveMagnet("near", 1.0),)))
