"""What a check measures, on recordings of which the answer is known in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from smolbot.bench.check.edges import find_edges
from smolbot.bench.check.prediction import predict_responses
from smolbot.bench.check.response_match import match_responses
from smolbot.bench.check.sensor_noise import measure_sensor_noise
from smolbot.config.rig import load_rig
from smolbot.core.coil_probe import BASELINE_DURATION, DECAY_DURATION, HOLD_DURATION, Probe
from smolbot.core.sensing import Recording
from smolbot.errors import InputError

RATE = 50_000.0


def white(rng: np.random.Generator, density: float, shape: tuple[int, int]) -> np.ndarray:
    """Samples of one-sided spectral density `density` T/√Hz."""
    return density * math.sqrt(RATE / 2) * rng.standard_normal(shape)


def quiet(fields: list[np.ndarray]) -> list[Recording]:
    return [Recording(field, RATE, math.inf) for field in fields]


def test_white_noise_has_the_density_that_it_was_made_with():
    rng = np.random.default_rng(1)
    density = np.array([6e-12, 12e-12, 30e-12])
    hum = measure_sensor_noise(quiet([white(rng, 1.0, (3, 150_000)) * density[:, None] for _ in range(4)]), 50.0)
    np.testing.assert_allclose(hum.floor, density, rtol=0.04)
    np.testing.assert_allclose(hum.slow, density, rtol=0.6)  # a dozen degrees of freedom
    np.testing.assert_allclose(hum.rms, density * math.sqrt(2500.0), rtol=0.05)  # averaged down to 5 kHz


def test_the_sensors_low_pass_is_made_good_in_the_floor():
    rng = np.random.default_rng(2)
    keep = math.exp(-2 * math.pi * 1000.0 / RATE)
    noise = lfilter([1 - keep], [1, -keep], white(rng, 6e-12, (4, 200_000)), axis=1)
    hum = measure_sensor_noise(quiet([noise]), 50.0, bandwidth=1000.0)
    np.testing.assert_allclose(hum.floor, 6e-12, rtol=0.06)
    assert np.all(measure_sensor_noise(quiet([noise]), 50.0).floor < 0.98 * 6e-12)


def test_slow_noise_is_heard_at_1_hz_and_not_in_the_floor():
    """A first-order process of corner f and deviation s has the density 2 s² / (pi f (1 + (1 Hz / f)²))."""
    rng = np.random.default_rng(3)
    corner, deviation = 1.2, 50e-12
    keep = math.exp(-2 * math.pi * corner / RATE)
    drive = math.sqrt(1 - keep**2) * deviation * rng.standard_normal((4, 16 * 150_000))
    slow = lfilter([1.0], [1, -keep], drive, axis=1)
    pieces = np.split(slow + white(rng, 1e-12, slow.shape), 16, axis=1)
    hum = measure_sensor_noise(quiet(pieces), 50.0)
    expected = math.sqrt(2 * deviation**2 / (math.pi * corner * (1 + (1.0 / corner) ** 2)))
    np.testing.assert_allclose(hum.slow, expected, rtol=0.35)
    np.testing.assert_allclose(hum.floor, 1e-12, rtol=0.1)


@pytest.mark.parametrize("frequency", [49.9, 50.0, 50.013])
def test_mains_and_harmonics_are_measured_where_the_grid_is(frequency):
    rng = np.random.default_rng(4)
    fields = []
    for start in (0.0, 7.3):
        time = start + np.arange(150_000) / RATE
        field = white(rng, 6e-12, (2, len(time))) + np.array([[3e-7], [-1e-7]])
        field[0] += 9e-9 * np.sin(2 * np.pi * frequency * time + 0.4) + 2e-9 * np.cos(6 * np.pi * frequency * time)
        field[1] += 4e-9 * np.cos(2 * np.pi * frequency * time) + 1e-9 * np.sin(10 * np.pi * frequency * time)
        fields.append(field)
    hum = measure_sensor_noise(quiet(fields), 50.0)
    assert hum.mains_frequency == pytest.approx(frequency, abs=2e-3)
    np.testing.assert_allclose(hum.mains, [9e-9, 4e-9], rtol=0.01)
    np.testing.assert_allclose(hum.harmonics[0], [0, 2e-9, 0, 0, 0, 0, 0], atol=6e-11)
    np.testing.assert_allclose(hum.harmonics[1], [0, 0, 0, 1e-9, 0, 0, 0], atol=6e-11)
    np.testing.assert_allclose(hum.offset, [3e-7, -1e-7], rtol=1e-3)
    np.testing.assert_allclose(hum.rms, 6e-12 * math.sqrt(2500.0), rtol=0.05)


def test_a_line_that_nobody_knows_of_does_not_raise_the_floor():
    rng = np.random.default_rng(5)
    time = np.arange(200_000) / RATE
    field = white(rng, 6e-12, (3, len(time))) + 5e-9 * np.sin(2 * np.pi * 211.0 * time)
    hum = measure_sensor_noise(quiet([field]), 50.0, bandwidth=1000.0)
    np.testing.assert_allclose(hum.floor, 6e-12, rtol=0.1)


def test_a_stuck_channel_has_no_span():
    rng = np.random.default_rng(6)
    field = white(rng, 6e-12, (2, 100_000))
    field[1] = 3.05e-10
    assert measure_sensor_noise(quiet([field]), 50.0).span[1] == 0.0


def test_too_little_to_say_something_of_1_hz_is_refused():
    with pytest.raises(InputError, match="at least 1 s; got 0.500 s"):
        measure_sensor_noise(quiet([np.zeros((2, 25_000))]), 50.0)
    with pytest.raises(InputError, match="got none"):
        measure_sensor_noise([], 50.0)


def two_poles(time: np.ndarray, constant: float, lag: float) -> np.ndarray:
    """What a first-order sensor of `lag` s says of a field that rises with `constant` s from 0 on."""
    t = np.maximum(time, 0.0)
    if lag == 0.0:
        return 1 - np.exp(-t / constant)
    return 1 - (constant * np.exp(-t / constant) - lag * np.exp(-t / lag)) / (constant - lag)


def stepped(closes: float, opens: float, constant: float, lag: float, pattern: np.ndarray, noise: float) -> Probe:
    rng = np.random.default_rng(7)
    time = np.arange(round((BASELINE_DURATION + HOLD_DURATION + DECAY_DURATION) * RATE)) / RATE
    on, off = BASELINE_DURATION, BASELINE_DURATION + HOLD_DURATION
    share = two_poles(time - on - closes, constant, lag) - two_poles(time - off - opens, constant, lag)
    mains = 10e-9 * np.sin(2 * np.pi * 50.0 * time + 1.0)
    field = pattern[:, None] * share + mains + 2e-7 + noise * rng.standard_normal((len(pattern), len(time)))
    return Probe(Recording(field, RATE, math.inf), on, off)


PATTERN = np.array([5e-6, -2e-6, 1e-6, 0.3e-6, -4e-6])


@pytest.mark.parametrize("lag", [0.0, 1.0 / (2 * math.pi * 1000.0)])
@pytest.mark.parametrize(
    ("closes", "opens", "constant"), [(0.0, 0.0, 3e-3), (0.9e-3, 0.4e-3, 3e-3), (7e-3, 3e-3, 1e-3)]
)
def test_edges_are_found_to_a_few_hundredths_of_a_millisecond(closes, opens, constant, lag):
    edges = find_edges(stepped(closes, opens, constant, lag, PATTERN, 2.4e-10), 0.03, lag)
    assert edges.closes == pytest.approx(closes, abs=5e-5)
    assert edges.opens == pytest.approx(opens, abs=5e-5)
    assert edges.rise == pytest.approx(constant, rel=0.04)
    assert edges.fall == pytest.approx(constant, rel=0.04)
    np.testing.assert_allclose(edges.response, PATTERN / 0.03, atol=2e-9 / 0.03)


def test_no_field_is_no_edge():
    edges = find_edges(stepped(0.0, 0.0, 3e-3, 0.0, 0.0 * PATTERN, 2.4e-10), 0.03)
    assert not edges.detected
    assert edges.closes is None


def test_a_relay_that_does_not_open_never_lets_the_field_go():
    edges = find_edges(stepped(1e-3, 10.0, 3e-3, 0.0, PATTERN, 2.4e-10), 0.03)
    assert edges.closes == pytest.approx(1e-3, abs=5e-5)
    assert edges.opens is None


@pytest.fixture(scope="module")
def nominal():
    return predict_responses(load_rig("tank"))


def slightly_off(nominal, seed: int) -> np.ndarray:
    """Responses of coils and sensors that stand slightly off, with gains of a few per cent."""
    rng = np.random.default_rng(seed)
    coils, sensors = nominal.response.shape
    found = nominal.response + 0.6 * nominal.spread * rng.standard_normal((coils, sensors))
    return found * (1 + 0.02 * rng.standard_normal((coils, 1))) * (1 + 0.005 * rng.standard_normal((1, sensors)))


SEEDS = range(8)


def faults_of(nominal, measured: np.ndarray) -> tuple[dict[str, str], dict[int, str]]:
    coils, sensors = match_responses(
        measured, nominal.response, nominal.names, np.ones(measured.shape[1], bool), nominal.spread
    )
    return (
        {name: c.fault for name, c in zip(nominal.names, coils) if c.fault},
        {k: s.fault for k, s in enumerate(sensors) if s.fault},
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_a_rig_that_is_slightly_off_is_fit(nominal, seed):
    assert faults_of(nominal, slightly_off(nominal, seed)) == ({}, {})


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("coil", range(6))
def test_a_reversed_coil_is_named_and_no_sensor_is_blamed(nominal, coil, seed):
    measured = slightly_off(nominal, seed)
    measured[coil] *= -1
    assert faults_of(nominal, measured) == ({nominal.names[coil]: "reversed"}, {})


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("pair", [(0, 1), (1, 2), (4, 5), (0, 4)])
def test_swapped_coils_are_named_as_each_other(nominal, pair, seed):
    a, b = pair
    measured = slightly_off(nominal, seed)
    measured[[a, b]] = measured[[b, a]]
    names = nominal.names
    assert faults_of(nominal, measured) == (
        {names[a]: f"this is the field of {names[b]}", names[b]: f"this is the field of {names[a]}"},
        {},
    )


def test_a_coil_that_is_swapped_and_reversed_says_both(nominal):
    measured = slightly_off(nominal, 1)
    measured[[2, 3]] = -measured[[3, 2]]
    coils, _ = faults_of(nominal, measured)
    assert coils == {"+y": "this is the field of -y, reversed", "-y": "this is the field of +y, reversed"}


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("sensor", [0, 4, 7, 9])
def test_a_reversed_sensor_is_named_and_no_coil_is_blamed(nominal, sensor, seed):
    measured = slightly_off(nominal, seed)
    measured[:, sensor] *= -1
    assert faults_of(nominal, measured) == ({}, {sensor: "reversed"})


@pytest.mark.parametrize("pair", [(0, 1), (3, 8), (6, 7)])
def test_swapped_sensors_are_named_as_each_other(nominal, pair):
    a, b = pair
    measured = slightly_off(nominal, 3)
    measured[:, [a, b]] = measured[:, [b, a]]
    coils, sensors = faults_of(nominal, measured)
    assert coils == {}
    assert sensors == {a: f"measures what sensor {b} should", b: f"measures what sensor {a} should"}


def test_a_deaf_sensor_a_silent_coil_and_a_wrong_gain_are_told_apart(nominal):
    measured = slightly_off(nominal, 4)
    measured[:, 5] *= 0.01
    measured[:, 2] *= 1.5
    measured[3] = 0.0
    measured[0] *= 0.5
    coils, sensors = faults_of(nominal, measured)
    assert coils == {"+x": coils["+x"], "-y": "makes no field"}
    assert coils["+x"].startswith("makes 0.5")
    assert sensors == {2: sensors[2], 5: "measures no coil"}
    assert sensors[2].startswith("says 1.5") or sensors[2].startswith("says 1.4")
