"""A key that stops: reads the terminal while a mission runs, and restores it afterwards."""

from __future__ import annotations

import atexit
import os
import re
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import TracebackType
from typing import Self

STOP_KEYS = (b"q", b"Q", b"\x1b")
"""q, or Esc by itself. Arrow and function keys also send an Esc first; they stop nothing."""

STOP_KEY_REASON = "stopped by the operator (key)"

_ESCAPE_SEQUENCE = rb"\x1b[\[O][0-9;]*[A-Za-z~]"  # of an arrow or function key
_POLL_INTERVAL = 0.2  # s between two looks whether the terminal is still ours
_SEQUENCE_TIMEOUT = 0.05  # s within which the rest of an arrow key's sequence has come


class Keyboard:
    """Calls a function when a stop key is pressed while a ``with`` block runs, from a thread of its own.

    Does nothing if standard input is no terminal, if this process is in its background, and on Windows.

    Parameters
    ----------
    stop : callable
        Takes no arguments.
    number : int, optional
        File descriptor of the terminal; standard input's unless given.

    Attributes
    ----------
    active : bool
        Whether the terminal is read.
    """

    def __init__(self, stop: Callable[[], object], number: int | None = None) -> None:
        self._stop: Callable[[], object] = stop
        self._number = number
        self._thread: threading.Thread | None = None
        self._kept: list[object] | None = None
        self._ours = threading.Lock()
        self._wake: tuple[int, int] | None = None
        self.active = False

    def __enter__(self) -> Self:
        number = self._find_terminal()
        if number is None:
            return self
        import termios

        self._number, self._kept = number, list(termios.tcgetattr(number))
        atexit.register(self._restore)
        self._wake = os.pipe()
        self.active = True
        self._listen()
        self._thread = threading.Thread(target=self._watch, name="stop key", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._thread is None or self._wake is None:
            return
        self.active = False
        os.write(self._wake[1], b"x")
        self._thread.join()
        for end in self._wake:
            os.close(end)
        self._restore()
        atexit.unregister(self._restore)

    @contextmanager
    def pause(self) -> Iterator[None]:
        """Restore the terminal while a ``with`` block asks a question."""
        if self._thread is None:
            yield
            return
        with self._ours:
            self._restore()
            try:
                yield
            finally:
                self._listen()

    def _find_terminal(self) -> int | None:
        if os.name != "posix":
            return None
        number = self._number
        if number is None:
            with suppress(AttributeError, OSError, ValueError):  # a stream that stands for standard input
                number = sys.stdin.fileno()
        return number if number is not None and os.isatty(number) and _is_in_foreground(number) else None

    def _listen(self) -> None:
        import termios
        import tty

        if self.active and self._number is not None and _is_in_foreground(self._number):
            tty.setcbreak(self._number, termios.TCSADRAIN)

    def _restore(self) -> None:
        import termios

        if self._number is not None and self._kept is not None and _is_in_foreground(self._number):
            with suppress(termios.error):  # the terminal may have been closed
                termios.tcsetattr(self._number, termios.TCSADRAIN, self._kept)  # type: ignore[arg-type]

    def _watch(self) -> None:
        import select

        assert self._number is not None
        assert self._wake is not None
        while self.active:
            ready, _, _ = select.select([self._wake[0], self._number], [], [], _POLL_INTERVAL)
            if self._wake[0] in ready:
                return
            if self._number not in ready or not self._ours.acquire(timeout=_POLL_INTERVAL):
                continue
            try:
                pressed = self._read_stop_key()
            except OSError:  # the terminal was closed: nobody can press anything
                return
            finally:
                self._ours.release()
            if pressed:
                self._stop()

    def _read_stop_key(self) -> bool:
        """Return whether a stop key was pressed; other keys are dropped."""
        import select

        assert self._number is not None
        if not _is_in_foreground(self._number) or not select.select([self._number], [], [], 0.0)[0]:
            return False
        keys = os.read(self._number, 64)
        if not keys:
            raise OSError("end of the terminal")
        if keys.endswith(b"\x1b") and select.select([self._number], [], [], _SEQUENCE_TIMEOUT)[0]:
            keys += os.read(self._number, 64)
        return has_stop_key(keys)


def has_stop_key(keys: bytes) -> bool:
    r"""Return whether a stop key is among the typed keys.

    Parameters
    ----------
    keys : bytes

    Returns
    -------
    bool

    Examples
    --------
    >>> has_stop_key(b"xq"), has_stop_key(b"\x1b"), has_stop_key(b"x\x1b[A\x1bOP\x1b[15~"), has_stop_key(b"\x1b[Aq")
    (True, True, False, True)
    """
    typed = re.sub(_ESCAPE_SEQUENCE, b"", keys)
    return any(key in typed for key in STOP_KEYS)


def _is_in_foreground(number: int) -> bool:
    """Return whether this process may use its terminal; one in the background would be suspended."""
    try:
        return os.tcgetpgrp(number) == os.getpgrp()
    except OSError:
        return False
