"""A hand leads a device where its track says, slower in bends, with its tremor; its shaft is magnetic by pieces."""

from __future__ import annotations

import magpylib
import numpy as np
import pytest

from sim.tank.carriers.endoscope_operator import EndoscopeOperator, OperatorParameters, build_routes
from sim.tank.carriers.endoscope_shaft import EndoscopeShaft
from sim.tank.carriers.routes import SplineRoute
from sim.tank.settings import OperatorSection, TankSettings
from sim.tank.world import TankWorld
from smolbot.config.document import validate
from smolbot.config.rig import load_rig
from smolbot.config.robot import load_robot
from smolbot.core.rotations import matrix_from_quaternion
from smolbot.core.shots import Excite, Listen, Rest, RingDown, Shot

STILL = {"tremor_mm": 0.0, "tremor_deg": 0.0, "torsion_deg": 0.0, "scatter_mm": 0.0}


def section(**changes) -> OperatorSection:
    settings, faults = validate(TankSettings, load_rig("kidney").sections.tank, ("tank",))
    assert settings is not None, faults
    return settings.hand.model_copy(update=changes)


def hand(seed=1, **changes) -> EndoscopeOperator:
    kind = section(**changes)
    return EndoscopeOperator(kind, OperatorParameters.sample(kind, seed))


def test_the_tank_holds_the_device_on_its_track_at_every_time():
    rig = load_rig("kidney", {"tank.hand.rest_s": "0.3"})
    track = hand(4, rest_s=0.3)
    shot = Shot((Excite((3.0, 0.0), 103.5, 3), RingDown(0.02), Listen(6, 103.5), Rest(0.5)))
    with TankWorld.open(rig, load_robot("endoscope_tip"), (0.0, 0.0), seed=4) as tank:
        for _ in range(4):
            tank.play(Shot(shot.windows, "hold", tank.now()))
        times = np.linspace(0.0, tank.now(), 301)
        truth = [tank.witness.truth(float(t)) for t in times]
    poses = track.interpolate_poses(times)
    assert np.ptp(poses[:, 0]) > 2e-3
    np.testing.assert_allclose([p.position for p in truth], poses[:, :3], atol=2e-7)
    alike = np.abs(np.sum(np.array([p.orientation for p in truth]) * poses[:, 3:], axis=1))
    assert alike.min() > 1.0 - 1e-9


def test_another_seed_is_another_operator_and_the_same_seed_the_same():
    times = np.linspace(20.0, 40.0, 50)
    assert np.array_equal(hand(1).interpolate_poses(times), hand(1).interpolate_poses(times))
    assert np.abs(hand(1).interpolate_poses(times) - hand(2).interpolate_poses(times))[:, :3].max() > 1e-3


def test_the_tip_rests_before_and_after():
    track = hand()
    for times in (np.linspace(0.0, track.start_time, 20), np.linspace(track.end_time, track.end_time + 5.0, 20)):
        assert np.ptp(track.interpolate_poses(times), axis=0).max() < 1e-5


def test_the_shipped_track_bends_by_more_than_half_a_turn_and_comes_back():
    first, second = (np.trapezoid(bend, arc) for arc, bend in (route.bends for route in build_routes(section())))
    assert first > np.pi
    assert second > np.radians(45.0)
    track = hand(**STILL)
    ends = track.interpolate_poses(np.array([track.start_time, track.end_time]))
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-6)


def test_an_operator_keeps_to_its_speed_and_is_slower_in_bends():
    track = hand(pace_percent=0.0, **STILL)
    times = np.arange(track.start_time, track.end_time, 2e-3)
    poses = track.interpolate_poses(times)
    speed = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1) / 2e-3
    turn = 2.0 * np.arccos(np.clip(np.abs(np.sum(poses[1:, 3:] * poses[:-1, 3:], axis=1)), 0.0, 1.0)) / 2e-3
    assert speed.max() < 12e-3 * 1.01
    assert np.percentile(turn, 99) < np.radians(90.0)
    bent = turn > np.radians(30.0)
    assert speed[bent].max() < 0.8 * speed.max()


def test_tremor_is_as_large_as_requested():
    shaken, calm = hand(tremor_mm=0.2, tremor_deg=0.0), hand(tremor_mm=0.0, tremor_deg=0.0)
    times = np.arange(calm.start_time + 1.0, calm.end_time - 1.0, 1e-3)
    off = np.linalg.norm(shaken.interpolate_poses(times)[:, :3] - calm.interpolate_poses(times)[:, :3], axis=1)
    assert np.sqrt(np.mean(off**2)) == pytest.approx(0.2e-3, rel=0.05)


def test_the_tip_points_the_way_it_goes_in():
    track = hand(**STILL)
    times = np.arange(track.start_time + 1.0, track.start_time + 12.0, 0.05)
    poses = track.interpolate_poses(times)
    ahead = np.array([matrix_from_quaternion(q)[:, 2] for q in poses[:, 3:]])
    step = track.interpolate_poses(times + 1e-2)[:, :3] - track.interpolate_poses(times - 1e-2)[:, :3]
    along = np.sum(ahead * step, axis=1) / np.linalg.norm(step, axis=1)
    assert np.degrees(np.arccos(along.min())) < 1.0


def test_a_frame_does_not_roll_in_a_flat_bend():
    angle = np.linspace(0.0, np.pi, 13)
    points = 0.02 * np.stack([np.sin(angle), 1.0 - np.cos(angle), 0.0 * angle], axis=1)
    frames = SplineRoute(points, np.array([1.0, 0.0, 0.0])).interpolate_rotations(np.linspace(0.0, 0.06, 40))
    np.testing.assert_allclose(frames[:, :, 0], np.tile([0.0, 0.0, 1.0], (40, 1)), atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=1e-9)


def test_a_shaft_makes_the_field_of_thin_magnets_laid_along_it():
    track = hand(**STILL)
    shaft = EndoscopeShaft.sample(section().shaft, 3, 1.5e-3)
    points = np.array(load_rig("kidney").sensors.positions)
    places = track.compute_shaft_positions(np.array([0.0]), shaft.distances)[0]  # straight behind the entrance
    magnets = []
    strength = np.cumsum(shaft.poles)[:-1]  # pole strength between two poles, A·m
    for a, b, q in zip(places[:-1], places[1:], strength, strict=True):
        thin = magpylib.magnet.Cylinder(
            polarization=(0, 0, q / (np.pi * (1e-4) ** 2) * 4e-7 * np.pi),
            dimension=(2e-4, float(np.linalg.norm(b - a))),
        )
        turn = magpylib_turn(a - b)
        magnets.append(thin.rotate(turn).move(0.5 * (a + b)))
    wanted = magpylib.getB(magnets, points, sumup=True)
    found = shaft.compute_field(track, np.array([0.0]), points)[:, 0]
    np.testing.assert_allclose(found, wanted, atol=1e-3 * np.abs(wanted).max())


def magpylib_turn(direction):
    from scipy.spatial.transform import Rotation

    return Rotation.align_vectors([direction / np.linalg.norm(direction)], [[0.0, 0.0, 1.0]])[0]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_shaft_has_no_pole_too_many_and_the_requested_strength(seed):
    kind = section().shaft
    shaft = EndoscopeShaft.sample(kind, seed, 1.5e-3)
    assert abs(shaft.poles.sum()) < 1e-12
    size = np.linalg.norm(shaft.compute_field_at_magnet(1.5e-3))
    assert 0.6 * 45e-6 <= size <= 1.4 * 45e-6
    surface = 1e-7 * np.abs(shaft.poles[1:-1]).max() / (1.5e-3) ** 2
    assert surface <= 1.4 * 120e-6


def test_sensors_hear_the_shaft_through_their_low_pass():
    track = hand(2)
    shaft = EndoscopeShaft.sample(section().shaft, 2, 1.5e-3)
    sensors = load_rig("kidney").sensors
    rate, tau, clock = 50e3, 1.0 / (2 * np.pi * 1000.0), 25.0
    found = shaft.compute_sensor_field(track, clock, 1450, rate, tau, sensors.positions, sensors.axes)
    times = clock + np.arange(-1000, 1450) / rate
    exact = np.einsum("mni,mi->mn", shaft.compute_field(track, times, sensors.positions), sensors.axes)
    slow, keep = exact.copy(), np.exp(-1.0 / (rate * tau))
    for k in range(1, exact.shape[1]):
        slow[:, k] = keep * slow[:, k - 1] + (1.0 - keep) * exact[:, k]
    change = np.ptp(slow[:, 1000:], axis=1).max()
    assert change > 2e-10
    assert np.abs(found - slow[:, 1000:]).max() < 0.02 * change
