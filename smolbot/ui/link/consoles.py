"""Files that list the consoles of this user, by which missions and ``smolbot stop`` find them."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import socket
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from smolbot.ui.link.frames import Kind, LinkError, make_frame
from smolbot.ui.link.handshake import STEP_TIMEOUT, authenticate_to_console

ENVIRONMENT = "SMOLBOT_CONSOLE"
"""Environment variable with the file of the console that has started a mission."""


@dataclass(frozen=True)
class Console:
    """A console that runs, or ran.

    Attributes
    ----------
    process : int
    link : int
        Loopback port for missions and for ``smolbot stop``.
    secret : str
        Shared secret by which both ends of a link authenticate, in hexadecimal.
    address : str
        Address of its page, with the token if it has one.
    port : int
        Port of its page.
    runs : str
        Folder of the runs that it shows.
    """

    process: int
    link: int
    secret: str
    address: str
    port: int
    runs: str

    def connect(self) -> socket.socket:
        """Open a mutually authenticated connection, with `STEP_TIMEOUT` as its timeout.

        Returns
        -------
        socket.socket

        Raises
        ------
        LinkError
            If no console answers, or not this one.
        """
        try:
            sock = socket.create_connection(("127.0.0.1", self.link), STEP_TIMEOUT)
        except OSError as error:
            raise LinkError(f"no console answers at 127.0.0.1:{self.link}: {error.strerror or error}") from error
        try:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            authenticate_to_console(sock, bytes.fromhex(self.secret))
        except BaseException:
            sock.close()
            raise
        return sock


def make_secret() -> str:
    """Make a random secret of 256 bits.

    Returns
    -------
    str
        In hexadecimal.
    """
    return secrets.token_hex(32)


def find_folder() -> Path:
    """Return the folder of the files: that of the login session if there is one, else in the user's cache.

    Returns
    -------
    Path
    """
    session = os.environ.get("XDG_RUNTIME_DIR")
    if session and Path(session).is_dir():
        return Path(session) / "smolbot"
    from lookup_tables.cache import get_default_cache_dir

    return get_default_cache_dir() / "consoles"


def write_console(console: Console) -> Path:
    """Write the file of a console; only this user can read it.

    Parameters
    ----------
    console : Console

    Returns
    -------
    Path
    """
    folder = find_folder()
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    path = folder / f"console-{console.port}.json"
    part = path.with_suffix(f".{os.getpid()}.part")
    with contextlib.suppress(FileNotFoundError):
        part.unlink()
    with open(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
        json.dump(asdict(console), file)
    os.replace(part, path)
    return path


def read_console(path: Path) -> Console | None:
    """Read the file of a console.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Console or None
        None if it cannot be read.
    """
    try:
        return Console(**json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


def connect_to_all(silent: list[str] | None = None) -> Iterator[tuple[Console, socket.socket]]:
    """Connect to every console of this user that answers, the newest first.

    Files of consoles that have ended are removed.

    Parameters
    ----------
    silent : list of str, optional
        Extended by a sentence for each console that does not answer.

    Yields
    ------
    console : Console
    sock : socket.socket
        An authenticated connection.
    """
    found: list[tuple[float, Console, Path]] = []
    for path in find_folder().glob("console-*.json"):
        console = read_console(path)
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


def list_running() -> list[Console]:
    """List the consoles of this user that answer, the newest first.

    Returns
    -------
    list of Console
    """
    found = []
    for console, sock in connect_to_all():
        with contextlib.suppress(OSError), sock:
            sock.sendall(make_frame(Kind.HELLO, b'{"role": "look"}'))
        found.append(console)
    return found
