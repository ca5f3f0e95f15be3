"""Measure the magnet stage's firmware on a simulated board: ``python -m sim.measure.firmware_figures``."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim.twin.firmware import build_firmware, measure_size
from sim.twin.simulated_uno import SimulatedUno
from sim.twin.uno_state import PINS
from smolbot.bench.hardware.stage.protocol import LINE_MAX, format_line

CYCLE = 1.0 / 16e6
FLASH, RAM = 32256, 2048  # bytes of an ATmega328P, beside the bootloader
LINES = 10_000
BEAT_BYTES = 1000
"""Bytes between two heartbeats while spoiled lines are sent: a tenth of a second."""


class Wire:
    """The serial port of a simulated board, byte by byte, without a driver.

    Parameters
    ----------
    port : str
    """

    def __init__(self, port: Path) -> None:
        self._file = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self.received = b""

    def send(self, text: bytes) -> None:
        """Send bytes, and read what arrives meanwhile.

        Parameters
        ----------
        text : bytes
        """
        while text:
            try:
                text = text[os.write(self._file, text) :]
            except BlockingIOError:
                time.sleep(0.001)
            self.listen()

    def listen(self) -> None:
        """Store what has arrived."""
        try:
            self.received += os.read(self._file, 65536)
        except BlockingIOError:
            return

    def ask(self, text: bytes, answer: bytes, patience: float = 2.0) -> bool:
        """Send `text` and wait for an answer.

        Parameters
        ----------
        text : bytes
        answer : bytes
        patience : float, in s

        Returns
        -------
        bool
            Whether it arrived.
        """
        self.received = b""
        self.send(text)
        end = time.monotonic() + patience
        while answer not in self.received and time.monotonic() < end:
            time.sleep(0.002)
            self.listen()
        return answer in self.received

    def close(self) -> None:
        """Close the port."""
        os.close(self._file)


@dataclass(frozen=True)
class Fuzzed:
    """Response of a board to lines that are no commands, with its motors armed."""

    lines: int
    steps: int
    resets: int
    armed_throughout: bool
    alive_after: bool


def fuzz(uno: SimulatedUno, wire: Wire, lines: int, seed: int = 1) -> Fuzzed:
    """Send corrupted lines to an armed board, with a heartbeat now and then.

    A line is random bytes, a command with flipped bits, cut, doubled or over-long, a wrong checksum, or a command with
    a right checksum that requests something forbidden. None may move a motor.

    Parameters
    ----------
    uno : SimulatedUno
    wire : Wire
    lines : int
    seed : int

    Returns
    -------
    Fuzzed
    """
    rng = np.random.default_rng(seed)
    uno.take_edges()
    before, resets = uno.steps, uno.resets
    wire.send(b"\n" + format_line(1, "BEAT"))
    armed = wire.ask(format_line(2, "ARM"), b"2 OK") and uno.enabled
    since_beat = 0
    for _ in range(lines):
        spoiled = make_corrupted_line(rng) + b"\n"
        since_beat += len(spoiled)
        if since_beat > BEAT_BYTES:
            spoiled += b"\n" + format_line(3, "BEAT") + b"\n"
            since_beat = 0
        wire.send(spoiled)
    alive = False
    for _ in range(
        200
    ):  # the board works off what is on its way; what it says to spoiled lines may crowd out its answer
        if alive := wire.ask(b"\n" + format_line(255, "BEAT"), b"255 OK ", 0.2):
            break
    edges = uno.take_edges()
    pulses = int(np.sum(((edges["pin"] == 0) | (edges["pin"] == 2)) & (edges["level"] == 1)))
    assert pulses >= abs(uno.steps[0] - before[0]) + abs(uno.steps[1] - before[1])
    off = edges[(edges["pin"] == PINS.index("drivers on")) & (edges["level"] == 0)]
    return Fuzzed(lines, pulses, uno.resets - resets, armed and uno.enabled and off.size == 0, alive)


def make_corrupted_line(rng: np.random.Generator) -> bytes:
    """Make a corrupted line, without its end, that must move nothing.

    Parameters
    ----------
    rng : numpy.random.Generator

    Returns
    -------
    bytes
    """
    command = f"MOVE {rng.integers(-9000, 9000)} {rng.integers(40, 4000)} {rng.integers(-9000, 9000)} 444"
    good = bytearray(format_line(int(rng.integers(0, 256)), command)[:-1])
    kind = int(rng.integers(0, 7))
    if kind == 0:
        return rng.bytes(int(rng.integers(1, 100))).replace(b"\n", b"*")
    if kind == 1:
        # up to three bits: this checksum finds every such change
        for at in rng.choice(len(good) - 5, int(rng.integers(1, 4)), replace=False):
            good[at] ^= 1 << int(rng.integers(0, 3))
        return bytes(good)
    if kind == 2:
        return bytes(good[: int(rng.integers(1, len(good)))])
    if kind == 3:
        return bytes(good + good)
    if kind == 4:
        return bytes(good) + bytes(rng.integers(32, 127, int(rng.integers(LINE_MAX, 5 * LINE_MAX))).astype(np.uint8))
    if kind == 5:
        return bytes(good[:-4]) + b"%04X" % ((int(good[-4:], 16) + int(rng.integers(1, 0xFFFF))) & 0xFFFF)
    forbidden = (
        "MOVE 100 39 0 0", "MOVE 100 4001 0 0", "MOVE 1000001 800 0 0", "MOVE 100 800", "MOVE 100 800 0 0 1", "MOVE",
        "MOVE 100 800 0 x", "MOVE 1e3 800 0 0", "MOVE 99999999 800 0 0", "MOVE  100 800 0", "move 100 800 0 0",
        "MOVE 100 -800 0 0", "JUMP", "ARM NOW", "LAMP", "LAMP FAR", "ID x", "MOVE 0 0 -100 0", "MOVE - 800 0 0",
    )  # fmt: skip
    return format_line(int(rng.integers(0, 256)), forbidden[int(rng.integers(len(forbidden)))])[:-1]


def _run_up(uno: SimulatedUno, wire: Wire) -> None:
    """Arm, and turn both axes for longer than any of the trials."""
    wire.send(b"\n" + format_line(1, "CLEAR") + format_line(2, "BEAT") + format_line(3, "ARM"))
    if not wire.ask(format_line(4, "MOVE 100000 800 100000 444"), b"4 OK"):
        raise SystemExit(f"the board does not move: {wire.received!r}")


def _read_board_time(uno: SimulatedUno) -> float:
    """Seconds since power-up by the board's own clock, which a busy machine may hold up; known to a millisecond."""
    return uno.state.read_number("cycles") * CYCLE


def _measure_off_delay(uno: SimulatedUno, since: float) -> float:
    """Seconds of the board from `since` until its drivers were switched off, and no step came after."""
    while uno.enabled and _read_board_time(uno) < since + 3.0:
        time.sleep(0.01)
    off = _read_board_time(uno)
    while _read_board_time(uno) < off + 0.1:
        time.sleep(0.01)
    edges = uno.take_edges()
    drivers = edges[(edges["pin"] == PINS.index("drivers on")) & (edges["level"] == 0)]
    if not drivers.size or uno.enabled:
        raise SystemExit("the drivers were not switched off")
    late = np.isin(edges["pin"], (0, 2)) & (edges["level"] == 1) & (edges["cycle"] > drivers["cycle"][-1] + 16000)
    if late.any():
        raise SystemExit("steps came after the drivers were off")
    return float(drivers["cycle"][-1]) * CYCLE - since


def measure_jitter(uno: SimulatedUno, wire: Wire, seconds: float = 3.0) -> dict[str, tuple[float, float, float]]:
    """Measure step intervals at a steady rate while axes and serial line are busy.

    Parameters
    ----------
    uno : SimulatedUno
    wire : Wire
    seconds : float

    Returns
    -------
    dict of str to (mean, standard deviation, largest deviation), in s
    """
    _run_up(uno, wire)
    began = time.monotonic()
    while time.monotonic() < began + 0.5 + seconds:
        wire.ask(format_line(5 + int(1000 * time.monotonic()) % 200, "BEAT"), b"*")
        if time.monotonic() < began + 0.5:
            uno.take_edges()  # the ramp
    edges = uno.take_edges()
    wire.ask(format_line(250, "OFF"), b"250 OK")
    found = {}
    for pin, name in ((0, "turn"), (2, "steering")):
        gaps = np.diff(edges["cycle"][(edges["pin"] == pin) & (edges["level"] == 1)].astype(np.int64)) * CYCLE
        mean = float(gaps.mean())
        found[name] = (mean, float(gaps.std()), float(np.abs(gaps - mean).max()))
    return found


def measure_heartbeat_loss(uno: SimulatedUno, wire: Wire) -> float:
    """Measure the time from the last heartbeat to motors off, while both turn.

    Parameters
    ----------
    uno : SimulatedUno
    wire : Wire

    Returns
    -------
    float, in s
    """
    _run_up(uno, wire)
    wire.ask(format_line(6, "BEAT"), b"6 OK")
    return _measure_off_delay(uno, _read_board_time(uno))


def measure_hung_loop(uno: SimulatedUno, wire: Wire) -> float:
    """Measure the time from a main loop that hangs, while its interrupts still step, to motors off.

    Parameters
    ----------
    uno : SimulatedUno
    wire : Wire

    Returns
    -------
    float, in s
    """
    _run_up(uno, wire)
    wire.ask(format_line(6, "BEAT"), b"6 OK")
    since = _read_board_time(uno)
    uno.hang()
    return _measure_off_delay(uno, since)


def main(lines: int = LINES) -> None:
    """Measure and print everything.

    Parameters
    ----------
    lines : int
        To fuzz with.
    """
    flash, ram = measure_size(build_firmware().firmware)
    print(f"flash                        {flash} of {FLASH} bytes ({100 * flash / FLASH:.1f} %)")
    print(f"RAM without stack            {ram} of {RAM} bytes ({100 * ram / RAM:.1f} %)")
    with tempfile.TemporaryDirectory() as folder:
        port = Path(folder) / "port"
        uno = SimulatedUno()
        try:
            uno.start(port)
            wire = Wire(port)
            for name, (mean, spread, most) in measure_jitter(uno, wire).items():
                print(
                    f"step jitter, {name:<15} {spread * 1e6:.2f} us standard deviation, {most * 1e6:.1f} us at most, "
                    f"of {mean * 1e6:.1f} us"
                )
            off = [measure_heartbeat_loss(uno, wire) for _ in range(3)]
            print(f"heartbeat lost to motors off {', '.join(f'{1e3 * s:.0f}' for s in off)} ms")
            off = [measure_hung_loop(uno, wire) for _ in range(3)]
            print(f"main loop hung to motors off {', '.join(f'{1e3 * s:.0f}' for s in off)} ms")
            wire.send(b"\n" + format_line(1, "CLEAR"))
            found = fuzz(uno, wire, lines)
            print(
                f"fuzz                         {found.lines} lines: {found.steps} steps, {found.resets} resets; "
                f"armed throughout: {found.armed_throughout}, answers after: {found.alive_after}"
            )
            wire.close()
        finally:
            uno.close()


if __name__ == "__main__":
    main(*(int(argument) for argument in sys.argv[1:]))
