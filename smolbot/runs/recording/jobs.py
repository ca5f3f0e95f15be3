"""What waits in a pump: objects as the loop hands them out, which become messages in the pump's own thread."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Protocol

from smolbot.core.sensing import Recording
from smolbot.core.shots import Shot
from smolbot.localization.synthetic import Sighting
from smolbot.runs.recording import messages
from smolbot.runs.recording import run_pb2 as pb
from smolbot.runs.recording.converter import Converter
from smolbot.runs.run import Event
from smolbot.runs.trace import Moment


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


class Job(Protocol):
    """What waits to be made into messages."""

    @property
    def count(self) -> int:
        """Messages that it makes."""

    @property
    def size(self) -> int:
        """Bytes of samples that it holds."""

    def messages(self, converter: Converter) -> Iterable[Message]: ...


@dataclass(frozen=True)
class Told:
    """Any message, as it is."""

    message: Message
    count = 1
    size = 0

    def messages(self, converter: Converter) -> Iterable[Message]:
        yield self.message


@dataclass(frozen=True)
class Happened:
    """An event."""

    event: Event
    count = 1
    size = 0

    def messages(self, converter: Converter) -> Iterable[Message]:
        yield Message("/events", self.event.time, messages.event_message(self.event))


@dataclass(frozen=True)
class Played:
    """A shot that was played until `ended` s, and what was heard of it."""

    number: int
    shot: Shot
    recording: Recording | None
    ended: float
    heard: bool

    @property
    def count(self) -> int:
        return 1 + self._samples

    @property
    def size(self) -> int:
        return 0 if self.recording is None else self.recording.field.nbytes

    @property
    def _samples(self) -> bool:
        return self.heard and self.recording is not None

    def messages(self, converter: Converter) -> Iterable[Message]:
        shot = messages.shot_message(self.number, self.shot, self.ended, heard=self.heard)
        yield Message("/shots", self.shot.start, shot)
        if self._samples:
            assert self.recording is not None
            samples = messages.samples_message(self.number, self.recording, converter)
            yield Message("/windows", self.recording.clock, samples)


def is_heard(recording: Recording | None) -> bool:
    """Whether there are samples to record."""
    return recording is not None and not isinstance(recording, Sighting)


@dataclass(frozen=True)
class Cycle:
    """A cycle and the number of its shot; it was over `wall` s after the record was begun."""

    number: int
    shot: int
    moment: Moment
    wall: float
    size = 0

    @property
    def count(self) -> int:
        cycle = self.moment.cycle
        return 2 + (cycle.pose is not None) + (cycle.tracked is not None) + self._knows_truth

    @property
    def _knows_truth(self) -> bool:
        return self.moment.truth is not None or self.moment.truth_at_end is not None

    def messages(self, converter: Converter) -> Iterable[Message]:
        cycle, number = self.moment.cycle, self.number
        at = min(cycle.shot.end, cycle.ended)
        if cycle.pose is not None:
            yield Message("/poses/raw", cycle.pose.time, messages.pose_message(number, cycle.pose))
        if cycle.tracked is not None:
            yield Message("/poses/tracked", cycle.tracked.time, messages.pose_message(number, cycle.tracked))
        if self._knows_truth:
            truth = messages.truth_message(number, self.moment.truth, self.moment.truth_at_end, self.moment.way)
            yield Message("/poses/true", at, truth)
        yield Message("/commands", at, messages.command_message(number, cycle.command))
        timing = pb.Timing(
            number=number, shot=self.shot, ended=cycle.ended, compute=cycle.compute, rig=cycle.rig,
            has_pose=cycle.pose is not None, has_tracked=cycle.tracked is not None, wall=self.wall,
        )  # fmt: skip
        yield Message("/timing", at, timing)
