"""One bad world is one failed row of a study, with the error and its place; never the end of the study."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import smolbot
from sim.batch import flights
from sim.tuning.cost import MISSED_COST, compute_cost
from smolbot.errors import InputError, PluginError
from smolbot.flight import session

SHORT = {
    "path.points_mm": "[[-1.0, 0.0], [1.0, 0.0]]", "start.offset_mm": "[0, 0]", "localization.quiet_s": "0",
    "stop.max_duration_s": "0.5",
}  # fmt: skip
BAD_SEED = 4


@pytest.fixture
def one_bad_world(monkeypatch: pytest.MonkeyPatch) -> None:
    real = session.fly

    def fly(mission: Any, seed: int, **options: Any) -> Any:
        if seed == BAD_SEED:
            np.linalg.inv(np.zeros((2, 2)))
        return real(mission, seed, **options)

    monkeypatch.setattr(session, "fly", fly)


@pytest.mark.usefixtures("one_bad_world")
def test_one_bad_world_is_one_failed_row_with_error_and_place(tmp_path: Path) -> None:
    found = smolbot.simulate("line", range(3, 6), settings=SHORT, out=tmp_path / "study", force="preview")
    assert [flight.summary["seed"] for flight in found.flights] == [3, 4, 5]
    reasons = [flight.summary["stop_reason"] for flight in found.flights]
    assert reasons[0].startswith("max_duration_s reached")
    assert reasons[2].startswith("max_duration_s reached")
    assert reasons[1].startswith("LinAlgError: Singular matrix (test_failed_flights.py:")
    assert not found.flights[1].passed
    with (tmp_path / "study" / "results.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["status"] for row in rows] == ["timeout", "failed", "timeout"]
    assert rows[1]["stop_reason"] == reasons[1]
    assert found.figures()["errors"] == 1
    assert (tmp_path / "study" / "flights.png").is_file()


@pytest.mark.usefixtures("one_bad_world")
def test_a_study_of_bad_worlds_only_ends_with_its_rows_too(tmp_path: Path) -> None:
    found = smolbot.simulate("line", [BAD_SEED], settings=SHORT, out=tmp_path / "study", force="preview")
    assert found.passed == 0
    assert found.figures()["errors"] == 1


@pytest.mark.usefixtures("one_bad_world")
def test_a_bad_world_costs_a_tuner_as_much_as_not_to_move() -> None:
    flight = flights.fly_one("line", None, SHORT, BAD_SEED)
    assert compute_cost(flight.summary) == 2 * MISSED_COST


@pytest.mark.parametrize("error", [PluginError("the law failed"), InputError("push_n must not exceed 15")])
def test_what_would_fail_in_every_flight_still_ends_the_study(
    error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fly(*_: Any, **__: Any) -> Any:
        raise error

    monkeypatch.setattr(session, "fly", fly)
    with pytest.raises(type(error)):
        smolbot.simulate("line", [1], settings=SHORT, force="preview")


def test_a_world_whose_coils_show_no_decay_flies_with_the_missions_own_ring_down() -> None:
    settings = {**SHORT, "localization.learn_ring_down": "true", "rig.tank.faults": '["excitation_lost@now:2"]'}
    mission = smolbot.load_mission("line", settings={**settings, "localization.quiet_s": "1"})
    run = smolbot.run(mission, seed=3, force="preview")
    (event,) = [event for event in run.events if event.what == "ring-down not learned"]
    assert "no decay" in str(event.detail["reason"])


def test_lines_that_were_found_already_are_not_found_again_where_noise_is_near_zero() -> None:
    run = smolbot.run("r_path", seed=7, rig__tank__mismatch__scale=3.0, stop__max_duration_s=0.5, force="preview")
    assert run.status == "timeout"
