"""Ground truth of a twin, received from another process of this machine. For recorder and report only."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
from typing import Any

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.errors import InputError, RigError

ROW_DTYPE = np.dtype("<f8")
N_COLUMNS = 8
"""A row holds the time on the monotonic clock in s, position (3) in m, and orientation (4), scalar first."""

ROW_TIMEOUT = 0.5
"""Seconds to wait for a row that is due."""

HISTORY_DURATION = 900.0
"""Seconds of ground truth that are kept."""


class RemoteWitness:
    """A `smolbot.core.rig.Witness` that receives the ground truth of a twin.

    Parameters
    ----------
    address : str
        As host:port.
    epoch : float, in s
        Zero of the rig's clock, on the monotonic clock that all processes of one machine share.

    Raises
    ------
    RigError
        If nothing answers there.
    """

    def __init__(self, address: str, epoch: float) -> None:
        host, _, port = address.rpartition(":")
        try:
            self._socket = socket.create_connection((host, int(port)), timeout=2.0)
            self._sampled: dict[str, Any] = json.loads(_read_line(self._socket))
        except (OSError, ValueError) as error:
            raise RigError(f"no twin serves ground truth at {address}: {error}.") from error
        self._socket.settimeout(None)
        self._address, self._epoch = address, epoch
        self._rows = np.zeros((1 << 16, N_COLUMNS))
        self._count = 0
        self._gone = False
        self._news = threading.Condition()
        self._thread = threading.Thread(target=self._receive, name="truth of the twin", daemon=True)
        self._thread.start()

    def provenance(self) -> dict[str, Any]:
        """Return the parameters that the twin has sampled.

        Returns
        -------
        dict
        """
        return dict(self._sampled)

    def truth(self, time: float) -> Pose:
        """Return the true pose, without covariance.

        Parameters
        ----------
        time : float, in s
            On the rig's clock.

        Returns
        -------
        Pose

        Raises
        ------
        InputError
            If the time is too old, or not played yet.
        RigError
            If the twin is gone.
        """
        requested = time + self._epoch
        with self._news:
            self._news.wait_for(lambda: self._gone or self._get_latest_time() >= requested, ROW_TIMEOUT)
            if self._count == 0 or self._get_latest_time() < requested:
                if self._gone:
                    raise RigError(f"The twin at {self._address} no longer serves ground truth: the connection ended.")
                raise InputError(f"The twin has not played {time:.3f} s yet.")
            times = self._rows[: self._count, 0]
            if requested < times[0]:
                raise InputError(f"The truth is known from {times[0] - self._epoch:.3f} s on; got {time:.3f} s.")
            after = max(int(np.searchsorted(times, requested)), 1)
            low, high = self._rows[after - 1].copy(), self._rows[min(after, self._count - 1)].copy()
        return _interpolate(low, high, requested, time)

    def _get_latest_time(self) -> float:
        return float(self._rows[self._count - 1, 0]) if self._count else -np.inf

    def _receive(self) -> None:
        size = N_COLUMNS * ROW_DTYPE.itemsize
        rest = b""
        while True:
            try:
                data = self._socket.recv(1 << 16)
            except OSError:
                data = b""
            if not data:
                break
            rest += data
            whole = len(rest) // size * size
            rows = np.frombuffer(rest[:whole], ROW_DTYPE).reshape(-1, N_COLUMNS)
            rest = rest[whole:]
            with self._news:
                self._store(rows)
                self._news.notify_all()
        with self._news:
            self._gone = True
            self._news.notify_all()

    def _store(self, rows: FloatArray) -> None:
        need = self._count + len(rows)
        if need > len(self._rows):
            first = int(np.searchsorted(self._rows[: self._count, 0], self._get_latest_time() - HISTORY_DURATION))
            kept = self._rows[first : self._count]
            larger = np.zeros((max(2 * (len(kept) + len(rows)), len(self._rows)), N_COLUMNS))
            larger[: len(kept)] = kept
            self._rows, self._count = larger, len(kept)
        self._rows[self._count : self._count + len(rows)] = rows
        self._count += len(rows)

    def close(self) -> None:
        """Close the connection."""
        with contextlib.suppress(OSError):  # it may have ended already
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


def _read_line(connection: socket.socket) -> str:
    """Read the first line byte by byte, since rows follow it at once."""
    text = bytearray()
    while not text.endswith(b"\n"):
        byte = connection.recv(1)
        if not byte:
            raise ValueError("the connection ended before it said what it is")
        text += byte
    return text.decode("utf-8")


def _interpolate(low: FloatArray, high: FloatArray, at: float, time: float) -> Pose:
    """Interpolate linearly between two rows."""
    span = high[0] - low[0]
    share = min(max((at - low[0]) / span, 0.0), 1.0) if span > 0 else 0.0
    if low[4:] @ high[4:] < 0.0:  # q and -q are the same turn
        high[4:] *= -1.0
    row = (1.0 - share) * low + share * high
    return Pose(time, row[1:4], row[4:] / np.linalg.norm(row[4:]), np.zeros((6, 6)))
