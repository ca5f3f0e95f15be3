"""The mission's end of the link: it sends messages and executes the console's orders, and never blocks the loop."""

from __future__ import annotations

import contextlib
import json
import queue
import socket
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from smolbot.flight.safety.stop_latch import Latch
from smolbot.ui.link.frames import (
    MAX_FRAME_SIZE,
    MAX_ORDER_SIZE,
    Kind,
    LinkError,
    make_frame,
    make_message_frame,
    receive,
)

SILENCE_TIMEOUT = 2.0
"""Seconds without a heartbeat after which a console counts as hung."""

HEARTBEAT_INTERVAL = 0.25
"""Seconds between two heartbeats."""

MAX_QUEUED = 4096
"""Largest number of queued messages, some minutes of a mission; more are dropped and counted."""

MAX_BATCH = 64
"""Largest number of messages that are sent at once."""

CONSOLE_REASON = "stopped by the operator (console)"


class PauseSwitch(Protocol):
    """Protocol of what pauses and resumes a loop."""

    def hold(self) -> None:
        """Only listen, from the next cycle on."""

    def resume(self) -> None:
        """Steer again, from the next cycle on."""


class Feed:
    """One mission's end of the link.

    From `begin` to `end`, the latch is tripped by an order to stop, by a console that is gone, and by one that
    sends nothing for `SILENCE_TIMEOUT` s. `put` may be called from any thread and never waits.

    Parameters
    ----------
    sock : socket
        Authenticated connection to a console, see `consoles.Console.connect`.
    about : mapping
        Description of the mission, which is sent as JSON.
    latch : Latch
    pause : PauseSwitch
    clock : callable
        Returns the time in s, for the times that are sent to the console.

    Attributes
    ----------
    dropped : int
        Number of messages that were not sent, since the console was too slow.
    """

    def __init__(
        self,
        sock: socket.socket,
        about: Mapping[str, Any],
        latch: Latch,
        pause: PauseSwitch,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._sock = sock
        self._latch, self._pause, self._clock = latch, pause, clock
        self._queue: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._over = threading.Event()
        self.dropped = 0
        sock.settimeout(SILENCE_TIMEOUT)
        sock.sendall(make_frame(Kind.HELLO, json.dumps({"role": "mission", **about}).encode()))
        self._threads = [
            threading.Thread(target=target, name=name, daemon=True)
            for target, name in ((self._send, "console, to"), (self._receive, "console, from"))
        ]

    def begin(self) -> None:
        """Send and receive from now on."""
        for thread in self._threads:
            thread.start()

    def put(self, topic: str, time_ns: int, data: bytes) -> None:
        """Queue a message of the record for sending.

        Parameters
        ----------
        topic : str
        time_ns : int
        data : bytes
            Serialized protobuf message.
        """
        if self._queue.qsize() >= MAX_QUEUED or len(data) > MAX_FRAME_SIZE // 2:
            self.dropped += 1
            return
        self._queue.put(make_message_frame(topic, time_ns, data))

    def end(self) -> None:
        """Send what is queued, and close the connection; the console has no effect any more."""
        self._over.set()
        self._queue.put(make_frame(Kind.BYE))
        self._queue.put(None)
        if self._threads[0].ident is not None:
            self._threads[0].join(1.0)
        with contextlib.suppress(OSError):
            self._sock.shutdown(socket.SHUT_RDWR)
        self._sock.close()

    def _send(self) -> None:
        last = False
        while not last:
            frames: list[bytes] = []
            with contextlib.suppress(queue.Empty):
                while not last and len(frames) < MAX_BATCH:
                    waiting = self._queue.get_nowait() if frames else self._queue.get(timeout=HEARTBEAT_INTERVAL)
                    if waiting is None:
                        last = True
                    else:
                        frames.append(waiting)
            beat = make_frame(Kind.BEAT, str(self.dropped).encode())
            try:
                self._sock.sendall(b"".join(frames) or beat)
            except OSError as error:
                self._trip(f"it takes nothing any more ({error.strerror or error})")
                return

    def _receive(self) -> None:
        while not self._over.is_set():
            try:
                kind, words = receive(self._sock, MAX_ORDER_SIZE)
            except TimeoutError:
                self._trip(f"no sign of life for {SILENCE_TIMEOUT:g} s")
                return
            except LinkError as error:
                self._trip(str(error))
                return
            self._execute(kind, words)

    def _execute(self, kind: Kind, words: bytes) -> None:
        if kind is Kind.STOP:
            received = self._clock()
            self._latch.trip(CONSOLE_REASON, "stopped")
            answer = {"heard": received, "zero": self._clock(), "asked": words.decode(errors="replace")}
            self._queue.put(make_frame(Kind.STOPPED, json.dumps(answer).encode()))
        elif kind is Kind.PAUSE:
            self._pause.hold()
        elif kind is Kind.RESUME:
            self._pause.resume()
        elif kind is Kind.BYE:
            self._trip("it was ended")

    def _trip(self, why: str) -> None:
        """Trip the latch, since nobody can stop the robot from the page any more."""
        if not self._over.is_set() and not self._latch.over:
            self._over.set()
            self._latch.trip(f"the console is gone: {why}")
