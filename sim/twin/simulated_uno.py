"""The magnet stage of the twin: its real firmware on a simulated board, behind a pseudo-terminal."""

from __future__ import annotations

import contextlib
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np

from sim.twin.firmware import build_firmware
from sim.twin.uno_state import MAGIC, SharedState
from smolbot.errors import RigError

ORDER_TIMEOUT = 5.0
"""Longest time, in s, for the board to start, and to carry out an order."""

POLL = 5e-4
"""Time, in s, between two checks of the board's state."""

NEAR_LAMP, AWAY_LAMP = 1, 2
"""Values of the lamp in the shared state."""


class SimulatedUno:
    """An Arduino Uno at 16 MHz of real time, with two stepper drivers, two switches and two lamps.

    It has its own power supply: with the cable unplugged it runs on. Motors step only while their drivers are on.

    Raises
    ------
    RigError
        If a tool is missing, or the board does not start or stops by itself.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._folder = tempfile.TemporaryDirectory(prefix="smolbot-uno-")
        self._link: Path | None = None
        self._switches: tuple[bool, bool] | None = None
        self._orders = 0
        self._ordering = threading.Lock()  # switches are set in one thread, faults in another
        self.state = SharedState(Path(self._folder.name) / "state")

    def start(self, link: Path, firmware: Path | None = None) -> None:
        """Power up the board.

        Parameters
        ----------
        link : Path
            Symbolic link that leads to the serial port from then on.
        firmware : Path, optional
            Another ELF than the shipped firmware.
        """
        built = build_firmware()
        link.parent.mkdir(parents=True, exist_ok=True)
        self._link = link
        self._process = subprocess.Popen(
            [built.board, firmware or built.firmware, link, Path(self._folder.name) / "state"],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            text=True,
        )
        self._wait_until(lambda: self.state.read_number("magic") == MAGIC, "start")

    @property
    def steps(self) -> tuple[int, int]:
        """Positions of the turning and the steering motor, in steps since power-up."""
        return self.state.steps

    @property
    def enabled(self) -> bool:
        """Whether the motors' drivers are on: their enable line."""
        return bool(self.state.read_number("enabled"))

    @property
    def lamp(self) -> Literal["near", "away"] | None:
        """Position of the magnet that the lamps request from the operator."""
        lit = self.state.read_number("lamp")
        return "near" if lit == NEAR_LAMP else "away" if lit == AWAY_LAMP else None

    @property
    def resets(self) -> int:
        """Number of resets since power-up, for any reason."""
        return self.state.read_number("resets")

    @property
    def corrupted_lines(self) -> int:
        """Number of lines that were garbled or truncated so far."""
        return self.state.read_number("taken")

    def take_edges(self) -> np.ndarray:
        """Return the edges of the motor lines since the last call.

        Returns
        -------
        ndarray of `uno_state.EDGE`
            Cycle, time (CLOCK_MONOTONIC, s), pin (`uno_state.PINS`) and level.
        """
        return self.state.take_edges()

    def set_switches(self, near: bool, away: bool) -> None:
        """Close or open the two end switches.

        Parameters
        ----------
        near, away : bool
            Whether closed.
        """
        if (near, away) != self._switches:
            self._switches = (near, away)
            self._send_order(f"switches {int(near)} {int(away)}", wait=False)

    def reset(self) -> None:
        """Pull the reset line for a moment."""
        self._send_order("reset")

    def turn_to_marks(self) -> None:
        """Turn both motors manually to their marks, which zeroes their positions."""
        self._send_order("mark")

    def hang(self) -> None:
        """Trap the main loop in an endless loop; interrupts go on."""
        self._send_order("hang")

    def unplug(self) -> None:
        """Unplug the serial cable. The board stays powered."""
        self._send_order("unplug")

    def plug(self) -> None:
        """Plug the serial cable in again."""
        self._send_order("plug")

    def garble(self, n: int = 1) -> None:
        """Flip a bit in each of the next lines, alternately to and from the board.

        Parameters
        ----------
        n : int
            Number of lines.
        """
        self._send_order(f"garble {n:d}")

    def truncate(self, n: int = 1) -> None:
        """Cut the end of each of the next lines, alternately to and from the board.

        Parameters
        ----------
        n : int
            Number of lines.
        """
        self._send_order(f"truncate {n:d}")

    def close(self) -> None:
        """Power down, for good; harmless when repeated."""
        process, self._process = self._process, None
        if process is not None:
            assert process.stdin is not None
            with contextlib.suppress(BrokenPipeError):  # it may have ended by itself
                process.stdin.close()
            try:
                process.wait(ORDER_TIMEOUT)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        if self._link is not None:
            self._link.unlink(missing_ok=True)
        self._folder.cleanup()

    def _send_order(self, text: str, wait: bool = True) -> None:
        if self._process is None or self._process.stdin is None:
            raise RigError("simulated magnet stage: not running.", device="magnet stage")
        with self._ordering:
            self._orders += 1
            number = self._orders
            try:
                self._process.stdin.write(text + "\n")
                self._process.stdin.flush()
            except BrokenPipeError:
                self._raise_ended(text)
        if wait:
            self._wait_until(lambda: self.state.read_number("done") >= number, text)

    def _wait_until(self, holds: Callable[[], bool], action: str) -> None:
        end = time.monotonic() + ORDER_TIMEOUT
        while not holds():
            if self._process is None or self._process.poll() is not None:
                self._raise_ended(action)
            if time.monotonic() > end:
                raise RigError(
                    f"simulated magnet stage: '{action}' took more than {ORDER_TIMEOUT:g} s.", device="magnet stage"
                )
            time.sleep(POLL)

    def _raise_ended(self, action: str) -> None:
        code = None if self._process is None else self._process.poll()
        raise RigError(
            f"simulated magnet stage: its program ended (exit code {code}) at '{action}'.", device="magnet stage"
        )
