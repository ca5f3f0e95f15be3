"""Entries of the recorder's queue: objects from the loop, converted to messages in the recorder's own thread."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Protocol

from smolbot.core.sensing import Recording
from smolbot.core.shots import Shot
from smolbot.localization.synthetic import SyntheticRecording
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
        """Time in ns, as stored in a record."""
        return max(round(self.time * 1e9), 0)


class QueueEntry(Protocol):
    """An entry of the queue, to be converted to messages."""

    @property
    def count(self) -> int:
        """Number of messages that it makes."""

    @property
    def size(self) -> int:
        """Bytes of samples that it holds."""

    def make_messages(self, converter: Converter) -> Iterable[Message]:
        """Convert to messages.

        Parameters
        ----------
        converter : Converter

        Returns
        -------
        iterable of Message
        """


@dataclass(frozen=True)
class PlainEntry:
    """A message that needs no conversion.

    Attributes
    ----------
    message : Message
    """

    message: Message
    count = 1
    size = 0

    def make_messages(self, converter: Converter) -> Iterable[Message]:
        """Yield the message.

        Parameters
        ----------
        converter : Converter

        Yields
        ------
        Message
        """
        yield self.message


@dataclass(frozen=True)
class EventEntry:
    """An event.

    Attributes
    ----------
    event : Event
    """

    event: Event
    count = 1
    size = 0

    def make_messages(self, converter: Converter) -> Iterable[Message]:
        """Convert to a message.

        Parameters
        ----------
        converter : Converter

        Yields
        ------
        Message
        """
        yield Message("/events", self.event.time, messages.encode_event(self.event))


@dataclass(frozen=True)
class ShotEntry:
    """A played shot and its recording.

    Attributes
    ----------
    number : int
        Number of the shot.
    shot : Shot
    recording : Recording or None
    ended : float, in s
        When the shot ended, on the rig's clock.
    has_samples : bool
        Whether the rig returned samples.
    """

    number: int
    shot: Shot
    recording: Recording | None
    ended: float
    has_samples: bool

    @property
    def count(self) -> int:
        """Number of messages that it makes."""
        return 1 + self._samples

    @property
    def size(self) -> int:
        """Bytes of samples that it holds."""
        return 0 if self.recording is None else self.recording.field.nbytes

    @property
    def _samples(self) -> bool:
        return self.has_samples and self.recording is not None

    def make_messages(self, converter: Converter) -> Iterable[Message]:
        """Convert to messages.

        Parameters
        ----------
        converter : Converter

        Yields
        ------
        Message
        """
        shot = messages.encode_shot(self.number, self.shot, self.ended, has_samples=self.has_samples)
        yield Message("/shots", self.shot.start, shot)
        if self._samples:
            assert self.recording is not None
            samples = messages.encode_samples(self.number, self.recording, converter)
            yield Message("/windows", self.recording.clock, samples)


def has_samples(recording: Recording | None) -> bool:
    """Return whether there are samples to record.

    Parameters
    ----------
    recording : Recording or None

    Returns
    -------
    bool
    """
    return recording is not None and not isinstance(recording, SyntheticRecording)


@dataclass(frozen=True)
class CycleEntry:
    """A cycle.

    Attributes
    ----------
    number : int
        Number of the cycle.
    shot : int
        Number of its shot.
    moment : Moment
    wall : float, in s
        Wall time from the start of the record to the end of the cycle.
    """

    number: int
    shot: int
    moment: Moment
    wall: float
    size = 0

    @property
    def count(self) -> int:
        """Number of messages that it makes."""
        cycle = self.moment.cycle
        return 2 + (cycle.pose is not None) + (cycle.tracked is not None) + self._knows_truth

    @property
    def _knows_truth(self) -> bool:
        return self.moment.truth is not None or self.moment.truth_at_end is not None

    def make_messages(self, converter: Converter) -> Iterable[Message]:
        """Convert to messages.

        Parameters
        ----------
        converter : Converter

        Yields
        ------
        Message
        """
        cycle, number = self.moment.cycle, self.number
        at = min(cycle.shot.end, cycle.ended)
        if cycle.pose is not None:
            yield Message("/poses/raw", cycle.pose.time, messages.encode_pose(number, cycle.pose))
        if cycle.tracked is not None:
            yield Message("/poses/tracked", cycle.tracked.time, messages.encode_pose(number, cycle.tracked))
        if self._knows_truth:
            truth = messages.encode_truth(number, self.moment.truth, self.moment.truth_at_end, self.moment.way)
            yield Message("/poses/true", at, truth)
        yield Message("/commands", at, messages.encode_command(number, cycle.command))
        timing = pb.Timing(
            number=number, shot=self.shot, ended=cycle.ended, compute=cycle.compute, rig=cycle.rig,
            has_pose=cycle.pose is not None, has_tracked=cycle.tracked is not None, wall=self.wall,
        )  # fmt: skip
        yield Message("/timing", at, timing)
