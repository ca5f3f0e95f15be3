"""Where the consoles of this user are written down, so that missions and ``smolbot stop`` find them."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import socket
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from smolbot.ui.link.frames import Kind, LinkError, frame
from smolbot.ui.link.handshake import PATIENCE, call

ENVIRONMENT = "SMOLBOT_CONSOLE"
"""Names the file of the console that a mission belongs to, where a console has started it."""


@dataclass(frozen=True)
class Console:
    """A console that runs, or ran.

    Attributes
    ----------
    process : int
    link : int
        Loopback port for missions and for ``smolbot stop``.
    secret : str
        That both ends of a link prove to know, in hexadecimal.
    address : str
        Of its page, with the token where it has one.
    port : int
        Of its page.
    runs : str
        Folder whose runs it shows.
    """

    process: int
    link: int
    secret: str
    address: str
    port: int
    runs: str

    def connect(self) -> socket.socket:
        """A connection that was proved from both ends, with `PATIENCE` as its timeout.

        Raises
        ------
        LinkError
            If no console answers, or not this one.
        """
        try:
            sock = socket.create_connection(("127.0.0.1", self.link), PATIENCE)
        except OSError as error:
            raise LinkError(f"no console answers at 127.0.0.1:{self.link}: {error.strerror or error}") from error
        try:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            call(sock, bytes.fromhex(self.secret))
        except BaseException:
            sock.close()
            raise
        return sock


def new_secret() -> str:
    """Of 256 bits, in hexadecimal."""
    return secrets.token_hex(32)


def kept_in() -> Path:
    """The folder of the files: the session's own where there is one, else in the user's cache."""
    session = os.environ.get("XDG_RUNTIME_DIR")
    if session and Path(session).is_dir():
        return Path(session) / "smolbot"
    from lookup_tables.cache import default_cache_dir

    return default_cache_dir() / "consoles"


def write_down(console: Console) -> Path:
    """Keep a file of it that only this user can read; its path."""
    folder = kept_in()
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    path = folder / f"console-{console.port}.json"
    part = path.with_suffix(f".{os.getpid()}.part")
    with contextlib.suppress(FileNotFoundError):
        part.unlink()
    with open(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
        json.dump(asdict(console), file)
    os.replace(part, path)
    return path


def read(path: Path) -> Console | None:
    """The console of a file; None if it is none."""
    try:
        return Console(**json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


def answering(silent: list[str] | None = None) -> Iterator[tuple[Console, socket.socket]]:
    """Every console of this user that answers, the newest first, with a connection that was proved.

    Files of those that ended are cleared away; those that hang are added to `silent`, in words.
    """
    found: list[tuple[float, Console, Path]] = []
    for path in kept_in().glob("console-*.json"):
        console = read(path)
        if console is not None:
            with contextlib.suppress(FileNotFoundError):  # it ended between two looks
                found.append((path.stat().st_mtime, console, path))
    for _, console, path in sorted(found, key=lambda each: each[0], reverse=True):
        try:
            sock = console.connect()
        except LinkError as error:
            if isinstance(error.__cause__, ConnectionRefusedError):
                path.unlink(missing_ok=True)
            elif silent is not None:
                silent.append(f"{console.address}: {error}")
            continue
        yield console, sock


def running() -> list[Console]:
    """Every console of this user that answers, the newest first."""
    found = []
    for console, sock in answering():
        with contextlib.suppress(OSError), sock:
            sock.sendall(frame(Kind.HELLO, b'{"role": "look"}'))
        found.append(console)
    return found
