"""The twin's power supply: a socket with the SCPI commands of an R&S NGP800, its limits, protections and faults."""

from __future__ import annotations

import re
import socket
import socketserver
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, get_args

from smolbot.core.closing import Closing

SupplyFault = Literal["off", "stalled", "wrong id", "garbled"]
"""``off``: no power, connections are lost. ``stalled``: accepts commands, does not answer. ``wrong id``: identifies as
another model. ``garbled``: answers with noise."""

LOAD = 6.0
"""Load of each output, in ohm: an idle amplifier."""

QUEUE = 16
"""Length of the error queue; when full, its last entry is the overflow error of SCPI-99."""

MIN_CURRENT = 0.001
"""Smallest current limit, in A."""

DIGITS = 3
"""Decimals, in V and A, of a setting."""

LONGEST_LINE = 1000
"""Bytes of a command."""

POLL = 0.05
"""Time, in s, between two checks whether the server ends."""

NO_ERROR = '0,"No error"'
OVERFLOW = '-350,"Queue overflow"'


@dataclass
class Output:
    """One channel, initially as after ``*RST``.

    Attributes
    ----------
    voltage, current : float, in V and A
        Settings.
    ovp : float, in V
        Over-voltage protection level.
    ovp_on, fuse_on : bool
        Whether over-voltage protection and fuse are on.
    selected : bool
        Whether the master switch acts on it.
    tripped : str
        The protection that switched it off: ``ovp``, ``fuse`` or empty.
    """

    voltage: float = 0.0
    current: float = 0.1
    ovp: float = 32.05
    ovp_on: bool = False
    fuse_on: bool = False
    selected: bool = False
    tripped: str = ""

    def given(self) -> tuple[float, float]:
        """Compute voltage and current of an output that is on; the lower of the two limits applies.

        Returns
        -------
        voltage : float, in V
        current : float, in A
        """
        current = min(self.voltage / LOAD, self.current)
        return current * LOAD, current


@dataclass
class SupplyModel:
    """State and answers of a supply, without a socket.

    Attributes
    ----------
    model : str
        Its last digit is the number of outputs.
    max_voltage, max_current : float, in V and A
        Of each output.
    outputs : list of Output
    master : bool
        The master switch.
    chosen : int
        Number of the output that commands apply to, from 1.
    """

    model: str = "NGP804"
    max_voltage: float = 32.05
    max_current: float = 20.01
    outputs: list[Output] = field(default_factory=list)
    master: bool = False
    chosen: int = 1

    def __post_init__(self) -> None:
        self._errors: deque[str] = deque()
        self._reset()

    @property
    def on(self) -> tuple[bool, ...]:
        """Which outputs supply current now."""
        return tuple(self.master and output.selected and not output.tripped for output in self.outputs)

    def answer(self, line: str) -> str | None:
        """Execute a line of one command or query.

        Parameters
        ----------
        line : str

        Returns
        -------
        str or None
            The answer of a query, else None.
        """
        line = line.strip()
        if not line:
            return None
        header, _, argument = line.partition(" ")
        for pattern, act in _COMMANDS:
            if pattern.fullmatch(header.lstrip(":")):
                try:
                    found = act(self, argument.strip())
                except _ScpiError as error:
                    self._note(str(error))
                    return None
                self._protect()
                return found
        self._note('-113,"Undefined header"')
        return None

    def next_error(self) -> str:
        """Remove and return the oldest error.

        Returns
        -------
        str
        """
        return self._errors.popleft() if self._errors else NO_ERROR

    def clear(self) -> None:
        """Remove all errors."""
        self._errors.clear()

    def reset(self) -> None:
        """Switch everything off and restore the default settings; errors stay."""
        self._reset()

    def _reset(self) -> None:
        self.outputs = [Output(ovp=self.max_voltage) for _ in range(int(self.model[-1]))]
        self.master, self.chosen = False, 1

    def _note(self, error: str) -> None:
        if len(self._errors) < QUEUE:
            self._errors.append(error)
        else:
            self._errors[-1] = OVERFLOW

    def _protect(self) -> None:
        """Switch off outputs above their over-voltage level, or at their current limit with a fuse."""
        for output, on in zip(self.outputs, self.on, strict=True):
            if not on:
                continue
            voltage, current = output.given()
            if output.ovp_on and voltage > output.ovp:
                output.tripped = "ovp"
            elif output.fuse_on and current >= output.current:
                output.tripped = "fuse"


class _ScpiError(Exception):
    """An entry of the error queue."""


def _pattern(header: str) -> re.Pattern[str]:
    """Compile the spellings that SCPI allows of a header such as ``OUTPut[:STATe]?``: long or short, in any case."""
    spelled = ""
    for token in re.findall(r"\[|\]|:|\?|\*?[A-Za-z]+", header):
        if token == "[":
            spelled += "(?:"
        elif token == "]":
            spelled += ")?"
        elif token in (":", "?"):
            spelled += re.escape(token)
        else:
            short = "".join(c for c in token if c.isupper() or c == "*")
            rest = "".join(c for c in token if c.islower())
            spelled += re.escape(short) + (f"(?:{rest})?" if rest else "")
    return re.compile(spelled, re.IGNORECASE)


def _numeric(text: str, low: float, high: float) -> float:
    words = {"MIN": low, "MINIMUM": low, "MAX": high, "MAXIMUM": high}
    if text.upper() in words:
        return words[text.upper()]
    try:
        value = float(text)
    except ValueError:
        raise _ScpiError('-104,"Data type error"' if text else '-109,"Missing parameter"') from None
    if not low <= value <= high:
        raise _ScpiError('-222,"Data out of range"')
    return round(value, DIGITS)


def _boolean(text: str) -> bool:
    try:
        return {"ON": True, "1": True, "OFF": False, "0": False}[text.upper()]
    except KeyError:
        raise _ScpiError('-104,"Data type error"' if text else '-109,"Missing parameter"') from None


Act = Callable[[SupplyModel, str], str | None]


def _set_number(name: str, low: float, high: Callable[[SupplyModel], float]) -> Act:
    def act(supply: SupplyModel, text: str) -> None:
        setattr(supply.outputs[supply.chosen - 1], name, _numeric(text, low, high(supply)))

    return act


def _set_flag(name: str) -> Act:
    def act(supply: SupplyModel, text: str) -> None:
        setattr(supply.outputs[supply.chosen - 1], name, _boolean(text))

    return act


def _get(name: str) -> Act:
    def act(supply: SupplyModel, _: str) -> str:
        value = getattr(supply.outputs[supply.chosen - 1], name)
        return str(int(value)) if isinstance(value, bool) else f"{value:.3f}"

    return act


def _choose(supply: SupplyModel, text: str) -> None:
    supply.chosen = int(_numeric(text.upper().removeprefix("OUT").removeprefix("PUT"), 1, len(supply.outputs)))


def _apply(supply: SupplyModel, text: str) -> None:
    voltage, _, rest = text.partition(",")
    current, _, output = rest.partition(",")
    if output:
        _choose(supply, output.strip())
    _set_number("voltage", 0.0, _max_voltage)(supply, voltage.strip())
    _set_number("current", MIN_CURRENT, _max_current)(supply, current.strip())


def _general(supply: SupplyModel, text: str) -> None:
    supply.master = _boolean(text)
    if not supply.master:
        return
    for output in supply.outputs:
        output.tripped = ""


def _trip(kind: str) -> Act:
    return lambda supply, _: str(int(supply.outputs[supply.chosen - 1].tripped == kind))


def _measure(index: int) -> Act:
    def act(supply: SupplyModel, _: str) -> str:
        on = supply.on[supply.chosen - 1]
        return f"{supply.outputs[supply.chosen - 1].given()[index] if on else 0.0:.3f}"

    return act


def _max_voltage(supply: SupplyModel) -> float:
    return supply.max_voltage


def _max_current(supply: SupplyModel) -> float:
    return supply.max_current


_COMMANDS: list[tuple[re.Pattern[str], Act]] = [
    (_pattern(header), act)
    for header, act in (
        ("*IDN?", lambda supply, _: f"Rohde&Schwarz,{supply.model},5601.4007k04/101234,2.015"),
        ("*RST", lambda supply, _: supply.reset()),
        ("*CLS", lambda supply, _: supply.clear()),
        ("*OPC?", lambda _supply, _: "1"),
        ("SYSTem:ERRor[:NEXT]?", lambda supply, _: supply.next_error()),
        ("INSTrument:NSELect", _choose),
        ("INSTrument:NSELect?", lambda supply, _: str(supply.chosen)),
        ("INSTrument[:SELect]", _choose),
        ("INSTrument[:SELect]?", lambda supply, _: f"OUT{supply.chosen}"),
        ("APPLy", _apply),
        ("[SOURce:]VOLTage[:LEVel][:IMMediate][:AMPLitude]", _set_number("voltage", 0.0, _max_voltage)),
        ("[SOURce:]VOLTage[:LEVel][:IMMediate][:AMPLitude]?", _get("voltage")),
        ("[SOURce:]CURRent[:LEVel][:IMMediate][:AMPLitude]", _set_number("current", MIN_CURRENT, _max_current)),
        ("[SOURce:]CURRent[:LEVel][:IMMediate][:AMPLitude]?", _get("current")),
        ("[SOURce:]VOLTage:PROTection[:STATe]", _set_flag("ovp_on")),
        ("[SOURce:]VOLTage:PROTection[:STATe]?", _get("ovp_on")),
        ("[SOURce:]VOLTage:PROTection:LEVel", _set_number("ovp", 0.0, _max_voltage)),
        ("[SOURce:]VOLTage:PROTection:LEVel?", _get("ovp")),
        ("[SOURce:]VOLTage:PROTection:TRIPped?", _trip("ovp")),
        ("FUSE[:STATe]", _set_flag("fuse_on")),
        ("FUSE[:STATe]?", _get("fuse_on")),
        ("FUSE:TRIPped?", _trip("fuse")),
        ("OUTPut:SELect", _set_flag("selected")),
        ("OUTPut:SELect?", _get("selected")),
        ("OUTPut:GENeral[:STATe]", _general),
        ("OUTPut:GENeral[:STATe]?", lambda supply, _: str(int(supply.master))),
        ("MEASure[:SCALar][:VOLTage][:DC]?", _measure(0)),
        ("MEASure[:SCALar]:CURRent[:DC]?", _measure(1)),
    )
]


class SupplyServer(Closing):
    r"""A supply behind a socket of this machine, from construction to `close`.

    Parameters
    ----------
    port : int
        0 takes a free one.
    model : SupplyModel, optional

    Attributes
    ----------
    model : SupplyModel
    fault : SupplyFault or None

    Examples
    --------
    >>> with SupplyServer() as supply:
    ...     with socket.create_connection(("127.0.0.1", supply.port), timeout=5) as client:
    ...         client.sendall(b"*IDN?\n")
    ...         print(client.makefile().readline().split(",")[1])
    NGP804
    """

    def __init__(self, port: int = 0, model: SupplyModel | None = None) -> None:
        self.model = SupplyModel() if model is None else model
        self.fault: SupplyFault | None = None
        self._lock = threading.Lock()
        self._clients: set[socket.socket] = set()
        owner = self

        class Handler(socketserver.StreamRequestHandler):
            def handle(self) -> None:
                owner._serve(self)

        class Server(socketserver.ThreadingTCPServer):
            allow_reuse_address = True
            daemon_threads = True
            block_on_close = False

        self._server = Server(("127.0.0.1", port), Handler)
        self._thread = threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": POLL}, name="supply", daemon=True
        )
        self._thread.start()

    @property
    def port(self) -> int:
        """Port on which it listens."""
        return int(self._server.server_address[1])

    @property
    def address(self) -> str:
        """Address in the spelling of a rig file."""
        return f"TCPIP::127.0.0.1::{self.port}::SOCKET"

    def inject(self, fault: SupplyFault | None) -> None:
        """Set or clear the fault; after a fault other than ``off`` the settings are kept.

        Parameters
        ----------
        fault : SupplyFault or None
            None clears it.

        Raises
        ------
        ValueError
            If the fault is unknown.
        """
        if fault is not None and fault not in get_args(SupplyFault):
            raise ValueError(f"A supply's faults are {', '.join(get_args(SupplyFault))}; got {fault!r}.")
        with self._lock:
            self.fault = fault
            if fault == "off":
                self.model.reset()
                self.model.clear()
                for client in self._clients:
                    _hang_up(client)

    def close(self) -> None:
        """Close the port and all connections; harmless when repeated."""
        self._server.shutdown()
        self._server.server_close()
        with self._lock:
            for client in self._clients:
                _hang_up(client)

    def _serve(self, handler: socketserver.StreamRequestHandler) -> None:
        client: socket.socket = handler.request
        with self._lock:
            self._clients.add(client)
        try:
            while line := handler.rfile.readline(LONGEST_LINE):
                with self._lock:
                    if self.fault == "off":
                        return
                    if self.fault == "stalled":
                        continue
                    answer = self.model.answer(line.decode("ascii", "replace"))
                    fault = self.fault
                if answer is None:
                    continue
                if fault == "wrong id" and line.strip().upper() == b"*IDN?":
                    answer = "HAMEG,HMP4040,103029,HW50020003/SW2.70"
                handler.wfile.write(b"\x7f#!?\n" if fault == "garbled" else answer.encode() + b"\n")
        except OSError:
            return  # the client has disconnected
        finally:
            with self._lock:
                self._clients.discard(client)


def _hang_up(client: socket.socket) -> None:
    try:
        client.shutdown(socket.SHUT_RDWR)
    except OSError:
        return  # already disconnected
