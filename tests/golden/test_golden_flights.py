"""Golden flights: what was answered once is answered again, to the last bit; or ``CHANGES.md`` says why not."""

from __future__ import annotations

import lzma
import shutil
from pathlib import Path

import numpy as np
import pytest

from smolbot.flight.replay import replay
from smolbot.runs.recording.reader import read_run
from tests.golden import answers, corpus, foreign
from tests.golden.answers import GoldenFileError, as_answers, compare, load, machine
from tests.golden.corpus import EXPECTED, HERE, LIMIT, RECORDS, SIGNALS, digest, read_reports, unpacked, windows
from tests.golden.flights import MAKERS, REPLAYS
from tests.golden.renew import renew

ANEW = 'If that is meant: python -m tests.golden.renew {name} --why "…"'


@pytest.mark.parametrize("name", MAKERS)
def test_a_golden_answer_is_given_again(name):
    made_on, expected = load(EXPECTED / f"{name}.json.xz")
    difference = compare(expected, MAKERS[name]())
    assert difference is None or difference.allowed(made_on == machine()), (
        f"{name}: {difference}. {ANEW.format(name=name)}"
    )


@pytest.mark.parametrize("name", MAKERS)
def test_every_change_of_an_answer_is_reported(name):
    last = read_reports().get(name)
    assert last == digest(EXPECTED / f"{name}.json.xz"), (
        f"expected/{name}.json.xz is not the one that CHANGES.md tells of ({last}). {ANEW.format(name=name)}"
    )


def test_recordings_are_never_made_anew():
    files = [*RECORDS.iterdir(), *SIGNALS.iterdir()]
    assert {p.relative_to(HERE).as_posix(): digest(p) for p in files} == windows()


def test_no_answer_stands_without_its_flight():
    assert sorted(p.name for p in EXPECTED.iterdir()) == sorted(f"{name}.json.xz" for name in MAKERS)
    assert {record for record, _ in REPLAYS.values()} == {p.name.split(".")[0] for p in RECORDS.iterdir()}


def test_the_corpus_stays_small():
    assert sum(p.stat().st_size for p in HERE.rglob("*.xz")) < LIMIT


@pytest.mark.parametrize("name", sorted({record for record, _ in REPLAYS.values()}))
def test_a_record_of_version_0_1_stays_readable(name):
    with unpacked(RECORDS / f"{name}.mcap.xz") as path:
        record = read_run(path)
        assert record.whole
        assert (record.dropped, record.lost, record.nameless) == (0, 0, 0)
        assert record.provenance["smolbot"] == "0.1.0"
        assert record.run().status == "completed"
        assert record.knows_truth
        assert len(list(record.recordings())) > 10
        assert record.mission().robot.device.frequency > 100.0


def test_a_replay_of_a_golden_record_gives_the_poses_of_the_flight():
    with unpacked(RECORDS / "brain_marker.mcap.xz") as path:
        again = replay(path)
        recorded = [{"pose": m.cycle.pose, "tracked": m.cycle.tracked} for m in again.record.moments]
        found = [{"pose": c.pose, "tracked": c.tracked} for c in again.cycles]
    difference = compare(as_answers(recorded), as_answers(found))
    assert difference is None or difference.allowed(same_machine=False), difference


@pytest.mark.parametrize("estimator", ["whitened", "paper"])
def test_poses_in_foreign_signals_are_where_the_foreign_magnet_was(estimator):
    _, expected = load(EXPECTED / f"foreign_{estimator}.json.xz")
    signals = foreign.read()
    off = []
    for key in foreign.keys(signals):
        cold = expected[key]["cold"]
        covariance = np.zeros((6, 6))
        covariance[np.triu_indices(6)] = cold["covariance"]
        error = np.array(cold["position"]) - signals[f"{key}_position"]
        upper = covariance[:3, :3]
        off.append(error @ np.linalg.solve(upper + upper.T - np.diag(np.diag(upper)), error))
        assert estimator == "paper" or cold["trusted"], key
    assert max(off) < 16.0  # of three degrees of freedom: 1 in 1000 lies above
    assert np.mean(off) < 6.0


# The guard itself


def moved(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the corpus's answers and changes, in which one may write."""
    shutil.copytree(EXPECTED, tmp_path / "expected")
    shutil.copy(corpus.CHANGES, tmp_path / "CHANGES.md")
    for module in (corpus, __import__("tests.golden.renew", fromlist=["EXPECTED"])):
        monkeypatch.setattr(module, "EXPECTED", tmp_path / "expected", raising=False)
    monkeypatch.setattr(corpus, "CHANGES", tmp_path / "CHANGES.md")
    return tmp_path / "expected" / f"{name}.json.xz"


def test_answers_made_anew_are_reported_with_their_size(tmp_path, monkeypatch, capsys):
    path = moved("foreign_paper", tmp_path, monkeypatch)
    _, before = load(path)
    other = as_answers(before)
    other["w2_1.1_z_0"]["cold"]["position"][0] += 2e-6
    monkeypatch.setitem(MAKERS, "foreign_paper", lambda: other)
    assert renew(["foreign_paper"], "a better filter") == 1
    row = (tmp_path / "CHANGES.md").read_text().splitlines()[-1]
    assert "2e-06 m" in row
    assert "a better filter" in row
    assert corpus.read_reports()["foreign_paper"] == digest(path)
    assert renew(["foreign_paper"], "nothing new") == 0
    assert ".cold.position[0]" in capsys.readouterr().out


@pytest.mark.parametrize("why", ["", "  ", "a | b", "two\nlines"])
def test_no_answer_is_made_anew_without_a_reason(why, tmp_path, monkeypatch):
    moved("foreign_paper", tmp_path, monkeypatch)
    with pytest.raises(GoldenFileError, match="say why"):
        corpus.tell("foreign_paper", why, "1 m")


def test_recordings_are_not_made_a_second_time():
    with pytest.raises(GoldenFileError, match="never made anew"):
        corpus.add_windows(RECORDS / "line.mcap.xz", b"")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is torn"),
        (b"no xz at all", "is torn"),
        (lzma.compress(b"{"), "is torn"),
        (lzma.compress(b'{"format": 99}'), "is of format 99; these tests read 1"),
        (lzma.compress(b"[]"), "is of format None"),
        (None, "is missing"),
    ],
)
def test_a_file_of_answers_that_cannot_be_used_says_what_to_do(content, says, tmp_path):
    path = tmp_path / "line.json.xz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(GoldenFileError, match=says) as told:
        load(path)
    assert "git checkout" in str(told.value)
    assert str(path) in str(told.value)


def test_a_torn_record_says_what_to_do(tmp_path):
    path = tmp_path / "line.mcap.xz"
    path.write_bytes((RECORDS / "line.mcap.xz").read_bytes()[:-100])
    with pytest.raises(GoldenFileError, match="take it from version control"), unpacked(path):
        pass


def test_differences_are_sized_in_their_unit_and_judged_by_the_machine():
    was = {"pose": {"position": [0.0, 1.0], "covariance": [4.0, *[0.0] * 20]}, "currents": [8.0] * 10, "note": "a"}
    now = as_answers(was)
    assert compare(was, now) is None
    now["pose"]["position"][0] = 0.5e-9
    small = compare(was, now)
    assert small.most == {"m": 0.5e-9}
    assert small.allowed(same_machine=False)
    assert not small.allowed(same_machine=True)
    now["currents"][0] += 5e-7  # one fit of many may end one step sooner
    assert compare(was, now).allowed(same_machine=False)
    now["currents"] = [8.0 + 5e-7] * 10
    assert not compare(was, now).allowed(same_machine=False)
    now["currents"] = [8.0 + 5e-6] + [8.0] * 9
    assert not compare(was, now).allowed(same_machine=False)
    for other in ({**was, "note": "b"}, {**was, "more": 1}, {"pose": was["pose"]}, {**was, "currents": []}):
        assert not compare(was, other).allowed(same_machine=False)
    assert answers.ELSEWHERE["m"] == 1e-9
