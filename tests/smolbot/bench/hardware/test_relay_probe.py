"""The waveform that times a relay: what begins and ends the field is the relay, and all ends at zero."""

from __future__ import annotations

import numpy as np
import pytest

from smolbot.bench.hardware.relay_probe import make_relay_probe
from smolbot.bench.hardware.waveform import get_line_bit
from smolbot.bench.hardware.wiring import BenchSection
from smolbot.config.document import validate
from smolbot.config.rig import load_rig
from smolbot.core.coil_probe import BASELINE_DURATION, DECAY_DURATION, HOLD_DURATION
from smolbot.errors import InputError


@pytest.fixture(scope="module")
def section() -> BenchSection:
    found, faults = validate(BenchSection, load_rig("bench").raw_section("bench"), ("bench",))
    assert found is not None, faults
    return found


@pytest.mark.parametrize("number", range(6))
def test_current_waits_for_the_relay_at_both_ends(section: BenchSection, number: int) -> None:
    load = section.loads[number]
    wave, on, off = make_relay_probe(section, load.name, 0.05, 50_000.0)
    relay = (wave.lines >> get_line_bit(load.relay)) & 1 > 0
    enabled = (wave.lines >> get_line_bit(section.outputs.enable)) & 1 > 0
    row = section.used_outputs.index(load.output)
    driven = wave.volts[row] != 0
    rate = section.outputs.rate_hz
    assert (on, off) == pytest.approx((BASELINE_DURATION, BASELINE_DURATION + HOLD_DURATION))
    assert np.flatnonzero(relay)[[0, -1]] / rate == pytest.approx([on, off - 1 / rate])
    assert np.array_equal(driven, enabled)
    assert np.flatnonzero(driven)[0] == np.flatnonzero(relay)[0]
    assert np.flatnonzero(driven)[-1] / rate > off + 3e-3 * section.relays.open_ms
    assert wave.volts[row][driven] * load.gain_a_per_v == pytest.approx(0.05)


@pytest.mark.parametrize("number", range(6))
def test_no_other_relay_closes_no_other_output_moves_and_all_ends_at_zero(section: BenchSection, number: int) -> None:
    load = section.loads[number]
    wave, _, _ = make_relay_probe(section, load.name, 0.05, 50_000.0)
    allowed = 1 << get_line_bit(load.relay) | 1 << get_line_bit(section.outputs.enable)
    assert not np.any(wave.lines & ~np.uint32(allowed))
    others = [k for k, output in enumerate(section.used_outputs) if output != load.output]
    assert not wave.volts[others].any()
    assert not wave.volts[:, -1].any()
    assert wave.lines[-1] == 0
    assert wave.listen == (0, wave.samples)
    assert wave.samples >= round((BASELINE_DURATION + HOLD_DURATION + DECAY_DURATION) * 50_000)
    assert wave.settled <= wave.samples


def test_what_cannot_be_driven_is_refused(section: BenchSection) -> None:
    with pytest.raises(InputError, match=r"No coil 'z' is wired; wired are \+x, -x"):
        make_relay_probe(section, "z", 0.05, 50_000.0)
    with pytest.raises(InputError, match=r"\+x: 50 A needs 25.00 V; the output gives ±10 V"):
        make_relay_probe(section, "+x", 50.0, 50_000.0)
