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

from smolbot.core.closeable import Closeable

SupplyFault = Literal["off", "stalled", "wrong id", "garbled"]
"""``off``: no power, connections are lost. ``stalled``: accepts commands, does not answer. ``wrong id``: identifies as
another model. ``garbled``: answers with noise."""

LOAD_RESISTANCE = 6.0
"""Load of each output, in ohm: an idle amplifier."""

MAX_ERRORS = 16
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
class SupplyOutput:
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

    def compute_output(self) -> tuple[float, float]:
        """Compute voltage and current of an output that is on; the lower of the two limits applies.

        Returns
        -------
        voltage : float, in V
        current : float, in A
        """
        current = min(self.voltage / LOAD_RESISTANCE, self.current)
        return current * LOAD_RESISTANCE, current


@dataclass
class SupplyModel:
    """State and answers of a supply, without a socket.

    Attributes
    ----------
    model : str
        Its last digit is the number of outputs.
    max_voltage, max_current : float, in V and A
        Of each output.
    outputs : list of SupplyOutput
    master : bool
        The master switch.
    channel : int
        Number of the output that commands apply to, from 1.
    """

    model: str = "NGP804"
    max_voltage: float = 32.05
    max_current: float = 20.01
    outputs: list[SupplyOutput] = field(default_factory=list)
    master: bool = False
    channel: int = 1

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
                    self._queue_error(str(error))
                    return None
                self._trip_protections()
                return found
        self._queue_error('-113,"Undefined header"')
        return None

    def pop_error(self) -> str:
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
        self.outputs = [SupplyOutput(ovp=self.max_voltage) for _ in range(int(self.model[-1]))]
        self.master, self.channel = False, 1

    def _queue_error(self, error: str) -> None:
        if len(self._errors) < MAX_ERRORS:
            self._errors.append(error)
        else:
            self._errors[-1] = OVERFLOW

    def _trip_protections(self) -> None:
        """Switch off outputs above their over-voltage level, or at their current limit with a fuse."""
        for output, on in zip(self.outputs, self.on, strict=True):
            if not on:
                continue
            voltage, current = output.compute_output()
            if output.ovp_on and voltage > output.ovp:
                output.tripped = "ovp"
            elif output.fuse_on and current >= output.current:
                output.tripped = "fuse"


class _ScpiError(Exception):
    """An entry of the error queue."""


def _compile_header(header: str) -> re.Pattern[str]:
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


def _parse_number(text: str, low: float, high: float) -> float:
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


def _parse_boolean(text: str) -> bool:
    try:
        return {"ON": True, "1": True, "OFF": False, "0": False}[text.upper()]
    except KeyError:
        raise _ScpiError('-104,"Data type error"' if text else '-109,"Missing parameter"') from None


Action = Callable[[SupplyModel, str], str | None]


def _make_number_setter(name: str, low: float, high: Callable[[SupplyModel], float]) -> Action:
    def act(supply: SupplyModel, text: str) -> None:
        setattr(supply.outputs[supply.channel - 1], name, _parse_number(text, low, high(supply)))

    return act


def _make_flag_setter(name: str) -> Action:
    def act(supply: SupplyModel, text: str) -> None:
        setattr(supply.outputs[supply.channel - 1], name, _parse_boolean(text))

    return act


def _make_getter(name: str) -> Action:
    def act(supply: SupplyModel, _: str) -> str:
        value = getattr(supply.outputs[supply.channel - 1], name)
        return str(int(value)) if isinstance(value, bool) else f"{value:.3f}"

    return act


def _select_output(supply: SupplyModel, text: str) -> None:
    supply.channel = int(_parse_number(text.upper().removeprefix("OUT").removeprefix("PUT"), 1, len(supply.outputs)))


def _apply_settings(supply: SupplyModel, text: str) -> None:
    voltage, _, rest = text.partition(",")
    current, _, output = rest.partition(",")
    if output:
        _select_output(supply, output.strip())
    _make_number_setter("voltage", 0.0, _get_max_voltage)(supply, voltage.strip())
    _make_number_setter("current", MIN_CURRENT, _get_max_current)(supply, current.strip())


def _switch_master(supply: SupplyModel, text: str) -> None:
    supply.master = _parse_boolean(text)
    if not supply.master:
        return
    for output in supply.outputs:
        output.tripped = ""


def _make_trip_query(kind: str) -> Action:
    return lambda supply, _: str(int(supply.outputs[supply.channel - 1].tripped == kind))


def _make_measurement(index: int) -> Action:
    def act(supply: SupplyModel, _: str) -> str:
        on = supply.on[supply.channel - 1]
        return f"{supply.outputs[supply.channel - 1].compute_output()[index] if on else 0.0:.3f}"

    return act


def _get_max_voltage(supply: SupplyModel) -> float:
    return supply.max_voltage


def _get_max_current(supply: SupplyModel) -> float:
    return supply.max_current


_COMMANDS: list[tuple[re.Pattern[str], Action]] = [
    (_compile_header(header), act)
    for header, act in (
        ("*IDN?", lambda supply, _: f"Rohde&Schwarz,{supply.model},5601.4007k04/101234,2.015"),
        ("*RST", lambda supply, _: supply.reset()),
        ("*CLS", lambda supply, _: supply.clear()),
        ("*OPC?", lambda _supply, _: "1"),
        ("SYSTem:ERRor[:NEXT]?", lambda supply, _: supply.pop_error()),
        ("INSTrument:NSELect", _select_output),
        ("INSTrument:NSELect?", lambda supply, _: str(supply.channel)),
        ("INSTrument[:SELect]", _select_output),
        ("INSTrument[:SELect]?", lambda supply, _: f"OUT{supply.channel}"),
        ("APPLy", _apply_settings),
        ("[SOURce:]VOLTage[:LEVel][:IMMediate][:AMPLitude]", _make_number_setter("voltage", 0.0, _get_max_voltage)),
        ("[SOURce:]VOLTage[:LEVel][:IMMediate][:AMPLitude]?", _make_getter("voltage")),
        (
            "[SOURce:]CURRent[:LEVel][:IMMediate][:AMPLitude]",
            _make_number_setter("current", MIN_CURRENT, _get_max_current),
        ),
        ("[SOURce:]CURRent[:LEVel][:IMMediate][:AMPLitude]?", _make_getter("current")),
        ("[SOURce:]VOLTage:PROTection[:STATe]", _make_flag_setter("ovp_on")),
        ("[SOURce:]VOLTage:PROTection[:STATe]?", _make_getter("ovp_on")),
        ("[SOURce:]VOLTage:PROTection:LEVel", _make_number_setter("ovp", 0.0, _get_max_voltage)),
        ("[SOURce:]VOLTage:PROTection:LEVel?", _make_getter("ovp")),
        ("[SOURce:]VOLTage:PROTection:TRIPped?", _make_trip_query("ovp")),
        ("FUSE[:STATe]", _make_flag_setter("fuse_on")),
        ("FUSE[:STATe]?", _make_getter("fuse_on")),
        ("FUSE:TRIPped?", _make_trip_query("fuse")),
        ("OUTPut:SELect", _make_flag_setter("selected")),
        ("OUTPut:SELect?", _make_getter("selected")),
        ("OUTPut:GENeral[:STATe]", _switch_master),
        ("OUTPut:GENeral[:STATe]?", lambda supply, _: str(int(supply.master))),
        ("MEASure[:SCALar][:VOLTage][:DC]?", _make_measurement(0)),
        ("MEASure[:SCALar]:CURRent[:DC]?", _make_measurement(1)),
    )
]


class SupplyServer(Closeable):
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
                    _disconnect(client)

    def close(self) -> None:
        """Close the port and all connections; harmless when repeated."""
        self._server.shutdown()
        self._server.server_close()
        with self._lock:
            for client in self._clients:
                _disconnect(client)

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


def _disconnect(client: socket.socket) -> None:
    try:
        client.shutdown(socket.SHUT_RDWR)
    except OSError:
        return  # already disconnected
