"""Frames of the link between a mission and its console: a length, a kind, and no more than is allowed."""

from __future__ import annotations

import socket
import struct
from enum import IntEnum

from smolbot.errors import SmolbotError

LONGEST = 4_000_000
"""Bytes of the longest frame that a console takes: far above a cycle's messages, far below what would hurt."""

LONGEST_ORDER = 4096
"""Bytes of the longest frame that a mission takes: an order is some tens."""


class LinkError(SmolbotError, ConnectionError):
    """A peer that is gone, that does not prove itself, or that says what makes no sense."""


class Kind(IntEnum):
    """What a frame holds."""

    HELLO = 1
    """JSON: who connects, and what for."""
    MESSAGE = 2
    """Of the record's stream: topic, time and bytes."""
    BEAT = 3
    """Still here; nothing else."""
    STOP = 4
    """Stop at once; the payload says who asks, in words."""
    PAUSE = 5
    RESUME = 6
    STOPPED = 7
    """Outputs are at zero; JSON."""
    STATE = 8
    """JSON: how the mission is, by itself."""
    BYE = 9
    """The end, on purpose; words."""
    ERROR = 10
    """Why the connection is closed; words."""


_HEAD = struct.Struct("!IB")


def frame(kind: Kind, payload: bytes = b"") -> bytes:
    """A frame as it is sent.

    Examples
    --------
    >>> frame(Kind.STOP, b"key")
    b'\\x00\\x00\\x00\\x03\\x04key'
    """
    return _HEAD.pack(len(payload), kind) + payload


def message(topic: str, time_ns: int, data: bytes) -> bytes:
    """One message of the record's stream, as a frame."""
    name = topic.encode()
    return frame(Kind.MESSAGE, struct.pack("!BQ", len(name), time_ns) + name + data)


def parse_message(payload: bytes) -> tuple[str, int, bytes]:
    """Topic, time in ns and bytes of a message.

    Raises
    ------
    LinkError
        If it is cut short.
    """
    try:
        length, time_ns = struct.unpack_from("!BQ", payload)
        topic = payload[9 : 9 + length].decode()
    except (struct.error, UnicodeDecodeError) as error:
        raise LinkError(f"a message of {len(payload)} bytes has no topic and time: {error}") from error
    if not topic.startswith("/") or len(payload) < 9 + length:
        raise LinkError(f"a message of {len(payload)} bytes has no topic")
    return topic, time_ns, payload[9 + length :]


def receive(sock: socket.socket, longest: int) -> tuple[Kind, bytes]:
    """The next frame.

    Raises
    ------
    TimeoutError
        If nothing came within the socket's timeout.
    LinkError
        If the peer is gone, or what it sends is no frame.
    """
    length, number = _HEAD.unpack(exactly(sock, _HEAD.size))
    if length > longest:
        raise LinkError(f"a frame of {length} bytes; at most {longest} are taken")
    if number not in Kind._value2member_map_:
        raise LinkError(f"a frame of unknown kind {number}")
    return Kind(number), exactly(sock, length)


def exactly(sock: socket.socket, count: int) -> bytes:
    """That many bytes; of a frame cut short by a silence, `LinkError`."""
    parts: list[bytes] = []
    missing = count
    while missing:
        try:
            part = sock.recv(min(missing, 65536))
        except TimeoutError:
            raise TimeoutError(f"silence, {missing} of {count} bytes missing") from None
        except OSError as error:
            raise LinkError(f"the connection broke: {error.strerror or error}") from error
        if not part:
            raise LinkError("the connection was closed")
        parts.append(part)
        missing -= len(part)
    return b"".join(parts)
