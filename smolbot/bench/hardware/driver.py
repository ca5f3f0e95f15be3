"""The card's client library, on this machine's driver or on a device server, and the meaning of its errors."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

from smolbot.bench.hardware.deadline import open_channel
from smolbot.errors import RigError

TWIN_HINT = "Without hardware, start the twin (`smolbot twin`) and use --rig twin."

LOST_READS = {-200284: "read time-out", -200279: "overrun", -200361: "overrun"}
"""Errors after which only the recording is lost: samples came too late, or were overwritten."""

DEVICE_GONE = -201003

_REMEDIES = {
    -201003: "Is the card plugged in and powered? Reset it before the next run.",
    -200220: "Is the device name in bench.device the one that the driver lists?",
    -50103: "Another program holds the card; end it first.",
    -200678: "The watchdog expired and opened every relay; the program was too slow to feed it.",
    -200077: "A value lies outside what the channel can do; compare bench ranges with the card's.",
    -200284: "Samples stopped coming: is the sample clock running, the cable in place?",
    -200279: "Samples were overwritten before they were read; is this machine overloaded?",
    -200361: "Samples were overwritten before they were read; is this machine overloaded?",
}


class Driver:
    """Makes tasks and devices of the client library.

    Parameters
    ----------
    server : str
        Address (host:port) of a device server; empty for this machine's driver.
    timeout : float, in s
        Deadline of every call to a server, in addition to the timeout of the request itself.

    Attributes
    ----------
    errors : tuple of type
        Exceptions of the client library.
    answers : bool
        False once card or server no longer answer.

    Raises
    ------
    RigError
        If there is no such driver, or no server answers.
    """

    def __init__(self, server: str, timeout: float) -> None:
        from nidaqmx.errors import Error

        self.server = server
        self.errors: tuple[type[BaseException], ...] = (Error,)
        self.answers = True
        self._options: Any = None
        self._urgent: Any = None
        self._channels: list[Any] = []
        if server:
            self._connect(server, timeout)

    def _connect(self, server: str, timeout: float) -> None:
        try:
            channels = [open_channel(server, timeout) for _ in range(2)]
        except ModuleNotFoundError as error:
            raise RigError("A device server needs gRPC: install smolbot with its extra 'twin'.") from error
        except ConnectionError as error:
            raise RigError(f"bench.server: {error}. {TWIN_HINT}") from error
        from nidaqmx import GrpcSessionOptions

        self._channels = [bare for _, bare in channels]
        self._options, self._urgent = (GrpcSessionOptions(channel, session_name="") for channel, _ in channels)

    def task(self, *, urgent: bool = False) -> Any:
        """Make a task without a name.

        Parameters
        ----------
        urgent : bool
            Use a connection of its own, which no long recording keeps busy.

        Returns
        -------
        nidaqmx.Task
        """
        import nidaqmx

        options = self._urgent if urgent else self._options
        with self._require_driver():
            return nidaqmx.Task(grpc_options=options) if options else nidaqmx.Task()

    def get_device(self, name: str) -> Any:
        """Return a device by its name in the driver.

        Parameters
        ----------
        name : str

        Returns
        -------
        nidaqmx.system.Device
        """
        from nidaqmx.system import Device

        with self._require_driver():
            return Device(name, grpc_options=self._options) if self._options else Device(name)

    def make_watchdog(self, name: str, timeout: float) -> Any:
        """Make the watchdog task of a device; it is not started.

        Parameters
        ----------
        name : str
            Name of the device.
        timeout : float, in s
            After which it expires.

        Returns
        -------
        nidaqmx.system.watchdog.WatchdogTask
        """
        from nidaqmx.system.watchdog import WatchdogTask

        with self._require_driver():
            return WatchdogTask(name, timeout=timeout, grpc_options=self._urgent)

    @contextlib.contextmanager
    def _require_driver(self) -> Iterator[None]:
        from nidaqmx.errors import DaqNotFoundError, DaqNotSupportedError

        try:
            yield
        except (DaqNotFoundError, DaqNotSupportedError) as error:
            raise RigError(f"The NI-DAQmx driver is not installed on this machine. {TWIN_HINT}") from error

    def is_lost_read(self, error: BaseException) -> bool:
        """Return whether an error means that only samples were lost.

        Parameters
        ----------
        error : BaseException

        Returns
        -------
        bool
        """
        return get_error_code(error) in LOST_READS

    def explain(self, error: BaseException) -> str:
        """Format the first line of an error's message, with its code.

        Parameters
        ----------
        error : BaseException

        Returns
        -------
        str
        """
        first = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        code, rpc = get_error_code(error), getattr(error, "rpc_code", None)
        if code is not None:
            return f"{first.rstrip('.')} ({code})."
        if rpc is not None:
            where = f"the device server at {self.server}"
            name = str(getattr(rpc, "name", rpc))
            causes = {"DEADLINE_EXCEEDED": f"{where} did not answer in time", "UNAVAILABLE": f"{where} is gone"}
            return f"{causes.get(name, first.rstrip('.'))} ({name})."
        return f"{first.rstrip('.')}."

    def suggest_remedy(self, error: BaseException) -> str:
        """Return what a person can do about an error.

        Parameters
        ----------
        error : BaseException

        Returns
        -------
        str
        """
        code, rpc = get_error_code(error), getattr(error, "rpc_code", None)
        if code in _REMEDIES:
            return _REMEDIES[code]
        if rpc is not None:
            return "Is the server running, the network in place?"
        return "See the driver's description of this error."

    def record_error(self, error: BaseException) -> None:
        """Remember if an error means that card or server no longer answer; nothing waits for them from then on.

        Parameters
        ----------
        error : BaseException
        """
        name = str(getattr(getattr(error, "rpc_code", None), "name", ""))
        if name in ("DEADLINE_EXCEEDED", "UNAVAILABLE") or get_error_code(error) == DEVICE_GONE:
            self.answers = False

    def attempt(self, action: Callable[[], object]) -> bool:
        """Try an action that brings the card to rest; errors of the client library are not raised.

        Parameters
        ----------
        action : callable
            Takes no arguments.

        Returns
        -------
        bool
            Whether it succeeded; False without a try if the card no longer answers.
        """
        if not self.answers:
            return False
        try:
            action()
        except self.errors as error:
            self.record_error(error)
            return False
        return True

    def close(self) -> None:
        """Close the connections to the server."""
        while self._channels:
            self._channels.pop().close()


def get_error_code(error: BaseException) -> int | None:
    """Return the error code of the card.

    Parameters
    ----------
    error : BaseException

    Returns
    -------
    int or None
        None for an error of the connection.
    """
    code = getattr(error, "error_code", None)
    return code if isinstance(code, int) else None
