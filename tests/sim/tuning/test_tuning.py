"""Tuning: the search finds, repeats, resumes and gives up as it says; the verdict is on worlds that it did not see."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from pathlib import Path
from types import SimpleNamespace

import pytest

from sim.batch.executors import open_executor
from sim.batch.flights import PlantModel
from sim.tuning import search as searching
from sim.tuning.cost import MISSED_COST, REFUSED_COST, compute_cost
from sim.tuning.report import compute_importances, format_tuned_gains, write_trials
from sim.tuning.search import Problem, list_finished, open_study, run_search
from sim.tuning.verdict import FIRST_HELD_OUT, Flown, fly_held_out, is_better
from smolbot.errors import InputError
from smolbot.motion.controller import Gain

GAINS = {"push_n": Gain(5.0, 0.5, 20.0, log=True), "aim_mm": Gain(1.0, 0.1, 10.0), "idle": Gain(1.0, 0.0, 2.0)}


class Here(Executor):
    """Runs everything at once, in this process."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@pytest.fixture
def flown(monkeypatch):
    """Flights in place of real ones: best at push = 2, aim = 3, a little different in each world."""
    seeds = []

    def fly(mission, rig, settings, seed, plant):
        seeds.append((seed, plant))
        push, aim = (float(settings[f"controller.gains.{name}"]) for name in ("push_n", "aim_mm"))
        if push > 15.0:
            raise InputError("push_n must not exceed 15")
        rms = 0.2 + 0.02 * (push - 2.0) ** 2 + 0.02 * (aim - 3.0) ** 2 + 0.01 * (seed % 3)
        summary = {"status": "completed", "verdict": "passed", "duration_s": 40.0, "path_length_mm": 40.0,
                   "tracking_error_mm": {"rms": rms}}  # fmt: skip
        return SimpleNamespace(summary=summary)

    monkeypatch.setattr(searching, "fly_one", fly)
    monkeypatch.setattr("sim.tuning.verdict.fly_one", fly)
    return seeds


def problem(worlds: int = 6) -> Problem:
    start = {name: gain.default for name, gain in GAINS.items()}
    return Problem("line", None, {}, GAINS, start, range(1000, 1000 + worlds), PlantModel.REDUCED)


def found(folder: Path, trials: int, seed: int = 3, resume: bool = False):
    study = open_study(folder / "journal", seed, "search", resume=resume)
    run_search(study, problem(), trials, Here())
    return study


def test_an_unfinished_flight_costs_more_than_any_that_arrives_and_less_the_further_it_came():
    slow = {"status": "completed", "verdict": "failed", "duration_s": 1e4, "path_length_mm": 10.0,
            "tracking_error_mm": {"rms": 30.0}}  # fmt: skip
    lost = [{"status": "lost", "path_length_mm": 10.0, "progress_mm": p} for p in (0.0, 5.0, 10.0)]
    assert (
        compute_cost(slow)
        <= MISSED_COST
        == compute_cost(lost[2])
        < compute_cost(lost[1])
        < compute_cost(lost[0])
        <= REFUSED_COST
    )


def test_present_gains_are_tried_first_and_better_ones_are_found(tmp_path, flown):
    study = found(tmp_path, 60)
    first = study.trials[0]
    assert first.params == pytest.approx({name: gain.default for name, gain in GAINS.items()})
    assert study.best_value < 0.75 * first.value
    assert study.best_params["push_n"] == pytest.approx(2.0, abs=1.5)
    assert study.best_params["aim_mm"] == pytest.approx(3.0, abs=1.5)
    assert all(gain.low <= t.params[name] <= gain.high for t in study.trials for name, gain in GAINS.items())
    shares = compute_importances(study)
    assert shares["idle"] < min(shares["push_n"], shares["aim_mm"])


def test_the_same_seed_searches_alike_and_another_does_not(tmp_path, flown):
    one, two, other = (found(tmp_path / str(i), 20, seed) for i, seed in enumerate((3, 3, 4)) if not
                       (tmp_path / str(i)).mkdir())  # fmt: skip
    assert [t.params for t in one.trials] == [t.params for t in two.trials]
    assert [t.params for t in one.trials] != [t.params for t in other.trials]


def test_poor_trials_are_given_up_before_they_have_flown_every_world(tmp_path, flown):
    study = found(tmp_path, 40)
    given_up = [t for t in study.trials if t.state.name == "PRUNED"]
    assert given_up
    assert len(flown) < 40 * 6
    assert all(len(t.intermediate_values) < 2 or t.state.name == "COMPLETE" for t in study.trials)
    costs = [next(iter(t.intermediate_values.values())) for t in given_up]
    assert min(costs) > study.best_value


def test_a_killed_search_continues_and_counts_running_trials_as_failed(tmp_path, flown):
    study = open_study(tmp_path / "journal", 3, "search", resume=False)
    run_search(study, problem(), 10, Here())
    study.ask()  # killed here
    again = found(tmp_path, 25, resume=True)
    assert len(list_finished(again)) == 25
    assert [t.state.name for t in again.trials].count("FAIL") == 1
    assert [t.params for t in again.trials[:10]] == [t.params for t in study.trials[:10]]
    with pytest.raises(InputError, match="holds no search to resume"):
        open_study(tmp_path / "nowhere" / "journal", 3, "search", resume=True)
    with pytest.raises(InputError, match="holds the search 'search', not 'another'"):
        open_study(tmp_path / "journal", 3, "another", resume=True)


def test_gains_that_the_law_refuses_cost_most_and_end_nothing(tmp_path, flown):
    study = found(tmp_path, 40)
    refused = [t for t in study.trials if t.params["push_n"] > 15.0]
    assert refused
    assert all(t.value == REFUSED_COST or t.state.name == "PRUNED" for t in refused)


def test_a_mission_that_refuses_its_own_gains_is_an_error(tmp_path, flown):
    study = open_study(tmp_path / "journal", 3, "search", resume=False)
    wrong = Problem("line", None, {}, GAINS, {"push_n": 16.0, "aim_mm": 1.0, "idle": 1.0}, range(3), PlantModel.REDUCED)
    with pytest.raises(InputError, match="must not exceed 15"):
        run_search(study, wrong, 4, Here())


def test_the_verdict_is_given_in_the_full_tank_on_worlds_of_its_own(tmp_path, flown):
    before, tuned = fly_held_out(problem(), [problem().start, {"push_n": 2.0, "aim_mm": 3.0, "idle": 1.0}], 5, Here())
    assert {seed for seed, _ in flown} == set(range(FIRST_HELD_OUT, FIRST_HELD_OUT + 5))
    assert {plant for _, plant in flown} == {PlantModel.FULL}
    assert is_better(tuned, before)
    assert not is_better(before, tuned)
    assert not is_better(before, before)
    assert tuned.figures()["passed"] == 5
    text = format_tuned_gains(problem(), "law", tuned, before, 3)
    assert "[controller.gains]\npush_n = 2\naim_mm = 3\nidle = 1\n" in text


def test_gains_that_pass_less_often_are_not_better_however_cheap():
    summary = {"status": "completed", "duration_s": 40.0, "path_length_mm": 40.0}
    good = {**summary, "verdict": "passed", "tracking_error_mm": {"rms": 2.0}}
    cheap = {**summary, "verdict": "failed", "tracking_error_mm": {"rms": 0.01}}
    assert not is_better(Flown({}, [good, cheap]), Flown({}, [good, good]))


def test_every_trial_is_written_down(tmp_path, flown):
    study = found(tmp_path, 12)
    write_trials(study, tmp_path / "trials.csv")
    lines = (tmp_path / "trials.csv").read_text().splitlines()
    assert lines[0] == "trial,state,cost_mm,aim_mm,idle,push_n"
    assert len(lines) == 13


def test_a_cluster_that_does_not_answer_is_one_error(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("sim.batch.executors.CONNECT_SECONDS", 0.5)
    says = r"--scheduler tcp://127\.0\.0\.1:1: no dask scheduler answers there"
    with pytest.raises(InputError, match=says), open_executor(scheduler="tcp://127.0.0.1:1"):
        pass


def test_processes_and_a_cluster_of_two_workers_find_the_same(tmp_path):
    distributed = pytest.importorskip("distributed")
    gains = {"p_thr_mm": Gain(3.0, 1.0, 6.0)}
    settings = {"path.points_mm": "[[-1.0, 0.0], [1.5, 0.0]]", "localization.quiet_s": "2.0"}
    task = Problem("line", None, settings, gains, {"p_thr_mm": 3.0}, [7], PlantModel.REDUCED)
    costs = []
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        for number, address in enumerate((None, cluster.scheduler_address)):
            study = open_study(tmp_path / f"journal-{number}", 3, "search", resume=False)
            with open_executor(2, address) as executor:
                run_search(study, task, 2, executor)
            costs.append([t.value for t in study.trials])
    assert costs[0] == costs[1]
    assert all(c < MISSED_COST for c in costs[0])
