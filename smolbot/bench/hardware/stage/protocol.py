"""Lines of the magnet stage's protocol: building, checking and parsing them. No port is used here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

FIRMWARE_NAME = "smolbot-magnet-stage"
PROTOCOL_VERSION = (1, 0)
"""Version of the protocol that this driver speaks; the firmware needs the same major and at least this minor number."""

RATE_MIN, RATE_MAX = 40, 4000
"""Steps per second that the firmware accepts."""

STEPS_MAX = 1_000_000
"""Steps that the firmware accepts in one command."""

LINE_MAX = 64
"""Characters of a line that the firmware accepts, without its end."""

Place = Literal["near", "away"]


class GarbledError(ValueError):
    """A line with a wrong checksum, or not in the form of a reply."""


@dataclass(frozen=True)
class Reply:
    """Reply of the firmware to a line.

    Attributes
    ----------
    sequence : int or None
        Number of the line that it answers; None if it has no number.
    word : str
        ``OK`` or ``ERR``; another word in a line without number.
    rest : tuple of str
        Further words.
    """

    sequence: int | None
    word: str
    rest: tuple[str, ...]


@dataclass(frozen=True)
class StageState:
    """State of the stage, from the answer to a heartbeat.

    Attributes
    ----------
    armed : bool
        Whether the motors have power.
    moving : bool
    at : {"near", "away"} or None
        Which end switch is closed; None if neither or both are.
    fault : str
        ``NONE`` if there is none.
    turn : int
        Position of the turning motor, in steps since the board booted.
    steering : int
        Position of the steering motor, in steps since the board booted.
    """

    armed: bool
    moving: bool
    at: Place | None
    fault: str
    turn: int
    steering: int


def compute_checksum(text: bytes) -> int:
    """Compute CRC-16/CCITT-FALSE: polynomial 0x1021, from 0xFFFF, no reflection.

    Parameters
    ----------
    text : bytes

    Returns
    -------
    int

    Examples
    --------
    >>> f"{compute_checksum(b'123456789'):04X}"
    '29B1'
    """
    crc = 0xFFFF
    for byte in text:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def format_line(sequence: int, command: str) -> bytes:
    r"""Build a command as it is sent.

    Parameters
    ----------
    sequence : int
        Number of the line.
    command : str

    Returns
    -------
    bytes

    Examples
    --------
    >>> format_line(7, "BEAT")
    b'7 BEAT*B04C\n'
    """
    body = f"{sequence} {command}".encode("ascii")
    return b"%s*%04X\n" % (body, compute_checksum(body))


def parse_reply(received: bytes) -> Reply:
    """Parse a line from the board.

    Parameters
    ----------
    received : bytes

    Returns
    -------
    Reply

    Raises
    ------
    GarbledError
        If its checksum or its form is wrong.

    Examples
    --------
    >>> parse_reply(format_line(7, "OK ARMED"))
    Reply(sequence=7, word='OK', rest=('ARMED',))
    """
    body, star, crc = received.strip(b"\r\n").rpartition(b"*")
    if not star or crc != b"%04X" % compute_checksum(body):
        raise GarbledError(f"garbled line {received[:80]!r}")
    try:
        head, word, *rest = body.decode("ascii").split(" ")
    except ValueError:
        raise GarbledError(f"line of no known form {received[:80]!r}") from None
    if head in ("!", "?"):
        return Reply(None, word, tuple(rest))
    if not head.isdecimal() or word not in ("OK", "ERR"):
        raise GarbledError(f"line of no known form {received[:80]!r}")
    return Reply(int(head), word, tuple(rest))


def parse_state(rest: tuple[str, ...]) -> StageState:
    """Parse the answer to a heartbeat.

    Parameters
    ----------
    rest : tuple of str
        The words after ``OK``.

    Returns
    -------
    StageState

    Raises
    ------
    GarbledError
        If its form is wrong.
    """
    try:
        armed, moving, switches, fault, turn, steering = rest
        at: dict[str, Place | None] = {"NEAR": "near", "AWAY": "away", "NONE": None, "BOTH": None}
        return StageState(armed == "ARMED", moving == "MOVING", at[switches], fault, int(turn), int(steering))
    except (ValueError, KeyError):
        raise GarbledError(f"state of no known form '{' '.join(rest)}'") from None


def find_version_fault(identity: tuple[str, ...]) -> str | None:
    """Check whether the driver supports a firmware.

    Parameters
    ----------
    identity : tuple of str
        Name and version, as ``NAME MAJOR.MINOR``.

    Returns
    -------
    str or None
        Why it cannot be used; None if it can.
    """
    needed = f"'{FIRMWARE_NAME} {PROTOCOL_VERSION[0]}.{PROTOCOL_VERSION[1]}'"
    got = " ".join(identity) or "nothing"
    try:
        name, version = identity
        major, minor = (int(part) for part in version.split("."))
    except ValueError:
        return f"got '{got}', needs {needed}"
    if name != FIRMWARE_NAME or major != PROTOCOL_VERSION[0] or minor < PROTOCOL_VERSION[1]:
        later = f"{PROTOCOL_VERSION[0]}.x"
        return f"got '{got}', needs {needed} or a later {later}; upload the firmware that came with smolbot"
    return None
