"""Small versions of the studies: what they promise, not what they print."""

from __future__ import annotations

import json
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from sim.studies import accuracy, bound, cold, damping, depth, precision
from sim.studies.benches import (
    make_characterised_device,
    make_localizers,
    make_pose_row,
    make_reference_orientation,
    open_bench,
)
from sim.studies.columns import join_columns, select_rows
from sim.studies.command import load_study, run_study
from sim.studies.running import StudyFolder, run_chunks
from sim.studies.study import Chunk, Options, cut_chunks
from smolbot.config.plugins import list_plugins
from smolbot.core.pose import Pose
from smolbot.errors import InputError, PluginError


def draws(chunk: Chunk):
    return {
        "value": np.random.default_rng(chunk.seed).standard_normal(chunk["n"]),
        "kind": np.array(["a"] * chunk["n"]),
    }


def fails(chunk: Chunk):
    raise RuntimeError("killed")


def pieces(seed=1, work=draws):
    return cut_chunks(Options("draws", seed), work, [(f"p{i}", {"n": 3}) for i in range(5)])


def small(name, **changes):
    return replace(Options(name, seed=2, jobs=1, poses=2), **changes)


def test_the_number_of_workers_does_not_change_a_result():
    alone = join_columns(run_chunks(pieces()))
    with ThreadPoolExecutor(3) as executor:
        together = join_columns(run_chunks(pieces(), None, executor))
    assert np.array_equal(alone["value"], together["value"])
    assert not np.array_equal(alone["value"], join_columns(run_chunks(pieces(seed=2)))["value"])


def test_more_chunks_leave_the_first_ones_as_they_were():
    few, many = (cut_chunks(Options("draws", 1), draws, [(f"p{i}", {"n": 1}) for i in range(n)]) for n in (3, 9))
    assert [c.seed for c in few] == [c.seed for c in many[:3]]
    assert len({c.seed for c in many}) == 9


def test_a_killed_study_continues_where_it_was(tmp_path):
    asked = Options("draws").list_deciding()
    broken = [*pieces()[:3], *pieces(work=fails)[3:]]
    with pytest.raises(PluginError, match="RuntimeError: killed"):
        run_chunks(broken, StudyFolder(tmp_path / "s", asked))
    folder = StudyFolder(tmp_path / "s", asked, resume=True)
    assert [folder.load(f"p{i}") is not None for i in range(5)] == [True] * 3 + [False] * 2
    told = []
    resumed = run_chunks([*pieces(work=fails)[:3], *pieces()[3:]], folder, None, lambda done, total: told.append(done))
    assert np.array_equal(join_columns(resumed)["value"], join_columns(run_chunks(pieces()))["value"])
    assert told == [3, 4, 5]


def test_a_folder_of_another_study_is_not_resumed_nor_overwritten(tmp_path):
    StudyFolder(tmp_path / "s", Options("bound", seed=1).list_deciding())
    with pytest.raises(InputError, match="not empty"):
        StudyFolder(tmp_path / "s", Options("bound", seed=1).list_deciding())
    with pytest.raises(InputError, match="seed was 1, is 2"):
        StudyFolder(tmp_path / "s", Options("bound", seed=2).list_deciding(), resume=True)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="no study"):
        StudyFolder(tmp_path / "other", Options("bound").list_deciding(), resume=True)


def test_a_half_written_chunk_is_run_again(tmp_path):
    folder = StudyFolder(tmp_path / "s", {})
    folder.save("p0", {"value": np.arange(3.0)})
    target = folder.path / "chunks" / "p0.npz"
    target.write_bytes(target.read_bytes()[:40])
    assert folder.load("p0") is None


def test_an_unknown_study_is_named_with_those_there_are():
    with pytest.raises(InputError, match=r"acuracy.*bound.*Did you mean accuracy\?"):
        load_study("acuracy")


def test_the_help_names_every_study():
    from typer.testing import CliRunner

    from sim.studies.command import app

    text = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "200"}).output
    assert all(name in text for name in list_plugins("studies"))


def test_nees_of_errors_sampled_from_the_covariance_averages_six():
    rng = np.random.default_rng(0)
    root = np.diag([1e-4, 2e-4, 5e-4, 1e-2, 2e-2, 1e-2]) @ (np.eye(6) + 0.3 * np.tri(6, k=-1))
    truth, turn = np.array([0, 0, 0.08]), np.array([1.0, 0, 0, 0])
    from smolbot.core.rotations import quaternion_from_rotation_vector

    nees = []
    for _ in range(600):
        error = root @ rng.standard_normal(6)
        pose = Pose(0.0, truth + error[:3], quaternion_from_rotation_vector(error[3:]), root @ root.T)
        nees.append(make_pose_row(pose, truth, turn)["nees"])
    assert np.mean(nees) == pytest.approx(6.0, rel=0.08)


@pytest.fixture(scope="module")
def bounded(tmp_path_factory):
    options = Options("bound", seed=4, jobs=1, poses=60, mismatch=0.0)
    return run_study(bound.STUDY, options, tmp_path_factory.mktemp("studies") / "bound")


def test_no_estimator_beats_the_bound_by_more_than_chance_and_the_whitened_one_reaches_it(bounded):
    for case in bounded[0].figures["cases"]:
        assert case["over_bound"] > 1.0 - 4.0 * case["over_bound_std"]
        if case["estimator"] == "whitened":
            assert case["over_bound"] < 1.15 + 4.0 * case["over_bound_std"]


def test_covariances_of_the_whitened_estimator_are_honest(bounded):
    for case in bounded[0].figures["cases"]:
        if case["estimator"] == "whitened":
            assert case["nees_over_6"] == pytest.approx(1.0, abs=5.0 * case["nees_over_6_std"])


def test_a_study_leaves_its_table_its_figure_and_what_it_was(bounded):
    outcome, folder = bounded
    described = json.loads((folder / "study.json").read_text())
    assert described["seed"] == 4
    assert len(described["layout"]["positions_mm"]) == 10
    assert described["devices"]["characterised"]["frequency_hz"] == 103.5
    assert described["noise"]["mains_nt"] > 0
    assert "versions" in described
    assert (folder / "bound.png").stat().st_size > 20_000
    lines = (folder / "results.csv").read_text().splitlines()
    assert len(lines) == 1 + len(outcome.columns["nees"]) == 1 + 60 * 4 * 2  # every pose, trusted or not


def test_accuracy_of_a_stage_reads_moves_along_and_about_the_right_axes():
    for axis in accuracy.AXES:
        for step in accuracy.list_steps(axis, accuracy.WIDE):
            pose = Pose(0.0, *accuracy.displace_pose(axis, float(step)), np.eye(6))
            assert np.angle(np.exp(1j * (accuracy.measure_displacement(axis, pose) - step))) == pytest.approx(
                0.0, abs=1e-9
            )
        spans = np.ptp(accuracy.list_steps(axis, accuracy.WIDE)), np.ptp(accuracy.list_steps(axis, accuracy.FINE))
        expected = (0.05, 0.001) if len(axis) == 1 else (math.radians(340), math.radians(5))
        assert spans == pytest.approx(expected)


def test_poses_not_trusted_are_counted_and_kept():
    options = small("cold", mismatch=0.0, poses=4, estimators=("whitened",))
    parts = [p.work(p) for p in cold.make_chunks(options)]
    parts[0]["trusted"][1] = 0.0
    outcome = cold.conclude(options, parts)
    assert outcome.figures["cases"][0]["untrusted"] >= 1
    assert len(outcome.columns["nees"]) == 4


def test_depth_is_where_the_scatter_first_passes_the_limit():
    heights = np.array([80.0, 100.0, 120.0])
    assert depth.find_crossing(heights, np.array([0.1, 0.5, 2.0])) == pytest.approx(110.0)
    assert math.isnan(depth.find_crossing(heights, np.array([0.1, 0.2, 0.3])))
    assert depth.make_device("characterised", depth.EDGE_MM).moment == pytest.approx(0.89e-3)
    assert depth.make_device("characterised", 2 * depth.EDGE_MM).moment == pytest.approx(8 * 0.89e-3)


def test_rates_are_those_of_the_timeline():
    assert precision.compute_rate(2) == pytest.approx(1.0 / (5 / 103.5 + 0.02 + 2 / 207.0))


def test_damping_costs_precision_and_the_trend_shows_it(monkeypatch):
    monkeypatch.setattr(damping, "DAMPINGS", (0.0, 40.0))
    monkeypatch.setattr(damping, "HALF_PERIODS", (2,))
    options = small("damping", poses=16, estimators=("whitened",))
    outcome = damping.conclude(options, run_chunks(damping.make_chunks(options)))
    assert all(trend["slope_um_s"] > 0 for trend in outcome.figures["trends"])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["accuracy", "precision", "damping", "depth", "cold", "speed"])
def test_every_study_runs_and_draws(name, tmp_path):
    study = load_study(name)
    outcome, folder = run_study(study, Options(name, 3, 2, 4, estimators=study.estimators), tmp_path / name)
    assert (folder / f"{name}.png").exists()
    assert json.loads((folder / "study.json").read_text())["study"] == name
    assert outcome.rows


@pytest.mark.slow
def test_whitened_poses_reach_the_bound_and_are_honest_over_a_thousand(tmp_path):
    outcome, _ = run_study(bound.STUDY, Options("bound", 11, 2, 1000, mismatch=0.0), tmp_path / "bound")
    for case in outcome.figures["cases"]:
        if case["estimator"] == "whitened":
            assert 0.95 < case["over_bound"] < 1.05
            assert 0.9 < case["nees_over_6"] < 1.1
            assert case["flipped"] == 0


@pytest.mark.slow
def test_mismatches_cost_accuracy_and_a_calibration_wins_most_of_it_back(tmp_path):
    options = Options("accuracy", 5, 2, 4, mismatch=2.0, estimators=("whitened",))
    outcome, _ = run_study(accuracy.STUDY, options, tmp_path / "accuracy")
    mae = {c["kind"]: c["mae_position_mm"] for c in outcome.figures["cases"] if c["span"] == accuracy.WIDE}
    assert max(mae["ideal"], mae["calibrated"]) < 0.6 * mae["mismatched"]


def test_a_constant_in_a_channel_changes_no_pose():
    chunk = Chunk("c", draws, 9, {"rig": "tank"})
    bench = open_bench(chunk, make_characterised_device(), 0.0)
    place, turn = np.array([0.0, 0.0, 0.08]), make_reference_orientation()
    recording = bench.record(place, turn, 2)
    prior = Pose(0.0, place, turn, np.eye(6) * 1e-6)
    shifted = replace(recording, field=recording.field + 1e-6 * np.eye(10)[3][:, None])
    for localizer in make_localizers(bench, ("whitened", "paper"), quiet=2.0).values():
        a, b = localizer.locate(recording, prior), localizer.locate(shifted, prior)
        assert b.position == pytest.approx(a.position, abs=1e-9)


def test_rows_are_chosen_by_value():
    columns = {"n": np.array([1, 2, 1]), "name": np.array(["a", "a", "b"])}
    assert len(select_rows(columns, n=1, name="a")["n"]) == 1
