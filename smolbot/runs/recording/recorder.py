"""Write ``run.mcap``, the record of a run, during the run."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from smolbot.errors import InputError
from smolbot.runs.recording import messages
from smolbot.runs.recording import run_pb2 as pb
from smolbot.runs.recording.converter import Converter
from smolbot.runs.recording.message_queue import MessageQueue
from smolbot.runs.recording.queue_entries import Message
from smolbot.runs.recording.run_files import RunFiles
from smolbot.runs.run import Run

RECORD = "run.mcap"
"""File of a run folder."""

PROFILE = "smolbot"
"""Profile in the file's header, which distinguishes our records from other MCAP files."""

CHUNK = 4 * 2**20
"""Bytes of a chunk; a flush ends one earlier."""


def lock(file: IO[bytes]) -> bool:
    """Lock a record while it is being written, for as long as it is open.

    Parameters
    ----------
    file : binary file

    Returns
    -------
    bool
        False if another process has locked it.
    """
    try:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except (ImportError, OSError):  # a system or a disk without such marks
        return True
    return True


class McapFile:
    """A record as an MCAP file; flushed messages survive the process, however it ends.

    The MCAP library holds Python's global lock while it writes, so it writes into memory. A flush passes that to
    the operating system without the lock: a slow disk does not stop the loop.

    Parameters
    ----------
    path : Path
    flushed : callable, optional
        Called after each flush with the number of messages in the file.

    Raises
    ------
    InputError
        If the file exists already, or cannot be made.
    """

    def __init__(self, path: Path, flushed: Callable[[int], None] | None = None) -> None:
        import foxglove
        from foxglove.mcap import MCAPWriteOptions

        try:
            self._file = path.open("xb", buffering=0)
        except OSError as error:
            raise InputError(f"{path}: the record cannot be made: {error.strerror or error}.") from error
        lock(self._file)
        self._made = _WriteBuffer()
        self._context = foxglove.Context()
        options = MCAPWriteOptions(chunk_size=CHUNK, compression_threads=0, profile=PROFILE, disable_seeking=True)
        self._writer = foxglove.open_mcap(self._made, context=self._context, writer_options=options)  # type: ignore[arg-type]
        self._channels: dict[str, Any] = {}
        self._flushed = flushed
        self._count = 0
        self._torn = False

    def write(self, message: Message) -> None:
        """Append one message.

        Parameters
        ----------
        message : Message
        """
        self.append(message.topic, message.nanoseconds, message.content.SerializeToString())

    def append(self, topic: str, nanoseconds: int, data: bytes) -> None:
        """Append an encoded message.

        Parameters
        ----------
        topic : str
        nanoseconds : int, in ns
            Time on the rig's clock.
        data : bytes
        """
        self._get_channel(topic).log(data, log_time=nanoseconds)
        self._count += 1

    def flush(self) -> None:
        """Pass everything written so far to the operating system."""
        self._writer.flush()
        self._pass_on()
        if self._flushed is not None:
            self._flushed(self._count)

    def close(self) -> None:
        """Finish the file; after a write error it stays torn as it is."""
        try:
            self._writer.close()
            if not self._torn:
                self._pass_on()
                os.fsync(self._file.fileno())
        finally:
            self._file.close()
            for channel in self._channels.values():
                channel.close()
            self._channels.clear()

    def _pass_on(self) -> None:
        made = memoryview(self._made.take())
        while made:
            try:
                made = made[self._file.write(made) :]
            except OSError:
                self._torn = True
                raise

    def _get_channel(self, topic: str) -> Any:
        known = self._channels.get(topic)
        if known is None:
            from foxglove import Channel, Schema

            name = messages.TOPICS[topic].DESCRIPTOR.full_name
            schema = Schema(name=name, encoding="protobuf", data=_make_schema())
            known = Channel(topic, schema=schema, message_encoding="protobuf", context=self._context)
            self._channels[topic] = known
        return known


class _WriteBuffer:
    """A write buffer that looks to the MCAP library like a file that is only appended to."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self._before = 0

    def write(self, data: bytes) -> int:
        self._bytes += data
        return len(data)

    def seek(self, offset: int, whence: int = 0) -> int:
        end = self._before + len(self._bytes)
        if (whence, offset) not in ((1, 0), (2, 0), (0, end)):
            raise OSError("a record is only appended to")
        return end

    def flush(self) -> None:
        """Do nothing: the buffer is emptied by `taken`."""

    def take(self) -> bytes:
        taken = bytes(self._bytes)
        self._before += len(taken)
        self._bytes.clear()
        return taken


def _make_schema() -> bytes:
    """Return the description of every message in the form that MCAP requires."""
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    found = FileDescriptorSet()
    pb.DESCRIPTOR.CopyToProto(found.file.add())
    return found.SerializeToString()


class Recorder(MessageQueue):
    """The record of one run in its folder, notified of shots and events as a recorder sink, and of every cycle.

    Parameters
    ----------
    folder : Path
        The run folder.
    converter : Converter
    flushed : callable, optional
        Called after each flush with the number of messages in the file.
    **options : object
        See `MessageQueue`.
    """

    def __init__(
        self, folder: Path, converter: Converter, flushed: Callable[[int], None] | None = None, **options: Any
    ) -> None:
        self.path = folder / RECORD
        super().__init__(McapFile(self.path, flushed), converter, **options)


def make_begin_message(files: RunFiles, provenance: dict[str, Any], converter: Converter) -> pb.Begin:
    """Build the first message of a record: files, provenance and converter.

    Parameters
    ----------
    files : RunFiles
    provenance : dict
    converter : Converter

    Returns
    -------
    pb.Begin
    """
    return pb.Begin(
        format=messages.FORMAT,
        files=files.contents,
        names=files.names,
        provenance=json.dumps(provenance, default=str),
        converter=messages.encode_converter(converter),
    )


def make_end_message(run: Run) -> pb.End:
    """Build the last message of a record: how the run ended.

    Parameters
    ----------
    run : Run

    Returns
    -------
    pb.End
    """
    return pb.End(
        status=run.status,
        stop_reason=run.stop_reason,
        duration=run.duration,
        wall=run.wall,
        begun=run.begun,
        recovered=json.dumps(run.recovered),
        safety=json.dumps(run.safety, default=str),
    )
