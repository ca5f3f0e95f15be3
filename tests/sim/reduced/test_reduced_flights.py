"""Flights of the reduced plant: repeatable, labelled, and as wrong about the pose as those of the full tank."""

from __future__ import annotations

import csv
import json
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sim.batch.flights import Flight, PlantModel, fly_seeds
from sim.batch.flights_picture import format_headline
from sim.reduced.rig import open_reduced, require_flyable
from smolbot.config.mission import load_steering_mission
from smolbot.core.rig import Rig
from smolbot.core.shots import Actuate, Excite, Listen, RingDown, Shot
from smolbot.errors import InputError, InterlockError, RigError
from smolbot.flight.session import fly
from smolbot.localization.localizer import Localizer
from smolbot.runs.folder import RunFolder
from smolbot.runs.pictures.gradient_run import format_headline as headline_of_run
from smolbot.ui.cli import app as command_line

UNITS = (("place", "mm"), ("gain", "percent"), ("axis", "deg"))
CYCLE = Shot((Actuate((8.0, 0.0, 3.0, 0.0), 0.03), Excite((6.0, 6.0), 103.5, 5), RingDown(0.02), Listen(2, 103.5)))


def told(run):
    """Everything that a flight's controller came to know and do."""
    poses = [(*c.pose.position, *c.pose.orientation) for c in run.cycles if c.pose is not None]
    return np.array(poses), [str(c.shot) for c in run.cycles], run.status


@pytest.fixture(scope="module")
def flown(line):
    return {seed: fly(line, seed, opener=open_reduced) for seed in (1, 2)}


def test_the_same_seed_is_the_same_flight_whatever_was_flown_before(line, flown):
    for seed in (2, 1):  # the other way round
        poses, shots, status = told(fly(line, seed, opener=open_reduced))
        before = told(flown[seed])
        assert np.array_equal(poses, before[0])
        assert shots == before[1]
        assert status == before[2] == "completed"
    assert told(flown[1])[1] != told(flown[2])[1]


@pytest.mark.slow
def test_the_number_of_processes_changes_nothing():
    from multiprocessing import get_context

    def figures(jobs):
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as executor:
            flights = fly_seeds(executor, "line", None, {}, [1, 2, 3], PlantModel.REDUCED)
            found = {f.summary["seed"]: (f.trail, f.value("tracking_rms_mm"), f.value("cycles")) for f in flights}
        return [found[seed] for seed in sorted(found)]

    for one, two in zip(figures(1), figures(2)):
        assert np.array_equal(one[0], two[0])
        assert one[1:] == two[1:]


def test_without_the_witness_poses_and_commands_are_the_same(line, flown):
    alone = fly(line, 1, opener=open_reduced, witness=False)
    assert np.array_equal(told(alone)[0], told(flown[1])[0])
    assert "tracking_error_mm" not in alone.summary


def test_poses_err_as_those_of_the_full_tank_with_the_same_draws(flown):
    # the reduced plant learns no sensors
    unlearned = load_steering_mission("line", settings={f"rig.sensors.{a}_tolerance_{unit}": "0" for a, unit in UNITS})
    full, reduced = fly(unlearned, 2).summary, flown[2].summary
    bias, other = np.array(full["localization_bias_mm"]), np.array(reduced["localization_bias_mm"])
    assert np.linalg.norm(bias) > 0.3
    assert np.linalg.norm(bias - other) < 0.15
    assert reduced["localization_scatter_mm"] == pytest.approx(full["localization_scatter_mm"], abs=0.05)
    assert reduced["tracked_error_mm"]["mean"] == pytest.approx(full["tracked_error_mm"]["mean"], abs=0.15)
    assert reduced["duration_s"] == pytest.approx(full["duration_s"], rel=0.3)


def test_it_keeps_the_promise_of_a_rig(line):
    rig = open_reduced(line, 1)
    assert isinstance(rig, Rig)
    assert json.dumps(rig.provenance())
    with pytest.raises(InterlockError, match="Nothing was played"):
        rig.play(Shot((Actuate((9.0, 0, 0, 0), 0.03),)))
    assert rig.now() == 0.0
    assert rig.play(Shot((Actuate((8.0, 0, 0, 0), 0.1),))) is None
    assert rig.now() == pytest.approx(0.1 + line.rig.turnaround)
    with pytest.raises(InputError, match="true pose is recorded"):
        rig.witness.truth(rig.now() + 0.01)
    rig.close()
    rig.close()
    with pytest.raises(RigError, match="closed"):
        rig.play(CYCLE)


def test_a_synthetic_recording_has_its_time_and_no_samples(line):
    rig = open_reduced(line, 1)
    poses = rig.make_synthetic_localizer(Localizer(rig.sensors, line.robot.device))
    heard = rig.play(CYCLE)
    pose, swing = poses.locate_swing(heard)
    assert heard.field.size == 0
    assert heard.clock == pytest.approx(0.03 + 5 / 103.5 + 0.02)
    assert heard.time_since_drive == pytest.approx(0.02)
    assert pose.time == pytest.approx(heard.clock + 0.5 / 103.5, abs=2e-5)
    truth = rig.witness.truth(pose.time)
    assert 0.0 < np.linalg.norm(pose.position - truth.position) < 2e-3
    assert swing.covariance[:6, :6] == pytest.approx(pose.covariance)
    again, _ = poses.locate_swing(heard)
    assert np.array_equal(again.position, pose.position)


def test_without_a_prior_either_ambiguous_orientation_is_found_with_one_the_nearer(line):
    rig = open_reduced(line, 1)
    poses = rig.make_synthetic_localizer(Localizer(rig.sensors, line.robot.device))
    found = []
    for _ in range(20):
        heard = rig.play(Shot(CYCLE.windows[1:]))  # lying still
        first, _ = poses.locate_swing(heard)
        truth = rig.witness.truth(first.time)
        w, x, y, z = truth.orientation
        twin = replace(truth, orientation=np.array([-z, y, -x, w]))
        found.append(abs(first.orientation @ truth.orientation) > 0.9)
        for prior in (truth, twin):
            assert abs(poses.locate_swing(heard, prior)[0].orientation @ prior.orientation) > 0.99
    assert 3 < sum(found) < 17


def test_what_is_hardly_driven_is_not_trusted_and_what_is_not_driven_not_located(line):
    rig = open_reduced(line, 1)
    poses = rig.make_synthetic_localizer(Localizer(rig.sensors, line.robot.device))
    faint = rig.play(Shot((Excite((0.01, 0.0), 103.5, 5), RingDown(0.02), Listen(2, 103.5))))
    with_nothing = rig.play(Shot((Listen(20, 103.5),), mode="quiet"))
    assert not poses.locate_swing(faint)[0].trusted
    with pytest.raises(InputError, match="nothing was driven"):
        poses.locate_swing(with_nothing)
    assert poses.locate_swing(rig.play(CYCLE))[0].trusted


def test_results_are_labelled_wherever_they_are_shown(flown, line, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sim.batch.executors.open_executor", lambda jobs, scheduler: ThreadPoolExecutor(1))
    arguments = ["simulate", "line", "--plant", "reduced", "--seeds", "1..2", "--out", "study", "--json",
                 "--force", "preview"]  # fmt: skip
    monkeypatch.setattr(sys, "argv", ["smolbot", *arguments])
    with pytest.raises(SystemExit) as ended:
        command_line.main()
    out, err = capsys.readouterr()
    assert ended.value.code == 0
    assert json.loads(out)["plant"] == "reduced"
    assert "reduced plant" in " ".join(err.split())
    with (tmp_path / "study" / "results.csv").open() as file:
        assert [row["plant"] for row in csv.DictReader(file)] == ["reduced", "reduced"]
    assert json.loads((tmp_path / "study" / "summary.json").read_text())["plant"] == "reduced"
    assert json.loads((tmp_path / "study" / "provenance.json").read_text())["world"]["plant"] == "reduced"
    flights = [Flight(run.summary, run.true_trail) for run in flown.values()]
    assert "reduced plant" in format_headline(line, flights)
    assert "reduced plant" in headline_of_run(line, flown[1])


def test_a_run_folder_of_the_reduced_plant_is_labelled(line, tmp_path):
    fly(line, 1, opener=open_reduced, folder=RunFolder(tmp_path / "run"))
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["plant"] == "reduced"
    assert json.loads((tmp_path / "run" / "provenance.json").read_text())["world"]["plant"] == "reduced"


def test_ring_down_is_taken_from_the_rig_file_where_there_is_none_to_learn_from(line):
    from smolbot.config.mission import load_steering_mission

    short = load_steering_mission(
        "line", settings={"localization.learn_ring_down": "true", "stop.max_duration_s": "2.0"}
    )
    run = fly(short, 1, opener=open_reduced)
    event = next(e for e in run.events if e.what == "ring-down learned")
    assert event.detail["time_constants_ms"] == pytest.approx([1.0, 1.0])
    windows = run.cycles[-1].shot.windows
    assert next(w.duration for w in windows if isinstance(w, RingDown)) < 0.02


@pytest.mark.parametrize(
    ("kind", "along", "world", "says"),
    [
        ("helix", False, "tank", "'other' is of kind 'helix'.*--plant full"),
        ("gradient", False, "tank", "across the cantilever.*--plant full"),
        ("gradient", True, "bench", "'place' is of world 'bench'"),
    ],
)
def test_what_it_cannot_fly_gets_one_clear_error(kind, along, world, says):
    robot = SimpleNamespace(kind=kind, name="other", device=SimpleNamespace(along_cantilever=along))
    with pytest.raises(InputError, match=says):
        require_flyable(SimpleNamespace(robot=robot, rig=SimpleNamespace(world=world, name="place")))
