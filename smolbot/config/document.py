"""Read TOML files strictly and report every fault at once, each with file, line and key."""

from __future__ import annotations

import copy
import json
import re
import tomllib
import types
import typing
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from smolbot.config.alternatives import void_keys
from smolbot.config.toml_layers import lay_over, set_values
from smolbot.config.units import SI
from smolbot.errors import ConfigError, InputError, MissingFileError, report_write_errors, suggest_name

KeyPath = tuple[str | int, ...]

EXTENDS = "extends"
"""The key by which a file names the one that it extends."""


class FileModel(BaseModel):
    """Base of every section of a user's file: no unknown keys, no silent conversions, finite numbers."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False, ignored_types=(SI,))


Model = TypeVar("Model", bound=FileModel)


@dataclass(frozen=True)
class Fault:
    """One fault of a file.

    Attributes
    ----------
    key : tuple of str or int
        Path of the key at fault, such as ``("coils", 2, "axis")``; empty for the file as such.
    message : str
        One sentence.
    """

    key: KeyPath
    message: str


class Document:
    """A TOML file: its text, its data, and the line of each key.

    Parameters
    ----------
    path : Path
    text : str
    parent : Document, optional
        The file that this one extends: what this one does not set is taken from there.

    Attributes
    ----------
    data : dict
        Values of file, parents and settings together.
    """

    def __init__(self, path: Path, text: str, parent: Document | None = None) -> None:
        self.path = path
        self.settings: dict[str, str] = {}
        self.prefix = ""
        self._void: list[tuple[str, str]] = []
        own = _parsed(path, text)
        places: dict[KeyPath, tuple[Path | None, int]] = {key: (None, n) for key, n in _find_key_lines(text).items()}
        if parent is not None:
            own.pop(EXTENDS, None)
            void = void_keys(parent.data, own)
            replaced = {*_values(own), *void}
            kept = {key: parent.place(key) for key in parent._places if not _under(key, replaced)}
            text, places = lay_over(parent.text, text, [(EXTENDS,), *void]), {**kept, **places}
        self._text = text
        self._places: dict[KeyPath, tuple[Path | None, int]] = places
        self.data: dict[str, Any] = own if parent is None else tomllib.loads(text)

    @classmethod
    def read(cls, path: Path) -> Document:
        """Read a file; a missing or unreadable one is one clear error.

        Parameters
        ----------
        path : Path

        Returns
        -------
        Document
        """
        return cls(path, read_text(path))

    @property
    def text(self) -> str:
        """One complete TOML text: parents, file and settings together, with their comments."""
        if not self.settings:
            return self._text
        given = {tuple(name.split(".")): _parse_setting(value) for name, value in self.settings.items()}
        return set_values(self._text, given, self._void)

    def place(self, key: KeyPath) -> tuple[Path, int]:
        """Find the line of a key.

        Parameters
        ----------
        key : tuple
            Its path.

        Returns
        -------
        Path, int
            File and line of `key`, or of the nearest key that encloses it: of this file, or of one that it extends.
        """
        while key and key not in self._places:
            key = key[:-1]
        path, line = self._places.get(key, (None, 1))
        return path or self.path, line

    def line(self, key: KeyPath) -> int:
        """Find the line number of a key, or of the nearest key that encloses it.

        Parameters
        ----------
        key : tuple of str or int

        Returns
        -------
        int
            Counted from 1.
        """
        return self.place(key)[1]

    def folder(self, key: KeyPath) -> Path:
        """Find the folder from which a file is meant that a key names.

        Parameters
        ----------
        key : tuple
            Its path.

        Returns
        -------
        Path
            Of the file that holds `key`: this one, which settings are laid over, or one that it extends.
        """
        return (self.path if ".".join(map(str, key)) in self.settings else self.place(key)[0]).parent

    def format_fault(self, fault: Fault) -> str:
        """Format a fault as ``file:line: key: message``.

        Parameters
        ----------
        fault : Fault

        Returns
        -------
        str
            Begins with the ``--set`` option instead where that set the value.
        """
        name = ".".join(str(part) for part in fault.key)
        for key, value in self.settings.items():
            if name == key or name.startswith(f"{key}."):
                return f"--set {self.prefix}{key}={value}: {fault.message}"
        path, line = self.place(fault.key)
        return f"{path}:{line}: {name + ': ' if name else ''}{fault.message}"

    def error(self, faults: list[Fault]) -> ConfigError:
        """Make one error of all faults.

        Parameters
        ----------
        faults : list of Fault

        Returns
        -------
        ConfigError
            One line for each fault, in the order of the file, then of its parents.
        """
        places = {fault: self.place(fault.key) for fault in faults}
        ordered = sorted(faults, key=lambda fault: (places[fault][0] != self.path, places[fault][1]))
        return ConfigError("\n".join(dict.fromkeys(self.format_fault(f) for f in ordered)))

    def override(self, settings: dict[str, str], prefix: str = "") -> Document:
        """Lay settings over a document.

        Parameters
        ----------
        settings : dict of str
            Values in TOML spelling by dotted keys: ``{"limits.max_current_a": "6.0"}``.
        prefix : str
            What the user put before the keys, for messages.

        Returns
        -------
        Document
            The same document with the settings.

        Raises
        ------
        ConfigError
            If a key leads through something that is no table.
        """
        if EXTENDS in settings:
            message = f"--set {prefix}{EXTENDS}={settings[EXTENDS]}: a file extends what it says itself"
            raise ConfigError(f"{message}; write a file of your own that extends another.")
        changed = copy.copy(self)
        changed.prefix, changed.settings = prefix, dict(settings)
        changed.data = copy.deepcopy(self.data)
        alone: dict[str, Any] = {}
        for name, value in settings.items():
            self._set(alone, name, value)
        changed._void = void_keys(self.data, alone)
        for section, key in changed._void:
            del changed.data[section][key]
        for name, value in settings.items():
            self._set(changed.data, name, value)
        return changed

    def _set(self, data: dict[str, Any], name: str, value: str) -> None:
        *sections, last = name.split(".")
        for part in sections:
            data = data.setdefault(part, {})
            if not isinstance(data, dict):
                raise ConfigError(f"--set {name}={value}: {part} is not a section of {self.path}.")
        data[last] = _parse_setting(value)

    def validate(self, model: type[Model]) -> tuple[Model | None, list[Fault]]:
        """Check the document against a model.

        Parameters
        ----------
        model : type of FileModel

        Returns
        -------
        FileModel or None
            The sections; None if there are faults.
        list of Fault
        """
        return validate(model, self.data)

    def section(self, name: str, model: type[Model]) -> tuple[Model | None, list[Fault]]:
        """Check one section against a model; a world checks its own so (`smolbot.config.World.check`).

        Parameters
        ----------
        name : str
            Of the section, ``[name]``; an empty one where the file has none.
        model : type of FileModel
            Its keys.

        Returns
        -------
        FileModel or None
            The section; None if it has faults.
        list of Fault
        """
        data = self.data.get(name, {})
        if not isinstance(data, dict):
            return None, [Fault((name,), f"must be a section, [{name}]; got {data!r}.")]
        return validate(model, data, (name,))

    def validated(self, model: type[Model]) -> Model:
        """Return the document as `model`, or raise.

        Parameters
        ----------
        model : type of FileModel

        Returns
        -------
        FileModel

        Raises
        ------
        ConfigError
            With every fault.
        """
        sections, faults = self.validate(model)
        if sections is None:
            raise self.error(faults)
        return sections


def validate(model: type[Model], data: dict[str, Any], key_prefix: KeyPath = ()) -> tuple[Model | None, list[Fault]]:
    """Check a section against a model.

    Parameters
    ----------
    model : type of FileModel
    data : dict
        The section.
    key_prefix : tuple of str or int, optional
        Key path of the section in its file.

    Returns
    -------
    FileModel or None
        The section; None if there are faults.
    list of Fault
    """
    try:
        return model.model_validate_json(json.dumps(data, default=str)), []
    except ValidationError as error:
        return None, [_make_fault(model, item, key_prefix) for item in error.errors()]


def write_lines(path: str | Path, lines: Iterable[str]) -> None:
    """Write a text file.

    Parameters
    ----------
    path : str or Path
    lines : iterable of str
        Without line ends.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    with report_write_errors(path):
        Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_text(path: Path) -> str:
    """Read a text file; a missing or unreadable one is one clear error.

    Parameters
    ----------
    path : Path

    Returns
    -------
    str
    """
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise MissingFileError(f"{path}: no such file.", name=str(path)) from error
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read as text: {error}") from error


def _parsed(path: Path, text: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        line = re.search(r"line (\d+)", str(error))
        where = f":{line[1]}" if line else ""
        raise ConfigError(f"{path}{where}: not valid TOML: {error}") from error


def _values(data: dict[str, Any], at: KeyPath = ()) -> set[KeyPath]:
    """Paths of all that is no table."""
    inner = [_values(value, (*at, key)) if isinstance(value, dict) else {(*at, key)} for key, value in data.items()]
    return set().union(*inner)


def _under(key: KeyPath, replaced: set[KeyPath]) -> bool:
    return any(key[:count] in replaced for count in range(1, len(key) + 1))


def format_setting(value: Any) -> str:
    """Spell a value as a setting of the command line.

    Parameters
    ----------
    value : object
        Text as TOML writes it, or a number, list or table; numbers and arrays of numpy too.

    Returns
    -------
    str

    Raises
    ------
    InputError
        If it is nothing that a file could hold.

    Examples
    --------
    >>> format_setting([0.5, 1])
    '[0.5, 1]'
    """
    if isinstance(value, str):
        return value
    try:
        return json.dumps(value, default=lambda one: one.tolist())
    except (AttributeError, TypeError, ValueError) as error:
        raise InputError(f"A setting must be text, a number, or a list or table of them; got {value!r}.") from error


def _parse_setting(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _make_fault(model: type[BaseModel], item: Any, at: KeyPath) -> Fault:
    location: KeyPath = tuple(item["loc"])
    kind, message = item["type"], item["msg"]
    if kind == "extra_forbidden":
        known = _list_fields(model, location[:-1])
        message = f"unknown key; known keys: {', '.join(known)}.{suggest_name(str(location[-1]), known)}"
    elif kind == "missing" and isinstance(location[-1], int):
        message, location = (
            f"entry {location[-1] + 1} is missing; got {json.dumps(item['input'], default=str)[:60]}.",
            location[:-1],
        )
    elif kind == "missing":
        message = (
            f"this key is missing; the section needs {', '.join(_list_fields(model, location[:-1], required=True))}."
        )
    elif kind == "value_error":
        message = str(item["ctx"]["error"])
    else:
        message = f"{message[0].lower()}{message[1:]}; got {json.dumps(item['input'], default=str)[:60]}."
    return Fault(at + location, message)


def _list_fields(model: type[BaseModel], location: KeyPath, *, required: bool = False) -> list[str]:
    current: type[BaseModel] | None = model
    for part in location:
        if current is None:
            return []
        if isinstance(part, int):
            continue
        info = current.model_fields.get(part)
        current = _find_inner_model(info.annotation) if info else None
    if current is None:
        return []
    return [name for name, info in current.model_fields.items() if not required or info.is_required()]


def _find_inner_model(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if typing.get_origin(annotation) in (list, tuple, dict, typing.Union, types.UnionType, typing.Annotated):
        for argument in typing.get_args(annotation):
            found = _find_inner_model(argument)
            if found:
                return found
    return None


_HEADER = re.compile(r"^\s*(\[\[?)\s*([^\]]+?)\s*\]\]?\s*(#.*)?$")
_ASSIGNMENT = re.compile(
    r"""^\s*((?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*')(?:\s*\.\s*(?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*'))*)\s*="""
)


def _split(name: str) -> tuple[str, ...]:
    return tuple(part.strip().strip("\"'") for part in re.findall(r"\"[^\"]*\"|'[^']*'|[^.]+", name))


def _find_key_lines(text: str) -> dict[KeyPath, int]:
    """Find the line number of every table header and key, and of the elements of nested arrays one level deep."""
    lines: dict[KeyPath, int] = {}
    prefix: KeyPath = ()
    counts: dict[KeyPath, int] = {}
    open_key: KeyPath | None = None
    depth = element = 0
    for number, line in enumerate(text.splitlines(), 1):
        code = re.sub(r'"(?:[^"\\]|\\.)*"', '""', line).split("#", 1)[0]
        if depth == 0 and (header := _HEADER.match(line)):
            name: KeyPath = _split(header[2])
            name = _insert_indices(name, counts)
            if header[1] == "[[":
                counts[name] = counts.get(name, -1) + 1
                name = (*name, counts[name])
            prefix = name
            lines.setdefault(prefix, number)
            for i in range(1, len(prefix)):
                lines.setdefault(prefix[:i], number)
            continue
        if depth == 0 and (assignment := _ASSIGNMENT.match(line)):
            open_key = prefix + _split(assignment[1])
            lines.setdefault(open_key, number)
            code = code[code.index("=") + 1 :] if "=" in code else code
            element = 0
        if open_key is None:
            continue
        for character in code:
            if character in "[{":
                depth += 1
                if depth == 2 and character == "[":
                    lines.setdefault((*open_key, element), number)
            elif character in "]}":
                depth -= 1
            elif character == "," and depth == 1:
                element += 1
        depth = max(depth, 0)
    return lines


def _insert_indices(name: KeyPath, counts: dict[KeyPath, int]) -> KeyPath:
    """Insert the current index where a header names a table inside an array of tables."""
    out: KeyPath = ()
    for position, part in enumerate(name):
        out = (*out, part)
        if out in counts and position < len(name) - 1:
            out = (*out, counts[out])
    return out
