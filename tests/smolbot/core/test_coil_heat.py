"""Heat and duty of coils, against an integrator, closed forms and brute force."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from smolbot.config.rig import load_rig
from smolbot.core.coil_heat import (
    COPPER_TEMPERATURE_COEFFICIENT,
    CoilHeat,
    ThermalCoil,
    advance_temperature,
    compute_mean_square_currents,
    compute_winding_heat_capacity,
)
from smolbot.core.shots import Actuate, Excite, Listen, RingDown
from smolbot.flight.safety.duty_cycle import DutyCycle
from smolbot.flight.safety.heat_store import SAVE_INTERVAL, HeatMemory

COIL = ThermalCoil("+x", resistance=1.0, capacity=58.0, thermal_resistance=8.0, limit=90.0)


@pytest.mark.parametrize("square", [0.0, 4.0, 1.0 / (8.0 * COPPER_TEMPERATURE_COEFFICIENT), 64.0])
@pytest.mark.parametrize("begin", [25.0, 90.0])
def test_a_step_is_what_an_integrator_finds_also_where_heating_outruns_cooling(square, begin):
    def slope(_, t):
        return (square * (1.0 + COPPER_TEMPERATURE_COEFFICIENT * (t - 20.0)) - (t - 25.0) / 8.0) / 58.0

    for duration in (0.1, 30.0, 600.0):
        found = solve_ivp(slope, (0.0, duration), [begin], rtol=1e-10, atol=1e-8).y[0, -1]
        assert advance_temperature(COIL, begin, square, duration, 25.0) == pytest.approx(found, rel=1e-6)


def test_one_long_step_is_many_short_ones():
    short = 25.0
    for _ in range(1000):
        short = advance_temperature(COIL, short, 30.0, 0.1, 25.0)
    assert short == pytest.approx(advance_temperature(COIL, 25.0, 30.0, 100.0, 25.0), rel=1e-10)


def test_a_steady_current_ends_where_heat_made_is_heat_given_off():
    end = advance_temperature(COIL, 25.0, 8.0, 1e6, 25.0)
    assert 8.0 * (1.0 + COPPER_TEMPERATURE_COEFFICIENT * (end - 20.0)) == pytest.approx((end - 25.0) / 8.0, rel=1e-9)


def test_an_undriven_coil_cools_by_e_in_its_time_constant():
    after = advance_temperature(COIL, 85.0, 0.0, 8.0 * 58.0, 25.0)
    assert after - 25.0 == pytest.approx(60.0 / math.e)


def test_over_complete_cycles_a_sine_heats_as_half_its_peak_squared():
    time_ = np.linspace(0.0, 5 / 103.5, 200001)
    square = np.trapezoid((3.0 * np.sin(2 * np.pi * 103.5 * time_)) ** 2, time_) / time_[-1]
    assert compute_mean_square_currents(Excite((3.0, -2.0), 103.5, 5), 4, 2) == pytest.approx([0, 0, 0, 0, square, 2.0])
    assert compute_mean_square_currents(Actuate((1.0, 0.0, 2.0, 0.0), 0.1), 4, 2) == [1.0, 0.0, 4.0, 0.0, 0.0, 0.0]
    assert not compute_mean_square_currents(Listen(2, 103.5), 4, 2)
    assert not compute_mean_square_currents(RingDown(0.1), 4, 2)
    assert not compute_mean_square_currents(Actuate((0.0,) * 4, 0.1), 4, 2)


def test_no_more_copper_is_assumed_than_fits_the_winding():
    honest = compute_winding_heat_capacity(1.0, 200, math.pi * 0.05, 4e-4)
    assert compute_winding_heat_capacity(0.5, 200, math.pi * 0.05, 4e-4) == pytest.approx(2.0 * honest)
    full = compute_winding_heat_capacity(0.01, 200, math.pi * 0.05, 4e-4)
    assert compute_winding_heat_capacity(0.001, 200, math.pi * 0.05, 4e-4) == full


def test_the_shipped_coils_have_the_mass_of_their_geometry():
    stated = load_rig("tank").thermal
    bare = load_rig("tank", {"safety.coils": "{}"}).thermal
    for coil, own in zip(bare[:4], stated[:4]):
        assert own.capacity == pytest.approx(coil.capacity, rel=0.03)
        assert own.thermal_resistance == pytest.approx(coil.thermal_resistance, rel=0.03)


def test_excitation_coils_of_unknown_make_have_no_temperature():
    rig = load_rig("tank", {"safety.excitation": "{ resistance_ohm = 0.8 }"})
    assert rig.thermal[4:] == (None, None)
    heat = CoilHeat(rig.thermal, 25.0)
    heat.advance([64.0] * 6, 10.0)
    assert heat.temperatures[4:] == [25.0, 25.0]
    assert heat.temperatures[0] > 30.0


def test_duty_is_the_driven_share_of_the_sliding_time():
    rng = np.random.default_rng(3)
    gaps, lengths = rng.uniform(0.0, 0.3, 200), rng.uniform(0.01, 0.4, 200)
    starts = np.cumsum(gaps + lengths) - lengths
    duty = DutyCycle(("a", "b"), window=3.0)
    shares = []
    for start, length in zip(starts, lengths):
        end = start + length
        overlap = np.clip(np.minimum(starts + lengths, end) - np.maximum(starts, end - 3.0), 0.0, None)
        shares.append(float(overlap.sum() / 3.0))
        assert duty.add_span(1, start, end) == pytest.approx(shares[-1])
    assert duty.peaks == [0.0, pytest.approx(max(shares))]


class Clock:
    def __init__(self, now: float = 1e9) -> None:
        self.now = now

    def __call__(self) -> float:
        return self.now


def warm(temperature: float) -> CoilHeat:
    heat = CoilHeat((COIL, None), 25.0)
    heat.temperatures[0] = temperature
    return heat


def test_the_next_run_begins_with_coils_as_the_last_has_left_them_but_for_what_they_cooled(tmp_path):
    clock = Clock()
    HeatMemory(tmp_path / "heat" / "bench.json", clock).keep(warm(85.0), now=True)
    clock.now += 8.0 * 58.0
    found = CoilHeat((COIL, None), 25.0)
    HeatMemory(tmp_path / "heat" / "bench.json", clock).restore(found)
    assert found.temperatures == [pytest.approx(25.0 + 60.0 / math.e), 25.0]
    assert found.peaks == found.temperatures


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"time": "x", "temperatures_c": {}}', '{"time": 2e9, "temperatures_c": {"+x": 80}}']
)
def test_an_unreadable_heat_file_leaves_coils_cold(tmp_path, text):
    (tmp_path / "bench.json").write_text(text)
    found = CoilHeat((COIL,), 25.0)
    HeatMemory(tmp_path / "bench.json", Clock()).restore(found)
    assert found.temperatures == [25.0]


def test_a_killed_run_is_remembered_by_some_seconds(tmp_path):
    clock, heat = Clock(), warm(30.0)
    memory = HeatMemory(tmp_path / "bench.json", clock)
    for _ in range(20):
        clock.now += 1.0
        heat.temperatures[0] += 1.0
        memory.keep(heat)
    found = CoilHeat((COIL,), 25.0)
    HeatMemory(tmp_path / "bench.json", clock).restore(found)
    assert 50.0 - SAVE_INTERVAL <= found.temperatures[0] <= 50.0


def test_a_place_that_cannot_be_written_costs_one_warning_and_no_run(tmp_path):
    (tmp_path / "file").write_text("")
    memory = HeatMemory(tmp_path / "file" / "bench.json", Clock())
    with pytest.warns(UserWarning, match="cannot be kept for the next run"):
        memory.keep(warm(40.0))
    memory.keep(warm(40.0), now=True)
