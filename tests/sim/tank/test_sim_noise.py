"""The reference noise against the spectra it is wanted to have."""

from __future__ import annotations

import numpy as np
import pytest

from sim.tank.magnetics.noise import FieldNoise, SensorNoise

RATE = 50_000.0


@pytest.fixture
def section(rig):
    return rig.sections.noise


def one_sensor_many_times(section, seconds=40.0, sensors=24, pieces=1):
    noise = SensorNoise(section, sensors, 1000.0, RATE, 1.0, np.random.default_rng(5))
    out = np.zeros((sensors, int(seconds * RATE)))
    for k, piece in enumerate(np.array_split(np.arange(out.shape[1]), pieces)):
        part = np.zeros((sensors, len(piece)))
        noise.add(part, piece[0] / RATE)
        out[:, piece] = part
        assert k < pieces
    return out


@pytest.mark.parametrize("pieces", [1, 400])
def test_sensor_noise_has_the_specified_spectrum_at_once_or_in_pieces(section, pieces):
    from scipy.signal import welch

    record = one_sensor_many_times(section, seconds=20.0, pieces=pieces)[:, ::10]
    f, power = welch(record, RATE / 10, nperseg=20_000)
    power = power.mean(axis=0)
    floor, top = section.floor_pt_per_rthz * 1e-12, section.at_1hz_pt_per_rthz * 1e-12
    for low, high in [(0.7, 1.5), (3, 6), (10, 20), (40, 70), (100, 200), (300, 500)]:
        band = (f >= low) & (f < high)
        wanted = (floor**2 / (1 + (f[band] / 1000) ** 2) + (top**2 - floor**2) / f[band]).mean()
        assert power[band].mean() == pytest.approx(wanted, rel=0.2), (low, high)


def test_sensor_noise_beyond_the_bandwidth_falls_off(section):
    from scipy.signal import welch

    f, power = welch(one_sensor_many_times(section, seconds=1.0), RATE, nperseg=5000)
    power = power.mean(axis=0)
    ratio = power[(f > 9e3) & (f < 11e3)].mean() / power[(f > 150) & (f < 250)].mean()
    assert 0.005 < ratio < 0.02  # (1 / 10)², somewhat more by sampling


def test_mains_is_coherent_on_the_clock_across_recordings(rig, section):
    n, axes = len(rig.sensors), rig.sensors.axes
    noise = FieldNoise(section, rig.sensors.positions, axes, 1000.0, 1.0, 1.0, np.random.default_rng(2))
    whole, late = np.zeros((n, 60_000)), np.zeros((n, 500))
    noise.add(whole, 0.0, RATE)
    noise.add(late, 1.0, RATE)
    assert late == pytest.approx(whole[:, 50_000:50_500], abs=1e-15)


def test_noise_of_a_room_is_smooth_in_space(section):
    """Neighbouring parallel sensors hear nearly the same."""
    places = np.array([[0.0, 0, 0], [0.06, 0, 0], [0.001, 0, 0]])
    axes = np.tile([0.0, 0.0, 1.0], (3, 1))
    ratios = []
    for seed in range(30):
        noise = FieldNoise(section, places, axes, 1000.0, 1.0, 1.0, np.random.default_rng(seed))
        heard = np.zeros((3, 5000))
        noise.add(heard, 0.0, RATE)
        heard -= heard.mean(axis=1, keepdims=True)
        ratios.append([(heard[0] - heard[1]).std(), (heard[0] - heard[2]).std(), heard[0].std()])
    far, near, raw = np.median(ratios, axis=0)
    assert far < 0.5 * raw
    assert near < 0.03 * far * 60 / 60 + 0.02 * raw


def test_quiet_settings_are_silent(section):
    silent = section.model_copy(
        update={
            "mains_nt": 0.0,
            "mains_gradient_nt_per_m": 0.0,
            "drift_nt_per_s": 0.0,
            "floor_pt_per_rthz": 0.0,
            "at_1hz_pt_per_rthz": 0.0,
        }
    )
    heard, rng = np.zeros((2, 500)), np.random.default_rng(0)
    FieldNoise(silent, np.zeros((2, 3)), np.eye(3)[:2], 1000.0, 1.0, 1.0, rng).add(heard, 0.0, RATE)
    SensorNoise(silent, 2, 1000.0, RATE, 1.0, rng).add(heard, 0.0)
    assert not heard.any()
