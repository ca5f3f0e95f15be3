"""The floating robot against closed forms: drag, alignment, buoyancy, walls."""

from __future__ import annotations

import numpy as np
import pytest

from sim.tank.carriers.bullet import Bodies
from sim.tank.carriers.hydrodynamics import GRAVITY, Hull, compute_float_step, compute_flow
from sim.tank.mismatch import RandomStreams, sample_truth
from sim.tank.settings import FlowSection, TankSettings
from smolbot.config.rig import load_rig
from smolbot.config.robot import load_robot
from smolbot.core.rotations import (
    matrix_from_quaternion,
    multiply_quaternions,
    quaternion_from_axes,
    quaternion_from_rotation_vector,
)

STEPS = [1e-3, 3e-4, 2.5e-3]
LEVEL = quaternion_from_axes(np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), "zy")


@pytest.fixture
def world(rig, robot):
    settings = TankSettings()
    hull = Hull.build(rig, robot, settings, sample_truth(settings, 6, 10, RandomStreams.from_seed(0), ideal=True))
    bodies = Bodies(rig, robot, np.array([0, 0, hull.float_height]), LEVEL)
    yield hull, bodies
    bodies.close()


def drift(hull, bodies, magnetic, duration, step):
    """Run under a constant body-frame force and torque; returns the last state."""
    for _ in range(round(duration / step)):
        state = bodies.read_state()
        bodies.move(*compute_float_step(*state, magnetic, hull.values, hull.float_height, step), step)
    return bodies.read_state()


@pytest.mark.parametrize("step", STEPS)
def test_terminal_velocity_is_force_over_stokes_drag_at_any_step(world, rig, robot, step):
    hull, bodies = world
    _, _, velocity, _ = drift(hull, bodies, (0, 0, 1e-4, 0, 0, 0), 0.1, step)
    drag = 6 * np.pi * rig.sections.medium.viscosity_pa_s * robot.drag_radius
    assert velocity[0] == pytest.approx(1e-4 / drag, rel=1e-6)
    assert 2e-3 < velocity[0] < 4e-3


@pytest.mark.parametrize("step", STEPS)
def test_alignment_time_constant_is_rotation_drag_over_torque(world, rig, robot, step):
    """A moment m in a field B at a small angle turns toward it with 8 pi mu r^3 / (m B)."""
    hull, bodies = world
    moment, field = 0.89e-3, 5e-3
    tau = 8 * np.pi * rig.sections.medium.viscosity_pa_s * robot.drag_radius**3 / (moment * field)
    times, angles = [], []
    direction = np.array([np.cos(0.2), np.sin(0.2), 0.0])
    for k in range(round(2 * tau / step)):
        position, quaternion, velocity, spin = bodies.read_state()
        rotation = matrix_from_quaternion(np.array(quaternion))
        torque = np.cross([0, 0, moment], rotation.T @ direction * field)
        times.append(k * step)
        angles.append(np.arcsin(np.cross(rotation[:, 2], direction)[2]))
        bodies.move(
            *compute_float_step(
                position, quaternion, velocity, spin, (0, 0, 0, *torque), hull.values, hull.float_height, step
            ),
            step,
        )
    later = np.array(times) > 5e-3
    tau -= hull.values[2] / hull.values[8]  # inertia, to first order
    # Overdamped in a field, tan(angle / 2) decays exponentially.
    measured = -1 / np.polyfit(np.array(times)[later], np.log(np.tan(0.5 * np.array(angles)[later])), 1)[0]
    assert measured == pytest.approx(tau, rel=0.6 * step / tau + 5e-3)  # first order in the step
    assert 0.025 < tau < 0.045


def test_robot_floats_where_displaced_liquid_weighs_as_much_as_it(world, rig, robot):
    hull, bodies = world
    bodies.set_pose(np.array([0, 0, hull.float_height + 3e-4]), LEVEL)
    position, _, _, _ = drift(hull, bodies, (0,) * 6, 1.0, 1e-3)
    x, y, z = robot.size
    draft = rig.surface_z - (position[2] - 0.5 * y)
    assert rig.sections.medium.density_kg_m3 * draft * x * z == pytest.approx(robot.mass, rel=1e-3)
    assert 0 < draft < y
    assert hull.values[10] == pytest.approx(robot.mass * GRAVITY)


def test_surface_rights_a_tilted_robot(world):
    hull, bodies = world
    tilt = quaternion_from_rotation_vector(np.array([0.2, 0.1, 0.0]))
    bodies.set_pose(np.array([0, 0, hull.float_height]), multiply_quaternions(tilt, LEVEL))
    _, quaternion, _, _ = drift(hull, bodies, (0,) * 6, 2.0, 1e-3)
    assert matrix_from_quaternion(np.array(quaternion))[2, 1] > 0.9999


def flowing(settings, **flow):
    """A tank's liquid that flows at 2 mm/s."""
    rig = load_rig("tank", settings={"medium.flow_mm_s": "2.0"})
    settings = settings.model_copy(update={"flow": FlowSection(**flow)})
    robot, truth = load_robot("gradient"), sample_truth(settings, 6, 10, RandomStreams.from_seed(0), ideal=True)
    return Hull.build(rig, robot, settings, truth), rig, truth


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("heading", [0.0, 1.1])
def test_a_robot_that_nothing_pulls_goes_with_the_flow(world, step, heading):
    _, bodies = world
    hull, _, _ = flowing(TankSettings(), direction_deg=30.0)
    ahead = np.array([np.cos(heading), np.sin(heading), 0])
    bodies.set_pose(np.array([0, 0, hull.float_height]), quaternion_from_axes(ahead, np.array([0, 0, 1.0]), "zy"))
    _, _, velocity, spin = drift(hull, bodies, (0,) * 6, 0.2, step)
    assert velocity == pytest.approx((2e-3 * np.cos(np.radians(30)), 1e-3, 0.0), abs=1e-8)
    assert spin == pytest.approx((0.0, 0.0, 0.0), abs=1e-8)


def test_in_a_rotating_liquid_a_robot_circles_and_turns_with_it(world):
    _, bodies = world
    hull, rig, truth = flowing(TankSettings(), rotating_percent=100.0)
    omega = truth.flow_sense * 2e-3 / (0.5 * rig.container.size[0])
    bodies.set_pose(np.array([8e-3, 0, hull.float_height]), LEVEL)
    place, quaternion, _, spin = drift(hull, bodies, (0,) * 6, 4.0, 1e-3)
    assert spin[2] == pytest.approx(omega, rel=1e-3)
    assert np.arctan2(place[1], place[0]) == pytest.approx(4.0 * omega, rel=1e-2)
    assert np.hypot(*place[:2]) == pytest.approx(8e-3, rel=1e-3)
    ahead = matrix_from_quaternion(np.array(quaternion))[:, 2]
    assert np.arctan2(ahead[1], ahead[0]) == pytest.approx(4.0 * omega, rel=1e-2)


def test_the_flow_s_direction_is_sampled_and_its_speed_nowhere_above_the_rig_file_s():
    settings = TankSettings(flow=FlowSection(rotating_percent=40.0))
    rig, directions = load_rig("tank", settings={"medium.flow_mm_s": "2.0"}), []
    for seed in range(20):
        truth = sample_truth(settings, 6, 10, RandomStreams.from_seed(seed))
        x, y, omega = compute_flow(rig, settings, truth)
        directions.append(np.sign([x, y, omega]))
        around = 20e-3 * np.array([(np.cos(a), np.sin(a)) for a in np.linspace(0, 6, 30)])
        assert np.max(np.hypot(x - omega * around[:, 1], y + omega * around[:, 0])) <= 2e-3
    assert len(np.unique(directions, axis=0)) > 4


@pytest.mark.parametrize("heading", [0.0, 0.7, 2.5, 4.0])
def test_walls_contain_the_robot(world, rig, heading):
    hull, bodies = world
    ahead = np.array([np.cos(heading), np.sin(heading), 0])
    bodies.set_pose(np.array([0, 0, hull.float_height]), quaternion_from_axes(ahead, np.array([0, 0, 1.0]), "zy"))
    position, _, _, _ = drift(hull, bodies, (0, 0, 1e-3, 0, 0, 0), 2.0, 1e-3)
    half = 0.5e-3 * np.array(rig.sections.container.size_mm)
    assert np.all(np.abs(position[:2]) < half - 0.9e-3)
    assert np.any(np.abs(position[:2]) > half - 3.5e-3)  # it got there


def test_a_robot_heavier_than_its_liquid_rests_on_the_floor(world, rig, robot):
    hull, bodies = world
    sunk = hull.values.copy()
    sunk[10] = 2 * hull.values[11]
    for _ in range(4000):
        bodies.move(*compute_float_step(*bodies.read_state(), (0,) * 6, sunk, hull.float_height, 1e-3), 1e-3)
    assert bodies.read_state()[0][2] == pytest.approx(45e-3 + 0.5 * robot.size[1], abs=5e-5)
