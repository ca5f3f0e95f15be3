"""Reading a record: what was flown is what is read; what is torn or damaged costs what it held, and nothing else."""

from __future__ import annotations

import contextlib
import random
import shutil

import mcap.reader
import mcap.writer
import numpy as np
import pytest

from smolbot.errors import InputError
from smolbot.runs.recording import run_pb2 as pb
from smolbot.runs.recording.reader import CUT_SHORT, read_run
from smolbot.runs.recording.scan import CHUNK, MAGIC, Scan


@pytest.fixture(scope="module")
def whole(chunked):
    return read_run(chunked)


def chunks(data):
    """Where each chunk begins and ends, by the lengths that the file tells."""
    position, found = len(MAGIC), []
    while position + 9 <= len(data):
        length = int.from_bytes(data[position + 1 : position + 9], "little")
        if data[position] == CHUNK:
            found.append((position, position + 9 + length))
        position += 9 + length
        if data[position:] == MAGIC:
            break
    return found


def test_what_is_read_is_what_was_flown_bit_for_bit(recorded, whole, same_cycle):
    run = recorded[0]
    found = read_run(recorded[1])
    read = found.run()
    assert found.whole
    assert (found.lost, found.dropped, found.nameless) == (0, 0, 0)
    assert len(read.cycles) == len(run.cycles)
    assert all(same_cycle(a, b) for a, b in zip(read.cycles, run.cycles))
    assert [(e.time, e.what) for e in read.events] == [(e.time, e.what) for e in run.events]
    for name in ("status", "stop_reason", "duration", "wall", "begun", "recovered", "safety", "folder"):
        assert getattr(read, name) == getattr(run, name), name
    assert read.true_trail.tobytes() == run.true_trail.tobytes()


def test_another_reader_of_mcap_finds_the_same_messages_by_the_index(recorded, whole):
    with whole.path.open("rb") as file:
        reader = mcap.reader.make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "smolbot"
        found = [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages(log_time_order=False)]
        assert reader.get_summary().statistics.message_count == whole.messages
    assert [tuple(m) for m in Scan(whole.path).read_messages()] == found


def test_the_mission_of_a_record_is_the_mission_that_was_flown(whole, recorded):
    assert whole.mission().name == "line"
    assert {n: (recorded[1] / n).read_bytes() for n in whole.begin.files} == dict(whole.begin.files)


def test_a_record_cut_anywhere_gives_the_beginning_of_what_was_flown(recorded, whole, tmp_path, same_cycle):
    data = whole.path.read_bytes()
    edges = {edge + off for span in chunks(data) for edge in span for off in (-1, 0, 1, 9, 40)}
    draw = random.Random(1)
    edges |= {draw.randrange(len(data)) for _ in range(60)} | set(range(12)) | {len(data) - 1, len(data) - 8}
    torn, before, most = tmp_path / "torn.mcap", 0, 0
    for cut in sorted(e for e in edges if 0 <= e < len(data)):
        torn.write_bytes(data[:cut])
        read = None
        with contextlib.suppress(InputError):
            read = read_run(torn)
        if read is None:
            assert before == 0
            continue
        assert read.messages >= before
        before = read.messages
        most = max(most, len(read.moments))
        assert not read.whole
        cycles = read.run().cycles
        assert all(same_cycle(a, b) for a, b in zip(cycles, recorded[0].cycles))
        if read.end is None:
            assert (read.run().status, read.run().stop_reason) == ("failed", CUT_SHORT)
    assert most == len(recorded[0].cycles)


def test_a_damaged_byte_costs_its_chunk_and_nothing_else(recorded, whole, tmp_path, same_cycle):
    data = whole.path.read_bytes()
    spans = chunks(data)
    begin, end = spans[len(spans) // 2]
    assert len(spans) > 5
    draw, hurt = random.Random(2), tmp_path / "hurt.mcap"
    for at in {
        begin,
        begin + 1,
        begin + 7,
        begin + 30,
        begin + 38,
        begin + 45,
        *(draw.randrange(begin, end) for _ in range(20)),
    }:
        broken = bytearray(data)
        broken[at] ^= 0xFF
        hurt.write_bytes(broken)
        read = read_run(hurt)
        assert not read.whole
        assert end - begin <= read.lost < end - begin + 2000, at
        assert read.end == whole.end
        known = dict(zip(whole.number_of_cycle, whole.run().cycles))
        assert all(same_cycle(c, known[n]) for n, c in zip(read.number_of_cycle, read.run().cycles))
        assert 0 < len(read.moments) < len(whole.moments)


def test_any_damaged_byte_is_borne_and_none_makes_up_a_cycle(recorded, whole, tmp_path, same_cycle):
    data, hurt, draw = whole.path.read_bytes(), tmp_path / "hurt.mcap", random.Random(3)
    known = dict(zip(whole.number_of_cycle, whole.run().cycles))
    for _ in range(80):
        broken = bytearray(data)
        broken[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
        hurt.write_bytes(broken)
        try:
            read = read_run(hurt)
        except InputError:
            continue
        assert all(same_cycle(c, known[n]) for n, c in zip(read.number_of_cycle, read.run().cycles))


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda p, foreign: foreign(p, "/camera"), "has a topic /camera"),
        (lambda p, foreign: foreign(p, ""), "holds no message of a run"),
        (lambda p, foreign: foreign(p, "/run/begin", b"\xff\xff"), "a message of /run/begin is none of smolbot's"),
        (lambda p, foreign: foreign(p, "/run/begin", pb.Begin(format=7).SerializeToString()), "in format 7"),
        (lambda p, foreign: foreign(p, "/shots", b""), "its beginning, /run/begin, is lost"),
        (lambda p, _: p.write_bytes(b""), "is no MCAP file, but empty"),
        (lambda p, _: p.write_bytes(b"time,x\n0,1\n"), "is no MCAP file; it begins with b'time,x"),
        (lambda p, _: p.write_bytes(MAGIC), "is cut short"),
        (lambda p, _: p.mkdir(), "holds no run.mcap"),
        (lambda p, _: None, "no such run"),
    ],
)  # fmt: skip
def test_what_is_no_record_is_told_in_one_line(make, told, tmp_path, foreign):
    path = tmp_path / "other.mcap"
    make(path, foreign)
    with pytest.raises(InputError, match=told) as caught:
        read_run(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_messages_that_parse_but_make_no_sense_are_an_input_error(recorded, tmp_path):
    begin = next(Scan(recorded[1] / "run.mcap").read_messages())
    path = tmp_path / "odd.mcap"
    with path.open("wb") as file:
        writer = mcap.writer.Writer(file)
        writer.start("smolbot")
        schema = writer.register_schema("s", "protobuf", b"")
        for topic, data in (
            ("/run/begin", begin.data),
            ("/shots", pb.Shot(number=0, mode="track", heard=False).SerializeToString()),
            ("/commands", pb.Command(number=0).SerializeToString()),
            ("/poses/raw", pb.Pose(number=0, position=[1.0, 2.0]).SerializeToString()),
            ("/timing", pb.Timing(number=0, shot=0, has_pose=True).SerializeToString()),
        ):
            writer.add_message(writer.register_channel(topic, "protobuf", schema), 0, data, 0)
        writer.finish()
    with pytest.raises(InputError, match="none of smolbot's"):
        read_run(path)


def test_channels_whose_first_mention_is_damaged_are_known_from_the_end(recorded, whole, tmp_path):
    data = bytearray(whole.path.read_bytes())
    begin, end = chunks(data)[1]  # the first after the beginning: most topics are named there
    data[(begin + end) // 2] ^= 0xFF
    hurt = tmp_path / "hurt.mcap"
    hurt.write_bytes(data)
    read = read_run(hurt)
    assert read.nameless == 0
    assert read.moments


def test_a_record_can_be_read_after_its_folder_is_gone(recorded, tmp_path):
    alone = tmp_path / "alone.mcap"
    shutil.copyfile(recorded[1] / "run.mcap", alone)
    assert np.isfinite(read_run(alone).run().duration)
