"""The true magnetics against magpylib, which computes finite coils and finite magnets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim.tank.magnetics.cantilever import STATE_LENGTH, advance_cantilever, compute_coil_field, compute_fields
from sim.tank.magnetics.coil_fields import pack_coils
from sim.tank.magnetics.coupling import compute_coupling
from sim.tank.magnetics.device_packing import pack_device
from sim.tank.magnetics.tank_coils import TabulatedExcitation, TankCoils, find_magnet_volume
from sim.tank.magnetics.true_sensors import TrueSensors
from sim.tank.mismatch import RandomStreams, sample_truth
from sim.tank.settings import TankSettings
from sim.tank.tank import NO_SAMPLES
from smolbot.core.rotations import matrix_from_quaternion, quaternion_from_rotation_vector

magpylib = pytest.importorskip("magpylib")


@pytest.fixture(scope="module")
def points(rig):
    low, high = find_magnet_volume(rig)
    return np.random.default_rng(0).uniform(low + 1e-3, high - 1e-3, (40, 3))


def nominal(coils, rig):
    n = len(coils)
    return pack_coils(coils, np.zeros((n, 3)), np.zeros((n, 3)), np.ones(n), *find_magnet_volume(rig))


def test_every_coil_has_the_field_of_its_windings(rig, points):
    coils = (*rig.round_coils(), *rig.flat_coils())
    fields = nominal(coils, rig)
    ours = compute_fields(points, fields.rows, fields.coefficients)
    for coil, field in zip(coils, ours, strict=True):
        exact = coil.source().getB(points)
        error = np.linalg.norm(field - exact, axis=1) / np.linalg.norm(exact, axis=1)
        assert error.max() < 2e-4, coil.name


def test_a_displaced_and_tilted_coil_has_the_field_of_such_a_coil(rig, points):
    coil = rig.round_coils()[0]
    place, tilt = np.array([3e-4, -5e-4, 2e-4]), np.array([0.01, 0.02, -0.015])
    fields = pack_coils((coil,), place[None], tilt[None], np.array([1.03]), *find_magnet_volume(rig))
    turn = matrix_from_quaternion(quaternion_from_rotation_vector(tilt))
    moved = replace(coil, center=coil.center + place, axis=turn @ coil.axis)
    exact = 1.03 * moved.field(points)
    assert np.allclose(compute_fields(points, fields.rows, fields.coefficients)[0], exact, rtol=1e-4, atol=2e-8)


def test_gradient_is_that_of_the_field_and_nearly_curl_free(rig, points):
    coils = (*rig.round_coils()[:1], *rig.flat_coils())
    fields = nominal(coils, rig)
    step, g, b, work = 1e-5, np.empty((3, 3)), np.empty(3), np.empty((4, 3, 3))
    for row in fields.rows:
        for point in points[:10]:
            compute_coil_field(point, row, fields.coefficients, np.eye(3), b, g, work)
            around = np.concatenate([point + step * np.eye(3), point - step * np.eye(3)])
            b_around = compute_fields(around, row[None], fields.coefficients)[0]
            assert np.allclose(g, (b_around[:3] - b_around[3:]).T / (2 * step), rtol=1e-4, atol=1e-5 * np.abs(g).max())
            assert np.abs(g - g.T).max() < 5e-3 * np.abs(g).max()
            assert abs(np.trace(g)) < 5e-3 * np.abs(g).max()


def test_force_and_torque_are_those_on_a_finite_magnet(rig, robot):
    """What magpylib lets a cylinder of 1 x 1 mm feel, about the middle of the housing."""
    coils = rig.round_coils()
    fields, currents = nominal(coils, rig), np.array([8.0, 0.0, 5.0, 1.0])
    device = robot.device
    packed = pack_device(
        device.moment,
        device.moment_in_body,
        device.l0,
        device.theta_max,
        1e4,
        0.0,
        "exponential",
        0.0,
        robot.center,
        1e-2,
    )  # a cantilever too heavy and stiff to move
    circuits = np.column_stack([currents, currents, np.zeros((4, 2))])
    quaternion = quaternion_from_rotation_vector(np.array([0.5, 1.1, -0.4]))
    rotation = matrix_from_quaternion(quaternion)
    middle = np.array([0.006, -0.004, 0.0595])
    felt = advance_cantilever(
        tuple(middle), tuple(quaternion), packed, np.zeros(3), fields.rows, fields.coefficients, circuits,
        np.zeros(STATE_LENGTH), np.empty((1, 7)), 0, np.empty((50, 5)), 0, 1e-3, 50, NO_SAMPLES, 0,
    )  # fmt: skip
    magnet_place = middle + rotation @ (np.array([0.0, 0.0, device.l0]) - np.array(robot.center))
    direction = rotation @ device.moment_in_body
    size = np.pi * 0.5e-3**2 * 1e-3
    from scipy.spatial.transform import Rotation

    magnet = magpylib.magnet.Cylinder(
        dimension=(1e-3, 1e-3),
        polarization=(0, 0, device.moment / size * 4e-7 * np.pi),
        position=magnet_place,
        orientation=Rotation.align_vectors([direction], [[0, 0, 1]])[0],
    )
    sources = []
    for coil, current in zip(coils, currents, strict=True):
        source = coil.source()
        for loop in source.sources_all:
            loop.current *= current
        sources.append(source)
    force = torque = np.zeros(3)
    for source in sources:
        for loop in source.sources_all:
            f, t = magpylib.getFT(loop, magnet, meshing=200, pivot=middle, eps=1e-5)
            force, torque = force + f, torque + t
    assert np.linalg.norm(rotation @ felt[:3] - force) < 1e-3 * np.linalg.norm(force)
    assert np.linalg.norm(rotation @ felt[3:] - torque) < 1e-3 * np.linalg.norm(torque)


def test_wires_couple_into_sensors_as_the_windings_do(rig):
    coils = (*rig.round_coils()[:1], *rig.flat_coils())
    n, sensors = len(coils), rig.sensors
    ours = compute_coupling(
        coils, np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)), np.ones(n), sensors.positions, sensors.axes
    )
    for coil, row in zip(coils, ours, strict=True):
        exact = np.einsum("ni,ni->n", coil.source().getB(sensors.positions), sensors.axes)
        assert np.allclose(row, exact, rtol=5e-3, atol=5e-3 * np.abs(exact).max())


def test_nominal_excitation_field_is_that_of_the_bobbins_inside_and_outside(rig):
    excitation = TabulatedExcitation(rig)
    for point in ([0.0, 0.0, 0.06], [0.015, -0.012, 0.058], [0.0, 0.0, 0.12]):
        exact = [coil.field(np.array([point]))[0] for coil in rig.flat_coils()]
        assert np.allclose(excitation.compute_field(np.array(point)), exact, rtol=1e-4, atol=1e-9)


def test_the_external_coil_leaves_a_few_microtesla_of_the_earths_field(rig):
    settings, left = TankSettings(), []
    for seed in range(20):
        streams = RandomStreams.from_seed(seed)
        truth = sample_truth(settings, 6, 10, streams)
        sensors = TrueSensors(rig, truth, streams.field_noise, streams.sensor_noise, streams.constants)
        coils = TankCoils.build(rig, settings, truth, sensors.positions, sensors.axes)
        row = coils.fields.rows[-1:]
        middle = np.array([[0.0, 0.0, 0.0595], [0.015, 0.0, 0.0595]])
        total = coils.earth + coils.circuits[-1, 0] * compute_fields(middle, row, coils.fields.coefficients)[0]
        left.append(np.linalg.norm(total, axis=1))
    assert 1e-6 < np.median(left) < 8e-6
    assert np.median(np.abs(np.diff(left, axis=1))) > 5e-8  # not uniform
