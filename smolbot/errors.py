"""Every error smolbot raises on purpose; each also derives from the built-in it resembles."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path


class SmolbotError(Exception):
    """Base of all errors raised on purpose."""


class InputError(SmolbotError, ValueError):
    """A value, shape or unit that cannot be used; the message says which, and what is possible."""


class ConfigError(SmolbotError, ValueError):
    """One or more faults of a user's file; the message has one ``file:line: key: fault`` line for each."""


class MissingFileError(SmolbotError, FileNotFoundError):
    """A named file, mission, rig or robot does not exist; the message lists what does."""

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""


class InterlockError(SmolbotError, ValueError):
    """A shot that breaks a limit of the rig. Nothing of it was played."""


class RigError(SmolbotError, RuntimeError):
    """The world failed while it played a shot. Every output is at zero."""


class SafetyError(RigError):
    """The safety ended a run; the message names device or quantity, value and limit. Nothing more is played."""


class OperatorStopError(RigError):
    """A person ended a run: by a key, by a button of the bench, by saying so when asked."""


class SignalLostError(SmolbotError, RuntimeError):
    """No signal that can be trusted, after every means of finding it was tried."""


class PluginError(SmolbotError, ImportError):
    """A controller, rig or command that is not installed, or is shadowed by a foreign package."""


@contextmanager
def writing(path: str | Path, what: str = "", done: str = "written") -> Iterator[None]:
    """What the system says against a file or folder that the block writes, as our error; `what` says what it holds."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: {what}{' ' if what else ''}cannot be {done}: {error}.") from error


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """`` Did you mean …?`` with the known name most like `name`, or that of another unit; empty if none is."""
    known = list(known)
    stem = name.rsplit("_", 1)[0]
    other_unit = [one for one in known if one.rsplit("_", 1)[0] in (stem, name)]
    close = difflib.get_close_matches(name, known, 1) or other_unit
    return f" Did you mean {close[0]}?" if close else ""
