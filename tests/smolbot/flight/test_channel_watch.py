"""A sensor that fails in flight is left out, and no pose that is wrong because of it is trusted."""

from __future__ import annotations

import json

import numpy as np
import pytest

from smolbot.config.load import load_mission
from smolbot.config.mission import load_steering_mission
from smolbot.core.pose import Pose
from smolbot.core.shots import Actuate, Listen, Rest, Shot
from smolbot.errors import SafetyError
from smolbot.flight.assembly import make_channel_watch
from smolbot.flight.session import fly, open_rig
from smolbot.flight.tracking.pose_gate import BOX_MARGIN, PoseGate, find_gross_error

SHORT = {"path.points_mm": "[[-3.0, 0.0], [3.0, 0.0]]", "localization.quiet_s": "2.0"}
MAX_ERROR = 2e-3
"""Distance, in m, from the truth beyond which a pose is wrong."""


def fly_with(*faults, rig=None, mission="line", seed=5, **settings):
    """Fly a short line with faults of the tank; return the run, and the errors (m) of its trusted poses."""
    changed = {**SHORT, **settings, "rig.tank.faults": json.dumps(faults)}
    witnesses = []

    def open_witnessed(loaded, seed):
        opened = open_rig(loaded, seed)
        witnesses.append(opened.witness)
        return opened

    run = fly(load_mission(mission, rig, changed), seed, opener=open_witnessed)
    trusted = [p for c in run.cycles for p in (c.pose, c.tracked) if p is not None and p.trusted]
    return run, [float(np.linalg.norm(p.position - witnesses[0].truth(p.time).position)) for p in trusted]


def list_events(run, what):
    return [event.detail["sensor"] for event in run.events if event.what == what]


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["sensor_gain.3=0.5@4s", "sensor_gain.7=0.8@4s", "sensor_hum.2=30nT@4s"])
def test_a_sensor_that_fails_in_flight_is_left_out_and_the_path_is_flown(fault):
    run, errors = fly_with(fault)
    assert run.status == "completed"
    assert list_events(run, "sensor left out") == [int(fault.split(".")[1][0])]
    assert max(errors) < MAX_ERROR


def test_a_sensor_with_half_its_gain_is_left_out_and_used_again_once_it_works():
    run, errors = fly_with("sensor_gain.3=0.5@4s:0.5")
    assert run.status == "completed"
    assert list_events(run, "sensor left out") == list_events(run, "sensor used again") == [3]
    assert max(errors) < MAX_ERROR


@pytest.mark.slow
def test_a_flight_in_which_nothing_fails_uses_every_sensor():
    run, _ = fly_with(seed=8)
    assert not list_events(run, "sensor left out")


def test_a_constant_sensor_ends_no_flight_in_a_tank():
    """Nor does one that is listed as broken, once the decay of coil currents is subtracted from its constant."""
    run, errors = fly_with("sensor_dead.4@4s:good", "sensor_dead.3@now:good", **{"rig.safety.broken_sensors": "[3]"})
    assert run.status == "completed"
    assert list_events(run, "sensor left out") == [4]
    assert max(errors) < MAX_ERROR


@pytest.mark.parametrize("fault", ["sensor_dead.4@4s:good", "sensor_gain.4=0.5@4s"])
def test_where_no_sensor_may_be_left_out_the_flight_ends_with_its_name(fault):
    run, errors = fly_with(fault, **{"rig.safety.may_leave_out_sensors": "false"})
    assert run.status == "failed"
    assert isinstance(run.error, SafetyError)
    assert run.error.channel == "4"
    assert "sensor 4" in run.stop_reason.lower()
    assert max(errors) < MAX_ERROR


@pytest.mark.parametrize(("rig", "allowed"), [("tank", True), ("bench", False)])
def test_a_tank_may_leave_out_a_sensor_and_a_bench_only_if_told_so(rig, allowed):
    assert load_steering_mission("line", rig).rig.may_leave_out_sensors is allowed
    told = load_steering_mission("line", rig, {"rig.safety.may_leave_out_sensors": str(not allowed).lower()})
    assert told.rig.may_leave_out_sensors is not allowed


def a_pose(x=0.0, y=0.0, z=0.06, sigma=1e-4, orientation=(1.0, 0.0, 0.0, 0.0)):
    return Pose(0.0, np.array([x, y, z]), np.array(orientation), np.diag([sigma**2] * 3 + [1e-4] * 3))


BOX = ((-0.02, -0.02, 0.045), (0.02, 0.02, 0.063))


@pytest.fixture(scope="module")
def setup():
    return load_steering_mission("line").setup()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_pose_outside_the_container_is_none(setup, axis):
    gate = PoseGate(BOX, setup.robot, setup.table)
    place = np.array([0.0, 0.0, 0.06])
    place[axis] = BOX[1][axis] + BOX_MARGIN - 1e-6
    assert not gate.find_objection(a_pose(*place), None)
    place[axis] += 2e-6
    assert "outside the container" in gate.find_objection(a_pose(*place), None)


def test_a_pose_farther_than_the_robot_can_have_moved_is_none(setup):
    gate = PoseGate(BOX, setup.robot, setup.table)
    still, pulled = Shot((Listen(2, 100.0),)), Shot((Actuate((8.0, 0.0, 0.0, 0.0), 0.05), Listen(2, 100.0)))
    gate.add_shot(still, np.array([0.0, 0.0, 0.06]))
    assert "can have moved by at most" in gate.find_objection(a_pose(x=1.5e-3), a_pose())
    assert not gate.find_objection(a_pose(x=5e-4), a_pose())  # noise of both
    gate.accept()
    for _ in range(5):
        gate.add_shot(pulled, np.array([0.0, 0.0, 0.06]))
    assert not gate.find_objection(a_pose(x=1.5e-3), a_pose())


def test_a_robot_that_was_not_seen_for_a_while_may_be_farther_away(setup):
    gate = PoseGate(BOX, setup.robot, setup.table)
    far = a_pose(x=4e-3)
    assert gate.find_objection(far, a_pose())
    gate.add_shot(Shot((Rest(2.0),)), None)
    assert not gate.find_objection(far, a_pose())


def test_a_pose_turned_the_wrong_way_round_is_a_gross_error_unless_no_sensor_can_tell():
    flipped = a_pose(orientation=(0.0, 0.0, 0.0, 1.0))  # half a turn about the cantilever
    assert "180°" in find_gross_error(flipped, a_pose(), along_cantilever=False)
    assert not find_gross_error(flipped, a_pose(), along_cantilever=True)
    assert not find_gross_error(a_pose(x=1e-3), a_pose(), along_cantilever=False)


def test_a_device_that_a_hand_guides_is_not_checked_against_its_motion():
    watch = make_channel_watch(load_mission("endoscope"))
    assert not watch.checks_signals
    assert make_channel_watch(load_mission("line")).checks_signals
