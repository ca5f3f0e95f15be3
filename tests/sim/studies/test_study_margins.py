"""The study of a mission's margins: what it leaves, what it refuses, gains that a mission takes."""

from __future__ import annotations

import json
import math
from functools import partial

import numpy as np
import pytest

from sim.analysis.lqr import Found
from sim.studies import margins as study
from sim.studies.command import _make_mission_options, load_study, run_study
from sim.studies.margins import STUDY, conclude, linearize_path, rebuild_cycles
from sim.studies.margins_report import format_files
from sim.studies.study import Chunk, Options
from smolbot.config.mission import load_steering_mission
from smolbot.errors import InputError
from smolbot.ui.cli.app import main
from smolbot.ui.cli.options import parse_settings

SHORT = (
    ("controller.law", "force_pursuit"),
    ("path.points_mm", "[[-2.0,0.0],[2.0,0.0]]"),
    ("start.offset_mm", "[-0.5,0.0]"),
)


def short(**changes) -> Options:
    return Options("margins", jobs=1, mission="line", settings=SHORT, **changes)


@pytest.fixture(scope="module")
def carried(tmp_path_factory):
    """The whole study of a short line, with a search of a few flights."""
    folder = tmp_path_factory.mktemp("margins") / "s"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "find_closest_gains", partial(study.find_closest_gains, most=4))
        patch.setattr(study, "_fly_reduced", lambda *_: np.zeros((0, 4)))
        outcome, path = run_study(load_study("margins"), short(), folder)
    return outcome, path


def test_the_study_writes_margins_at_every_place_and_reports_the_worst(carried):
    outcome, path = carried
    figures = json.loads((path / "study.json").read_text())
    assert {"results.csv", "margins.png", "study.json"} <= {p.name for p in path.iterdir()}
    for name in ("gain_margin_db", "phase_margin_deg", "delay_margin_ms"):
        values = np.asarray(outcome.columns[name])
        assert figures[name]["worst"] == pytest.approx(values.min())
        assert figures[name]["median"] == pytest.approx(np.median(values))
        assert figures[name]["where_mm"] == pytest.approx(outcome.columns["arc_mm"][int(np.argmin(values))])
    assert figures["places"] == len(outcome.columns["arc_mm"]) > 10
    assert {"bandwidth_hz", "settle_s", "largest_pole", "gains", "regulator", "unstable_places"} <= set(figures)
    assert np.all(np.diff(outcome.columns["arc_mm"]) >= 0.0)


def test_all_parts_together_are_the_flight_once(carried):
    outcome, _ = carried
    chunk = Chunk("path-1", linearize_path, 1, {"mission": "line", "own_rig": None, "settings": SHORT, "part": 1})
    alone = linearize_path(chunk)
    assert set(alone["cycle"] % study.PARTS) == {1}
    assert set(alone["cycle"]) <= set(outcome.columns["cycle"])
    assert len(set(outcome.columns["cycle"])) == outcome.figures["places"]
    back = rebuild_cycles(alone)
    assert [c.arc for c in back] == list(alone["arc"])
    assert back[0].feedback[1, 0] == alone["feedback_2"][0]


def test_gains_that_are_found_can_be_given_to_a_mission(carried, tmp_path):
    outcome, _ = carried
    outcome.figures["gains"] = {"lookahead_mm": 1.25, "force_un": 80.0}
    path = tmp_path / "gains.toml"
    path.write_text(format_files(outcome)["gains.toml"])
    settings = parse_settings(["controller.law=force_pursuit", f"@{path}"])
    assert dict(load_steering_mission("line", None, settings).gains) == {"lookahead_mm": 1.25, "force_un": 80.0}


def test_a_settings_file_that_cannot_be_read_is_named(tmp_path):
    bad = tmp_path / "bad.toml"
    bad.write_text("gains = [")
    for path in (bad, tmp_path / "none.toml"):
        with pytest.raises(InputError, match=f"--set @{path}: cannot be read as TOML"):
            parse_settings([f"@{path}"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["margins"], "needs a mission"),
        (["margins", "line", "--poses", "5"], "takes no --poses"),
        (["margins", "line", "--mismatch", "1"], "takes no --mismatch"),
        (["bound", "line"], "takes no MISSION 'line'"),
        (["bound", "--set", "controller.law=predictive"], "takes no --set"),
        (["margins", "line", "--weights", "0.1,10"], "three numbers above 0"),
        (["margins", "line", "--weights", "0.1,-10,1"], "got '0.1,-10,1'"),
        (["bound", "--weights", "1,1,1"], "takes no --weights"),
        (["margins", "no_such_mission"], "no_such_mission"),
        (["margins", "tests/missions/stalls.toml"], "there is no flight to analyse"),
    ],
)
def test_what_cannot_be_studied_is_one_clear_error(arguments, message, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("sys.argv", ["smolbot", "study", *arguments, "--out", str(tmp_path / "s")])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 2
    said = " ".join(capsys.readouterr().err.split())
    assert message in said
    assert "Traceback" not in said


def test_a_study_of_a_mission_resumes_with_the_same_mission_only():
    def given(mission, settings):
        return _make_mission_options(STUDY, mission, 1, 0, None, settings, {}).list_deciding()

    assert given("line", ["a=1", "b=2"]) == given("line", ["b=2", "a=1"])
    assert given("line", None) != given("r_path", None)
    assert given("line", ["a=1"]) != given("line", ["a=2"])


@pytest.mark.parametrize("passed", [{1.0: 1, 0.5: 3}, {1.0: 0, 0.5: 1, 0.25: 2}])
def test_gains_go_no_further_than_the_reduced_plant_follows(passed, monkeypatch):
    """Of three flights all pass now: the first share of the way with which no fewer pass is taken, or else the last."""
    found = Found({"lookahead_mm": 1.6}, 1.0, 0.5, (10.0, 10.0), 7)
    monkeypatch.setattr(study, "find_closest_gains", lambda model, weights: found)
    asked = []

    def flown(chunk, mission, settings):
        given = dict(settings).get("controller.gains.lookahead_mm")
        count = 3
        if given is not None:
            asked.append(float(given))
            count = list(passed.values())[len(asked) - 1]
        return np.array([[i, 0.3, 50.0, i < count] for i in range(3)], dtype=float)

    monkeypatch.setattr(study, "_fly_reduced", flown)
    arguments = {"mission": "line", "own_rig": None, "settings": SHORT, "seed": 1, "weights": None}
    columns = study.search_gains(Chunk("gains", study.search_gains, 1, arguments))
    assert asked == pytest.approx([0.8 * 2.0**share for share in passed])  # a logarithmic gain, from 0.8 to 1.6
    assert columns["_share"][0] == list(passed)[-1]
    assert columns["_values"][0] == asked[-1]


@pytest.mark.slow
def test_both_sets_of_gains_are_flown_in_the_same_worlds_of_the_reduced_plant():
    arguments = {"mission": "line", "own_rig": None, "settings": SHORT, "seed": 4, "weights": "0.1,10,0.5"}
    columns = study.search_gains(Chunk("gains", study.search_gains, 1, arguments))
    before, after = columns["_flown_before"], columns["_flown_after"]
    assert list(before[:, 0]) == [4, 5, 6]
    assert np.all(before[:, 1] < 1.0)
    assert after.shape == (before.shape if columns["_names"].size else (0, 4))


def test_a_flight_too_short_to_analyse_is_an_error():
    empty = {"_names": np.array([], dtype=np.str_), "_values": np.array([])}
    row = {"cycle": np.array([1]), "arc": np.array([0.0]), "speed": np.array([0.0]), "duration": np.array([0.1]),
           "wait": np.array([0.0]), "saturated": np.array([False])}  # fmt: skip
    row |= {f"{name}_{i}": np.zeros(1) for name, shape in study.MATRICES.items() for i in range(math.prod(shape))}
    with pytest.raises(InputError, match="less than two cycles"):
        conclude(short(), [empty, row])
