"""Opens a console and keeps it open: the link for missions, the page, and the file by which it is found."""

from __future__ import annotations

import contextlib
import logging
import os
import secrets
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from smolbot.errors import InputError
from smolbot.ui.console.hub import Hub, Log
from smolbot.ui.console.page_access import LOOPBACK, PageAccess, check_port_free
from smolbot.ui.link.console_server import ConsoleServer
from smolbot.ui.link.consoles import Console, list_running, make_secret, read_console, write_console

PORT = 8420
"""Default port of the page."""

IDLE_TIMEOUT = 5.0
"""Seconds that a console that a mission has opened stays open without a mission and without a page."""

JOIN_TIMEOUT = 30.0
"""Seconds that such a console waits for its mission."""


class OpenConsole:
    """A console, from when it is made until it is closed.

    Parameters
    ----------
    host : str
        Address of the page.
    port : int
        Port of the page.
    token : str, optional
        Token that a browser must show; by default one is made if other machines can reach the host.
    runs : Path
        Folder of the runs that it shows.
    log : callable
        Called with each line of the log.

    Raises
    ------
    InputError
        If a console of this user shows these runs already, or the port is busy.
    """

    def __init__(
        self, host: str = "127.0.0.1", port: int = PORT, token: str | None = None, runs: Path = Path("runs"),
        log: Callable[[str], None] = lambda line: print(line, file=sys.stderr, flush=True),
    ) -> None:  # fmt: skip
        for other in list_running():
            if Path(other.runs) == runs.absolute() or other.port == port:
                raise InputError(
                    f"A console runs already (process {other.process}) and shows {other.runs} at {other.address}. "
                    "Use that one, or end it with Ctrl-C where it was started; another needs other --runs and --port."
                )
        if token is None:
            token = "" if host in LOOPBACK else secrets.token_urlsafe(18)
        self.access = PageAccess(host, port, token)
        check_port_free(host, port)
        from smolbot.ui.console.page import Page

        for name in ("websockets.server", "websockets"):  # what strangers send is answered, and not worth a traceback
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self.hub = Hub(Log(log))
        secret = make_secret()
        self.page = Page(self.access, self.hub, runs)
        self.hub.console_server = ConsoleServer(secret, self.hub, self.hub.stop, self.hub.log)
        self.console = Console(
            os.getpid(), self.hub.console_server.port, secret, self.access.address, port, str(runs.absolute())
        )  # fmt: skip
        self.file = self.hub.file = write_console(self.console)

    def wait(self, over: threading.Event, *, follow: bool = False) -> None:
        """Wait until the console is to end.

        Parameters
        ----------
        over : threading.Event
            Ends it when set.
        follow : bool
            End also once no mission and no page is left.
        """
        left = 0.0
        connected = False
        while not over.wait(0.25):
            connected |= self.hub.flying
            left = 0.0 if self.hub.busy or self.page.bar.open else left + 0.25
            if follow and left >= (IDLE_TIMEOUT if connected else JOIN_TIMEOUT):
                return

    def close(self) -> None:
        """Stop every mission, and close page and link."""
        self.hub.close()
        if read_console(self.file) == self.console:
            self.file.unlink(missing_ok=True)
        self.page.close()


@contextlib.contextmanager
def watch_end_signals() -> Iterator[threading.Event]:
    """Make an event that Ctrl-C and SIGTERM set while a ``with`` block runs.

    Yields
    ------
    threading.Event
    """
    over = threading.Event()
    before = {number: signal.signal(number, lambda *_: over.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield over
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
