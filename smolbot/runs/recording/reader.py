"""Read the record of a run: complete, cut short by a kill, or not one of smolbot's at all."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from smolbot.config.load import AnyMission
from smolbot.core.pose import Pose
from smolbot.core.results import Readable
from smolbot.core.sensing import Recording
from smolbot.core.shots import Shot
from smolbot.errors import ConfigError, InputError
from smolbot.motion.controller import Command
from smolbot.runs.recording import messages
from smolbot.runs.recording import run_pb2 as pb
from smolbot.runs.recording.converter import Converter
from smolbot.runs.recording.recorder import RECORD
from smolbot.runs.recording.run_files import RunFiles
from smolbot.runs.recording.scan import Scan, ScannedMessage
from smolbot.runs.run import CycleRecord, Event, Run
from smolbot.runs.trace import Moment, Trace

CUT_SHORT = "the record ends without an end: the process was ended from outside, or the machine stopped"


@dataclass(frozen=True)
class PlayedShot:
    """A played shot.

    Attributes
    ----------
    number : int
    shot : Shot
    ended : float, in s
        On the rig's clock.
    samples : Samples message, or None
    """

    number: int
    shot: Shot
    ended: float
    samples: pb.Samples | None

    def recording(self, converter: Converter) -> Recording | None:
        """Decode the samples, bit for bit as the rig returned them.

        Parameters
        ----------
        converter : Converter

        Returns
        -------
        Recording or None
            None without samples.
        """
        return None if self.samples is None else messages.decode_recording(self.samples, converter, self.shot)


@dataclass(repr=False)
class RecordedRun(Readable):
    """A recorded run.

    Attributes
    ----------
    path : Path
        The record.
    begin : Begin message
    played : list of PlayedShot
        Every shot, including those from which noise and coil decay were learned.
    moments : list of Moment
        Every cycle, with the ground truth where it was known.
    shot_of_cycle, number_of_cycle : list of int
        Number of the shot of each cycle, and of the cycle; numbers are missing where part of a record is lost.
    events : list of Event
    end : End message, or None
        None if the record was cut short.
    whole : bool
        False if the file was not finished.
    dropped : int
        Number of messages that the recorder could not take.
    messages : int
        Number of messages that were read.
    nameless : int
        Number of messages that were read, but whose topic is lost.
    lost : int
        Bytes of the file that cannot be read.
    recovered : Recovered message, or None
        Present if ``smolbot recover`` rewrote this record.
    wall : float, in s
        Wall time from the start of the record to the last cycle.
    """

    path: Path
    begin: pb.Begin
    played: list[PlayedShot] = field(default_factory=list)
    moments: list[Moment] = field(default_factory=list)
    shot_of_cycle: list[int] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    end: pb.End | None = None
    whole: bool = True
    dropped: int = 0
    messages: int = 0
    nameless: int = 0
    lost: int = 0
    recovered: pb.Recovered | None = None
    wall: float = 0.0
    number_of_cycle: list[int] = field(default_factory=list)

    @property
    def folder(self) -> Path:
        """The run folder."""
        return self.path.parent

    @cached_property
    def provenance(self) -> dict[str, Any]:
        """Version, commit, seed, settings, and sampled mismatches."""
        found: dict[str, Any] = json.loads(self.begin.provenance)
        return found

    @cached_property
    def converter(self) -> Converter:
        """The converter that turned fields into counts."""
        return messages.decode_converter(self.begin.converter)

    @property
    def files(self) -> RunFiles:
        """The files that the run started from."""
        return RunFiles(dict(self.begin.files), dict(self.begin.names))

    def mission(self, settings: dict[str, str] | None = None) -> AnyMission:
        """Load the mission as it was flown, from the record itself.

        Parameters
        ----------
        settings : dict of str to str, optional
            Values that replace those of the files.

        Returns
        -------
        Mission or Observation

        Raises
        ------
        ConfigError
            With a line for every fault.
        """
        import tempfile

        with tempfile.TemporaryDirectory() as folder:
            for name, content in self.begin.files.items():
                (Path(folder) / name).write_bytes(content)
            try:
                mission = self.files.load(Path(folder), settings)
            except ConfigError as error:
                raise ConfigError(str(error).replace(folder, str(self.path))) from error
        for document in (mission.document, mission.rig.document, mission.robot.document):
            document.path = self.path / document.path.name  # later errors name the record, not the original place
        return mission

    @property
    def knows_truth(self) -> bool:
        """Whether a witness provided the ground truth."""
        return any(moment.truth is not None or moment.truth_at_end is not None for moment in self.moments)

    def recordings(self) -> Iterator[tuple[PlayedShot, Recording]]:
        """Decode the recording of every shot that has one.

        Yields
        ------
        PlayedShot
        Recording
        """
        for played in self.played:
            recording = played.recording(self.converter)
            if recording is not None:
                yield played, recording

    def trace(self) -> Trace:
        """Build the trace of the cycles, as it was in flight.

        Returns
        -------
        Trace
        """
        trace = Trace(None)
        trace.moments = list(self.moments)
        trace.knows_truth = self.knows_truth
        return trace

    def run(self) -> Run:
        """Build the result of the flight; one whose record was cut short counts as failed.

        Returns
        -------
        Run
        """
        cycles = [moment.cycle for moment in self.moments]
        last = max((p.ended for p in self.played), default=0.0)
        run = Run("failed", CUT_SHORT, last, cycles=cycles, events=list(self.events))
        run.begun = cycles[0].shot.start if cycles else last
        run.wall = self.wall
        if self.end is not None:
            end = self.end
            run.status, run.stop_reason = end.status, end.stop_reason  # type: ignore[assignment]
            run.duration, run.wall, run.begun = end.duration, end.wall, end.begun
            run.recovered, run.safety = json.loads(end.recovered), json.loads(end.safety)
        run.folder = str(self.folder)
        run.true_trail = self.trace().true_positions() if self.knows_truth else None
        return run


def find_record(run: str | Path) -> Path:
    """Find the record of a run.

    Parameters
    ----------
    run : str or Path
        Run folder, or its record.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If there is none, or ``run`` is no path.
    """
    if not isinstance(run, str | os.PathLike):
        raise InputError(f"A run is named by a path, of its folder or its record; got {run!r}.")
    path = Path(run)
    if path.is_dir():
        inside = path / RECORD
        if not inside.is_file():
            raise InputError(f"{path}: holds no {RECORD}; is it a run folder? It holds: {_format_listing(path)}.")
        return inside
    if not path.is_file():
        near = sorted(p.name for p in path.parent.iterdir())[-5:] if path.parent.is_dir() else []
        beside = f" Beside it: {', '.join(near)}." if near else ""
        raise InputError(f"{path}: no such run.{beside}")
    return path


def read_run(run: str | Path) -> RecordedRun:
    """Read the record of a run, given by its folder or by the file itself.

    A record that was cut short or damaged gives what is in it; `whole` is False then.

    Parameters
    ----------
    run : str or Path
        Run folder, or its record.

    Returns
    -------
    RecordedRun

    Raises
    ------
    InputError
        Where there is no record, or it is none of smolbot's.

    Examples
    --------
    >>> import smolbot
    >>> smolbot.read_run("runs/monday")
    Traceback (most recent call last):
    smolbot.errors.InputError: runs/monday: no such run.
    """
    path = find_record(run)
    scan = Scan(path)
    reading = _RunBuilder(path)
    for message in scan.read_messages():
        reading.add(message)
    return reading.build(scan)


class _RunBuilder:
    """Assemble messages to a run, whichever are missing between them."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._found: RecordedRun | None = None
        self._parts: dict[int, dict[str, Any]] = {}
        self._shots: dict[int, pb.Shot] = {}
        self._samples: dict[int, pb.Samples] = {}
        self._timings: dict[int, pb.Timing] = {}
        self._events: list[pb.Event] = []
        self._nameless = 0

    def add(self, told: ScannedMessage) -> None:
        """Add the next message."""
        if told.topic is None:
            self._nameless += 1
            return
        topic, message = told.topic, _parse(self._path, told.topic, told.data)
        if topic == "/run/begin":
            if message.format != messages.FORMAT:
                raise InputError(
                    f"{self._path}: was written in format {message.format}; "
                    f"this version of smolbot reads {messages.FORMAT}."
                )
            strange = [name for name in message.files if not name or name != Path(name).name]
            if strange:
                raise InputError(f"{self._path}: names a file '{strange[0]}', which would lie outside a run's folder.")
            self._found = RecordedRun(self._path, message)
        elif topic == "/shots":
            self._shots[message.number] = message
        elif topic == "/windows":
            self._samples[message.number] = message
        elif topic in ("/poses/raw", "/poses/tracked", "/poses/true", "/commands"):
            self._parts.setdefault(message.number, {})[topic] = message
        elif topic == "/timing":
            self._timings[message.number] = message
        elif topic == "/events":
            self._events.append(message)
        elif self._found is not None:
            if topic == "/run/dropped":
                self._found.dropped = message.messages
            elif topic == "/run/recovered":
                self._found.recovered = message
            elif topic == "/run/end":
                self._found.end = message
        if self._found is not None:
            self._found.messages += 1

    def build(self, scan: Scan) -> RecordedRun:
        """Build the run from all messages."""
        found = self._found
        if found is None:
            raise InputError(f"{self._path}: {self._explain_missing_begin(scan)}")
        found.lost, found.nameless = scan.lost_bytes, self._nameless
        found.whole = scan.finished and found.end is not None
        try:
            self._assemble(found)
        except (ValueError, TypeError, KeyError, IndexError) as error:  # e.g. a pose of five numbers
            raise InputError(f"{self._path}: its messages are none of smolbot's: {error}") from error
        return found

    def _explain_missing_begin(self, scan: Scan) -> str:
        if self._shots or self._timings or self._nameless:
            return "its beginning, /run/begin, is lost: without it, the rest cannot be understood."
        return f"holds no message of a run{'' if scan.finished else ', and is cut short'}."

    def _assemble(self, found: RecordedRun) -> None:
        found.events = [messages.decode_event(event) for event in self._events]
        for number in sorted(self._shots):
            told = self._shots[number]
            if told.heard and number not in self._samples:
                continue  # its samples were not flushed any more
            found.played.append(PlayedShot(number, messages.decode_shot(told), told.ended, self._samples.get(number)))
            found.played[-1].recording(found.converter)  # to fail here if it must
        shots = {p.number: p.shot for p in found.played}
        for number in sorted(self._timings):
            timing, parts = self._timings[number], self._parts.get(number, {})
            shot = shots.get(timing.shot)
            needed = {"/commands"} | ({"/poses/raw"} if timing.has_pose else set())
            needed |= {"/poses/tracked"} if timing.has_tracked else set()
            if shot is None or not needed <= parts.keys():
                continue  # part of it was dropped
            found.moments.append(_make_moment(shot, timing, parts))
            found.shot_of_cycle.append(timing.shot)
            found.number_of_cycle.append(number)
            found.wall = timing.wall


def stream_messages(run: str | Path) -> Iterator[tuple[str, bytes]]:
    """Iterate over the messages of a record in the order in which they were written, as far as they can be read.

    Parameters
    ----------
    run : str or Path
        Run folder, or its record.

    Returns
    -------
    iterator of tuple
        Topic and bytes of each message.

    Raises
    ------
    InputError
        If there is no record, or it is no MCAP file.
    """
    scan = Scan(find_record(run))
    return ((found.topic, found.data) for found in scan.read_messages() if found.topic is not None)


def _make_moment(shot: Shot, timing: pb.Timing, parts: dict[str, Any]) -> Moment:
    def pose(topic: str) -> Pose | None:
        return messages.decode_pose(parts[topic]) if topic in parts else None

    command: Command = messages.decode_command(parts["/commands"])
    record = CycleRecord(
        shot, pose("/poses/raw"), pose("/poses/tracked"), command, timing.compute, timing.ended, timing.rig
    )
    true = parts.get("/poses/true")
    if true is None:
        return Moment(record, None, None)
    at = messages.decode_pose(true.pose) if true.HasField("pose") else None
    end = messages.decode_pose(true.end) if true.HasField("end") else None
    return Moment(record, at, end, np.array(true.way).reshape(-1, 3))


def _parse(path: Path, topic: str, data: bytes) -> Any:
    from google.protobuf.message import DecodeError

    kind = messages.TOPICS.get(topic)
    if kind is None:
        raise InputError(
            f"{path}: has a topic {topic}, which no record of smolbot has; those are {', '.join(messages.TOPICS)}."
        )
    try:
        return kind.FromString(data)
    except DecodeError as error:
        raise InputError(f"{path}: a message of {topic} is none of smolbot's: {error}.") from error


def _format_listing(folder: Path) -> str:
    names = sorted(p.name for p in folder.iterdir())
    return ", ".join(names[:12]) + (", …" if len(names) > 12 else "") or "nothing"
