"""Read the messages of an MCAP file, as many as possible: reading goes on behind a torn or damaged part."""

from __future__ import annotations

import mmap
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from smolbot.errors import InputError

MAGIC = b"\x89MCAP0\r\n"
FOOTER, CHANNEL, MESSAGE, CHUNK, DATA_END, LAST_OPCODE = 0x02, 0x04, 0x05, 0x06, 0x0F, 0x0F
_ZSTD = b"\x04\x00\x00\x00zstd"
_BEFORE_ZSTD = 37  # bytes of a chunk record before the name of its compression
_FOOTER_SIZE = 9 + 20


class ScannedMessage(NamedTuple):
    """A message.

    Attributes
    ----------
    topic : str or None
        None if the file has lost it.
    time : int, in ns
        Log time.
    data : bytes
    """

    topic: str | None
    time: int
    data: bytes


class Scan:
    """The messages of a file, in the order in which they were written.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    lost_bytes : int
        Number of unreadable bytes, after all is read.
    finished : bool
        Whether the file has its end and no byte of it is damaged, after all is read.

    Raises
    ------
    InputError
        If it is no MCAP file, or cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.lost_bytes = 0
        self.finished = False
        self._topics: dict[int, str] = {}
        try:
            with path.open("rb") as file:
                start = file.read(len(MAGIC))
                if start != MAGIC:
                    raise InputError(f"{path}: is no MCAP file{_describe_start(start)}.")
                self._data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror or error}.") from error

    def read_messages(self) -> Iterator[ScannedMessage]:
        """Read every intact message.

        Yields
        ------
        ScannedMessage
        """
        data, size = self._data, len(self._data)
        self._topics = self._read_summary_channels()
        position = sound = len(MAGIC)  # up to `sound`, lengths are known to be right
        whole = True
        while position + 9 <= size:
            opcode, length = struct.unpack_from("<BQ", data, position)
            end = position + 9 + length
            if opcode == CHUNK and end <= size:
                records = _unpack(data[position + 9 : end])
                if records is not None:
                    yield from self._read_records(records)
                    position = sound = end
                    continue
                whole = False
                if self._is_record_start(end):
                    self.lost_bytes += end - position
                    position = sound = end
                    continue
            elif 0 < opcode <= LAST_OPCODE and end <= size:
                body = data[position + 9 : end]
                if opcode == DATA_END and len(body) >= 4:
                    (stated,) = struct.unpack_from("<I", body)
                    whole = whole and stated in (0, zlib.crc32(data[:position]))
                elif opcode == FOOTER and data[end:] == MAGIC and len(body) == 20:
                    begun, _, stated = struct.unpack("<QQI", body)
                    self.finished = whole and stated in (0, zlib.crc32(data[begun or position : end - 4]))
                    return
                else:
                    yield from self._read_record(opcode, body)
                position = end
                continue
            whole = False
            found = self._find_next_chunk(sound)
            if found is None:
                break
            self.lost_bytes += found - sound
            position = sound = found
        self.lost_bytes += size - position

    def _read_records(self, records: bytes) -> Iterator[ScannedMessage]:
        """Yield the messages of an unpacked chunk."""
        position = 0
        while position + 9 <= len(records):
            opcode, length = struct.unpack_from("<BQ", records, position)
            position += 9
            yield from self._read_record(opcode, records[position : position + length])
            position += length

    def _read_record(self, opcode: int, body: bytes) -> Iterator[ScannedMessage]:
        if opcode == CHANNEL:
            self._learn(body)
        elif opcode == MESSAGE and len(body) >= 22:
            channel, _, time, _ = struct.unpack_from("<HIQQ", body)
            yield ScannedMessage(self._topics.get(channel), time, body[22:])

    def _learn(self, body: bytes) -> None:
        if len(body) >= 8:
            number, _, length = struct.unpack_from("<HHI", body)
            self._topics[number] = body[8 : 8 + length].decode("utf-8", "replace")

    def _read_summary_channels(self) -> dict[int, str]:
        """Read the topics by channel from the end of a finished file: their first mention may be damaged."""
        data, size = self._data, len(self._data)
        self._topics = {}
        at = size - len(MAGIC) - _FOOTER_SIZE
        if at > 0 and data[size - len(MAGIC) :] == MAGIC and data[at] == FOOTER:
            (position,) = struct.unpack_from("<Q", data, at + 9)
            while position > 0 and position + 9 <= at:
                opcode, length = struct.unpack_from("<BQ", data, position)
                if opcode == CHANNEL and position + 9 + length <= at:
                    self._learn(data[position + 9 : position + 9 + length])
                position += 9 + length
        return self._topics

    def _is_record_start(self, position: int) -> bool:
        if position + 9 > len(self._data):
            return position == len(self._data)
        opcode, length = struct.unpack_from("<BQ", self._data, position)
        return 0 < opcode <= LAST_OPCODE and position + 9 + length <= len(self._data)

    def _find_next_chunk(self, position: int) -> int | None:
        """Search byte by byte for the start of the next intact chunk."""
        data, size = self._data, len(self._data)
        hit = data.find(_ZSTD, position)
        while hit >= 0:
            start = hit - _BEFORE_ZSTD
            if start >= position and data[start] == CHUNK:
                (length,) = struct.unpack_from("<Q", data, start + 1)
                end = start + 9 + length
                if end <= size and _unpack(data[start + 9 : end]) is not None:
                    return start
            hit = data.find(_ZSTD, hit + 1)
        return None


def _unpack(chunk: bytes) -> bytes | None:
    """Unpack the records of a chunk; None if it is damaged."""
    import zstandard

    try:
        _, _, size, crc, named = struct.unpack_from("<QQQII", chunk)
        compression = chunk[32 : 32 + named]
        (length,) = struct.unpack_from("<Q", chunk, 32 + named)
        packed = chunk[40 + named :]
        if len(packed) != length or compression not in (b"", b"zstd"):
            return None
        records = zstandard.ZstdDecompressor().decompressobj().decompress(packed) if compression else packed
    except (struct.error, zstandard.ZstdError, MemoryError):
        return None
    if len(records) != size or (crc and zlib.crc32(records) != crc):
        return None
    return records


def _describe_start(start: bytes) -> str:
    return f"; it begins with {start!r}" if start else ", but empty"
