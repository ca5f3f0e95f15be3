"""Takes what the loop hands out, and lets a thread of its own do the rest: the loop never waits."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Protocol

from smolbot.flown import Event
from smolbot.recording import messages
from smolbot.recording import run_pb2 as pb
from smolbot.recording.converter import Converter
from smolbot.records.trace import Moment
from smolbot.sensing import Recording
from smolbot.shots import Shot
from smolbot.sightings import Sighting

CAPACITY = 4096
"""Shots, cycles and events that may wait: minutes of them."""

FLUSH_EVERY = 0.25
"""Seconds between two flushes."""

_PATIENCE = 10.0  # s for what waits at the end to be written


@dataclass(frozen=True)
class Message:
    """One message of a record.

    Attributes
    ----------
    topic : str
    time : float, in s
        On the rig's clock.
    content : protobuf message
        As ``run.proto`` describes it.
    """

    topic: str
    time: float
    content: Any

    @property
    def nanoseconds(self) -> int:
        """Its time as a record has it."""
        return max(round(self.time * 1e9), 0)


class Sink(Protocol):
    """Where messages go. Called from the pump's thread only."""

    def write(self, message: Message) -> None: ...

    def flush(self) -> None: ...

    def close(self) -> None: ...


class Pump:
    """Makes messages of what was played and what happened, and hands them to a sink, in its own thread.

    Its queue is bounded: what does not fit is dropped and counted. A sink that fails is given no more; `error` says
    why, and the flight goes on.

    Parameters
    ----------
    sink : Sink
    converter : Converter
    windows : bool
        Whether to hand on what the sensors heard; most of a record is that.
    """

    def __init__(self, sink: Sink, converter: Converter, *, windows: bool = True, capacity: int = CAPACITY) -> None:
        self.dropped = 0
        self.error: str | None = None
        self._sink = sink
        self._converter = converter
        self._windows = windows
        self._queue: queue.Queue[_Job] = queue.Queue(capacity)
        self._over = threading.Event()
        self._shots = 0
        self._told = 0
        self._thread = threading.Thread(target=self._run, name=type(sink).__name__, daemon=True)
        self._thread.start()

    def played(self, shot: Shot, recording: Recording | None, ended: float) -> None:
        """A shot was played; see `smolbot.flown.Tape`."""
        self._put(_Played(self._shots, shot, recording, ended))
        self._shots += 1

    def happened(self, event: Event) -> None:
        """See `smolbot.flown.Tape`."""
        self._put(_Happened(event))

    def cycle(self, number: int, moment: Moment) -> None:
        """The cycle of that number is over; its shot was the last that was played."""
        self._put(_Cycle(number, self._shots - 1, moment))

    def tell(self, topic: str, when: float, content: Any) -> None:
        """Any other message."""
        self._put(_Told(Message(topic, when, content)))

    def close(self) -> None:
        """Write what still waits, then end; harmless when repeated."""
        self._over.set()
        self._thread.join(_PATIENCE)

    def _put(self, job: _Job) -> None:
        try:
            self._queue.put_nowait(job)
        except queue.Full:
            self.dropped += 1

    def _run(self) -> None:
        flushed = time.monotonic()
        try:
            while True:
                over = self._over.is_set()  # before the look into the queue: what was put before the end is written
                try:
                    job = self._queue.get(timeout=0.0 if over else max(flushed + FLUSH_EVERY - time.monotonic(), 0.0))
                except queue.Empty:
                    if over:
                        break
                else:
                    for message in job.messages(self._converter):
                        if self._windows or message.topic != "/windows":
                            self._sink.write(message)
                if time.monotonic() - flushed >= FLUSH_EVERY:
                    self._tell_of_drops()
                    self._sink.flush()
                    flushed = time.monotonic()
            self._tell_of_drops()
            self._sink.flush()
        except Exception as error:
            self.error = f"{type(error).__name__}: {error}"
        finally:
            self._sink.close()

    def _tell_of_drops(self) -> None:
        if self.dropped != self._told:
            self._told = self.dropped
            self._sink.write(Message("/run/dropped", 0.0, pb.Dropped(messages=self._told)))


class Tapes:
    """Several pumps as one tape."""

    def __init__(self, pumps: tuple[Pump, ...]) -> None:
        self._pumps = pumps

    def played(self, shot: Shot, recording: Recording | None, ended: float) -> None:
        """See `smolbot.flown.Tape`."""
        for pump in self._pumps:
            pump.played(shot, recording, ended)

    def happened(self, event: Event) -> None:
        """See `smolbot.flown.Tape`."""
        for pump in self._pumps:
            pump.happened(event)

    def cycle(self, number: int, moment: Moment) -> None:
        """The cycle of that number is over."""
        for pump in self._pumps:
            pump.cycle(number, moment)

    def tell(self, topic: str, when: float, content: Any) -> None:
        """Any other message."""
        for pump in self._pumps:
            pump.tell(topic, when, content)

    def close(self) -> None:
        """Let each write what still waits."""
        for pump in self._pumps:
            pump.close()

    def figures(self) -> dict[str, Any]:
        """What was dropped, and what went wrong, for the summary; of the first pump, the recorder."""
        first = self._pumps[0]
        return {"dropped": first.dropped, "error": first.error}


class _Job(Protocol):
    def messages(self, converter: Converter) -> Iterable[Message]: ...


@dataclass(frozen=True)
class _Told:
    message: Message

    def messages(self, converter: Converter) -> Iterable[Message]:
        yield self.message


@dataclass(frozen=True)
class _Happened:
    event: Event

    def messages(self, converter: Converter) -> Iterable[Message]:
        yield Message("/events", self.event.time, messages.event_message(self.event))


@dataclass(frozen=True)
class _Played:
    number: int
    shot: Shot
    recording: Recording | None
    ended: float

    def messages(self, converter: Converter) -> Iterable[Message]:
        heard = self.recording is not None and not isinstance(self.recording, Sighting)
        shot = messages.shot_message(self.number, self.shot, self.ended, heard=heard)
        yield Message("/shots", self.shot.start, shot)
        if heard:
            assert self.recording is not None
            samples = messages.samples_message(self.number, self.recording, converter)
            yield Message("/windows", self.recording.clock, samples)


@dataclass(frozen=True)
class _Cycle:
    number: int
    shot: int
    moment: Moment

    def messages(self, converter: Converter) -> Iterable[Message]:
        cycle, number = self.moment.cycle, self.number
        at = min(cycle.shot.end, cycle.ended)
        if cycle.pose is not None:
            yield Message("/poses/raw", cycle.pose.time, messages.pose_message(number, cycle.pose))
        if cycle.tracked is not None:
            yield Message("/poses/tracked", cycle.tracked.time, messages.pose_message(number, cycle.tracked))
        truth, end = self.moment.truth, self.moment.truth_at_end
        if truth is not None or end is not None:
            yield Message("/poses/true", at, messages.truth_message(number, truth, end, self.moment.way))
        yield Message("/commands", at, messages.command_message(number, cycle.command))
        timing = pb.Timing(
            number=number, shot=self.shot, ended=cycle.ended, compute=cycle.compute, rig=cycle.rig,
            has_pose=cycle.pose is not None, has_tracked=cycle.tracked is not None,
        )  # fmt: skip
        yield Message("/timing", at, timing)
