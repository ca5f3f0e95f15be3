"""A control interface of the twin: lines of JSON over a loopback socket, to inject faults and to inspect the card."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
from collections.abc import Callable, Mapping
from typing import Any

from smolbot.core.closeable import Closeable
from smolbot.errors import InputError, RigError

Handler = Callable[[Mapping[str, Any]], Any]


class ControlServer:
    """Answers each line ``{"do": NAME, …}`` with ``{"ok": …}`` or ``{"error": …}``.

    Parameters
    ----------
    host : str
    port : int
        0 takes a free one.
    handlers : mapping of str to callable
        Called with the request, by its ``do``; their result is the answer.

    Attributes
    ----------
    port : int

    Raises
    ------
    RigError
        If the port is taken.
    """

    def __init__(self, host: str, port: int, handlers: Mapping[str, Handler]) -> None:
        try:
            self._socket = socket.create_server((host, port))
        except OSError as error:
            raise RigError(
                f"The twin's control cannot listen on {host}:{port}: {error.strerror or error}. Does another twin run?"
            ) from error
        self.port: int = self._socket.getsockname()[1]
        self._handlers = handlers
        threading.Thread(target=self._accept_clients, name="control", daemon=True).start()

    def _accept_clients(self) -> None:
        while True:
            try:
                connection, _ = self._socket.accept()
            except OSError:  # closed
                return
            threading.Thread(target=self._serve_client, args=(connection,), name="control", daemon=True).start()

    def _serve_client(self, connection: socket.socket) -> None:
        with connection, contextlib.suppress(OSError), connection.makefile("rw", encoding="utf-8") as stream:
            for line in stream:
                stream.write(json.dumps(self._answer(line), default=str) + "\n")
                stream.flush()

    def _answer(self, line: str) -> dict[str, Any]:
        try:
            request = json.loads(line)
            handler = self._handlers[request["do"]]
        except (ValueError, KeyError, TypeError):
            return {"error": f'send one line of JSON with "do": {", ".join(self._handlers)}.'}
        try:
            return {"ok": handler(request)}
        except (InputError, RigError, KeyError, TypeError, ValueError) as error:
            return {"error": str(error)}

    def close(self) -> None:
        """Stop listening."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


class TwinControl(Closeable):
    """A client of a twin's control interface.

    Parameters
    ----------
    address : str
        As ``host:port``.
    timeout : float, in s
        For each answer.

    Raises
    ------
    RigError
        If no twin answers there.

    Examples
    --------
    Inject an overrun in the 30th shot, while it listens::

        with TwinControl("127.0.0.1:31765") as twin:
            twin.inject("overrun@listening#30")
    """

    def __init__(self, address: str, timeout: float = 5.0) -> None:
        host, _, port = address.rpartition(":")
        try:
            self._socket = socket.create_connection((host, int(port)), timeout)
        except (OSError, ValueError) as error:
            raise RigError(f"No twin answers at its control address {address}: {error}.") from error
        self._stream = self._socket.makefile("rw", encoding="utf-8")

    def send_request(self, do: str, **detail: Any) -> Any:
        """Send one request and return the answer.

        Parameters
        ----------
        do : str
            Name of the request.
        **detail : Any
            Its arguments.

        Returns
        -------
        Any
            Decoded from JSON.

        Raises
        ------
        RigError
            If the twin refuses, or the connection is lost.
        """
        try:
            self._stream.write(json.dumps({"do": do, **detail}) + "\n")
            self._stream.flush()
            line = self._stream.readline()
        except OSError as error:
            raise RigError(f"The connection to the twin's control is lost: {error}.") from error
        if not line:
            raise RigError("The connection to the twin's control is lost.")
        answer = json.loads(line)
        if "error" in answer:
            raise RigError(f"The twin reports: {answer['error']}")
        return answer["ok"]

    def inject(self, fault: str) -> None:
        """Inject a fault.

        Parameters
        ----------
        fault : str
            As ``NAME@MOMENT[:once|good]``.
        """
        self.send_request("inject", fault=fault)

    def clear(self) -> None:
        """Remove all faults, present and pending."""
        self.send_request("clear")

    def read_log(self, since: int = 0) -> list[dict[str, Any]]:
        """Return the card's log entries.

        Parameters
        ----------
        since : int
            Number of the last entry that is not needed.

        Returns
        -------
        list of dict
            With times in s on the monotonic clock.
        """
        return list(self.send_request("log", since=since))

    def read_state(self) -> dict[str, Any]:
        """Return the twin's present state.

        Returns
        -------
        dict
        """
        return dict(self.send_request("state"))

    def close(self) -> None:
        """Close the connection."""
        self._stream.close()
        self._socket.close()
