"""Frequency, damping and amplitude of a free oscillation, from made-up and from known signals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smolbot.core.sensing import SensorArray
from smolbot.errors import InputError
from smolbot.localization.device.fit import fit_device
from smolbot.localization.device.ringdown import measure_ring_down
from smolbot.localization.device.thinning import Hum, thin_recording

RATE = 50_000.0


def hum_of(n, channels, seed, frequency=50.008):
    """Mains lines of random size and phase in each channel, and a drift, in T."""
    rng = np.random.default_rng(seed)
    time = np.arange(n) / RATE
    field = np.zeros((channels, n))
    for order, size in ((1, 1e-8), (2, 6e-10), (3, 3e-9), (5, 1e-9)):
        sizes = size * rng.standard_normal((channels, 1))
        field += sizes * np.cos(2 * np.pi * order * frequency * time + rng.uniform(0, 6, (channels, 1)))
    return field + 2e-9 * rng.standard_normal((channels, 1)) * time + 1e-10 * rng.standard_normal((channels, n))


@pytest.mark.parametrize(("name", "damping"), [("along", 31.7), ("along", 1.6), ("across", 1.1)])
def test_frequency_and_damping_are_found_under_the_hum(devices, array, pose_at, hear, name, damping):
    device = replace(devices[name], damping=damping)
    half_periods = int(2.0 * device.frequency)
    clean = hear(array, device, pose_at((2, 1, 70), 30.0), half_periods)
    recording = replace(clean, field=clean.field + hum_of(clean.field.shape[1], len(array), 1))
    assumed = replace(device, frequency=device.frequency + 1.3, damping=1.2 * damping)
    found = measure_ring_down(recording, array, assumed)
    assert found.frequency == pytest.approx(device.frequency, abs=5e-3)
    assert found.damping == pytest.approx(damping, rel=0.01)
    assert found.signal_to_noise > 100.0


@pytest.mark.parametrize(("name", "damping"), [("along", 31.7), ("across", 1.1)])
def test_known_height_gives_the_amplitude(devices, array, pose_at, hear, name, damping):
    device = replace(devices[name], damping=damping)
    order = "zy" if name == "along" else "xy"
    pose = pose_at((3, -2, 70), 40.0, order)
    amplitude = 0.8 * device.theta_max
    clean = hear(array, device, pose, int(2.0 * device.frequency), amplitude=amplitude)
    recording = replace(clean, field=clean.field + hum_of(clean.field.shape[1], len(array), 2))
    near = pose_at((3.4, -1.7, 70), 43.0, order)
    found = fit_device(recording, array, device, near.position, near.orientation)
    assert found.amplitude == pytest.approx(amplitude, rel=3e-3)
    assert found.position == pytest.approx(pose.position, abs=5e-5)
    below = SensorArray(0.3 * array.positions, array.axes)  # the law of distance holds for sensors under the device
    clean = hear(below, device, pose, int(2.0 * device.frequency), amplitude=amplitude)
    found = fit_device(clean, below, device, near.position, near.orientation)
    higher = fit_device(clean, below, device, near.position + np.array([0, 0, 7e-4]), near.orientation)
    assert higher.amplitude / found.amplitude == pytest.approx((70.7 / 70.0) ** 3, rel=0.01)  # B ~ theta / z³


@pytest.mark.parametrize("true_model", ["linear", "exponential"])
def test_the_likelier_damping_fits_better(across_device, array, pose_at, hear, true_model):
    device = replace(across_device, damping=0.8, damping_model=true_model)
    pose = pose_at((0, 0, 75), 10.0, "xy")
    clean = hear(array, device, pose, int(2.0 * device.frequency))
    recording = replace(clean, field=clean.field + hum_of(clean.field.shape[1], len(array), 3))
    fits = {
        model: fit_device(recording, array, replace(device, damping_model=model), pose.position, pose.orientation)
        for model in ("linear", "exponential")
    }
    assert min(fits, key=lambda m: fits[m].sse) == true_model


def test_constants_and_slow_drifts_change_nothing(along_device, array, pose_at, hear):
    recording = hear(array, along_device, pose_at((0, 0, 60)), 100)
    plain = measure_ring_down(recording, array, along_device)
    time = np.arange(recording.field.shape[1]) / RATE
    rng = np.random.default_rng(1)
    added = 1e-6 * rng.standard_normal((len(array), 1)) + 1e-8 * rng.standard_normal((len(array), 1)) * time
    moved = measure_ring_down(replace(recording, field=recording.field + added), array, along_device)
    assert moved.frequency == pytest.approx(plain.frequency, abs=1e-4)
    assert moved.damping == pytest.approx(plain.damping, rel=1e-4)


def test_mains_lines_are_removed_from_a_long_window(array, along_device, hear, pose_at):
    recording = hear(array, along_device, pose_at((0, 0, 60)), 207)
    only_hum = replace(recording, field=hum_of(recording.field.shape[1], len(array), 4))
    thinned = thin_recording(only_hum, array, along_device.frequency, Hum())
    block_noise = 1e-10 / np.sqrt(thinned.block)
    assert np.std(thinned.data) < 1.5 * block_noise


def test_recordings_that_tell_nothing_are_refused(along_device, array, pose_at, hear):
    recording = hear(array, along_device, pose_at((0, 0, 60)), 10)
    with pytest.raises(InputError, match="at least one period"):
        measure_ring_down(replace(recording, field=recording.field[:, :200]), array, along_device)
    with pytest.raises(InputError, match="9 channels"):
        measure_ring_down(
            replace(recording, field=recording.field[:9], saturated=np.zeros(9, bool)), array, along_device
        )
    with pytest.raises(InputError, match="after a drive"):
        measure_ring_down(replace(recording, time_since_drive=np.inf), array, along_device)
    deaf = replace(recording, saturated=np.arange(10) < 7)
    with pytest.raises(InputError, match="0, 1, 2, 3, 4, 5, 6"):
        measure_ring_down(deaf, array, along_device)
