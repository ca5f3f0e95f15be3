"""The static bench: the tank's sensors and noise, and a yardstick that knows them exactly."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sim.studies.benches import make_characterised_device, make_optimised_device, make_reference_orientation
from sim.studies.cramer_rao import compute_bound, compute_own_covariance, compute_position_bound
from sim.tank.static_bench import StaticBench, with_sensors
from smolbot.config.rig import load_rig
from smolbot.core.sensing import Device
from smolbot.errors import InputError
from smolbot.localization.forward import compute_deflection, compute_sensor_field
from smolbot.localization.noise.model import NoiseModel

PLACE, TURN = np.array([0.004, -0.006, 0.08]), make_reference_orientation()
SILENT = {
    "noise.mains_nt": "0", "noise.mains_gradient_nt_per_m": "0", "noise.floor_pt_per_rthz": "0",
    "noise.at_1hz_pt_per_rthz": "0", "noise.drift_nt_per_s": "0",
}  # fmt: skip


def bench(seed=1, mismatch=0.0, device=None, settings=None):
    return StaticBench(load_rig("tank", settings), device or make_characterised_device(), seed, mismatch)


def in_glycerol():
    """The gradient robot's device: moment along the cantilever, 31.7 1/s."""
    return Device(0.89e-3, np.array([0.0, 0.0, 1.0]), 1.5e-3, math.radians(17.8), 103.5, 31.7, "exponential")


def true_noise_model(bench, top=2500.0, spacing=0.5):
    """The noise as it truly is, as a localizer takes it: lines, and the spectrum of the sensors' own noise."""
    noise = bench.true_sensors.field_noise
    frequencies = np.arange(0.0, top + 0.5 * spacing, spacing)
    corners, deviations = bench.true_sensors.sensor_noise.processes
    power = 2.0 / np.pi * deviations**2 / corners  # of a first-order process, one-sided, at 0 Hz
    density = np.sum(power / (1.0 + (frequencies[:, None] / corners) ** 2), axis=1)
    density += bench.true_sensors.converter_step**2 / 6.0 / bench.rate
    phasors = noise.amplitudes
    eye = np.eye(len(bench.sensors), dtype=np.complex128)
    return NoiseModel(
        line_frequencies=np.array(noise.frequencies),
        lines=np.einsum("lj,lk->ljk", phasors, phasors.conj()),
        frequencies=frequencies,
        spectrum=density[:, None, None] * eye,
        block=1.0 / bench.rate,
    )


@pytest.mark.parametrize(
    "device",
    [make_characterised_device(), make_optimised_device(), in_glycerol()],
    ids=["solid", "optimised", "glycerol"],
)
def test_an_ideal_noiseless_bench_measures_what_the_forward_model_predicts(device):
    settings = {"sensors.bandwidth_hz": "1e9"}
    ours = bench(device=device, settings=settings)
    n = ours.count_samples(2)
    theta = compute_deflection(device, 0.02 + np.arange(n) / ours.rate, 0.2, 0.7)
    expected = compute_sensor_field(ours.sensors, device, PLACE, TURN, theta)
    assert ours.compute_clean_readings(PLACE, TURN, n, 0.02, 0.2, 0.7) == pytest.approx(
        expected, abs=1e-4 * np.abs(expected).max()
    )


def test_the_same_seed_makes_the_same_recordings_and_another_one_others():
    first, again, other = (bench(seed, 1.0).record(PLACE, TURN, 2).field for seed in (3, 3, 4))
    assert np.array_equal(first, again)
    assert not np.allclose(first, other, atol=1e-10)


def test_mismatches_move_the_truth_and_not_the_belief():
    ideal, off = bench(5, 0.0), bench(5, 1.0)
    assert np.array_equal(ideal.sensors.positions, off.sensors.positions)
    assert ideal.true_device.frequency == ideal.device.frequency
    assert off.true_device.frequency != off.device.frequency
    assert np.abs(off.true_sensors.positions - off.sensors.positions).max() > 1e-4


def test_a_device_guided_along_a_constant_track_gives_the_signal_of_a_held_one():
    held, led = bench(), bench()

    def track(t):
        return np.tile(PLACE, (len(t), 1)), np.tile(TURN, (len(t), 1))

    assert led.record_track(track, 4).field == pytest.approx(held.record(PLACE, TURN, 4).field, abs=1e-15)


def test_a_disturbing_field_is_measured_along_each_axis_and_low_passed():
    calm, loud = bench(settings=SILENT), bench(settings=SILENT)

    def step(times, places):
        field = np.zeros((len(places), len(times), 3))
        field[..., 0] = 1e-6 * (times >= 0.0)
        return field

    difference = (
        loud.record(PLACE, TURN, 2, phase=0.0, disturbance=step).field - calm.record(PLACE, TURN, 2, phase=0.0).field
    )
    along_x = np.abs(loud.sensors.axes[:, 0]) > 0.9
    assert difference[~along_x] == pytest.approx(0.0, abs=1e-9)
    late, early = difference[along_x, -1], difference[along_x, 8]  # 8 samples: one time constant of 1 kHz
    assert late == pytest.approx(1e-6, abs=1e-9)
    assert early == pytest.approx(1e-6 * (1 - np.exp(-1.1)), rel=0.06)


def test_background_recordings_have_the_requested_length_and_follow_no_drive():
    quiet = bench().record_background(5.0)
    assert 5.0 <= sum(q.duration for q in quiet) < 5.001
    assert all(q.drive is None and not np.isfinite(q.time_since_drive) for q in quiet)


def test_learned_noise_comes_near_the_true_one():
    ours = bench(2)
    learned, true = NoiseModel.learn(ours.record_background(6.0)), true_noise_model(ours)
    for order in (1, 3, 5):
        a = learned.lines[int(np.argmin(np.abs(learned.line_frequencies - 50.0 * order)))]
        b = true.lines[int(np.argmin(np.abs(true.line_frequencies - 50.0 * order)))]
        assert np.abs(a - b).max() < 0.05 * np.abs(b).max()
    at = [float(np.interp(f, learned.frequencies, np.real(np.einsum("fjj->f", learned.spectrum)))) for f in (75, 320)]
    expected = [float(np.interp(f, true.frequencies, np.real(np.einsum("fjj->f", true.spectrum)))) for f in (75, 320)]
    assert at == pytest.approx(expected, rel=0.2)


def test_closed_form_covariance_of_the_sensors_own_noise_is_that_of_its_draws():
    settings = dict(SILENT) | {
        "noise.floor_pt_per_rthz": "6",
        "noise.at_1hz_pt_per_rthz": "20",
        "noise.constant_nt": "0",
    }
    ours = bench(7, settings=settings)
    count, size = 8, 50
    draws = np.concatenate([ours._measure(np.zeros((10, count * size)), np.inf, None).field for _ in range(300)])
    blocks = draws.reshape(len(draws), count, size).mean(axis=2)
    blocks -= blocks.mean(axis=1, keepdims=True)  # slow noise would need longer to average
    middle = np.eye(count) - 1.0 / count
    expected = middle @ compute_own_covariance(ours, count, size) @ middle
    assert blocks.T @ blocks / len(blocks) == pytest.approx(expected, abs=0.08 * expected.max())


def test_the_bound_falls_with_listening_and_amplitude_and_ignores_lines_it_can_project_out():
    ours = bench()
    at = [compute_position_bound(compute_bound(ours, PLACE, TURN, n, 0.3)) for n in (1, 2, 6)]
    assert at[0] > at[1] > at[2]
    small = compute_position_bound(compute_bound(ours, PLACE, TURN, 2, 0.3, amplitude=0.5 * ours.device.theta_max))
    assert small == pytest.approx(2.0 * at[1], rel=0.15)
    louder = bench(settings={"noise.mains_nt": "98.0", "noise.mains_gradient_nt_per_m": "210.0"})
    assert compute_position_bound(compute_bound(louder, PLACE, TURN, 2, 0.3)) < 1.1 * at[1]


def test_sensors_elsewhere_hear_from_there():
    rig = load_rig("tank")
    wide = with_sensors(rig, 2.0 * rig.sensors.positions, rig.sensors.axes)
    assert wide.sensors.positions == pytest.approx(2.0 * rig.sensors.positions)
    far = StaticBench(wide, make_characterised_device(), 1, 0.0).compute_clean_readings(2.0 * PLACE, TURN, 50)
    near = bench(device=replace(make_characterised_device(), l0=0.75e-3)).compute_clean_readings(PLACE, TURN, 50)
    assert far == pytest.approx(near / 8.0, rel=1e-6)
    with pytest.raises(InputError, match="axes"):
        with_sensors(rig, rig.sensors.positions, rig.sensors.axes[:3])


def test_a_negative_mismatch_is_refused():
    with pytest.raises(InputError, match="mismatch_scale"):
        bench(mismatch=-1.0)
