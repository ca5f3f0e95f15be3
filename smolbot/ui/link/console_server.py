"""The console's end of the link: it authenticates connections, and serves missions and stop orders."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
import time
from collections.abc import Callable
from typing import Any, Protocol

from smolbot.ui.link.frames import MAX_FRAME_SIZE, MAX_ORDER_SIZE, Kind, LinkError, make_frame, parse_message, receive
from smolbot.ui.link.handshake import STEP_TIMEOUT, authenticate_caller

MAX_UNAUTHENTICATED = 16
"""Largest number of connections that are not authenticated yet; more are closed at once."""

SILENCE_TIMEOUT = 10.0
"""Seconds without a message after which a mission counts as gone."""


ROLES = ("mission", "stop", "look")
"""Roles of a peer; one with the role ``look`` only tests whether a console is there."""


class MissionConnection:
    """Connection of a console to one mission.

    Parameters
    ----------
    sock : socket.socket
    about : dict
        Description that the mission sent.

    Attributes
    ----------
    open : bool
        False once the mission is gone.
    stopped : dict or None
        The mission's answer to a stop order.
    answered : threading.Event
        Set once the mission has answered, or is gone.
    """

    def __init__(self, sock: socket.socket, about: dict[str, Any]) -> None:
        self._sock = sock
        self._sending = threading.Lock()
        self.about = about
        self.open = True
        self.stopped: dict[str, Any] | None = None
        self.answered = threading.Event()

    def send_order(self, kind: Kind, words: str = "") -> bool:
        """Send one order.

        Parameters
        ----------
        kind : Kind
        words : str
            Who gives the order.

        Returns
        -------
        bool
            False if the mission is gone.
        """
        try:
            with self._sending:
                self._sock.sendall(make_frame(kind, words.encode()))
        except OSError:
            return False
        return True


class MissionListener(Protocol):
    """Protocol of what receives the events of missions; called in the threads of their connections."""

    def add_mission(self, line: MissionConnection) -> None:
        """Receive that a mission has joined.

        Parameters
        ----------
        line : MissionConnection
        """

    def receive_message(self, line: MissionConnection, topic: str, time_ns: int, data: bytes) -> None:
        """Receive a message of a mission's record.

        Parameters
        ----------
        line : MissionConnection
        topic : str
        time_ns : int
        data : bytes
            Serialized protobuf message.
        """

    def log_stop(self, line: MissionConnection) -> None:
        """Receive that a mission has stopped; `Line.stopped` has its answer.

        Parameters
        ----------
        line : MissionConnection
        """

    def remove_mission(self, line: MissionConnection, why: str) -> None:
        """Receive that a mission is gone.

        Parameters
        ----------
        line : MissionConnection
        why : str
            Empty if it ended as planned.
        """


class ConsoleServer:
    """Listens on a free loopback port until it is closed.

    Parameters
    ----------
    secret : str
        Shared secret in hexadecimal; a peer that does not know it is refused.
    listener : MissionListener
    stop : callable
        Executes the order of ``smolbot stop``: takes who gives it, returns the stopped missions as JSON data.
    log : callable
        Called with one line for each connection that was refused.

    Attributes
    ----------
    port : int
    """

    def __init__(
        self,
        secret: str,
        listener: MissionListener,
        stop: Callable[[str], list[dict[str, Any]]],
        log: Callable[[str], None],
    ) -> None:
        self._secret = bytes.fromhex(secret)
        self._missions, self._stop, self._tell = listener, stop, log
        self._unauthenticated = threading.BoundedSemaphore(MAX_UNAUTHENTICATED)
        self._connections: list[MissionConnection] = []
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._socket.getsockname()[1]
        threading.Thread(target=self._accept, name="console server", daemon=True).start()

    @property
    def connections(self) -> list[MissionConnection]:
        """Connections to missions."""
        return list(self._connections)

    def send_heartbeats(self) -> None:
        """Send a heartbeat to every mission; called from the thread that must work for a STOP to get through."""
        for line in self.connections:
            line.send_order(Kind.BEAT)

    def close(self) -> None:
        """Tell every mission that the console ends, which ends the mission too, and stop listening."""
        for line in self.connections:
            line.send_order(Kind.BYE)
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def _accept(self) -> None:
        while True:
            try:
                sock, _ = self._socket.accept()
            except OSError:
                if self._socket.fileno() < 0:
                    return
                time.sleep(0.05)  # out of descriptors: somebody holds too many connections
                continue
            if not self._unauthenticated.acquire(blocking=False):
                sock.close()
                continue
            threading.Thread(target=self._serve, args=(sock,), name="line", daemon=True).start()

    def _serve(self, sock: socket.socket) -> None:
        with sock:
            try:
                about = self._authenticate(sock)
            except (LinkError, OSError, ValueError) as error:
                self._tell(f"A connection to the link was closed: {error}.")
                return
            finally:
                self._unauthenticated.release()
            if about["role"] == "mission":
                self._serve_mission(sock, about)
            elif about["role"] == "stop":
                answers = self._stop(str(about.get("asked", "smolbot stop")))
                with contextlib.suppress(OSError):
                    sock.sendall(make_frame(Kind.STOPPED, json.dumps(answers).encode()))

    def _authenticate(self, sock: socket.socket) -> dict[str, Any]:
        """Authenticate a peer; return its description of itself."""
        sock.settimeout(STEP_TIMEOUT)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        authenticate_caller(sock, self._secret)
        kind, words = receive(sock, MAX_ORDER_SIZE)
        about = json.loads(words) if kind is Kind.HELLO else None
        if not isinstance(about, dict) or about.get("role") not in ROLES:
            message = f"say first who you are: a HELLO with a role, one of {', '.join(ROLES)}"
            sock.sendall(make_frame(Kind.ERROR, message.encode()))
            raise LinkError(message)
        return about

    def _serve_mission(self, sock: socket.socket, about: dict[str, Any]) -> None:
        sock.settimeout(SILENCE_TIMEOUT)
        line, why = MissionConnection(sock, about), "its process ended"
        self._connections.append(line)
        self._missions.add_mission(line)
        try:
            while True:
                kind, words = receive(sock, MAX_FRAME_SIZE)
                if kind is Kind.MESSAGE:
                    self._missions.receive_message(line, *parse_message(words))
                elif kind is Kind.STOPPED:
                    line.stopped = json.loads(words)
                    line.answered.set()
                    self._missions.log_stop(line)
                elif kind is Kind.BYE:
                    why = ""
                    return
        except TimeoutError:
            why = f"it said nothing for {SILENCE_TIMEOUT:g} s"
        except (LinkError, ValueError) as error:
            why = str(error)
        finally:
            line.open = False
            line.answered.set()
            self._connections.remove(line)
            self._missions.remove_mission(line, why)


def request_stop(sock: socket.socket, asked: str, timeout: float = 5.0) -> list[dict[str, Any]]:
    """Let a console stop its missions.

    Parameters
    ----------
    sock : socket.socket
        Authenticated connection to the console.
    asked : str
        Who gives the order.
    timeout : float, in s

    Returns
    -------
    list of dict
        The console's report on each mission.

    Raises
    ------
    LinkError
        If it does not answer.
    """
    sock.settimeout(timeout)
    try:
        sock.sendall(make_frame(Kind.HELLO, json.dumps({"role": "stop", "asked": asked}).encode()))
        kind, words = receive(sock, MAX_FRAME_SIZE)
    except OSError as error:
        raise LinkError(f"the console does not answer: {error}") from error
    answer = json.loads(words) if kind is Kind.STOPPED else None
    if not isinstance(answer, list):
        raise LinkError(f"the console answers {kind.name}: {words.decode(errors='replace')}")
    return answer
