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
from smolbot.ui.link.frames import LONGEST, LONGEST_ORDER, Kind, LinkError, frame, message, receive

SILENCE = 2.0
"""Seconds without a heartbeat after which a console counts as hung."""

BEAT = 0.25
"""Seconds between two heartbeats."""

WAITING = 4096
"""Largest number of queued messages, some minutes of a mission; more are dropped and counted."""

TOGETHER = 64
"""Largest number of messages that are sent at once."""

CONSOLE = "stopped by the operator (console)"


class Pausing(Protocol):
    """Protocol of what pauses and resumes a loop."""

    def hold(self) -> None:
        """Only listen, from the next cycle on."""

    def resume(self) -> None:
        """Steer again, from the next cycle on."""


class Feed:
    """One mission's end of the link.

    From `begin` to `end`, the latch is tripped by an order to stop, by a console that is gone, and by one that
    sends nothing for `SILENCE` s. `put` may be called from any thread and never waits.

    Parameters
    ----------
    sock : socket
        Authenticated connection to a console, see `consoles.Console.connect`.
    about : mapping
        Description of the mission, which is sent as JSON.
    latch : Latch
    pause : Pausing
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
        pause: Pausing,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._sock = sock
        self._latch, self._pause, self._clock = latch, pause, clock
        self._waiting: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._over = threading.Event()
        self.dropped = 0
        sock.settimeout(SILENCE)
        sock.sendall(frame(Kind.HELLO, json.dumps({"role": "mission", **about}).encode()))
        self._threads = [
            threading.Thread(target=target, name=name, daemon=True)
            for target, name in ((self._send_on, "console, to"), (self._hear_on, "console, from"))
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
        if self._waiting.qsize() >= WAITING or len(data) > LONGEST // 2:
            self.dropped += 1
            return
        self._waiting.put(message(topic, time_ns, data))

    def end(self) -> None:
        """Send what is queued, and close the connection; the console has no effect any more."""
        self._over.set()
        self._waiting.put(frame(Kind.BYE))
        self._waiting.put(None)
        if self._threads[0].ident is not None:
            self._threads[0].join(1.0)
        with contextlib.suppress(OSError):
            self._sock.shutdown(socket.SHUT_RDWR)
        self._sock.close()

    def _send_on(self) -> None:
        last = False
        while not last:
            frames: list[bytes] = []
            with contextlib.suppress(queue.Empty):
                while not last and len(frames) < TOGETHER:
                    waiting = self._waiting.get_nowait() if frames else self._waiting.get(timeout=BEAT)
                    if waiting is None:
                        last = True
                    else:
                        frames.append(waiting)
            beat = frame(Kind.BEAT, str(self.dropped).encode())
            try:
                self._sock.sendall(b"".join(frames) or beat)
            except OSError as error:
                self._lost(f"it takes nothing any more ({error.strerror or error})")
                return

    def _hear_on(self) -> None:
        while not self._over.is_set():
            try:
                kind, words = receive(self._sock, LONGEST_ORDER)
            except TimeoutError:
                self._lost(f"no sign of life for {SILENCE:g} s")
                return
            except LinkError as error:
                self._lost(str(error))
                return
            self._take(kind, words)

    def _take(self, kind: Kind, words: bytes) -> None:
        if kind is Kind.STOP:
            heard = self._clock()
            self._latch.shut(CONSOLE, "stopped")
            told = {"heard": heard, "zero": self._clock(), "asked": words.decode(errors="replace")}
            self._waiting.put(frame(Kind.STOPPED, json.dumps(told).encode()))
        elif kind is Kind.PAUSE:
            self._pause.hold()
        elif kind is Kind.RESUME:
            self._pause.resume()
        elif kind is Kind.BYE:
            self._lost("it was ended")

    def _lost(self, why: str) -> None:
        """Trip the latch, since nobody can stop the robot from the page any more."""
        if not self._over.is_set() and not self._latch.over:
            self._over.set()
            self._latch.shut(f"the console is gone: {why}")
