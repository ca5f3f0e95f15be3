"""Connects a mission to the console that shows it, and opens a console if none runs."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smolbot.errors import InputError
from smolbot.flight.safety.stop_latch import Latch
from smolbot.ui.link.consoles import ENVIRONMENT, Console, list_running, read_console
from smolbot.ui.link.feed import Feed, PauseSwitch
from smolbot.ui.link.frames import LinkError

if TYPE_CHECKING:
    from smolbot.runs.recording.queue_entries import Message

OPEN_TIMEOUT = 30.0
"""Seconds within which a new console must open its page."""


class ConsoleSink:
    """Recorder sink that sends the messages of a mission to its console.

    Parameters
    ----------
    feed : Feed
    """

    def __init__(self, feed: Feed) -> None:
        self._feed = feed

    def write(self, message: Message) -> None:
        """Queue a message for sending.

        Parameters
        ----------
        message : Message
        """
        self._feed.put(message.topic, message.nanoseconds, message.content.SerializeToString())

    def flush(self) -> None:
        """Do nothing: messages are sent as they come."""

    def close(self) -> None:
        """Do nothing: whoever began the feed ends it."""


def join_console(console: Console, about: Mapping[str, Any], latch: Latch, pause: PauseSwitch) -> Feed:
    """Connect this mission to a console.

    Parameters
    ----------
    console : Console
    about : mapping
        Description of the mission, which is sent as JSON.
    latch : Latch
    pause : PauseSwitch

    Returns
    -------
    Feed
        It has begun.

    Raises
    ------
    InputError
        If the console does not answer. Nothing has moved by then.
    """
    try:
        feed = Feed(console.connect(), {"process": os.getpid(), **about}, latch, pause)
    except (LinkError, OSError) as error:
        raise InputError(f"The console of process {console.process} cannot be joined: {error}.") from error
    feed.begin()
    return feed


def find_console(port: int | None = None) -> tuple[Console, bool]:
    """Find the console of a mission: the one that has started it, else one that runs, else a new one.

    Parameters
    ----------
    port : int, optional
        Port of the console's page; any unless given.

    Returns
    -------
    console : Console
    opened : bool
        Whether it was opened for this mission; it then ends by itself once its page is closed.

    Raises
    ------
    InputError
        If no console runs and none can be opened.
    """
    named = os.environ.get(ENVIRONMENT)
    if named:
        console = read_console(Path(named))
        if console is None:
            raise InputError(f"{ENVIRONMENT} names {named}, where no console is written down. Did it end?")
        return console, False
    known = [console for console in list_running() if port is None or console.port == port]
    return (known[0], False) if known else (_open_console(port), True)


def _open_console(port: int | None) -> Console:
    command = [sys.executable, "-P", "-m", "smolbot", "console", "--follow"]
    command += [] if port is None else ["--port", str(port)]
    apart: dict[str, Any] = (
        {"start_new_session": True}
        if os.name == "posix"
        else {"creationflags": 0x00000200}  # a process group of its own
    )
    with tempfile.TemporaryFile("w+") as output:  # not a pipe: the console goes on to write when nobody reads any more
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=output, **apart
        )  # fmt: skip
        end = time.monotonic() + OPEN_TIMEOUT
        while time.monotonic() < end and process.poll() is None:
            for console in list_running():
                if console.process == process.pid:
                    return console
            time.sleep(0.1)
        if process.poll() is None:
            process.kill()
            raise InputError(f"No console opened within {OPEN_TIMEOUT:g} s.")
        output.seek(0)
        why = output.read().strip() or f"exit code {process.returncode}"
    raise InputError(f"No console could be opened: {why}")
