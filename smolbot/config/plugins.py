"""Controllers, rigs and commands are entry points: a lab adds its own without touching ours."""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from smolbot.config.document import Document, Fault
from smolbot.errors import PluginError, did_you_mean

_OURS = {"controllers", "sim", "lookup_tables"}


@cache
def _installed(group: str) -> dict[str, EntryPoint]:
    """Entry points of ``smolbot.<group>``, by name; looked for once, since that reads a file of every package."""
    return {point.name: point for point in reversed(tuple(entry_points(group=f"smolbot.{group}")))}


def names(group: str) -> list[str]:
    """Names of the installed entry points of ``smolbot.<group>``."""
    return sorted(_installed(group))


def load(group: str, name: str) -> Any:
    """Load the entry point `name` of ``smolbot.<group>``.

    Raises
    ------
    PluginError
        If none has that name, or if a foreign package shadows the one that it lives in.
    """
    found = _installed(group).get(name)
    if found is None:
        known = names(group)
        hint = did_you_mean(name, known)
        raise PluginError(
            f"No {group[:-1]} is named '{name}'; installed: {', '.join(known) or 'none'}.{hint}", group=group, name=name
        )
    return _load(found)


def load_world(name: str, document: Document) -> Any:
    """The `smolbot.config.world.World` that a rig file names; an unknown one is a fault of that file."""
    if name not in names("rigs"):
        raise document.error([Fault(("world",), f"no world is named '{name}'; installed: {', '.join(names('rigs'))}.")])
    return load("rigs", name)


def _load(point: EntryPoint) -> Any:
    try:
        return point.load()
    except (ImportError, AttributeError) as error:
        package = point.value.split(":")[0].split(".")[0]
        group = point.group.removeprefix("smolbot.")
        raise PluginError(_explain(package, point, error), group=group, name=point.name) from error


def _explain(package: str, point: EntryPoint, error: Exception) -> str:
    from importlib.util import find_spec

    message = f"'{point.name}' ({point.value}) cannot be loaded: {error}."
    if package not in _OURS:
        return message
    found = find_spec(package)
    where = found.origin if found is not None else "not there"
    return (
        f"{message} The package '{package}' that Python finds is {where}; if it is not smolbot's, "
        "it shadows ours: run from another directory, or rename it."
    )
