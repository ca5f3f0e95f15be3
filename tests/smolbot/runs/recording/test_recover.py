"""Recovering a run: whatever a kill left becomes a whole folder again, nothing is lost by it, and twice is once."""

from __future__ import annotations

import csv
import json
import os
import random

import mcap.reader
import pytest

from smolbot.errors import InputError, SmolbotError
from smolbot.runs.recording.reader import CUT_SHORT, read_run
from smolbot.runs.recording.recorder import McapFile
from smolbot.runs.recover import recover

LEFT = ("summary.json", "path.png", "cycles.csv", "provenance.json", "mission.toml", "rig.toml", "robot.toml")


def cut(folder, share):
    record = folder / "run.mcap"
    data = record.read_bytes()
    record.write_bytes(data[: int(share * len(data))])
    return record.read_bytes()


def contents(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir()}


def test_a_whole_run_needs_nothing_and_is_left_as_it_is(copied):
    before = contents(copied)
    done = recover(copied)
    assert not done.needed
    assert contents(copied) == before


@pytest.mark.parametrize("share", [0.5, 0.9, 0.9999])
def test_a_torn_record_becomes_a_whole_one_that_says_the_same(copied, share, same_cycle):
    torn = cut(copied, share)
    for name in LEFT:
        (copied / name).unlink()
    before = read_run(copied)
    done = recover(copied)
    assert done.needed
    assert (copied / "run.torn.mcap").read_bytes() == torn
    after = read_run(copied)
    assert after.whole
    a, b = after.run(), before.run()
    assert all(same_cycle(x, y) for x, y in zip(a.cycles, b.cycles, strict=True))
    assert (a.status, a.stop_reason, a.duration, a.begun) == (b.status, b.stop_reason, b.duration, b.begun)
    assert [p.samples for p in after.played] == [p.samples for p in before.played]
    assert after.lost == 0
    assert after.recovered.lost_bytes == before.lost > 0
    with (copied / "run.mcap").open("rb") as file:
        assert mcap.reader.make_reader(file, validate_crcs=True).get_summary().chunk_indexes
    summary = json.loads((copied / "summary.json").read_text())
    assert summary["cycles"] == len(before.moments)
    assert summary["verdict"] == ("failed" if before.end is None else "passed")
    if before.end is None:
        assert (summary["status"], summary["stop_reason"]) == ("failed", CUT_SHORT)
    assert not [p for p in copied.iterdir() if ".part" in p.name]


def test_files_that_are_missing_are_made_as_the_flight_had_made_them(copied):
    before = contents(copied)
    for name in LEFT:
        (copied / name).unlink()
    done = recover(copied)
    assert set(done.written) == set(LEFT)
    assert done.torn is None
    after = contents(copied)
    for name in set(LEFT) - {"summary.json", "path.png"}:
        assert after[name] == before[name], name
    old, new = (json.loads(c["summary.json"]) for c in (before, after))
    assert old.keys() == new.keys()
    assert {k for k in old if old[k] != new[k]} <= {"recording", "run"}


def test_twice_is_once(copied):
    cut(copied, 0.8)
    (copied / "summary.json").unlink()
    recover(copied)
    before = contents(copied)
    assert not recover(copied).needed
    assert contents(copied) == before


@pytest.mark.parametrize("torn", [b"", b'{"status": "comp'])
def test_a_summary_that_was_being_written_is_made_again(copied, torn):
    before = json.loads((copied / "summary.json").read_text())
    (copied / "summary.json").write_bytes(torn)
    (copied / "path.png").write_bytes((copied / "path.png").read_bytes()[:-10])
    done = recover(copied)
    assert set(done.written) == {"summary.json", "path.png"}
    assert json.loads((copied / "summary.json").read_text())["verdict"] == before["verdict"] == "passed"


def test_cycles_that_the_record_lacks_are_kept_and_told(recorded, copied):
    cut(copied, 0.9)
    before = (copied / "cycles.csv").read_bytes()
    done = recover(copied)
    assert (copied / "cycles.csv").read_bytes() == before
    assert done.cycles_not_recorded == len(recorded[0].cycles) - len(done.found.moments)


@pytest.mark.parametrize("where", [b"zstd", b"/timing"], ids=["in a chunk", "in the index"])
def test_a_damaged_record_keeps_how_the_run_ended(copied, where):
    data = bytearray((copied / "run.mcap").read_bytes())
    data[data.rfind(where) - 1000 * (where == b"zstd")] ^= 0x10
    (copied / "run.mcap").write_bytes(data)
    before = read_run(copied)
    assert before.end is not None
    assert not before.whole
    recover(copied)
    after = read_run(copied)
    assert after.recovered.ended
    assert after.whole
    assert after.run().status == "completed"
    assert len(after.moments) == len(before.moments) > 0


def test_a_second_torn_record_does_not_replace_the_first(copied):
    first = cut(copied, 0.9)
    recover(copied)
    second = cut(copied, 0.95)
    recover(copied)
    assert (copied / "run.torn.mcap").read_bytes() == first
    assert (copied / "run.torn-2.mcap").read_bytes() == second


def test_a_recovery_that_was_itself_cut_short_is_taken_up(copied):
    cut(copied, 0.9)
    (copied / "run.mcap").rename(copied / "run.torn.mcap")  # as between two renames, where links are not to be had
    (copied / "run.mcap.part").write_bytes(b"half")
    recover(copied)
    assert read_run(copied).whole
    assert not (copied / "run.mcap.part").exists()


def test_a_recovery_that_ended_between_keeping_and_replacing_is_taken_up(copied):
    torn = cut(copied, 0.9)
    os.link(copied / "run.mcap", copied / "run.torn.mcap")
    recover(copied)
    assert read_run(copied).whole
    assert sorted(p.name for p in copied.glob("*.mcap")) == ["run.mcap", "run.torn.mcap"]
    assert (copied / "run.torn.mcap").read_bytes() == torn


def test_a_torn_record_does_not_take_the_place_of_one_that_is_there(copied):
    before = (copied / "run.mcap").read_bytes()
    (copied / "run.torn.mcap").write_bytes(before[:-9])
    with pytest.raises(InputError, match="stands beside it"):
        recover(copied / "run.torn.mcap")
    assert (copied / "run.mcap").read_bytes() == before


def test_a_record_that_was_copied_elsewhere_is_recovered_alone(copied, tmp_path):
    cut(copied, 0.9)
    own = tmp_path / "downloads"
    own.mkdir()
    (copied / "run.mcap").rename(own / "tuesday.mcap")
    done = recover(own / "tuesday.mcap")
    assert read_run(own / "tuesday.mcap").whole
    assert sorted(p.name for p in own.iterdir()) == ["tuesday.mcap", "tuesday.torn.mcap"]
    assert not recover(own / "tuesday.mcap").needed
    assert done.written == []


def test_a_run_that_goes_on_is_not_touched(copied):
    (copied / "run.mcap").rename(copied / "old.mcap")
    writing = McapFile(copied / "run.mcap")
    before = contents(copied)
    with pytest.raises(InputError, match="the run goes on"):
        recover(copied)
    assert contents(copied) == before
    writing.close()


def test_where_nothing_can_be_written_the_old_record_stays(copied, monkeypatch):
    torn = cut(copied, 0.9)

    def refuse(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(InputError, match="No space left"):
        recover(copied)
    assert (copied / "run.mcap").read_bytes() == torn
    assert not (copied / "run.torn.mcap").exists()


def test_a_mission_that_cannot_be_loaded_here_still_gets_its_record(copied, monkeypatch):
    cut(copied, 0.9)
    (copied / "summary.json").unlink()

    def refuse(*_):
        raise SmolbotError("controller 'own' is not installed")

    monkeypatch.setattr("smolbot.runs.recording.reader.RecordedRun.mission", refuse)
    done = recover(copied)
    assert "own" in done.reason_not_written
    assert read_run(copied).whole


def test_the_cycles_written_are_those_of_the_record(copied):
    cut(copied, 0.9)
    (copied / "cycles.csv").unlink()
    done = recover(copied)
    with (copied / "cycles.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(r["pose_x_m"]) for r in rows] == [c.pose.position[0] for c in done.found.run().cycles]


@pytest.mark.parametrize(
    "make",
    [
        lambda p, _: (p / "run.mcap").write_bytes(b""),
        lambda p, _: (p / "run.mcap").write_bytes(random.Random(0).randbytes(1000)),
        lambda p, foreign: foreign(p / "run.mcap", "/camera"),
        lambda p, _: cut(p, 0.0001),
        lambda p, _: (p / "run.mcap").unlink(),
    ],
    ids=["empty", "noise", "foreign", "no beginning", "none"],
)
def test_what_is_no_record_is_one_error_and_nothing_is_written(copied, make, foreign, smolbot):
    make(copied, foreign)
    before = contents(copied)
    code, out, err = smolbot("recover", copied)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert str(copied) in err
    assert contents(copied) == before


def test_the_command_tells_what_was_found_and_what_is_missing(copied, smolbot):
    cut(copied, 0.9)
    code, out, _ = smolbot("recover", copied, "--json")
    assert code == 0
    told = json.loads(out)
    assert told["needed"]
    assert told["lost_bytes"] > 0
    assert told["cycles_not_recorded"] > 0
    assert told["written"] == []
    code, out, _ = smolbot("recover", copied)
    assert code == 0
    assert "nothing to recover" in out
