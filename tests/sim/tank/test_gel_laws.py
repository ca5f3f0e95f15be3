"""The helix in the gel: the cube's field, what moves below and above the yield, what a turn brings, when it is lost."""

from __future__ import annotations

import magpylib as magpy
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from sim.tank.carriers.gel import gel_kernels as k
from sim.tank.carriers.gel.mismatch import make_gel_generators, pack_cube, pack_gel, sample_gel
from sim.tank.magnetics.device_packing import pack_device
from sim.tank.settings import TankSettings
from sim.tank.world import TankWorld
from smolbot.config.rig import load_rig
from smolbot.config.robot import load_robot
from smolbot.core.rotations import matrix_from_quaternion, quaternion_from_axes
from smolbot.core.shots import Excite, Listen, MoveMagnet, RingDown, Rotate, Shot

RIG, ROBOT = load_rig("gel"), load_robot("helical")
SIDE, REMANENCE = 0.0508, 1.27
IDEAL = sample_gel(TankSettings(), make_gel_generators(0)[0], ideal=True)
GEL = pack_gel(RIG, ROBOT, TankSettings(), IDEAL)
FREE = GEL.copy()  # no plates in the way
FREE[k.LOW], FREE[k.HIGH] = -1.0, 1.0
DEVICE = pack_device(0.89e-3, np.array([1.0, 0, 0]), 1.5e-3, np.radians(8.0), 181.0, 1.1, "linear", 0.2, (0, 0, 0))
NONE = np.zeros((3, 3))
finite = st.floats(-1.0, 1.0)


def cube_at(point):
    b, g = np.empty(3), np.empty((3, 3))
    k.compute_cuboid_field(*point, SIDE / 2, REMANENCE, b, g)
    return b, g


POINTS = [(0, 0, 0.058), (0.058, 0.0, 0.0), (0.02, -0.03, 0.05), (-0.04, 0.028, -0.031), (0.0254, 0.01, 0.06)]


@pytest.mark.parametrize("point", POINTS)
def test_field_and_gradient_of_the_cube_are_those_of_magpylib(point):
    cube = magpy.magnet.Cuboid(dimension=(SIDE,) * 3, polarization=(0, 0, REMANENCE))
    b, g = cube_at(point)
    np.testing.assert_allclose(b, cube.getB(point), rtol=1e-9, atol=1e-12)
    step = 1e-6
    slopes = [(cube.getB(point + step * e) - cube.getB(point - step * e)) / (2 * step) for e in np.eye(3)]
    np.testing.assert_allclose(g, np.array(slopes).T, atol=1e-6 * np.abs(g).max())
    assert abs(np.trace(g)) < 1e-12 * np.abs(g).max()
    np.testing.assert_array_equal(g, g.T)


@pytest.mark.parametrize(("steer", "turn"), [(0.0, 0.0), (0.7, 1.2), (-2.0, 4.0)])
def test_the_turned_and_steered_cube_is_magpylibs_too(steer, turn):
    """At a turn of zero its pole looks down; it turns about a horizontal axis."""
    cube = pack_cube(RIG, IDEAL)
    point = np.array([0.004, -0.011, 0.049])
    b, g = np.empty(3), np.empty((3, 3))
    k.compute_magnet_field(point, cube, steer, turn, b, g, np.empty((4, 3, 3)))
    axis = np.array([np.cos(steer), np.sin(steer), 0.0])
    down = Rotation.from_matrix(np.column_stack([axis, np.cross([0, 0, -1.0], axis), [0, 0, -1.0]]))
    world = Rotation.from_rotvec(turn * axis) * down
    reference = magpy.magnet.Cuboid(
        dimension=(SIDE,) * 3, polarization=(0, 0, REMANENCE), position=cube[2:5], orientation=world
    )
    np.testing.assert_allclose(b, reference.getB(point), rtol=1e-9)


def test_a_hundred_millitesla_act_and_they_turn_against_the_magnet():
    cube, point = pack_cube(RIG, IDEAL), np.array([0.0, 0.0, 0.0495])
    fields = []
    for turn in np.linspace(0, 2 * np.pi, 181):
        b = np.empty(3)
        k.compute_magnet_field(point, cube, 0.0, float(turn), b, np.empty((3, 3)), np.empty((4, 3, 3)))
        fields.append(b)
    fields = np.array(fields)
    assert np.mean(np.linalg.norm(fields, axis=1)) == pytest.approx(0.1, rel=0.02)
    about = np.unwrap(np.arctan2(fields[:, 2], fields[:, 1]))  # about +x, the magnet's axis
    assert about[-1] - about[0] == pytest.approx(-2 * np.pi, abs=1e-6)


def moved(load, gel=GEL, forward=(1.0, 0.0, 0.0)):
    out = np.empty(6)
    k.compute_gel_flow(np.array(forward), np.asarray(load, dtype=float), gel, 1.0, 1.0, out)
    return out


@given(st.lists(finite, min_size=6, max_size=6), st.floats(0.0, 0.99))
def test_nothing_moves_below_the_yield(direction, size):
    d = np.array(direction)
    strengths = np.array([GEL[k.THREAD]] + [GEL[k.ACROSS]] * 2 + [GEL[k.SPIN]] + [GEL[k.TILT]] * 2)
    conjugate = d / max(np.linalg.norm(d), 1e-9) * size * strengths  # inside the ellipsoid
    load = conjugate.copy()
    load[3] -= GEL[k.LEAD] * load[0]  # a push along the thread twists as well
    assert not moved(load).any()


@pytest.mark.parametrize("over", [1.2, 2.0, 5.0])
def test_a_torque_above_the_yield_turns_as_a_bingham_body_does(over):
    gel = GEL.copy()
    gel[k.CUT] = 0.0
    gel[k.THREAD] = 1e6  # no slip: the screw advances with its turn
    out = moved([0, 0, 0, over * gel[k.SPIN], 0, 0], gel)
    assert out[3] == pytest.approx(gel[k.RATE] * (over - 1.0), rel=1e-9)
    assert out[0] == pytest.approx(gel[k.LEAD] * out[3], rel=1e-9)
    np.testing.assert_allclose(out[[1, 2, 4, 5]], 0.0, atol=1e-15)


def test_a_turning_screw_yields_to_a_pull_across_it_that_alone_does_not_move_it():
    pull = 0.1 * GEL[k.ACROSS]
    assert not moved([0, pull, 0, 0, 0, 0]).any()
    out = moved([0, pull, 0, 2.0 * GEL[k.SPIN], 0, 0])
    twist = 2.0 * GEL[k.SPIN]
    assert out[1] / out[3] == pytest.approx(pull / GEL[k.ACROSS] ** 2 * GEL[k.SPIN] ** 2 / twist, rel=0.05)


@given(finite, finite, finite)
def test_gel_and_plates_only_ever_take_power(a, b, c):
    load = np.array([a * 0.05, b * 0.1, 0.0, c * 6e-5, a * 1e-4, b * 1e-4])
    out = moved(load)
    assert load @ out >= -1e-18


def spin_in(field, frequency, turns, gel, step=2e-3):
    """State after a field of constant size turned about x, the axis of the helix."""
    state = np.zeros(k.GEL_STATE_LENGTH)
    state[3:7] = quaternion_from_axes(np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), "zx")
    load, out = np.empty(6), np.empty(6)
    rolled, last = 0.0, 0.0
    for i in range(int(turns / frequency / step)):
        angle = 2 * np.pi * frequency * i * step
        rotation = matrix_from_quaternion(state[3:7])
        b = field * np.array([0.0, np.cos(angle), np.sin(angle)])
        state[7] = k.compute_magnetic_load(rotation, state[7], b, NONE, DEVICE, load)
        k.compute_gel_flow(np.ascontiguousarray(rotation[:, 2]), load, gel, 1.0, 1.0, out)
        k.advance_pose(state, out, step)
        now = np.arctan2(rotation[2, 0], rotation[1, 0])
        rolled += (now - last + np.pi) % (2 * np.pi) - np.pi
        last = now
    return state, rolled / (2 * np.pi)


def test_advance_per_turn_is_pitch_less_the_slip_of_the_closed_form():
    """In steady rotation the push of the nose F and the slip s obey s = lambda F / S_thread², omega = lambda g / S²."""
    frequency, turns = 0.25, 3.0
    state, rolled = spin_in(0.1, frequency, turns, FREE)
    omega = 2 * np.pi * frequency
    spin, thread, cut = FREE[k.SPIN], FREE[k.THREAD], FREE[k.CUT]

    def excess(g):
        n = np.hypot(g / spin, cut / thread)
        return spin * FREE[k.RATE] * (n - 1) / n * g / spin**2 - omega

    g = brentq(excess, spin, 100 * spin)
    slip = omega * cut / thread**2 * spin**2 / g
    assert state[0] / rolled == pytest.approx(2 * np.pi * (FREE[k.LEAD] - slip / omega), rel=0.01)
    assert rolled == pytest.approx(turns, abs=0.15)  # it lags a little behind


@pytest.mark.parametrize(("share", "follows"), [(0.96, True), (1.04, False)])
def test_the_robot_steps_out_where_drag_and_yield_ask_for_more_than_m_b(share, follows):
    """S (1 + omega / Gamma) = m B is the most that a field can turn."""
    gel = FREE.copy()
    gel[k.CUT], gel[k.THREAD] = 0.0, 1e3
    field = 0.03
    limit = gel[k.RATE] * (DEVICE[0] * field / gel[k.SPIN] - 1.0) / (2 * np.pi)
    _, rolled = spin_in(field, share * limit, 12.0, gel)
    assert (rolled > 11.5) == follows


def test_the_same_seed_at_twice_the_scale_is_the_same_gel_with_everything_doubled():
    one, two = (
        sample_gel(TankSettings.model_validate({"mismatch": {"scale": s}}), make_gel_generators(7)[0])
        for s in (1.0, 2.0)
    )
    for name, value in one.as_dict().items():
        other = np.array(two.as_dict()[name])
        if name.startswith("start"):
            assert other == value  # put down by hand, not a mismatch
        elif name in ("steering", "home") or name.startswith("magnet"):
            np.testing.assert_allclose(other, 2 * np.array(value))
        else:
            assert other - 1 == pytest.approx(2 * (value - 1))


def test_doubled_mismatches_lead_farther_astray():
    """From where the same hand put it down, the robot ends farther from where the nominal one does."""
    away = np.zeros(2)
    for seed in range(1, 6):
        ends = []
        for scale in (0.0, 1.0, 2.0):
            rig = load_rig("gel", {"tank.mismatch.scale": str(scale)})
            with TankWorld.open(rig, ROBOT, (0.0, -5e-3, 0.3), seed) as tank:
                turn = Rotate((-np.cos(0.9), -np.sin(0.9), 0.0), 0.25, 6.0)
                tank.play(Shot((MoveMagnet("near", 5.0), turn, MoveMagnet("away", 5.0))))
                ends.append(tank.witness.truth(tank.now()).position)
        away += [np.linalg.norm(end - ends[0]) for end in ends[1:]]
    assert away[0] > 5e-4
    assert away[1] > 1.4 * away[0]


def test_a_helix_rests_while_the_coils_drive_and_the_magnet_is_away():
    with TankWorld.open(RIG, ROBOT, (0.0, 0.0, 0.0), 1) as tank:
        before = tank.witness.truth(0.0)
        tank.play(Shot((MoveMagnet("away", 3.0),)))
        heard = tank.play(Shot((Excite((10.0, 4.0), 181.0, 20), RingDown(0.02), Listen(4, 181.0))))
        after = tank.witness.truth(tank.now())
    np.testing.assert_array_equal(before.position, after.position)
    np.testing.assert_array_equal(before.orientation, after.orientation)
    assert np.ptp(heard.field, axis=1).max() > 1e-9
