"""The queue: the loop never waits for a sink, and what a sink could not take is counted and told."""

from __future__ import annotations

import resource
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from smolbot.config.mission import load_steering_mission
from smolbot.core.sensing import Recording
from smolbot.core.shots import Listen, Shot
from smolbot.errors import InputError
from smolbot.flight.session import fly
from smolbot.motion.controller import Command
from smolbot.runs.folder import RunFolder
from smolbot.runs.recording import run_pb2 as pb
from smolbot.runs.recording.converter import Converter
from smolbot.runs.recording.message_queue import MessageQueue
from smolbot.runs.recording.reader import read_run
from smolbot.runs.recording.recorder import McapFile, Recorder
from smolbot.runs.run import CycleRecord, Event
from smolbot.runs.trace import Moment

SHOT = Shot((Listen(2, 100.0),), "track", 1.0)
SHORT = {"path.points_mm": "[[-1.0, 0.0], [0.0, 0.0]]", "localization.estimator": "paper"}


@pytest.fixture
def converter():
    return Converter(16, 10.0, 5e4, np.ones(2))


class Gate:
    """A sink that takes nothing until it is opened."""

    def __init__(self):
        self.open, self.came = threading.Event(), threading.Event()
        self.got, self.closed = [], 0

    def write(self, message):
        self.came.set()
        assert self.open.wait(60)
        self.got.append(message)

    def flush(self):
        pass

    def close(self):
        self.closed += 1


class Broken(Gate):
    """A sink that fails at one of its calls."""

    def __init__(self, at):
        super().__init__()
        self.open.set()
        self.at = at

    def write(self, message):
        super().write(message)
        if self.at == "write":
            raise OSError("the disk is full")

    def flush(self):
        if self.at == "flush":
            raise OSError("the disk is full")

    def close(self):
        super().close()
        if self.at == "close":
            raise OSError("the disk is full")


def recording(n=10):
    return Recording(np.zeros((2, n)), 1e4, 0.01, clock=1.1)


def blocked(queue, gate):
    """A queue whose thread waits in its sink with the first message."""
    queue.record_event(Event(0.5, "first"))
    assert gate.came.wait(60)


def test_a_sink_that_blocks_stops_no_one_and_what_does_not_fit_is_counted(converter):
    gate = Gate()
    queue = MessageQueue(gate, converter, capacity=3)
    blocked(queue, gate)
    for _ in range(3):
        queue.record_shot(SHOT, recording(), 1.2)
    assert queue.dropped == 0
    queue.record_shot(SHOT, recording(), 1.2)  # two messages
    queue.record_event(Event(2.0, "lost"))
    assert queue.dropped == 3
    gate.open.set()
    queue.close()
    assert queue.error is None
    told = [m for m in gate.got if m.topic == "/run/dropped"]
    assert [m.topic for m in gate.got if m not in told] == ["/events", *["/shots", "/windows"] * 3]
    assert told[-1].content == pb.Dropped(messages=3)
    assert told[-1].time > 0.0
    assert gate.closed == 1


def test_samples_that_wait_are_bounded_in_bytes(converter):
    gate = Gate()
    queue = MessageQueue(gate, converter, memory=3 * recording().field.nbytes)
    blocked(queue, gate)
    for _ in range(5):
        queue.record_shot(SHOT, recording(), 1.2)
    assert queue.dropped == 2 * 2
    queue.record_event(Event(2.0, "small"))  # what has no samples still fits
    assert queue.dropped == 4
    gate.open.set()
    queue.close()
    queue = MessageQueue(Broken("never"), converter, memory=1)
    queue.record_shot(SHOT, recording(), 1.2)  # one that is larger than the bound goes through where none waits
    queue.close()
    assert queue.dropped == 0


def test_shots_keep_their_numbers_where_some_are_dropped(converter):
    gate = Gate()
    queue = MessageQueue(gate, converter, capacity=1)
    blocked(queue, gate)
    for _ in range(3):
        queue.record_shot(SHOT, None, 1.2)
    gate.open.set()
    queue.close()
    assert [m.content.number for m in gate.got if m.topic == "/shots"] == [0]
    assert queue.dropped == 2


@pytest.mark.parametrize("at", ["write", "flush", "close"])
def test_a_sink_that_fails_is_told_of_and_given_no_more(converter, at):
    sink = Broken(at)
    queue = MessageQueue(sink, converter)
    for _ in range(20):
        queue.record_event(Event(1.0, "x"))
    queue.close()
    assert queue.error == "OSError: the disk is full"
    before = len(sink.got)
    queue.record_event(Event(1.0, "late"))
    assert len(sink.got) == before
    assert queue.dropped >= 1


def test_what_comes_after_the_end_is_counted_as_dropped(converter):
    sink = Broken("never")
    queue = MessageQueue(sink, converter)
    queue.record_event(Event(1.0, "x"))
    queue.close()
    queue.record_shot(SHOT, recording(), 1.2)
    assert (len(sink.got), queue.dropped) == (1, 2)
    queue.close()
    assert sink.closed == 1


def test_a_message_that_cannot_be_made_costs_only_itself(converter):
    sink = Broken("never")
    queue = MessageQueue(sink, converter)
    queue.record_shot(SHOT, SimpleNamespace(field=np.zeros((2, 3))), 1.2)
    queue.record_event(Event(1.0, "fine"))
    queue.close()
    assert [m.topic for m in sink.got if m.topic == "/events"] == ["/events"]
    assert queue.dropped == 2
    assert "AttributeError" in queue.error


def test_a_sink_that_blocks_at_the_end_is_left_to_itself_and_told_of(converter):
    gate = Gate()
    queue = MessageQueue(gate, converter, patience=0.01)
    blocked(queue, gate)
    queue.close()
    assert "left to itself" in queue.error
    queue.close()  # does not wait once more
    gate.open.set()


def test_the_end_of_a_run_waits_for_its_place_in_a_full_queue(converter):
    gate = Gate()
    queue = MessageQueue(gate, converter, capacity=1)
    blocked(queue, gate)
    queue.record_event(Event(1.0, "x"))
    threading.Timer(0.05, gate.open.set).start()
    queue.record_message("/run/end", 2.0, pb.End(status="completed"), wait=True)
    queue.close()
    assert gate.got[-1].topic == "/run/end"


def test_what_is_dropped_is_in_the_record_and_the_reader_tells(recorded, tmp_path):
    whole = read_run(recorded[1])
    begun, recorder = whole.begin, Recorder(tmp_path, whole.converter)
    recorder.record_message("/run/begin", 0.0, begun)
    cycle = CycleRecord(SHOT, None, None, Command(None), 0.001, 1.2)
    recorder.record_shot(SHOT, recording(), 1.2)
    recorder._refused += 7
    recorder.record_cycle(0, Moment(cycle, None, None))
    recorder.close()
    read = read_run(tmp_path)
    assert read.dropped == 7
    assert len(read.moments) == 1


def test_a_flight_whose_recorder_fails_goes_on_and_says_so(tmp_path, monkeypatch):
    def refuse(self):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(McapFile, "flush", refuse)
    run = fly(load_steering_mission("line", settings=SHORT), 3, folder=RunFolder(tmp_path / "run"))
    assert run.status == "completed"
    assert run.summary["recording"]["error"] == "OSError: [Errno 28] No space left on device"
    assert run.summary["recording"]["dropped"] > 0
    assert (tmp_path / "run" / "path.png").is_file()


def test_a_flight_goes_on_while_its_sink_blocks_and_the_summary_and_the_record_tell_what_is_missing(
    tmp_path, monkeypatch, same_cycle
):
    mission, opened, played = load_steering_mission("line", settings=SHORT), threading.Event(), []
    append = McapFile.append

    def blocks(self, topic, nanoseconds, data):
        assert topic != "/shots" or opened.wait(60)
        append(self, topic, nanoseconds, data)

    def listener(record):
        played.append(record)
        if len(played) == 12:
            opened.set()

    monkeypatch.setattr(McapFile, "append", blocks)
    monkeypatch.setitem(MessageQueue.__init__.__kwdefaults__, "capacity", 10)
    folder = tmp_path / "run"
    run = fly(mission, 3, folder=RunFolder(folder), make_listeners=lambda _: (listener,))
    free = fly(mission, 3)
    assert run.status == "completed"
    assert len(run.cycles) == len(free.cycles)
    assert all(a.pose.position.tobytes() == b.pose.position.tobytes() for a, b in zip(run.cycles, free.cycles))
    read = read_run(folder)
    dropped = run.summary["recording"]["dropped"]
    assert read.dropped == dropped > 0
    assert read.whole
    assert all(same_cycle(c, run.cycles[n]) for n, c in zip(read.number_of_cycle, read.run().cycles))
    assert len(read.moments) < len(run.cycles)


def test_a_process_ends_while_its_sink_blocks():
    script = """
import threading
import numpy as np
from smolbot.runs import Converter, Event
from smolbot.runs.recording.message_queue import MessageQueue

class Blocked:
    def write(self, message): threading.Event().wait()
    def flush(self): pass
    def close(self): pass

queue = MessageQueue(Blocked(), Converter(16, 10.0, 5e4, np.ones(2)), patience=0.05)
queue.record_event(Event(0.0, "x"))
queue.close()
print(queue.error)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=True)
    assert "left to itself" in done.stdout
    assert done.stderr == ""


def test_a_full_disk_ends_the_table_of_cycles_and_not_the_run(tmp_path, monkeypatch):
    def refuse(self, line):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(RunFolder, "_append", refuse)
    run = fly(load_steering_mission("line", settings=SHORT), 3, folder=RunFolder(tmp_path / "run"))
    assert run.status == "completed"
    assert run.summary["recording"]["error"] == "cycles.csv: No space left on device"
    assert read_run(tmp_path / "run").whole


def test_a_folder_that_cannot_be_written_into_is_an_input_error_before_anything_moves(tmp_path, monkeypatch):
    def refuse(self, content):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "write_bytes", refuse)
    with pytest.raises(InputError, match="the run folder cannot be made"):
        fly(load_steering_mission("line", settings=SHORT), 3, folder=RunFolder(tmp_path / "run"))


def test_a_full_disk_tears_the_record_and_what_was_flushed_before_can_be_read(recorded, tmp_path):
    path = tmp_path / "run.mcap"
    flushed = []
    script = f"""
import resource, sys
from pathlib import Path
from smolbot.runs.recording.recorder import McapFile
from smolbot.runs.recording.scan import Scan
resource.setrlimit(resource.RLIMIT_FSIZE, (150000, {resource.RLIM_INFINITY}))
file = McapFile(Path({str(path)!r}), lambda n: print(n, flush=True))
try:
    for message in Scan(Path({str(recorded[1] / "run.mcap")!r})).read_messages():
        file.append(message.topic, message.time, message.data)
        file.flush()
except OSError as error:
    print(error.strerror, file=sys.stderr)
file.close()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stderr == "File too large\n"
    flushed = [int(line) for line in done.stdout.split()]
    read = read_run(path)
    assert path.stat().st_size == 150000
    assert not read.whole
    assert read.messages == flushed[-1] > 0
    assert read.lost > 0


def test_two_runs_in_one_process_do_not_mix(converter, tmp_path, recorded):
    begun = read_run(recorded[1]).begin
    recorders = []
    for name in "ab":
        (tmp_path / name).mkdir()
        recorders.append(Recorder(tmp_path / name, converter))
        recorders[-1].record_message("/run/begin", 0.0, begun)
    for number, recorder in enumerate(recorders * 3):
        recorder.record_event(Event(float(number), "ab"[number % 2]))
    for recorder in recorders:
        recorder.close()
    assert [[e.what for e in read_run(tmp_path / name).events] for name in "ab"] == [["a"] * 3, ["b"] * 3]


def test_no_thread_and_no_file_stay_after_a_flight(recorded):
    assert [t.name for t in threading.enumerate() if t.name == "McapFile"] == []


@pytest.mark.parametrize("make", [lambda p: p.write_bytes(b"mine"), lambda p: p.mkdir()])
def test_an_existing_record_is_not_written_over(make, tmp_path):
    make(tmp_path / "run.mcap")
    with pytest.raises(InputError, match="cannot be made: File exists"):
        McapFile(tmp_path / "run.mcap")


def test_a_folder_that_is_not_there_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        McapFile(tmp_path / "none" / "run.mcap")
