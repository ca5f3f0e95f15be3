"""An instrument controlled by SCPI over a socket: every exchange has a deadline, every refusal is an error."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from smolbot.errors import RigError

if TYPE_CHECKING:
    from pyvisa.resources import MessageBasedResource

MAX_QUEUE_LENGTH = 20
"""Number of entries of an error queue that are read before it counts as endless."""

LOCK_TIMEOUTS = 5.0
"""Number of time-outs that a thread waits for another thread's exchange to end."""

Permit = Callable[[], None]


class ScpiSocket:
    """One instrument behind a socket.

    After any failure the connection is closed, since a late answer must not be taken for the next one. The next
    exchange opens it anew.

    Parameters
    ----------
    name : str
        What and where it is, for the start of messages.
    address : str
        VISA address of a socket.
    timeout : float, in s
        Of connecting, and of every answer.
    """

    def __init__(self, name: str, address: str, timeout: float) -> None:
        self._name, self._address, self._timeout = name, address, timeout
        self._lock = threading.RLock()
        self._resource: MessageBasedResource | None = None

    def send_query(self, query: str, action: str) -> str:
        """Send a query and return its answer.

        Parameters
        ----------
        query : str
        action : str
            For the message of an error, such as "read back channel 1".

        Returns
        -------
        str

        Raises
        ------
        RigError
            If no answer comes; the message names device, address and action.
        """
        with self._hold_lock(action):
            return self._exchange(query, action)

    def send_commands(self, *commands: str, action: str, permit: Permit | None = None, then: str | None = None) -> str:
        """Send commands, and read the error queue after each; other threads wait meanwhile.

        Parameters
        ----------
        *commands : str
        action : str
            For the message of an error.
        permit : callable, optional
            Called right before the first command is sent, and may raise.
        then : str, optional
            Query to send afterwards.

        Returns
        -------
        str
            Answer to `then`; empty without it.

        Raises
        ------
        RigError
            If a command is refused or the instrument does not answer; the message names device, address and action.
        """
        with self._hold_lock(action):
            if permit is not None:
                permit()
            for command in commands:
                found = self._read_errors(command, action)
                if found:
                    raise self._fault(f"cannot {action}: it refused '{command}': {'; '.join(found)}.")
            return "" if then is None else self._exchange(then, action)

    def clear_errors(self, action: str) -> None:
        """Empty the error queue.

        Parameters
        ----------
        action : str
            For the message of an error.
        """
        with self._hold_lock(action):
            self._read_errors("*CLS", action)

    def close(self) -> None:
        """Close the connection; harmless when repeated."""
        with self._hold_lock("close the connection"):
            self._drop()

    @contextmanager
    def _hold_lock(self, action: str) -> Iterator[None]:
        if not self._lock.acquire(timeout=LOCK_TIMEOUTS * self._timeout):
            raise self._fault(f"cannot {action}: another thread's exchange with it does not end.")
        try:
            yield
        finally:
            self._lock.release()

    def _read_errors(self, command: str, action: str) -> list[str]:
        """Read the error queue after a command, up to the entry "no error"."""
        found: list[str] = []
        first: str | None = command
        while len(found) < MAX_QUEUE_LENGTH:
            answer = self._exchange("SYST:ERR?", action, first)
            first = None
            code, _, text = answer.partition(",")
            try:
                number = int(code)
            except ValueError:
                self._drop()
                raise self._fault(
                    f"cannot {action}: it answers SYST:ERR? with '{answer}', which is no error's number."
                ) from None
            if number == 0:
                break
            found.append(f"{number}, {text.strip().strip(chr(34))}")
        return found

    def _exchange(self, query: str, action: str, before: str | None = None) -> str:
        """Send an optional command, then a query, and wait for its answer."""
        from pyvisa.errors import Error as VisaError

        try:
            # In one packet: two small ones would wait for each other's acknowledgement, 40 ms each time.
            return self._get_connection().query(query if before is None else f"{before}\n{query}").strip()
        except (VisaError, OSError, UnicodeError, EOFError) as error:
            self._drop()
            raise self._fault(f"cannot {action}: {self._explain(error)}") from error

    def _fault(self, what: str) -> RigError:
        return RigError(f"{self._name}: {what}", device=self._name)

    def _explain(self, error: Exception) -> str:
        from pyvisa.constants import StatusCode
        from pyvisa.errors import VisaIOError

        if isinstance(error, VisaIOError) and error.error_code == StatusCode.error_timeout:
            return f"no answer within {1e3 * self._timeout:g} ms."
        if isinstance(error, OSError) and error.strerror:
            return f"{error.strerror[0].lower()}{error.strerror[1:]}."
        return f"{str(error).rstrip('.')}."

    def _get_connection(self) -> MessageBasedResource:
        """Return the connection, and open it first if necessary."""
        if self._resource is None:
            import pyvisa
            from pyvisa.resources import MessageBasedResource

            milliseconds = 1e3 * self._timeout
            try:
                opened = pyvisa.ResourceManager("@py").open_resource(
                    self._address,
                    open_timeout=int(milliseconds),
                    timeout=milliseconds,
                    read_termination="\n",
                    write_termination="\n",
                )
            except (pyvisa.errors.Error, OSError):
                raise
            except Exception as error:  # pyvisa-py raises the base class if it cannot connect
                raise OSError(0, str(error)) from error
            assert isinstance(opened, MessageBasedResource)
            self._resource = opened
        return self._resource

    def _drop(self) -> None:
        resource, self._resource = self._resource, None
        if resource is not None:
            resource.close()
