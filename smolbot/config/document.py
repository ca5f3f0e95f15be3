"""Reads TOML files strictly and reports every fault at once, each with file, line and key."""

from __future__ import annotations

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

from smolbot.config.units import SI
from smolbot.errors import ConfigError, MissingFileError, did_you_mean, writing

KeyPath = tuple[str | int, ...]


class FileModel(BaseModel):
    """Base of every section of a user's file: no unknown keys, no silent conversions, finite numbers."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False, ignored_types=(SI,))


Model = TypeVar("Model", bound=FileModel)


@dataclass(frozen=True)
class Fault:
    """One thing wrong with a file: the key it concerns, and a sentence."""

    key: KeyPath
    message: str


class Document:
    """A TOML file: its text, its data, and the line on which each key stands."""

    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        self.text = text
        self.settings: dict[KeyPath, str] = {}
        self.prefix = ""
        try:
            self.data: dict[str, Any] = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            line = re.search(r"line (\d+)", str(error))
            where = f":{line[1]}" if line else ""
            raise ConfigError(f"{path}{where}: not valid TOML: {error}") from error
        self._lines = _key_lines(text)

    @classmethod
    def read(cls, path: Path) -> Document:
        """Read `path`; a missing or unreadable file is one clear error."""
        try:
            return cls(path, path.read_text(encoding="utf-8"))
        except FileNotFoundError as error:
            raise MissingFileError(f"{path}: no such file.", name=str(path)) from error
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f"{path}: cannot be read as text: {error}") from error

    def line(self, key: KeyPath) -> int:
        """Line of `key`, or of the nearest key that encloses it."""
        while key and key not in self._lines:
            key = key[:-1]
        return self._lines.get(key, 1)

    def spell(self, fault: Fault) -> str:
        """``file:line: key: message``, or the setting that was laid over the file."""
        name = ".".join(str(part) for part in fault.key)
        for key, value in self.settings.items():
            if fault.key[: len(key)] == key:
                return f"--set {self.prefix}{'.'.join(str(part) for part in key)}={value}: {fault.message}"
        return f"{self.path}:{self.line(fault.key)}: {name + ': ' if name else ''}{fault.message}"

    def error(self, faults: list[Fault]) -> ConfigError:
        """One error with a line for each fault, in the order of the file."""
        ordered = sorted(faults, key=lambda f: self.line(f.key))
        return ConfigError("\n".join(dict.fromkeys(self.spell(f) for f in ordered)))

    def override(self, settings: dict[str, str], prefix: str = "") -> Document:
        """The same document with ``key.path = value`` settings laid over it, values in TOML spelling.

        `prefix` is what the user put before the keys, for messages.
        """
        changed = Document(self.path, self.text)
        changed.prefix = prefix
        changed.settings = {tuple(name.split(".")): value for name, value in settings.items()}
        for name, value in settings.items():
            parts = name.split(".")
            target = changed.data
            for part in parts[:-1]:
                target = target.setdefault(part, {})
                if not isinstance(target, dict):
                    raise ConfigError(f"--set {name}={value}: {part} is not a section of {self.path}.")
            target[parts[-1]] = _setting(value)
        return changed

    def validate(self, model: type[Model]) -> tuple[Model | None, list[Fault]]:
        """The document as `model`, or None and every fault found."""
        return validate(model, self.data)

    def validated(self, model: type[Model]) -> Model:
        """The document as `model`. Raises ConfigError with every fault."""
        sections, faults = self.validate(model)
        if sections is None:
            raise self.error(faults)
        return sections


def validate(model: type[Model], data: dict[str, Any], at: KeyPath = ()) -> tuple[Model | None, list[Fault]]:
    """Check a section (standing at key path `at`) against its model."""
    try:
        return model.model_validate_json(json.dumps(data, default=str)), []
    except ValidationError as error:
        return None, [_fault(model, item, at) for item in error.errors()]


def write_lines(path: str | Path, lines: Iterable[str]) -> None:
    """Write a text file. Raises InputError if that cannot be done."""
    with writing(path):
        Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def quoted(value: str) -> str:
    """A TOML basic string."""
    return json.dumps(value, ensure_ascii=False)


def _setting(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _fault(model: type[BaseModel], item: Any, at: KeyPath) -> Fault:
    location: KeyPath = tuple(item["loc"])
    kind, message = item["type"], item["msg"]
    if kind == "extra_forbidden":
        known = _fields_at(model, location[:-1])
        message = f"unknown key; known keys: {', '.join(known)}.{did_you_mean(str(location[-1]), known)}"
    elif kind == "missing" and isinstance(location[-1], int):
        message, location = (
            f"entry {location[-1] + 1} is missing; got {json.dumps(item['input'], default=str)[:60]}.",
            location[:-1],
        )
    elif kind == "missing":
        message = (
            f"this key is missing; the section needs {', '.join(_fields_at(model, location[:-1], required=True))}."
        )
    elif kind == "value_error":
        message = str(item["ctx"]["error"])
    else:
        message = f"{message[0].lower()}{message[1:]}; got {json.dumps(item['input'], default=str)[:60]}."
    return Fault(at + location, message)


def _fields_at(model: type[BaseModel], location: KeyPath, *, required: bool = False) -> list[str]:
    current: type[BaseModel] | None = model
    for part in location:
        if current is None:
            return []
        if isinstance(part, int):
            continue
        info = current.model_fields.get(part)
        current = _inner_model(info.annotation) if info else None
    if current is None:
        return []
    return [name for name, info in current.model_fields.items() if not required or info.is_required()]


def _inner_model(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if typing.get_origin(annotation) in (list, tuple, dict, typing.Union, types.UnionType, typing.Annotated):
        for argument in typing.get_args(annotation):
            found = _inner_model(argument)
            if found:
                return found
    return None


_HEADER = re.compile(r"^\s*(\[\[?)\s*([^\]]+?)\s*\]\]?\s*(#.*)?$")
_ASSIGNMENT = re.compile(
    r"""^\s*((?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*')(?:\s*\.\s*(?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*'))*)\s*="""
)


def _split(name: str) -> tuple[str, ...]:
    return tuple(part.strip().strip("\"'") for part in re.findall(r"\"[^\"]*\"|'[^']*'|[^.]+", name))


def _key_lines(text: str) -> dict[KeyPath, int]:
    """Line number of every table header and key; elements of arrays of arrays one level deep."""
    lines: dict[KeyPath, int] = {}
    prefix: KeyPath = ()
    counts: dict[KeyPath, int] = {}
    open_key: KeyPath | None = None
    depth = element = 0
    for number, line in enumerate(text.splitlines(), 1):
        code = re.sub(r'"(?:[^"\\]|\\.)*"', '""', line).split("#", 1)[0]
        if depth == 0 and (header := _HEADER.match(line)):
            name: KeyPath = _split(header[2])
            name = _indexed(name, counts)
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


def _indexed(name: KeyPath, counts: dict[KeyPath, int]) -> KeyPath:
    """Insert the current index where a header names a table inside an array of tables."""
    out: KeyPath = ()
    for position, part in enumerate(name):
        out = (*out, part)
        if out in counts and position < len(name) - 1:
            out = (*out, counts[out])
    return out
