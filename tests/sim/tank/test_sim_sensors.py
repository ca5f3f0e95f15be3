"""What the true sensors make of a magnet, of dying coils, and of themselves."""

from __future__ import annotations

import numpy as np
import pytest

from sim.tank.magnetics.device_packing import MAGNET_MASS, pack_device
from sim.tank.magnetics.true_sensors import TrueSensors
from sim.tank.mismatch import RandomStreams, sample_truth
from sim.tank.settings import TankSettings
from smolbot.config.rig import load_rig
from smolbot.core.rotations import matrix_from_quaternion, quaternion_from_rotation_vector
from smolbot.core.shots import Actuate, Excite, Listen, RingDown, Shot

magpylib = pytest.importorskip("magpylib")
MOMENT, L0, THETA_MAX, FREQUENCY = 0.89e-3, 1.5e-3, np.radians(17.8), 103.5
LISTEN = Shot((Excite((4.0, 4.0), FREQUENCY, 5), RingDown(0.02), Listen(2, FREQUENCY)))


def quiet_sensors(**settings):
    rig = load_rig("tank", settings)
    streams = RandomStreams.from_seed(0)
    truth = sample_truth(TankSettings(), 6, len(rig.sensors), streams, ideal=True)
    return TrueSensors(rig, truth, streams.field_noise, streams.sensor_noise, streams.constants)


def device(moment=(0.0, 0.0, 1.0)):
    return pack_device(
        MOMENT, np.array(moment), L0, THETA_MAX, FREQUENCY, 1.1, "linear", 0.2, (0, 0, 0.5e-3), MAGNET_MASS
    )


def still(sensors, theta, pose, n=20, currents=0, coupling=None):
    """What is heard of a magnet held at one deflection."""
    trace = np.full((2, 1 + currents), 0.0)
    trace[:, 0] = theta
    poses = np.tile(pose, (2, 1))
    coupling = np.zeros((currents, len(sensors.positions))) if coupling is None else coupling
    times = np.array([-1.0, 1.0])
    return sensors.compute_clean_readings(0.0, n, device(), coupling, times, trace, times, poses)


@pytest.mark.parametrize("theta", [0.0, THETA_MAX])
def test_dipole_signal_is_that_of_a_finite_magnet_to_1e_4_at_80_mm(theta):
    sensors = quiet_sensors()
    quaternion = quaternion_from_rotation_vector(np.array([0.4, -0.9, 0.3]))
    rotation, centre = matrix_from_quaternion(quaternion), np.array([0.002, -0.001, 0.08])
    heard = still(sensors, theta, np.concatenate([centre, quaternion]))
    direction = rotation @ [np.sin(theta), 0, np.cos(theta)]
    from scipy.spatial.transform import Rotation

    magnet = magpylib.magnet.Cylinder(
        dimension=(1e-3, 1e-3),
        polarization=(0, 0, MOMENT / (np.pi * 0.5e-3**2 * 1e-3) * 4e-7 * np.pi),
        position=centre + L0 * direction,
        orientation=Rotation.align_vectors([direction], [[0, 0, 1]])[0],
    )
    exact = np.einsum("ni,ni->n", magnet.getB(sensors.positions), sensors.axes)
    assert heard[:, -1] == pytest.approx(exact, abs=1e-4 * np.abs(exact).max())


def test_static_field_on_axis_at_80_mm_is_348_nanotesla():
    sensors = quiet_sensors()
    upright = np.array([0.0, 0.0, 0.08 - L0, 1.0, 0.0, 0.0, 0.0])
    sensors.positions[0], sensors.axes[0] = (0, 0, 0), (0, 0, 1)
    assert still(sensors, 0.0, upright)[0, 0] == pytest.approx(348e-9, rel=2e-3)


def test_sensors_low_pass_lags_and_weakens_as_a_first_order_one_does():
    sensors = quiet_sensors(**{"sensors.bandwidth_hz": "200.0"})
    n, omega = 5000, 2 * np.pi * 100.0
    times = np.arange(-2000, n + 10) * 2e-5
    trace = 0.01 * np.cos(omega * times)[:, None]
    pose = np.tile([0.0, 0.0, 0.08, 1.0, 0.0, 0.0, 0.0], (2, 1))
    heard = sensors.compute_clean_readings(
        0.0, n, device(), np.zeros((0, 10)), times, trace, np.array([-1.0, 1.0]), pose
    )[4]
    bright = np.sum((heard - heard.mean()) * np.exp(-1j * omega * times[2000 : 2000 + n])) * 2 / n
    upper, lower = still(sensors, 0.01, pose[0])[4, -1], still(sensors, -0.01, pose[0])[4, -1]
    expected = 0.5 * (upper - lower) / (1 + 1j * 100.0 / 200.0)
    assert abs(bright - expected) < 0.01 * abs(expected)


def test_recordings_come_in_steps_of_the_converter(open_tank):
    field = open_tank().play(LISTEN).field
    step = 20.0 / 2**16 * 1e-6
    assert field / step == pytest.approx(np.round(field / step), abs=1e-6)
    assert len(np.unique(field)) > 50


def test_listening_through_a_strong_field_saturates_and_reports_it(open_tank):
    rig = open_tank(limits__min_ring_down_ms="0.0")
    loud = rig.play(Shot((Actuate((8.0, 0, 0, 0), 0.03), Listen(2, FREQUENCY))))
    assert loud.saturated.any()
    assert np.abs(loud.field).max() <= 10.0e-6 + 1e-12
    assert not rig.play(LISTEN).saturated.any()


def test_decaying_coils_are_measured_shortly_after_a_drive_and_not_after_20_ms(open_tank):
    rig = open_tank(noise__constant_nt="0.0")
    soon = rig.play(Shot((Excite((8.0, 8.0), FREQUENCY, 5), RingDown(0.006), Listen(2, FREQUENCY)))).field
    late = rig.play(Shot((Excite((8.0, 8.0), FREQUENCY, 5), RingDown(0.020), Listen(2, FREQUENCY)))).field
    assert np.abs(soon[:, :20]).max() > 2e-6
    assert np.abs(late[:, :20]).max() < 1.5e-6


def test_each_shot_has_its_own_unknown_constant_in_each_channel(open_tank):
    rig = open_tank(ideal=True, noise__constant_nt="500.0", noise__mains_nt="0.0", noise__mains_gradient_nt_per_m="0.0")
    quiet = Shot((Listen(2, FREQUENCY),))
    means = np.array([rig.play(quiet).field.mean(axis=1) for _ in range(40)])
    assert means.std(axis=0).mean() == pytest.approx(500e-9, rel=0.15)
    assert np.abs(np.corrcoef(means.T) - np.eye(10)).max() < 0.6


def test_recordings_with_another_constant_differ_by_a_constant_only(open_tank):
    shots = [LISTEN, LISTEN]
    small, large = open_tank(), open_tank(noise__constant_nt="2000.0")
    for shot in shots:
        difference = large.play(shot).field - small.play(shot).field
        assert difference.std(axis=1).max() < 0.4e-9  # the converter's steps
    assert np.abs(difference.mean(axis=1)).max() > 500e-9
