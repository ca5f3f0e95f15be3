"""A server that publishes the true poses of a twin on this machine."""

from __future__ import annotations

import contextlib
import json
import queue
import socket
import threading
from collections.abc import Mapping
from typing import Any

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.errors import RigError

MAX_WAITING_BLOCKS = 4096
"""Blocks of rows that wait for a slow listener before it is disconnected."""


class TruthServer:
    """Sends the true poses to every listener: a line of JSON, then one row for every physics step.

    A row is the time on the monotonic clock (s), the position (3, m) and the orientation (4, scalar first), world
    frame.

    Parameters
    ----------
    host : str
    port : int
        0 takes a free one.
    sampled : mapping
        The twin's sampled mismatches; sent first.

    Attributes
    ----------
    port : int

    Raises
    ------
    RigError
        If the port is taken.
    """

    def __init__(self, host: str, port: int, sampled: Mapping[str, Any]) -> None:
        try:
            self._socket = socket.create_server((host, port))
        except OSError as error:
            raise RigError(
                f"The twin's truth server cannot listen on {host}:{port}: {error.strerror or error}."
            ) from error
        self.port: int = self._socket.getsockname()[1]
        self._greeting = (json.dumps(dict(sampled), default=_to_plain) + "\n").encode("utf-8")
        self._listeners: list[_Listener] = []
        self._lock = threading.Lock()
        threading.Thread(target=self._accept, name="truth", daemon=True).start()

    def publish(self, rows: FloatArray) -> None:
        """Send rows to all listeners without blocking; a listener that is too slow is disconnected.

        Parameters
        ----------
        rows : ndarray, shape (n, 8)
        """
        data = np.ascontiguousarray(rows, dtype="<f8").tobytes()
        with self._lock:
            for listener in tuple(self._listeners):
                try:
                    listener.waiting.put_nowait(data)
                except queue.Full:  # a listener must not miss rows silently
                    self._listeners.remove(listener)
                    listener.disconnect()

    def close(self) -> None:
        """Disconnect every listener and close the port."""
        with self._lock:
            for listener in self._listeners:
                listener.disconnect()
            self._listeners.clear()
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)  # wakes the accepting thread, which holds the port
        self._socket.close()

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._socket.accept()
            except OSError:  # closed
                return
            threading.Thread(target=self._send, args=(connection,), name="truth listener", daemon=True).start()

    def _send(self, connection: socket.socket) -> None:
        listener = _Listener(connection)
        listener.waiting.put_nowait(self._greeting)
        with self._lock:  # from the greeting on, no row is missed
            self._listeners.append(listener)
        with connection:
            try:
                while (data := listener.waiting.get()) is not None:
                    connection.sendall(data)
            except OSError:  # the listener has disconnected
                pass
            with self._lock:
                if listener in self._listeners:
                    self._listeners.remove(listener)


class _Listener:
    """One connection, and the rows that wait for it."""

    def __init__(self, connection: socket.socket) -> None:
        self.waiting: queue.Queue[bytes | None] = queue.Queue(MAX_WAITING_BLOCKS)
        self._connection = connection

    def disconnect(self) -> None:
        """Close the connection at once, without sending what is queued, and wake its thread."""
        with contextlib.suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)
        with contextlib.suppress(queue.Full):  # then it is not waiting
            self.waiting.put_nowait(None)


def _to_plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)
