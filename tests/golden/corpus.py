"""The files of the corpus: records and signals that are never made anew, answers that are, and what tells of either."""

from __future__ import annotations

import hashlib
import lzma
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import date
from pathlib import Path

from tests.golden.answers import GoldenFileError

HERE = Path(__file__).parent
RECORDS, SIGNALS, EXPECTED = HERE / "records", HERE / "signals", HERE / "expected"
WINDOWS = HERE / "WINDOWS.sha256"
"""Digests of everything that was heard; nothing here writes a line of it twice."""
CHANGES = HERE / "CHANGES.md"
LIMIT = 12e6
"""Bytes of the whole corpus."""


def digest(path: Path) -> str:
    """Of a file's bytes, short enough for a table."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


@contextmanager
def unpacked(path: Path) -> Iterator[Path]:
    """A packed record as a file in a folder of its own, while the block runs.

    Raises
    ------
    GoldenFileError
        If it is missing or torn.
    """
    try:
        content = lzma.decompress(path.read_bytes())
    except FileNotFoundError:
        raise GoldenFileError(f"{path}: is missing; take it from version control again.") from None
    except (lzma.LZMAError, EOFError) as error:
        raise GoldenFileError(f"{path}: is torn: {error}; take it from version control again.") from error
    with tempfile.TemporaryDirectory() as folder:
        inside = Path(folder) / "run.mcap"
        inside.write_bytes(content)
        yield inside


def windows() -> dict[str, str]:
    """Digest by file, of every record and signal."""
    lines = WINDOWS.read_text(encoding="utf-8").splitlines() if WINDOWS.exists() else []
    return {name: told for told, name in (line.split() for line in lines)}


def pack_record(name: str, record: Path) -> Path:
    """Add the record of a run, its chunks unpacked so that xz sees the samples; a name that is taken is refused."""
    from mcap.reader import make_reader
    from mcap.writer import CompressionType, Writer

    path = RECORDS / f"{name}.mcap.xz"
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / "run.mcap"
        with record.open("rb") as source, plain.open("wb") as target:
            writer = Writer(target, compression=CompressionType.NONE)
            writer.start(profile="", library="smolbot")
            channels: dict[int, int] = {}
            for schema, channel, message in make_reader(source).iter_messages(log_time_order=False):
                if channel.id not in channels:
                    assert schema is not None
                    known = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, known)
                where = channels[channel.id]
                writer.add_message(where, message.log_time, message.data, message.publish_time, message.sequence)
            writer.finish()
        add_windows(path, lzma.compress(plain.read_bytes(), preset=9))
    return path


def add_windows(path: Path, content: bytes) -> None:
    """Write a new file of records or signals, and its digest; one that is there is never written again."""
    name = path.relative_to(HERE).as_posix()
    if path.exists() or name in windows():
        raise GoldenFileError(f"{path}: is there; what was heard is never made anew. Take another name.")
    path.write_bytes(content)
    with WINDOWS.open("a", encoding="utf-8") as file:
        file.write(f"{digest(path)} {name}\n")


def read_reports() -> dict[str, str]:
    """The digest that ``CHANGES.md`` tells last of each file of answers."""
    rows = [line.split("|") for line in CHANGES.read_text(encoding="utf-8").splitlines() if line.startswith("| 2")]
    return {row[2].strip(): row[3].strip() for row in rows}


def tell(name: str, why: str, sizes: str) -> None:
    """Add a row to ``CHANGES.md`` about answers that were made anew."""
    if not why.strip() or "|" in why or "\n" in why:
        raise GoldenFileError("say why in one line without '|': --why \"…\"; nothing was written.")
    with CHANGES.open("a", encoding="utf-8") as file:
        file.write(f"| {date.today()} | {name} | {digest(EXPECTED / f'{name}.json.xz')} | {sizes} | {why.strip()} |\n")
