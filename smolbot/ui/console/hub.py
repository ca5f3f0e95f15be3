"""The missions of a console: those that joined it, and those that it has started."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from smolbot.errors import InputError
from smolbot.ui.console.flight_state import Ending, FlightState
from smolbot.ui.link.console_server import ConsoleServer, MissionConnection
from smolbot.ui.link.consoles import ENVIRONMENT
from smolbot.ui.link.frames import Kind

STOP_TIMEOUT = 1.0
"""Seconds within which a mission must report that its outputs are at zero, or counts as not answering."""

MAX_LOG_LINES = 200
"""Number of lines that the log keeps."""


@dataclass
class ChildMission:
    """A mission that this console has started.

    Attributes
    ----------
    process : subprocess.Popen
    name : str
    output : file
        What it prints.
    joined : bool
        Whether it has connected to this console.
    """

    process: subprocess.Popen[bytes]
    name: str
    output: IO[bytes]
    joined: bool = False

    def read_output(self) -> str:
        """Return the end of what it has printed.

        Returns
        -------
        str
        """
        self.output.seek(0)
        return self.output.read().decode(errors="replace").strip()[-2000:]


class Log:
    """Lines of the console's log, newest last. Each is also passed on, but only some per second.

    Parameters
    ----------
    also : callable
        Called with each line.
    """

    def __init__(self, also: Callable[[str], None]) -> None:
        self.lines: deque[str] = deque(maxlen=MAX_LOG_LINES)
        self._also = also
        self._second, self._said = 0, 0

    def __call__(self, line: str) -> None:
        """Add a line.

        Parameters
        ----------
        line : str
        """
        second = int(time.monotonic())
        self._said = self._said + 1 if second == self._second else 0
        self._second = second
        if self._said < 10:  # whoever knocks ten times a second is not worth more lines
            self.lines.append(f"{time.strftime('%H:%M:%S')} {line}")
            self._also(line)


class Hub:
    """Keeps track of the missions of a console, and gives orders to all of them.

    Parameters
    ----------
    log : Log

    Attributes
    ----------
    console_server : ConsoleServer
        Set by whoever opens it, once the hub exists.
    live : FlightState or None
        The run that joined last.
    """

    def __init__(self, log: Log) -> None:
        self.log = log
        self.console_server: ConsoleServer | None = None
        self.file: Path | None = None
        self.live: FlightState | None = None
        self._flights: dict[MissionConnection, FlightState] = {}
        self._children: list[ChildMission] = []
        self._lock = threading.Lock()

    def add_mission(self, line: MissionConnection) -> None:
        """Add a mission; see `MissionListener`.

        Parameters
        ----------
        line : MissionConnection
        """
        about = line.about
        flight = FlightState(str(about.get("mission", "a mission")))
        with self._lock:
            self._flights[line] = flight
            self.live = flight
            for child in self._children:
                child.joined |= child.process.pid == about.get("process")
        self.log(f"{flight.name} joined (process {about.get('process')}).")

    def receive_message(self, line: MissionConnection, topic: str, time_ns: int, data: bytes) -> None:
        """Pass a message on to its flight; see `MissionListener`.

        Parameters
        ----------
        line : MissionConnection
        topic : str
        time_ns : int
        data : bytes
        """
        flight = self._flights[line]
        try:
            flight.add_message(topic, data)
        except Exception as error:  # a page that cannot draw must still be able to stop
            flight.dropped += 1
            self.log(f"A message of {topic} cannot be shown: {type(error).__name__}: {error}")

    def log_stop(self, line: MissionConnection) -> None:
        """Log that a mission has stopped; see `MissionListener`.

        Parameters
        ----------
        line : MissionConnection
        """
        report = line.stopped or {}
        took = 1e3 * (report.get("zero", 0.0) - report.get("heard", 0.0))
        name, asked = self._flights[line].name, report.get("asked")
        self.log(f"{name}: stopped, outputs at zero {took:.1f} ms after the order ({asked}).")

    def remove_mission(self, line: MissionConnection, why: str) -> None:
        """Remove a mission; see `MissionListener`.

        Parameters
        ----------
        line : MissionConnection
        why : str
            Empty if it ended as planned.
        """
        with self._lock:
            flight = self._flights.pop(line)
        if flight.ending is None:
            flight.ending = Ending("failed", f"its process is gone: {why}" if why else "it ended", flight.latest)
        self.log(f"{flight.name} left{': ' + why if why else ''}.")

    @property
    def flying(self) -> bool:
        """True while a mission is connected."""
        return bool(self._flights)

    @property
    def busy(self) -> str:
        """Names of the missions that fly or are starting; empty if there is none."""
        names = [flight.name for flight in list(self._flights.values())]
        names += [child.name for child in self._list_alive() if not child.joined]
        return ", ".join(names)

    def order(self, kind: Kind, words: str = "") -> None:
        """Send an order to every mission, without waiting for an answer.

        A stop also ends those that have not joined yet.

        Parameters
        ----------
        kind : Kind
        words : str
            Who gives the order.
        """
        for line in self.console_server.connections if self.console_server else []:
            line.send_order(kind, words)
        if kind is Kind.STOP:
            for child in self._list_alive():
                if not child.joined:
                    child.process.terminate()

    def stop(self, asked: str) -> list[dict[str, Any]]:
        """Stop every mission, and wait for their answers; for ``smolbot stop``.

        Parameters
        ----------
        asked : str
            Who gives the order.

        Returns
        -------
        list of dict
            For each mission: name, process, whether it stopped, and the time that it took in ms.
        """
        lines = self.console_server.connections if self.console_server else []
        waiting = [child for child in self._list_alive() if not child.joined]
        begun = time.monotonic()
        self.order(Kind.STOP, asked)
        reports: list[dict[str, Any]] = []
        for line in lines:
            line.answered.wait(max(begun + STOP_TIMEOUT - time.monotonic(), 0.0))
            name, process = line.about.get("mission"), line.about.get("process")
            answer = {"mission": name, "process": process, "stopped": line.stopped is not None or not line.open}
            reports.append({**answer, "took_ms": 1e3 * (time.monotonic() - begun)})
        for child in waiting:
            reports.append({"mission": child.name, "process": child.process.pid, "stopped": True, "took_ms": 0.0})
        return reports

    def start(self, arguments: Sequence[str], name: str) -> ChildMission:
        """Start ``smolbot run`` as a process of its own, which joins this console.

        Parameters
        ----------
        arguments : sequence of str
            Of the command.
        name : str
            Name of the mission.

        Returns
        -------
        ChildMission

        Raises
        ------
        InputError
            If a mission flies.
        """
        if self.busy:
            raise InputError(f"{self.busy} flies; stop it before the next one is started.")
        output = tempfile.TemporaryFile()  # noqa: SIM115 (closed when the child has ended)
        command = [sys.executable, "-P", "-m", "smolbot", "run", *arguments, "--live"]
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=output, stderr=output,
            env=os.environ | {ENVIRONMENT: str(self.file), "COLUMNS": "120"},
            start_new_session=os.name == "posix",
        )  # fmt: skip
        child = ChildMission(process, name, output)
        self._children.append(child)
        self.log(f"Started: smolbot {' '.join(command[4:])} (process {process.pid}).")
        threading.Thread(target=self._wait_for_end, args=(child,), name="child", daemon=True).start()
        return child

    def close(self) -> None:
        """Stop every mission, and wait for those that this console has started."""
        self.order(Kind.STOP, "the console was ended")
        for child in self._list_alive():
            try:
                child.process.wait(10.0)
            except subprocess.TimeoutExpired:
                child.process.send_signal(signal.SIGTERM)
        if self.console_server is not None:
            self.console_server.close()

    def _list_alive(self) -> list[ChildMission]:
        return [child for child in list(self._children) if child.process.poll() is None]

    def _wait_for_end(self, child: ChildMission) -> None:
        code = child.process.wait()
        meaning = {0: "passed", 1: "verdict failed", 2: "bad input", 3: "stopped"}.get(code, "ended from outside")
        words = child.read_output().splitlines()
        self.log(f"{child.name}: {meaning} (exit code {code})." + ("" if child.joined else f" {' '.join(words[-3:])}"))
        child.output.close()
        self._children.remove(child)
