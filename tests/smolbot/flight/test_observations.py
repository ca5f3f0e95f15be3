"""Missions that only look: what is seen depends on signals alone, bends are followed, measurements are independent."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

from sim.tank.world import TankWorld
from smolbot.config.load import load_mission
from smolbot.config.observation import Observation
from smolbot.core.pose import Pose
from smolbot.core.rotations import quaternion_from_rotation_vector
from smolbot.core.shots import Excite, Listen, RingDown, Shot
from smolbot.errors import ConfigError
from smolbot.flight.assembly import make_loop
from smolbot.flight.session import fly, run
from smolbot.localization.localizer import Localizer
from smolbot.motion.controller import Command
from smolbot.runs.observation_summary import compute_pose_rate, compute_scatter, evaluate_observation
from smolbot.runs.run import CycleRecord
from smolbot.ui.cli import app as command_line


@pytest.fixture
def smolbot(monkeypatch, capsys, tmp_path):
    """``code, out, err = smolbot("run", "endoscope")``, in an empty directory."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["smolbot", *arguments])
        with pytest.raises(SystemExit) as ended:
            command_line.main()
        out, err = capsys.readouterr()
        return int(ended.value.code or 0), out, err

    return call


QUICK = {  # a fast motion, so that a short test covers the complete bend
    "rig.tank.hand.rest_s": "1.3",
    "rig.tank.hand.speed_mm_s": "30.0",
    "rig.tank.hand.turn_deg_s": "150.0",
    "rig.tank.hand.pace_percent": "0.0",
    "localization.quiet_s": "1.0",
    "observe.speed_mm_s": "20.0",
    "observe.turn_deg_s": "60.0",
}
SHORT = {**QUICK, "observe.duration_s": "1.0"}


@pytest.fixture(scope="module")
def bend():
    """The way into the lower calyx, round the bend."""
    settings = {**QUICK, "observe.duration_s": "8.5"}
    return fly(load_mission("endoscope", None, settings), 3, settings=settings)


@pytest.fixture(scope="module")
def marked():
    """Three measurements of a marker, with every recording that was made."""
    settings = {"observe.measurements": "3", "localization.quiet_s": "1.0"}
    mission = load_mission("brain_marker", None, settings)
    recorded = []
    with TankWorld.open(mission.rig, mission.robot, mission.start, 5) as rig:
        play = rig.play

        def listen(shot):
            recording = play(shot)
            recorded.append((shot, recording))
            return recording

        rig.play = listen
        loop = make_loop(rig, mission)
        flown = loop.fly()
    return mission, loop, flown, recorded


def test_a_bend_of_more_than_half_a_turn_is_followed_without_a_gap(bend):
    seen = [c.pose for c in bend.cycles if c.pose is not None and c.pose.trusted]
    headings = np.unwrap([np.arctan2(p.rotation[1, 2], p.rotation[0, 2]) for p in seen])
    assert np.ptp(headings) > np.pi
    assert bend.status == "completed"
    assert bend.summary["gaps"]["count"] == 0
    assert bend.summary["flips"] == 0
    assert bend.summary["pose_rate_hz"] > 8.0


@pytest.mark.parametrize("guided", [True, False])
def test_residuals_of_an_externally_guided_device_do_not_change_the_noise_model(guided):
    """A tip that moves during a recording causes residuals, which otherwise pass for noisier sensors."""
    mission = load_mission("endoscope", None, {"observe.duration_s": "10", "localization.quiet_s": "2"})
    with TankWorld.open(mission.rig, mission.robot, mission.start, 3) as rig:
        loop = make_loop(rig, mission)
        assert loop.externally_guided
        loop.guided = guided
        flown = loop.fly()
    assert flown.status == "completed"
    assert ("noise refreshed" not in {event.what for event in flown.events}) == guided


def test_excitation_turns_with_the_tip(bend):
    for cycle in bend.cycles[10:]:
        x, y = cycle.shot.excite.currents
        ahead = cycle.pose.rotation[:, 2]
        assert abs(x * ahead[0] - y * -ahead[1]) > 0.0
    mixes = np.array([np.abs(c.shot.excite.currents) for c in bend.cycles[10:]])
    share = mixes[:, 0] / mixes.sum(axis=1)
    assert share.max() > 0.9
    assert share.min() < 0.3


def test_poses_are_the_same_to_the_bit_without_a_witness():
    mission = load_mission("endoscope", None, SHORT)
    one, other = fly(mission, 2), fly(mission, 2, witness=False)
    assert "localization_error_mm" in one.summary
    assert "localization_error_mm" not in other.summary
    assert len(one.cycles) == len(other.cycles) > 8
    for a, b in zip(one.cycles, other.cycles):
        assert np.array_equal(a.pose.position, b.pose.position)
        assert np.array_equal(a.pose.orientation, b.pose.orientation)
        assert a.shot == b.shot


def test_doubling_every_mismatch_changes_the_error():
    off = []
    for scale in ("0.0", "1.0", "2.0"):
        settings = {**SHORT, "rig.tank.hand.rest_s": "30.0", "rig.tank.mismatch.scale": scale}
        flown = fly(load_mission("endoscope", None, settings), 2)
        off.append(np.array(flown.summary["localization_bias_mm"]))
        assert flown.summary["ideal"] == (scale == "0.0")
    once, twice = np.linalg.norm(off[1] - off[0]), np.linalg.norm(off[2] - off[0])
    assert once > 0.05
    assert 1.3 < twice / once < 3.0


def test_measurements_are_cold_starts_in_each_recording_alone(marked):
    mission, loop, flown, recorded = marked
    assert flown.status == "completed"
    alone = Localizer(loop.rig.sensors, mission.robot.device, loop.localizer.noise, volume=loop.localizer.volume)
    cycles = [c for c in flown.cycles if c.shot.mode == "hold"]
    assert len(cycles) == 3
    recordings = {shot.start: recording for shot, recording in recorded}
    for cycle in reversed(cycles):  # in another order: none uses the one before
        pose = alone.locate(recordings[cycle.shot.start])
        assert np.array_equal(pose.position, cycle.pose.position)
        assert np.array_equal(pose.orientation, cycle.pose.orientation)


def test_every_measurement_searches_for_its_own_excitation(marked):
    _, _, flown, _ = marked
    modes = [c.shot.mode for c in flown.cycles]
    for index, mode in enumerate(modes):
        if mode == "hold":
            assert modes[index - 1] == "search"
    searched = [c.shot.excite.currents for i, c in enumerate(flown.cycles) if i == 0 or modes[i - 1] == "hold"]
    assert set(searched) == {searched[0]}  # each begins with the first direction, whatever the last one taught


def pose(position, turn=(0.0, 0.0, 0.0), time=0.0, trusted=True) -> Pose:
    vector = np.array(turn, dtype=float)
    return Pose(time, np.array(position), quaternion_from_rotation_vector(vector), np.eye(6), 0.9, 1.0, trusted)


def test_scatter_is_the_standard_deviation_of_a_sample():
    rng = np.random.default_rng(4)
    places, turns = 1e-3 * rng.standard_normal((10, 3)), 0.01 * rng.standard_normal((10, 3))
    found = compute_scatter([pose(p, t) for p, t in zip(places, turns)])
    deviations = 1e3 * np.sqrt(np.sum((places - places.mean(axis=0)) ** 2, axis=0) / 9.0)
    assert [found["sigma_mm"][a] for a in "xyz"] == pytest.approx(deviations)
    assert found["sigma_mm"]["distance"] == pytest.approx(np.sqrt(np.sum(deviations**2)))
    assert [found["sigma_deg"][a] for a in "xyz"] == pytest.approx(np.degrees(turns.std(axis=0, ddof=1)), rel=0.02)
    assert found["mean_mm"] == pytest.approx(1e3 * places.mean(axis=0))


def test_gaps_are_runs_of_shots_that_gave_no_pose():
    cycles = []
    for number, good in enumerate("..xxx.xx.xx"):  # x: trusted
        shot = Shot((Excite((1.0, 0.0), 100.0, 1), RingDown(0.05), Listen(8, 100.0)), "track", 0.1 * number)
        seen = pose((0, 0, 0), time=shot.end - 0.02) if good == "x" else None
        cycles.append(CycleRecord(shot, seen, seen, Command(None), 0.0))
    from smolbot.runs.run import Run

    found = compute_pose_rate(Run(cycles=cycles))
    assert found["gaps"] == {"count": 2, "shots": 2, "longest_s": pytest.approx(0.2)}
    assert found["pose_rate_hz"] == pytest.approx(7 / 0.9)


def test_a_verdict_names_every_limit_that_was_missed(bend):
    settings = {**QUICK, "verdict.mean_localization_mm": "0.01", "verdict.min_rate_hz": "50.0"}
    mission = load_mission("endoscope", None, settings)
    verdict, reasons = evaluate_observation(mission, bend, bend.summary)
    assert verdict == "failed"
    assert len(reasons) == 2
    assert "exceeds 0.01 mm" in reasons[0]
    assert "fewer than 50" in reasons[1]


def test_a_run_from_the_command_line_writes_its_figures_and_fails_where_they_are_missed(smolbot, tmp_path):
    quick = ["--set", "observe.measurements=2", "--set", "localization.quiet_s=1.0"]
    strict = ["--set", "verdict.max_sigma_mm=0.0001"]
    code, out, err = smolbot(
        "run", "brain_marker", "--seed", "2", "--out", "one", "--json", "--no-report", *quick, *strict
    )
    assert code == 1
    message = json.loads(out)
    assert message["verdict_reasons"][0].startswith("sigma ")
    assert message["measurements"] == 2
    assert "in space" in err
    drawn = json.loads((tmp_path / "one" / "provenance.json").read_text())["world"]
    assert len(drawn["carrier"]["place"]["position"]) == 3
    assert (tmp_path / "one" / "path.png").stat().st_size > 20000


@pytest.mark.slow
def test_simulate_flies_every_seed_and_writes_what_an_observation_has(smolbot, tmp_path):
    quick = ["--set", "observe.measurements=2", "--set", "localization.quiet_s=1.0", "--jobs", "1"]
    code, out, _ = smolbot("simulate", "brain_marker", "--seeds", "1..2", "--out", "all", "--json", *quick)
    assert code == 0
    assert json.loads(out)["sigma_mm"]["max"] < 1.0
    lines = (tmp_path / "all" / "results.csv").read_text().splitlines()
    assert len(lines) == 3
    assert "sigma_mm" in lines[0]
    assert "tracking_rms_mm" not in lines[0]
    assert (tmp_path / "all" / "flights.png").stat().st_size > 20000


def test_preview_times_an_observation_and_refuses_one_that_is_too_slow(smolbot):
    code, out, _ = smolbot("preview", "endoscope", "--json")
    assert code == 0
    assert json.loads(out)["loop_rate_hz"] > 8.0
    code, out, _ = smolbot("preview", "endoscope", "--json", "--set", "cycle.excite_cycles=20")
    assert code == 1
    assert "min_rate_hz" in json.loads(out)["reasons"][0]


def test_a_copied_observation_can_be_carried_out_as_ones_own(smolbot, tmp_path):
    code, _, _ = smolbot("init", "own", "--mission", "brain_marker")
    assert code == 0
    assert {p.name for p in (tmp_path / "own").iterdir()} == {"brain_marker.toml", "brain.toml", "marker.toml"}
    assert isinstance(load_mission(str(tmp_path / "own" / "brain_marker.toml")), Observation)


@pytest.mark.parametrize(
    ("mission", "settings", "message"),
    [
        ("endoscope", {"controller.law": '"predictive"'}, "[observe] only looks, and [controller] steers"),
        ("endoscope", {"path.glyph": '"R"'}, "[observe] only looks, and [path] steers"),
        (
            "brain_marker",
            {"observe.measurements": "1"},
            "observe.measurements=1: input should be greater",
        ),
        ("endoscope", {"observe.measurements": "5"}, "give one of duration_s"),
        ("brain_marker", {"observe.speed_mm_s": "5.0"}, "independent measurements know of no motion"),
        ("endoscope", {"robot": '"gradient"'}, "'gradient' is of kind 'gradient', which swims"),
        ("endoscope", {"rig": '"tank"'}, "needs [tank.hand] or [tank.place]"),
        ("endoscope", {"cycle.ring_down_ms": "1.0"}, "need 5.0 ms of ring-down"),
        ("endoscope", {"rig.tank.hand.scatter_mm": "3.0"}, "lies outside the container"),
        ("endoscope", {"rig.container.size_mm": "[50, 40]"}, "tank.hand.routes"),
        ("brain_marker", {"rig.tank.place.position_mm": "[29.0, 0.0, 45.0]"}, "tank.place.position_mm"),
        ("brain_marker", {"rig.tank.hand.routes": "[]"}, "tank.hand.routes"),
        ("r_small", {"robot": '"marker"'}, "nothing moves"),
    ],
)
def test_settings_that_contradict_are_refused_before_anything_moves(mission, settings, message):
    with pytest.raises(ConfigError) as caught:
        load_mission(mission, None, settings)
    assert message in str(caught.value)


def test_a_mission_that_only_looks_cannot_be_tuned_nor_flown_on_the_reduced_plant(smolbot):
    code, _, err = smolbot("tune", "endoscope", "--trials", "2")
    assert code == 2
    assert "steers nothing" in err
    code, _, err = smolbot("simulate", "endoscope", "--seeds", "1..1", "--plant", "reduced")
    assert code == 2
    assert "of kind 'device'" in err


def test_the_same_from_a_notebook():
    flown = run("endoscope", seed=2, **{k.replace(".", "__"): v for k, v in SHORT.items() if not k.startswith("rig")})
    assert flown.summary["mission"] == "endoscope"
    assert flown.summary["run"] is None
