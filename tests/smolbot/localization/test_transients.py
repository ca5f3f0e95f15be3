"""The excitation coils' ring-down is learned, and separated from a signal."""

import numpy as np
import pytest

from smolbot.core.pose import Pose
from smolbot.core.rotations import quaternion_from_axes
from smolbot.core.sensing import Device, Recording, SensorArray
from smolbot.errors import InputError
from smolbot.localization.forward import compute_deflection, compute_sensor_field
from smolbot.localization.localizer import Localizer
from smolbot.localization.noise.excitation_transients import learn_time_constant
from smolbot.localization.noise.model import NoiseModel

RATE = 20_000.0
RNG = np.random.default_rng(4)
SENSORS = SensorArray(
    np.column_stack([RNG.uniform(-0.06, 0.06, (10, 2)), np.zeros(10)]), np.eye(3)[[2] * 6 + [0] * 2 + [1] * 2]
)
DEVICE = Device(0.89e-3, np.array([0.0, 0.0, 1.0]), 1.5e-3, np.radians(17.8), 103.5, 31.7, "exponential")
POSITION = np.array([3e-3, -2e-3, 0.06])
ORIENTATION = quaternion_from_axes(np.array([0.3, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]), "zy")
COUPLING = RNG.normal(size=(10, 1)) * 1e-3  # T, at the end of the drive


def recording(since: float, half_periods: int, tau: float, swing: float = 1.0) -> Recording:
    n = round(half_periods * RATE / (2.0 * DEVICE.frequency))
    time = since + np.arange(n) / RATE
    theta = compute_deflection(DEVICE, time, swing * DEVICE.theta_max, 0.8)
    field = compute_sensor_field(SENSORS, DEVICE, POSITION, ORIENTATION, theta) + COUPLING * np.exp(-time / tau)
    return Recording(field + 1e-10 * RNG.normal(size=field.shape), RATE, since)


@pytest.mark.parametrize("tau", [0.4e-3, 1.0e-3, 2.5e-3])
def test_the_time_constant_is_found_beside_a_swinging_device(tau):
    learned = learn_time_constant([recording(5.0 * tau, 8, tau, swing=0.1)], DEVICE.frequency)
    assert learned == pytest.approx(tau, rel=0.02)


def test_without_a_decay_nothing_is_learned():
    with pytest.raises(InputError, match="no decay"):
        learn_time_constant([recording(0.2, 8, 1e-3)], DEVICE.frequency)
    with pytest.raises(InputError, match="at least one probe"):
        learn_time_constant([], DEVICE.frequency)


def test_a_learned_ring_down_lets_listening_start_before_it_is_over():
    tau, since = 1.0e-3, 10e-3
    prior = Pose(0.0, POSITION + 3e-4, ORIENTATION, np.eye(6))
    quiet = [Recording(1e-10 * RNG.normal(size=(10, int(RATE))), RATE, np.inf) for _ in range(5)]
    plain = Localizer(SENSORS, DEVICE, NoiseModel.learn(quiet))
    knowing = plain.with_transients((1.002 * tau,))
    sample = recording(since, 2, tau)
    off = [float(np.linalg.norm(x.locate(sample, prior).position - POSITION)) for x in (plain, knowing)]
    assert off[1] < 0.3e-3
    assert off[1] < 0.2 * off[0]
