"""The study of preview against flights: the worlds that it draws, and how it counts."""

from __future__ import annotations

import numpy as np
import pytest

from sim.studies import agreement
from sim.studies.agreement import conclude, make_chunks, run_chunk
from sim.studies.drawn_rigs import FILES, write_drawn_world
from sim.studies.study import Options
from smolbot.config.rig import load_rig
from smolbot.config.robot import load_robot
from smolbot.errors import InputError


def read_all(folder):
    return {name: (folder / name).read_text() for name in FILES if (folder / name).is_file()}


def draw(folder, seed, number):
    folder.mkdir()
    write_drawn_world(folder, seed, number)
    return read_all(folder)


def test_a_number_is_one_world_and_no_two_seeds_share_one(tmp_path):
    first = draw(tmp_path / "a", 1, 7)
    assert draw(tmp_path / "b", 1, 7) == first
    assert draw(tmp_path / "c", 2, 7)["rig.toml"] != first["rig.toml"]
    assert draw(tmp_path / "d", 1, 8)["rig.toml"] != first["rig.toml"]


@pytest.mark.parametrize("number", range(12))
def test_the_files_of_a_world_are_read_and_its_coils_stand_outside_the_container(tmp_path, number):
    drawn = write_drawn_world(tmp_path, 3, number)
    rig, robot = load_rig(str(tmp_path / "rig.toml")), load_robot(str(tmp_path / "robot.toml"))
    assert (len(rig.coil_names), len(rig.sensors)) == (drawn["coils"], drawn["sensors"])
    assert robot.device.along_cantilever != drawn["across"]
    corner = np.linalg.norm(rig.container.size) / 2.0
    for coil in rig.sections.coils:
        assert np.linalg.norm(coil.center[:2]) - coil.length / 2.0 > corner


def columns_of(cases):
    """Columns of worlds from (refused, go, passed) each."""
    refused, go, passed = (np.array(column) for column in zip(*cases, strict=True))
    texts = np.array([""] * len(cases))
    return {
        "world": np.arange(len(cases)), "refused": refused, "go": go, "passed": passed, "reason": texts,
        "ended_by": texts,
    }  # fmt: skip


def test_every_disagreement_is_counted_and_listed():
    cases = [(False, True, True)] * 3 + [(False, True, False), (False, False, True), (True, False, False)]
    found = conclude(Options("agreement"), [columns_of(cases)]).figures
    assert (found["go_passed"], found["go_failed"], found["no_go_passed"], found["no_go_failed"]) == (3, 1, 1, 0)
    assert found["refused"] == 1
    assert found["no_go_passed_share"] == 0.5
    assert [wrong["world"] for wrong in found["wrong"]] == [3, 4]


def test_a_world_that_cannot_be_flown_is_a_failed_row_that_names_its_error(monkeypatch):
    def fail(*_, **__):
        raise InputError("nobody is at home.")

    monkeypatch.setattr("smolbot.config.load.load_mission", lambda path: object())
    monkeypatch.setattr("smolbot.flight.preview.gradient.preview", fail)
    (chunk,) = make_chunks(Options("agreement", seed=5, poses=1))
    row = run_chunk(chunk)
    assert row["status"][0] == "error"
    assert row["ended_by"][0] == "InputError: nobody is at home."
    assert not row["passed"][0]


def test_a_file_that_is_refused_is_not_flown(monkeypatch):
    monkeypatch.setattr(agreement, "write_drawn_world", write_broken)
    (chunk,) = make_chunks(Options("agreement", seed=5, poses=1))
    row = run_chunk(chunk)
    assert row["refused"][0]
    assert "no_such_rig" in row["reason"][0]


def write_broken(folder, seed, number):
    drawn = write_drawn_world(folder, seed, number)
    path = folder / "mission.toml"
    path.write_text(path.read_text().replace("rig.toml", "no_such_rig.toml"))
    return drawn
