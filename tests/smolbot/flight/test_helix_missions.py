"""Missions of the helical robot in the full tank: poses from signals alone, magnet and sensors kept apart, recovery."""

from __future__ import annotations

import json
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from smolbot.config.mission import load_steering_mission
from smolbot.config.rig import load_rig
from smolbot.core.pose import Pose
from smolbot.core.rotations import multiply_quaternions, quaternion_from_axes, quaternion_from_rotation_vector
from smolbot.core.shots import Listen, MoveMagnet, Rotate, Shot
from smolbot.errors import ConfigError
from smolbot.flight.preview.helix import compute_tightest_bend, preview_helix
from smolbot.flight.session import fly, run
from smolbot.flight.tracking.tracker import Tracker
from smolbot.motion import helix_kernels as kernels
from smolbot.paths.curve import Curve
from smolbot.ui.cli import app as command_line
from tests.conftest import mission_of

LINE = str(Path(__file__).parents[2] / "missions" / "flown" / "screw_line.toml")
SHORT = {"cycle.half_periods": "4"}  # how long it listens changes nothing of the way, and is quicker to check
ACROSS = quaternion_from_axes(np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), "zx")


def s_path():
    return mission_of("s_path", cycle__half_periods="4")


@cache
def helix():
    return s_path().helix_setup().helix


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    out = tmp_path_factory.mktemp("helix") / "run"
    return run(LINE, "gel_blocked", seed=2, out=out, report=False, force="preview"), out


def test_a_lump_is_got_over_by_backing_off_and_turning_slowly(flown):
    result, _ = flown
    assert result.status == "completed"
    assert result.summary["step_outs"] >= 1
    assert {"step-out", "recovered"} <= {e.what for e in result.events}
    rates = {w.frequency for c in result.cycles for w in c.shot.windows if isinstance(w, Rotate)}
    assert min(rates) < max(rates) == 0.25


def test_without_recovery_the_same_lump_ends_the_mission_with_a_reason():
    result = run(LINE, "gel_blocked", seed=2, controller__gains__tries=0, force="preview")
    assert result.status == "stuck"
    assert "stepped out" in result.stop_reason
    assert result.summary["verdict"] == "failed"
    assert result.cycles[-1].shot.listen is not None  # the magnet is away, the sensors had the last word


def test_the_magnet_is_away_and_nothing_turns_while_sensors_listen(flown):
    result, _ = flown
    near = False
    for cycle in result.cycles:
        for window in cycle.shot.windows:
            if isinstance(window, MoveMagnet):
                near = window.to == "near"
            assert not (isinstance(window, Listen) and near)
            assert not (isinstance(window, Rotate) and not near)
    assert not near


def test_axis_and_position_are_known_from_signals_and_no_pose_is_flipped(flown):
    summary = flown[0].summary
    assert summary["flips"] == 0
    assert summary["axis_error_deg"]["mean"] < 3.0
    assert summary["localization_error_mm"]["mean"] < 1.0


def test_the_folder_has_the_sampled_values_and_a_picture_of_the_run(flown):
    _, out = flown
    drawn = json.loads((out / "provenance.json").read_text())["world"]["carrier"]
    assert {"strength", "viscosity", "pitch", "magnet_place", "steering", "home"} <= set(drawn)
    assert (out / "path.png").stat().st_size > 20_000


def test_the_witness_changes_nothing():
    mission = load_steering_mission(LINE, "gel", {"controller.gains.max_turns": "2", "stop.max_duration_s": "50"})
    one, other = (fly(mission, 4, witness=w) for w in (True, False))
    assert [c.shot for c in one.cycles] == [c.shot for c in other.cycles]
    for a, b in zip(one.cycles, other.cycles, strict=True):
        if a.pose is not None:
            np.testing.assert_array_equal(a.pose.position, b.pose.position)


def test_preview_reports_go_and_counts_turns_and_pauses():
    seen = preview_helix(s_path())
    assert seen.go
    assert len(seen.turns) >= 8
    assert sum(seen.turns) * helix().advance == pytest.approx(seen.length + 7e-3, rel=0.05)
    assert seen.torque_margin.min() > 1.0
    assert seen.min_radius < seen.tightest_radius


def test_preview_refuses_a_hairpin_and_a_gel_that_holds_the_robot():
    hairpin = preview_helix(load_steering_mission(LINE, settings={"path.points_mm": "[[-6, 0], [2, 0], [-6, 0.6]]"}))
    assert any("turns with" in r for r in hairpin.reasons)
    stiff = load_steering_mission(LINE, settings={"rig.medium.yield_stress_pa": "220"})
    assert any("lose the robot" in r for r in preview_helix(stiff).reasons)


@pytest.mark.parametrize(("beside_mm", "go"), [(2.0, True), (2.5, False)])
def test_preview_refuses_a_start_from_which_the_robot_would_go_on_too_far_beside_the_path(beside_mm, go):
    """A fifth of its length, 1.5 mm, is how far it may be from the path once it is past the path's start.

    Beginning beside the path it misses the first millimetres, which is another reason not to fly.
    """
    settings = {"start.offset_mm": f"[1.0, {beside_mm}]"}
    assert not preview_helix(load_steering_mission(LINE, settings=settings)).go
    seen = preview_helix(load_steering_mission(LINE, settings={**settings, "verdict.min_visited_share": "0.5"}))
    beside = np.abs(seen.trail[1:, 1])  # the path lies on y = 0
    assert seen.trail[1, 0] > -7e-3
    assert beside.max() < 4.5e-3
    assert seen.go == go == (beside.max() < 1.5e-3)
    if not go:
        assert seen.reasons == [
            f"the robot would leave the path near ({1e3 * seen.trail[-1, 0]:.1f}, {1e3 * seen.trail[-1, 1]:.1f}) mm."
        ]


def test_the_preview_command_exits_by_its_verdict(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["smolbot", "preview", LINE, "--json"])
    with pytest.raises(SystemExit) as ended:
        command_line.main()
    assert ended.value.code == 0
    output = json.loads(capsys.readouterr().out)
    assert output["go"]
    assert output["pauses"] == len(output["turns"])


@pytest.mark.parametrize(
    ("settings", "rig", "words"),
    [
        ({"controller.law": '"predictive"'}, None, "drives robots of kind gradient; 'helical' is helical"),
        ({}, "tank", "has no [magnet]"),
        ({"rig.medium.yield_stress_pa": "0"}, None, "a helix needs a gel"),
        ({"robot": '"gradient"'}, None, "drives robots of kind helical; 'gradient' is gradient"),
    ],
)
def test_robot_law_and_rig_have_to_fit(settings, rig, words):
    with pytest.raises(ConfigError) as error:
        load_steering_mission("s_path", rig, SHORT | settings)
    assert words in str(error.value)


def test_the_blocked_rig_is_the_rig_but_for_the_lump():
    one, other = (load_rig(name).document.data for name in ("gel", "gel_blocked"))
    lump = other["tank"]["gel"].pop("inclusions")
    assert lump
    for key in ("name", "description"):
        one.pop(key), other.pop(key)
    assert one == other


def test_the_bend_of_a_circle_is_its_radius():
    angle = np.linspace(0, np.pi, 400)
    circle = Curve(8e-3 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(400)]))
    assert compute_tightest_bend(circle) == pytest.approx(8e-3, rel=0.02)


def located(time, position, roll=0.0):
    turned = multiply_quaternions(ACROSS, quaternion_from_rotation_vector(np.array([0.0, 0.0, roll])))
    return Pose(time, np.asarray(position), turned, np.diag([3e-5] * 3 + [5e-3] * 3) ** 2)


def test_a_tracked_helix_goes_with_its_turns_forgets_its_roll_and_keeps_its_place_in_the_gel():
    tracker = Tracker(helix(), s_path().robot.device, None)
    start = np.array([-3e-3, 0.0, 0.0495])
    listen = Listen(20, 181.0)
    for i in range(3):
        tracker.update(Shot((listen,), start=0.1 * i), located(0.1 * i, start))
    assert not tracker.orientation_uncertain
    shot = Shot((MoveMagnet("near", 10.0), Rotate((-1.0, 0, 0), 0.25, 4.0), MoveMagnet("away", 10.0)), start=1.0)
    tracker.update(shot, None)
    assert tracker.misses == 0
    assert tracker.pose.position[0] - start[0] == pytest.approx(4 * helix().advance, rel=0.05)
    assert tracker.orientation_uncertain  # its roll may be anything now: a fit has to start from nothing
    found = start + np.array([4.3e-3, 0.2e-3, 0.0])
    tracker.update(Shot((listen,), start=40.0), located(40.0, found, roll=2.6))
    assert tracker.misses == 0
    np.testing.assert_allclose(tracker.pose.position, found, atol=1e-4)
    before = tracker.pose_at(40.1)
    np.testing.assert_array_equal(before.position, tracker.pose_at(4000.0).position)  # a gel holds
    np.testing.assert_array_equal(before.covariance, tracker.pose_at(4000.0).covariance)


def test_a_step_out_is_no_outlier_to_the_tracker():
    tracker = Tracker(helix(), s_path().robot.device, None)
    place = np.array([-3e-3, 0.0, 0.0495])
    for i in range(3):
        tracker.update(Shot((Listen(20, 181.0),), start=0.1 * i), located(0.1 * i, place))
    shot = Shot((MoveMagnet("near", 10.0), Rotate((-1.0, 0, 0), 0.25, 6.0), MoveMagnet("away", 10.0)), start=1.0)
    tracker.update(shot, None)
    tracker.update(Shot((Listen(20, 181.0),), start=50.0), located(50.0, place, roll=-2.0))
    assert tracker.misses == 0
    np.testing.assert_allclose(tracker.pose.position, place, atol=1e-4)


@pytest.mark.parametrize("tilt", [-0.7, 0.2, 0.9])
def test_predicted_turns_forward_and_back_return_and_stay_between_the_plates(tilt):
    state = np.array([2e-3, -4e-3, 0.048, 0.3, 0.0, np.nan])
    there = kernels.advance_screw(helix().body, helix().factors, state, 0.3 + tilt, 1.0, 6.0, 0.25)
    for end in (-1, 1):
        height = there[2] + (helix().center_ahead + end * helix().half_length) * np.sin(there[4])
        assert helix().low - 1e-4 < height < helix().high + 1e-4
    under = np.array([-3e-3, 0.0, 0.0495, 0.0, 0.0, np.nan])  # on the line through the magnet nothing pulls aside
    straight = kernels.advance_screw(helix().body, np.array([1.0, 0, 0, 0]), under, 0.0, 1.0, 6.0, 0.25)
    back = kernels.advance_screw(helix().body, np.array([1.0, 0, 0, 0]), straight, 0.0, -1.0, 6.0, 0.25)
    np.testing.assert_allclose(back[:2], under[:2], atol=4e-4)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_letter_s_is_followed_in_sampled_gels(seed):
    result = run("s_path", seed=seed)
    assert result.status == "completed"
    assert result.summary["tracking_error_mm"]["rms"] < 0.7
    assert result.summary["axis_error_deg"]["mean"] < 3.0
    assert result.summary["pauses"] >= 8


@pytest.mark.slow
def test_the_blocked_letter_s_needs_recovery():
    assert run("s_path_blocked", seed=1).status == "completed"
    assert run("s_path_blocked", seed=1, controller__gains__tries=0).status == "stuck"
