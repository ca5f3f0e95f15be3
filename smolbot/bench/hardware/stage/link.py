"""Serial link to the magnet stage: a command out, its answer back; one garbled or lost answer is repeated."""

from __future__ import annotations

import errno
import threading
import time
from collections import Counter
from typing import Any

from smolbot.bench.hardware.stage.protocol import (
    PROTOCOL_VERSION,
    GarbledError,
    Reply,
    find_version_fault,
    format_line,
    parse_reply,
)
from smolbot.errors import RigError

ANSWER_TIMEOUT = 0.2
"""Seconds to wait for an answer. Two of them and a pause still fit into the firmware's heartbeat of 0.5 s."""

WRITE_TIMEOUT = 0.2
"""Seconds that a write may take."""

READ_TIMEOUT = 0.02
"""Seconds that one read of the port may wait."""

BOOT_TIMEOUT = 4.0
"""Seconds that a board may take to boot if opening the port resets it: bootloader, then banner."""

QUERY_INTERVAL = 0.5
"""Seconds between two queries of the identity, while a board may boot."""

MAX_LINE_LENGTH = 256
"""Number of bytes without an end of line after which they are discarded."""

_PORT_ERRORS = {
    errno.ENOENT: "there is no such port",
    errno.ENXIO: "there is no such port",
    errno.EACCES: "permission denied; your user must be in the group that owns it",
    errno.EAGAIN: "it is busy: another program has it open",
    errno.EBUSY: "it is busy: another program has it open",
}


class Link:
    """An open port with the right firmware behind it.

    Parameters
    ----------
    port : str
    baud : int
    boot : float, in s
        How long to wait for the board to boot.

    Attributes
    ----------
    identity : str
        Name and version of the firmware.

    Raises
    ------
    RigError
        From every method, with port and action: if the port is absent, busy or lost, nothing answers in time, the
        answer is garbled twice, the firmware refuses, or it has restarted.
    """

    def __init__(self, port: str, baud: int, boot: float = BOOT_TIMEOUT) -> None:
        self.port = port
        self._recovered: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._sequence = 0
        self._received = bytearray()
        self._serial = self._open(baud)
        try:
            self.identity = " ".join(self._await_firmware(boot))
        except BaseException:
            self.close()
            raise

    def exchange(self, command: str, action: str) -> tuple[str, ...]:
        """Send a command and return its answer. Safe from any thread.

        Parameters
        ----------
        command : str
        action : str
            For the message of an error.

        Returns
        -------
        tuple of str
            The words after ``OK``.
        """
        with self._lock:
            self._sequence = self._sequence % 255 + 1
            sent = format_line(self._sequence, command)
            try:
                reply = self._send(sent, action)
            except (GarbledError, TimeoutError) as first:
                self._recovered["garbled line" if isinstance(first, GarbledError) else "lost line"] += 1
                try:
                    reply = self._send_again(sent, action)
                except TimeoutError:
                    raise self.make_error(
                        action, f"twice no answer in {ANSWER_TIMEOUT:g} s that can be read ({first})"
                    ) from first
        if reply.word == "ERR":
            raise self.make_error(action, f"the firmware refuses: {' '.join(reply.rest) or 'no reason given'}")
        return reply.rest

    def take_recovered(self) -> Counter[str]:
        """Return, and reset, the number of repeated lines by cause. Safe from any thread.

        Returns
        -------
        Counter
            Since the last call.
        """
        with self._lock:
            taken, self._recovered = self._recovered, Counter()
        return taken

    def make_error(self, action: str, why: str) -> RigError:
        """Build the error of a failed action.

        Parameters
        ----------
        action : str
        why : str

        Returns
        -------
        RigError
        """
        return RigError(f"magnet stage on {self.port}: {action}: {why}.", device="magnet stage")

    def close(self) -> None:
        """Close the port."""
        self._serial.close()

    def _send(self, sent: bytes, action: str) -> Reply:
        self._write(sent, action)
        return self._wait_for_answer(action, again=False)

    def _send_again(self, sent: bytes, action: str) -> Reply:
        """Send the same line once more: the firmware repeats its answer and executes nothing twice.

        An end of line is sent first, since the board may hold half of the first line; the answer to it is ignored.
        """
        self._received.clear()
        self._write(b"\n" + sent, action)
        return self._wait_for_answer(action, again=True)

    def _wait_for_answer(self, action: str, again: bool) -> Reply:
        end = time.monotonic() + ANSWER_TIMEOUT
        while True:
            try:
                reply = parse_reply(self._read_line(end, action))
            except GarbledError:
                if again:
                    continue
                raise
            if reply.sequence is None and reply.word == "HELLO":
                raise self.make_error(
                    action, f"the firmware has started anew ({' '.join(reply.rest)}); its motors are off"
                )
            if reply.sequence is None and not again:
                raise GarbledError(f"the board could not read the line: {' '.join((reply.word, *reply.rest))}")
            if reply.sequence == self._sequence:
                return reply

    def _open(self, baud: int) -> Any:
        import serial

        try:
            opened = serial.Serial(self.port, baud, timeout=READ_TIMEOUT, write_timeout=WRITE_TIMEOUT, exclusive=True)
            opened.reset_input_buffer()
        except (OSError, ValueError) as error:
            why = _PORT_ERRORS.get(getattr(error, "errno", None) or 0, str(error))
            raise self.make_error("opening the port", why) from error
        return opened

    def _await_firmware(self, boot: float) -> tuple[str, ...]:
        """Wait for name and version of the firmware.

        A board that was running answers at once; one that resets sends them as it boots. A bootloader that receives
        the query instead starts the firmware at once.
        """
        action = "waiting for the banner"
        end = time.monotonic() + boot
        received = b""
        while time.monotonic() < end:
            self._write(b"\n" + format_line(0, "ID"), action)
            look = min(end, time.monotonic() + QUERY_INTERVAL)
            while (text := self._read_or_none(look, action)) is not None:
                received = text or received
                try:
                    reply = parse_reply(text)
                except GarbledError:
                    continue
                if reply.word == "HELLO" or (reply.sequence == 0 and reply.word == "OK"):
                    identity = reply.rest[:2]
                    if (fault := find_version_fault(identity)) is not None:
                        raise self.make_error("checking the firmware's version", fault)
                    return self._discard_rest(identity, action)
        answer = f"received only {received[:60]!r}" if received else "received nothing"
        version = "version {}.{}".format(*PROTOCOL_VERSION)
        raise self.make_error(action, f"{answer} within {boot:g} s; is the firmware ({version} is needed) on it?")

    def _discard_rest(self, identity: tuple[str, ...], action: str) -> tuple[str, ...]:
        """Discard the second of banner and answer, since both may come."""
        end = time.monotonic() + 2.0 * READ_TIMEOUT
        while self._read_or_none(end, action) is not None:
            pass
        return identity

    def _write(self, text: bytes, action: str) -> None:
        import serial

        try:
            self._serial.write(text)
        except (OSError, TypeError) as error:  # pyserial meets its own closed port with a TypeError
            why = "it takes no bytes" if isinstance(error, serial.SerialTimeoutException) else f"port lost ({error})"
            raise self.make_error(action, why) from error

    def _read_or_none(self, end: float, action: str) -> bytes | None:
        try:
            return self._read_line(end, action)
        except TimeoutError:
            return None

    def _read_line(self, end: float, action: str) -> bytes:
        """Read the next line, without its end.

        Raises
        ------
        TimeoutError
            If there is none by `end` (time.monotonic()).
        """
        while (at := self._received.find(b"\n")) < 0:
            if time.monotonic() >= end:
                raise TimeoutError("no answer")
            try:
                self._received += self._serial.read(max(1, self._serial.in_waiting))
            except (OSError, TypeError) as error:
                raise self.make_error(action, f"port lost ({error})") from error
            if len(self._received) > MAX_LINE_LENGTH and b"\n" not in self._received:
                self._received.clear()
        text = bytes(self._received[:at])
        del self._received[: at + 1]
        return text
