"""Pass what the loop produces to a sink in a thread of its own, so that the loop never waits."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections import deque
from typing import Any, Protocol

from smolbot.core.sensing import Recording
from smolbot.core.shots import Shot
from smolbot.runs.recording import run_pb2 as pb
from smolbot.runs.recording.converter import Converter
from smolbot.runs.recording.queue_entries import (
    CycleEntry,
    EventEntry,
    Message,
    PlainEntry,
    QueueEntry,
    ShotEntry,
    has_samples,
)
from smolbot.runs.run import Event
from smolbot.runs.trace import Moment

_LOG = logging.getLogger(__name__)

MAX_ENTRIES = 4096
"""Shots, cycles and events that may wait: minutes of them."""

FLUSH_INTERVAL = 0.25
"""Seconds between two flushes."""

MAX_BYTES = 64 * 2**20
"""Bytes of samples that may wait."""

POLL_INTERVAL = 0.02
"""Seconds between two looks for what has come: to wake the thread at once would cost the loop time."""

CLOSE_TIMEOUT = 10.0
"""Seconds that the end of a run waits for what is not yet written."""


class MessageSink(Protocol):
    """A destination of messages; called from the thread of its queue only."""

    def write(self, message: Message) -> None:
        """Write one message.

        Parameters
        ----------
        message : Message
        """

    def flush(self) -> None:
        """Make everything written so far safe from a kill of the process."""

    def close(self) -> None:
        """Finish and release the destination."""


class MessageQueue:
    """Convert played shots, cycles and events to messages, and pass them to a sink in its own thread.

    The queue is bounded in entries and in bytes of samples: what does not fit is dropped and counted. After an
    error the sink gets no more messages; `error` has the reason, further messages count as dropped, and the flight
    goes on.

    Parameters
    ----------
    sink : MessageSink
    converter : Converter
    windows : bool
        Whether to pass on the samples, which are most of a record.
    capacity : int
        Largest number of waiting entries.
    memory : int, in bytes
        Largest size of waiting samples.
    patience : float, in s
        How long `close` waits for unwritten messages.

    Attributes
    ----------
    error : str or None
        The first reason why something could not be passed on.
    computing : float, in s
        Processor time of the thread, once it has ended.
    """

    def __init__(
        self,
        sink: MessageSink,
        converter: Converter,
        *,
        windows: bool = True,
        capacity: int = MAX_ENTRIES,
        memory: int = MAX_BYTES,
        patience: float = CLOSE_TIMEOUT,
    ) -> None:
        self.error: str | None = None
        self.computing = 0.0
        self._sink = sink
        self._converter = converter
        self._windows = windows
        self._memory = memory
        self._patience = patience
        self._capacity = capacity
        self._queue: deque[QueueEntry] = deque()
        self._over = threading.Event()
        self._closed = False
        self._shots = 0
        self._refused = self._lost = 0  # dropped by the loop's thread, and by the queue's: each counts its own
        self._put_in = self._taken_out = 0  # bytes; likewise
        self._reported = 0
        self._now = 0.0
        self._flushed = float("-inf")  # what the run starts from is flushed at once
        self._begun = time.monotonic()
        self._thread = threading.Thread(target=self._run, name=type(sink).__name__, daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Number of messages that could not be passed on so far."""
        return self._refused + self._lost

    def record_shot(self, shot: Shot, recording: Recording | None, ended: float) -> None:
        """Record a played shot; see `smolbot.runs.run.RecorderSink`.

        Parameters
        ----------
        shot : Shot
        recording : Recording or None
        ended : float, in s
            On the rig's clock.
        """
        self._put(ShotEntry(self._shots, shot, recording if self._windows else None, ended, has_samples(recording)))
        self._shots += 1

    def record_event(self, event: Event) -> None:
        """Record an event; see `smolbot.runs.run.RecorderSink`.

        Parameters
        ----------
        event : Event
        """
        self._put(EventEntry(event))

    def record_cycle(self, number: int, moment: Moment) -> None:
        """Record a finished cycle, whose shot was the last one played.

        Parameters
        ----------
        number : int
        moment : Moment
        """
        self._put(CycleEntry(number, self._shots - 1, moment, time.monotonic() - self._begun))

    def record_message(self, topic: str, when: float, content: Any, *, wait: bool = False) -> None:
        """Record any other message.

        Parameters
        ----------
        topic : str
        when : float, in s
            On the rig's clock.
        content : protobuf message
        wait : bool
            Wait for a free place in the queue, as the last message of a run does.
        """
        self._put(PlainEntry(Message(topic, when, content)), self._patience if wait else 0.0)

    def close(self) -> None:
        """Write what still waits, then end the thread; repeated calls do nothing."""
        if self._closed:
            return
        self._closed = True
        self._over.set()
        self._thread.join(self._patience)
        if self._thread.is_alive():
            self.error = (
                self.error or f"was still being written {self._patience:g} s after the run, and is left to itself"
            )
        else:
            self._drain()

    def _put(self, entry: QueueEntry, patience: float = 0.0) -> None:
        until = time.monotonic() + patience
        while not self._has_room(entry.size):
            if self._over.is_set() or time.monotonic() >= until:
                self._refused += entry.count
                return
            time.sleep(POLL_INTERVAL)
        self._put_in += entry.size
        self._queue.append(entry)

    def _has_room(self, size: int) -> bool:
        waiting = self._put_in - self._taken_out
        fits = not waiting or waiting + size <= self._memory
        return fits and len(self._queue) < self._capacity and not self._over.is_set()

    def _run(self) -> None:
        try:
            self._serve()
            self._sink.close()
        except Exception as error:
            self._fail(error)
            self._over.set()  # what comes now is refused
            self._drain()
            with contextlib.suppress(Exception):  # the first error is the one that matters
                self._sink.close()
        finally:
            self.computing = time.thread_time()

    def _serve(self) -> None:
        due = float("inf")
        while True:
            over = self._over.is_set()  # before the look into the queue: what was put before the end is written
            if self._queue:
                self._pass_on(self._queue.popleft())
                due = min(due, self._flushed + FLUSH_INTERVAL)
            elif over:
                break
            else:
                self._over.wait(POLL_INTERVAL)
            if time.monotonic() >= due:
                self._report_drops()
                self._sink.flush()
                self._flushed, due = time.monotonic(), float("inf")
        self._report_drops()
        self._sink.flush()

    def _pass_on(self, entry: QueueEntry) -> None:
        self._taken_out += entry.size
        try:
            made = tuple(entry.make_messages(self._converter))
        except Exception as error:  # one that cannot be encoded must not cost the others
            self._fail(error)
            self._lost += entry.count
            return
        for message in made:
            self._now = message.time
            self._sink.write(message)

    def _fail(self, error: Exception) -> None:
        """Keep the first error, and log each."""
        self.error = self.error or _format_error(error)
        _LOG.warning("the record, or what is shown live, is incomplete: %s", _format_error(error))

    def _drain(self) -> None:
        while self._queue:
            self._lost += self._queue.popleft().count

    def _report_drops(self) -> None:
        dropped = self.dropped
        if dropped != self._reported:
            self._reported = dropped
            _LOG.warning("%d messages were dropped so far: the disk or the page is too slow", dropped)
            self._sink.write(Message("/run/dropped", self._now, pb.Dropped(messages=dropped)))


def _format_error(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


class RecorderSinks:
    """Several queues as one recorder sink.

    Parameters
    ----------
    queues : tuple of MessageQueue
        The first is the recorder.
    """

    def __init__(self, queues: tuple[MessageQueue, ...]) -> None:
        self._queues = queues

    def record_shot(self, shot: Shot, recording: Recording | None, ended: float) -> None:
        """Record a played shot; see `smolbot.runs.run.RecorderSink`.

        Parameters
        ----------
        shot : Shot
        recording : Recording or None
        ended : float, in s
            On the rig's clock.
        """
        for queue in self._queues:
            queue.record_shot(shot, recording, ended)

    def record_event(self, event: Event) -> None:
        """Record an event; see `smolbot.runs.run.RecorderSink`.

        Parameters
        ----------
        event : Event
        """
        for queue in self._queues:
            queue.record_event(event)

    def record_cycle(self, number: int, moment: Moment) -> None:
        """Record a finished cycle.

        Parameters
        ----------
        number : int
        moment : Moment
        """
        for queue in self._queues:
            queue.record_cycle(number, moment)

    def record_message(self, topic: str, when: float, content: Any, *, wait: bool = False) -> None:
        """Record any other message; see `MessageQueue.record_message`.

        Parameters
        ----------
        topic : str
        when : float, in s
            On the rig's clock.
        content : protobuf message
        wait : bool
            Wait for a free place in the queue.
        """
        for queue in self._queues:
            queue.record_message(topic, when, content, wait=wait)

    def close(self) -> None:
        """Let each queue write what still waits, then end it."""
        for queue in self._queues:
            queue.close()

    def collect_figures(self) -> dict[str, Any]:
        """Collect dropped messages and the first error of the recorder, for the summary.

        Returns
        -------
        dict
        """
        first = self._queues[0]
        return {"dropped": first.dropped, "error": first.error}
