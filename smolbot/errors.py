"""All errors that smolbot raises on purpose; each also derives from the built-in error that it resembles."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

_LINE = re.compile(r"(?P<file>.+?):(?P<line>\d+): (?:(?P<key>[\w.+-]+): )?(?P<fault>.+)")
_OURS = {"smolbot", "sim", "controllers", "lookup_tables"}
_PASSING = {"lookup_tables", "click", "typer"}
"""Packages whose errors tell people something as they are: an end, a wrong option, a point outside a table."""
_SETTING = re.compile(r"--set (?P<key>[^=\s]+)=.*?: (?P<fault>.+)")


class SmolbotError(Exception):
    """Base of all errors raised on purpose: the message is for people, the fields are for programs.

    Fields are given by keyword where the error is raised, if they are known; they survive pickling.

    Examples
    --------
    >>> import smolbot
    >>> try:
    ...     smolbot.load_mission("lime")
    ... except smolbot.SmolbotError as error:
    ...     print(type(error).__name__)
    MissingFileError
    """


class InputError(SmolbotError, ValueError):
    """A value, shape or unit that cannot be used; the message names it, and what is possible.

    Parameters
    ----------
    message : str
    channel : str

    Attributes
    ----------
    channel : str
        Sensor, converter input or coil that it concerns; empty if it concerns none.

    Examples
    --------
    >>> import smolbot
    >>> try:
    ...     smolbot.read_run("runs/monday")
    ... except smolbot.InputError as error:
    ...     print(error)
    runs/monday: no such run.
    """

    def __init__(self, message: str = "", /, *, channel: str = "") -> None:
        super().__init__(message)
        self.channel = channel


@dataclass(frozen=True)
class FileFault:
    """One fault of a file; `line` is None and `key` empty if unknown, `file` is empty for a ``--set`` option."""

    file: str
    line: int | None
    key: str
    fault: str


class ConfigError(SmolbotError, ValueError):
    """One or more faults of a user's file; the message has one ``file:line: key: fault`` line for each.

    Attributes
    ----------
    faults : tuple of FileFault
        Every fault: file, line, key and what is wrong.

    Examples
    --------
    >>> import smolbot
    >>> try:
    ...     smolbot.load_mission("line", settings={"controller.tolerence_mm": "0.5"})
    ... except smolbot.ConfigError as error:
    ...     print(error.key)
    controller.tolerence_mm
    """

    @property
    def faults(self) -> tuple[FileFault, ...]:
        """Every line of the message as a fault."""
        return tuple(_parse_fault(line) for line in str(self).splitlines())

    @property
    def file(self) -> str:
        """File of the first fault."""
        return self.faults[0].file if self.faults else ""

    @property
    def line(self) -> int | None:
        """Line of the first fault."""
        return self.faults[0].line if self.faults else None

    @property
    def key(self) -> str:
        """Key of the first fault, with dots."""
        return self.faults[0].key if self.faults else ""


def _parse_fault(line: str) -> FileFault:
    if found := _SETTING.fullmatch(line):
        return FileFault("", None, found["key"], found["fault"])
    if found := _LINE.fullmatch(line):
        return FileFault(found["file"], int(found["line"]), found["key"] or "", found["fault"])
    return FileFault("", None, "", line)


class MissingFileError(SmolbotError, FileNotFoundError):
    """A named file, mission, rig or robot does not exist; the message lists those that do.

    Parameters
    ----------
    message : str
    name : str
    known : iterable of str

    Attributes
    ----------
    name : str
        The requested name.
    known : tuple of str
        Shipped files of the same kind; empty if there is no kind.
    """

    def __init__(self, message: str = "", /, *, name: str = "", known: Iterable[str] = ()) -> None:
        super().__init__(message)
        self.name, self.known = name, tuple(known)

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""


class InterlockError(SmolbotError, ValueError):
    """A shot that breaks a limit of the rig. Nothing of it was played.

    Parameters
    ----------
    message : str
    limit, value : float, optional
    unit, channel : str

    Attributes
    ----------
    limit, value : float or None
        The first limit that is broken, and the requested value; None if it is no number.
    unit : str
        Of both.
    channel : str
        Coil or device that it concerns.

    Examples
    --------
    >>> import smolbot
    >>> limits = smolbot.Limits(coils=("+x",), max_current=8.0)
    >>> try:
    ...     limits.check(smolbot.Shot((smolbot.Actuate((9.0,), 0.03),)))
    ... except smolbot.InterlockError as error:
    ...     print(error.channel, error.value, error.limit, error.unit)
    +x 9.0 8.0 A
    """

    def __init__(
        self, message: str = "", /, *, limit: float | None = None, value: float | None = None, unit: str = "",
        channel: str = "",
    ) -> None:  # fmt: skip
        super().__init__(message)
        self.limit, self.value, self.unit, self.channel = limit, value, unit, channel


class RigError(SmolbotError, RuntimeError):
    """The rig failed while it played a shot. Every output is at zero.

    Parameters
    ----------
    message : str
    device, channel : str

    Attributes
    ----------
    device : str
        Card, supply, stage or server that failed; empty if none is named.
    channel : str
        Coil or input of the device; empty if it is the complete device.
    """

    def __init__(self, message: str = "", /, *, device: str = "", channel: str = "") -> None:
        super().__init__(message)
        self.device, self.channel = device, channel


class SafetyError(RigError):
    """The safety supervisor ended a run; the message names device or quantity, value and limit.

    Nothing more is played.

    Parameters
    ----------
    message : str
    limit, value : float, optional
    unit, channel, device : str

    Attributes
    ----------
    limit, value : float or None
        Of the quantity that the message names; None if it is no number.
    unit : str
        Of both.
    channel : str
        Coil, sensors or axis that it concerns.
    """

    def __init__(
        self, message: str = "", /, *, limit: float | None = None, value: float | None = None, unit: str = "",
        channel: str = "", device: str = "",
    ) -> None:  # fmt: skip
        super().__init__(message, device=device, channel=channel)
        self.limit, self.value, self.unit = limit, value, unit


class OperatorStopError(RigError):
    """A person ended a run: by a key, by a button at the bench, or by answering no to a question."""


class SignalLostError(SmolbotError, RuntimeError):
    """No usable signal, after every way of searching for it was tried.

    Parameters
    ----------
    message : str
    signal_to_noise, needed : float, optional

    Attributes
    ----------
    signal_to_noise, needed : float or None
        The best signal-to-noise ratio that was measured, and the smallest that suffices.
    """

    def __init__(
        self, message: str = "", /, *, signal_to_noise: float | None = None, needed: float | None = None
    ) -> None:
        super().__init__(message)
        self.signal_to_noise, self.needed = signal_to_noise, needed


class PluginError(SmolbotError, ImportError):
    """A part that is not installed, breaks its protocol, fails in use, or is shadowed by a foreign package.

    Parameters
    ----------
    message : str
    group, name : str

    Attributes
    ----------
    group : str
        Kind of plug-in: ``controllers``, ``rigs``, …; empty if a package is missing.
    name : str
        Of the entry point, or of the package.
    """

    def __init__(self, message: str = "", /, *, group: str = "", name: str = "") -> None:
        super().__init__(message, name=name)
        self.group = group


@contextmanager
def report_write_errors(path: str | Path, what: str = "", done: str = "written") -> Iterator[None]:
    """Convert an `OSError` of the block, which writes a file or folder, into an `InputError`.

    Parameters
    ----------
    path : str or Path
        File or folder that is written; named in the message.
    what : str
        What it holds, for the message.
    done : str
        Past participle of the failed action, for the message.

    Yields
    ------
    None

    Raises
    ------
    InputError
        If the block raises `OSError`.
    """
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: {what}{' ' if what else ''}cannot be {done}: {error}.") from error


@contextmanager
def report_plugin_errors(kind: str, plugin: object, call: str) -> Iterator[None]:
    """Convert an unexpected error of the block, which calls a lab's own part, into a `PluginError` that names the part.

    Errors of smolbot and its field tables pass as they are, and so does every error of a part that ships with it.

    Parameters
    ----------
    kind : str
        What the message calls the part: ``Controller``, ``Estimator``, …
    plugin : object
        The class, object or function that is called.
    call : str
        The method of it that is called; empty if it is called itself.

    Yields
    ------
    None

    Raises
    ------
    PluginError
        With the part, the method, the error, and the file and line in the part where it was raised.
    """
    try:
        yield
    except Exception as error:
        owner = plugin if hasattr(plugin, "__qualname__") else type(plugin)
        package = _top_package(owner)
        passes = isinstance(error, SmolbotError | BrokenPipeError) or _top_package(type(error)) in _PASSING
        if passes or package in _OURS:
            raise
        where = _find_place(error.__traceback__, package)
        part, call = f"{owner.__module__}:{owner.__qualname__}", call or owner.__qualname__
        raise PluginError(f"{kind} {part} failed in {call}(): {type(error).__name__}: {error} ({where}).") from error


def _top_package(owner: Any) -> str:
    """Name the top package in which a class or function is defined."""
    return str(owner.__module__).partition(".")[0]


def _find_place(trace: TracebackType | None, package: str) -> str:
    """Find the deepest line of a package in a traceback; the last line of all if it has none there."""
    place = last = "place unknown"
    while trace is not None:
        last = f"{trace.tb_frame.f_code.co_filename}:{trace.tb_lineno}"
        if str(trace.tb_frame.f_globals.get("__name__", "")).partition(".")[0] == package:
            place = last
        trace = trace.tb_next
    return last if place == "place unknown" else place


def suggest_name(name: str, known: Iterable[str]) -> str:
    """Suggest the known name that is most like an unknown one, or the same name with another unit.

    Parameters
    ----------
    name : str
        The unknown name.
    known : iterable of str
        Names that exist.

    Returns
    -------
    str
        `` Did you mean …?`` with a leading space; empty if no known name is similar.
    """
    known = list(known)
    stem = name.rsplit("_", 1)[0]
    other_unit = [one for one in known if one.rsplit("_", 1)[0] in (stem, name)]
    close = difflib.get_close_matches(name, known, 1) or other_unit
    return f" Did you mean {close[0]}?" if close else ""
