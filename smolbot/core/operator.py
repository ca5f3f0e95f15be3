"""The person at the bench, who does by hand what no stage can do, and is asked in the terminal."""

from __future__ import annotations

import io
import os
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import Any, Protocol, TextIO

from smolbot.errors import RigError

DONE_ANSWERS = ("", "y", "yes", "done", "ok")
ABORT_ANSWERS = ("q", "quit", "n", "no", "abort")
_POLL_INTERVAL = 0.05  # s: between two checks whether the operator has acted


class Operator(Protocol):
    """A person, or a stand-in, who can be asked to do something at the bench."""

    def ask(self, question: str, timeout: float, until: Callable[[], bool] | None = None) -> bool:
        """Ask for something to be done, and wait until it is.

        Parameters
        ----------
        question : str
            What is to be done, such as ``Bring the magnet near``.
        timeout : float, in s
        until : callable, optional
            Polled while waiting. It returns True once the action was done, for instance by an end switch; then no
            answer is needed. It may raise, which ends the wait.

        Returns
        -------
        bool
            True once it was done, False if the operator aborts.

        Raises
        ------
        RigError
            If nobody answers in time, or nobody can be asked.
        """

    def say(self, text: str) -> None:
        """Show the operator a message that needs no answer.

        Parameters
        ----------
        text : str
        """


class SilentOperator:
    """Stand-in for an unattended run: only actions that a switch can confirm are possible."""

    def ask(self, question: str, timeout: float, until: Callable[[], bool] | None = None) -> bool:
        """Wait until `until` reports that it was done.

        Parameters
        ----------
        question : str
            What is to be done.
        timeout : float, in s
        until : callable, optional
            Polled while waiting; required here.

        Returns
        -------
        bool
            Always True.

        Raises
        ------
        RigError
            Without `until`, or if it is not True in time.
        """
        if until is None:
            raise RigError(
                f"No operator is present to ask: '{question}'. Use smolbot run in a terminal, or pass "
                "operator=TerminalOperator()."
            )
        end = time.monotonic() + timeout
        while not until():
            if time.monotonic() >= end:
                raise RigError(f"Nothing happened within {timeout:g} s of: '{question}'.")
            time.sleep(_POLL_INTERVAL)
        return True

    def say(self, text: str) -> None:
        """Ignore the message.

        Parameters
        ----------
        text : str
        """


class TerminalOperator:
    """Operator who is asked on standard error and answers in lines of standard input, a terminal or not.

    Enter means done, q means abort.

    Parameters
    ----------
    source, out : text streams, optional
        Standard input and error unless given.

    Attributes
    ----------
    pauses : list of callables
        Each makes a context in which the terminal is free for a question: it hides a progress bar, or stops a thread
        that reads keys.
    """

    def __init__(self, source: TextIO | None = None, out: TextIO | None = None) -> None:
        self.pauses: list[Callable[[], AbstractContextManager[Any]]] = []
        self._source, self._out = source, out
        self._lines: _Lines | None = None

    def ask(self, question: str, timeout: float, until: Callable[[], bool] | None = None) -> bool:
        """Ask in the terminal and wait for the answer; see `Operator.ask`.

        An unclear answer is asked for again; the time-out covers all attempts together.

        Parameters
        ----------
        question : str
            What is to be done.
        timeout : float, in s
        until : callable, optional
            Polled while waiting: True means that it was done.

        Returns
        -------
        bool
            True once it was done, False if the operator aborts.

        Raises
        ------
        RigError
            If nobody answers in time, or standard input has ended.
        """
        with self._pause_others():
            out = self._out or sys.stderr  # a progress bar that is paused restores it
            lines = self._open_reader()
            lines.discard_pending()
            end = time.monotonic() + timeout
            print(f"{question}  [Enter: done, q: abort, {timeout:g} s] ", end="", file=out, flush=True)
            while True:
                answer = self._wait_for_answer(lines, end, until, question, timeout)
                if answer in DONE_ANSWERS or answer in ABORT_ANSWERS:
                    return answer in DONE_ANSWERS
                print(f"'{answer}' is neither: Enter when it is done, q to abort ", end="", file=out, flush=True)

    def say(self, text: str) -> None:
        """Print one line on standard error.

        Parameters
        ----------
        text : str
        """
        with self._pause_others():
            print(text, file=self._out or sys.stderr, flush=True)

    def _wait_for_answer(
        self, lines: _Lines, end: float, until: Callable[[], bool] | None, question: str, timeout: float
    ) -> str:
        ended = False
        while True:
            if until is not None and until():
                print("done", file=self._out or sys.stderr, flush=True)
                return ""
            left = end - time.monotonic()
            if left <= 0.0:
                raise RigError(f"The operator did not answer within {timeout:g} s: '{question}'.")
            if ended:  # only `until` can answer now
                time.sleep(min(left, _POLL_INTERVAL))
                continue
            try:
                line = lines.read_line(min(left, _POLL_INTERVAL))
            except EOFError:
                if until is None:
                    raise RigError(
                        f"Nobody can answer '{question}': standard input has ended. Run it in a terminal, or give one "
                        "line for each question."
                    ) from None
                ended = True
                continue
            if line is not None:
                return line.strip().lower()

    @contextmanager
    def _pause_others(self) -> Iterator[None]:
        with ExitStack() as stack:
            for pause in self.pauses:
                stack.enter_context(pause())
            yield

    def _open_reader(self) -> _Lines:
        if self._lines is None:
            source = self._source or sys.stdin
            try:
                number = source.fileno()
            except (AttributeError, OSError, io.UnsupportedOperation):
                number = -1
            self._lines = _ThreadLines(source) if number < 0 or os.name == "nt" else _DescriptorLines(number)
        return self._lines


class _Lines(Protocol):
    def read_line(self, timeout: float) -> str | None:
        """Return the next line, or None if none came within `timeout` s; raise EOFError at the end."""

    def discard_pending(self) -> None:
        """Drop what was typed before the question."""


class _DescriptorLines:
    """Reader of a file descriptor's lines, without a thread that would go on reading after the question."""

    def __init__(self, number: int) -> None:
        self._number = number
        self._held = b""

    def read_line(self, timeout: float) -> str | None:
        import select

        end = time.monotonic() + timeout
        while b"\n" not in self._held:
            ready, _, _ = select.select([self._number], [], [], max(end - time.monotonic(), 0.0))
            if not ready:
                return None
            read = os.read(self._number, 1024)
            if not read:
                if not self._held:
                    raise EOFError
                self._held += b"\n"  # a last line without a line break
                break
            self._held += read
        line, _, self._held = self._held.partition(b"\n")
        return line.decode(errors="replace")

    def discard_pending(self) -> None:
        if os.isatty(self._number):
            import termios

            self._held = b""
            termios.tcflush(self._number, termios.TCIFLUSH)


class _ThreadLines:
    """Lines of a stream that cannot be polled: that of a notebook, or of Windows."""

    def __init__(self, source: TextIO) -> None:
        self._queue: queue.Queue[str | None] = queue.Queue()
        threading.Thread(target=self._read, args=(source,), daemon=True).start()

    def _read(self, source: TextIO) -> None:
        try:
            for line in iter(source.readline, ""):
                self._queue.put(line)
        finally:
            self._queue.put(None)

    def read_line(self, timeout: float) -> str | None:
        try:
            line = self._queue.get(timeout=timeout)
        except queue.Empty:
            return None
        if line is None:
            self._queue.put(None)
            raise EOFError
        return line

    def discard_pending(self) -> None:
        """Keep everything: a stream that is no terminal holds answers given in advance."""
