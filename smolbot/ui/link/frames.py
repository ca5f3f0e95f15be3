"""Frames of the link between a mission and its console: length, kind and payload, with a limit on the length."""

from __future__ import annotations

import socket
import struct
from enum import IntEnum

from smolbot.errors import SmolbotError

MAX_FRAME_SIZE = 4_000_000
"""Largest frame, in bytes, that a console accepts: far above a cycle's messages, far below what would do harm."""

MAX_ORDER_SIZE = 4096
"""Largest frame, in bytes, that a mission accepts; an order has some tens."""


class LinkError(SmolbotError, ConnectionError):
    """The peer is gone, is not authenticated, or sends invalid frames."""


class Kind(IntEnum):
    """Kind of a frame."""

    HELLO = 1
    """JSON: who connects, and what for."""
    MESSAGE = 2
    """A message of the record: topic, time and bytes."""
    BEAT = 3
    """A heartbeat."""
    STOP = 4
    """Order to stop at once; the payload names who gives it."""
    PAUSE = 5
    RESUME = 6
    STOPPED = 7
    """Outputs are at zero; JSON."""
    STATE = 8
    """JSON: state of the mission."""
    BYE = 9
    """Planned end; text."""
    ERROR = 10
    """Why the connection is closed; text."""


_HEAD = struct.Struct("!IB")


def make_frame(kind: Kind, payload: bytes = b"") -> bytes:
    r"""Build a frame.

    Parameters
    ----------
    kind : Kind
    payload : bytes

    Returns
    -------
    bytes

    Examples
    --------
    >>> make_frame(Kind.STOP, b"key")
    b'\x00\x00\x00\x03\x04key'
    """
    return _HEAD.pack(len(payload), kind) + payload


def make_message_frame(topic: str, time_ns: int, data: bytes) -> bytes:
    """Build the frame of one message of the record.

    Parameters
    ----------
    topic : str
    time_ns : int
    data : bytes
        Serialized protobuf message.

    Returns
    -------
    bytes
    """
    name = topic.encode()
    return make_frame(Kind.MESSAGE, struct.pack("!BQ", len(name), time_ns) + name + data)


def parse_message(payload: bytes) -> tuple[str, int, bytes]:
    """Parse the payload of a message frame.

    Parameters
    ----------
    payload : bytes

    Returns
    -------
    topic : str
    time_ns : int
    data : bytes

    Raises
    ------
    LinkError
        If it is incomplete.
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
    """Receive the next frame.

    Parameters
    ----------
    sock : socket.socket
    longest : int
        Largest allowed payload, in bytes.

    Returns
    -------
    kind : Kind
    payload : bytes

    Raises
    ------
    TimeoutError
        If nothing came within the socket's timeout.
    LinkError
        If the peer is gone, or sends an invalid frame.
    """
    length, number = _HEAD.unpack(receive_exactly(sock, _HEAD.size))
    if length > longest:
        raise LinkError(f"a frame of {length} bytes; at most {longest} are taken")
    if number not in Kind._value2member_map_:
        raise LinkError(f"a frame of unknown kind {number}")
    return Kind(number), receive_exactly(sock, length)


def receive_exactly(sock: socket.socket, count: int) -> bytes:
    """Receive a given number of bytes.

    Parameters
    ----------
    sock : socket.socket
    count : int

    Returns
    -------
    bytes

    Raises
    ------
    TimeoutError
        If they did not come within the socket's timeout.
    LinkError
        If the connection was closed or broke.
    """
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
