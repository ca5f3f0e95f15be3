"""Plug-ins are entry points: a lab adds controllers, rigs and commands without changing smolbot."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from inspect import Parameter
from typing import Any

from smolbot.config.document import Document, Fault
from smolbot.errors import PluginError, suggest_name

PROTOCOLS = {
    "controllers": "smolbot.motion.controller:Controller",
    "rigs": "smolbot.config.world:World",
    "path_readers": "smolbot.config.plugin_protocols:PathReader",
    "sensors": "smolbot.config.plugin_protocols:SensorKind",
    "studies": "smolbot.config.plugin_protocols:StudyPlugin",
    "estimators": "smolbot.localization.estimator:PoseEstimator",
}
"""Protocol of the entry points of each group, imported when needed; entry points of other groups are callables."""

_CALLED = {"studies": "study", "path_readers": "path reader", "sensors": "kind of sensors"}
"""Name of a group's entry point in messages, where it is not the group's name without its last letter."""

_OURS = {"controllers", "sim", "lookup_tables"}
_POSITIONAL = (Parameter.POSITIONAL_ONLY, Parameter.POSITIONAL_OR_KEYWORD)


@cache
def _find_entry_points(group: str) -> dict[str, dict[str, EntryPoint]]:
    """Find the entry points of ``smolbot.<group>`` by name, and those of one name by what they name.

    Cached, since that reads a file of every package.
    """
    found: dict[str, dict[str, EntryPoint]] = {}
    for point in entry_points(group=f"smolbot.{group}"):
        found.setdefault(point.name, {}).setdefault(point.value, point)
    return found


def list_plugins(group: str) -> list[str]:
    """List the names of the installed entry points of ``smolbot.<group>``.

    Parameters
    ----------
    group : str
        ``controllers``, ``rigs`` or ``commands``.

    Returns
    -------
    list of str
        Sorted.
    """
    return sorted(_find_entry_points(group))


def load_plugin(group: str, name: str) -> Any:
    """Load the entry point `name` of ``smolbot.<group>``, and check that it implements the protocol of that group.

    Parameters
    ----------
    group : str
        Such as ``controllers``.
    name : str

    Returns
    -------
    object
        What the entry point names.

    Raises
    ------
    PluginError
        If none has that name or several packages have it, if a foreign package shadows its package, or if it breaks its
        protocol.
    """
    found, kind = _find_entry_points(group).get(name), _CALLED.get(group, group[:-1])
    if found is None:
        known = list_plugins(group)
        hint = suggest_name(name, known)
        message = f"No {kind} is named '{name}'; installed: {', '.join(known) or 'none'}.{hint}"
        raise PluginError(message, group=group, name=name)
    if len(found) > 1:
        named = ", ".join(sorted(found))
        message = f"Several packages have a {kind} '{name}': {named}; rename one, or uninstall its package."
        raise PluginError(message, group=group, name=name)
    (point,) = found.values()
    plugin, what = _load_entry_point(point), f"{kind.capitalize()} '{name}' ({point.value})"
    if group in PROTOCOLS:
        module, _, protocol = PROTOCOLS[group].partition(":")
        check_protocol(plugin, getattr(import_module(module), protocol), what)
    elif not callable(plugin):
        raise PluginError(f"{what} must be a function or a class; got {plugin!r}.")
    return plugin


def check_protocol(plugin: object, protocol: type, what: str) -> None:
    """Check that a plug-in has every method and attribute of a protocol, and that its methods take its arguments.

    For a class, only the attributes that a protocol marks ``ClassVar`` are checked.

    Parameters
    ----------
    plugin : object
        A class, or an object that implements the protocol itself.
    protocol : type
        A subclass of `typing.Protocol`.
    what : str
        Description of the plug-in in the message: its group, name and location.

    Raises
    ------
    PluginError
        With everything that is missing or named differently, and what the protocol requires.

    Examples
    --------
    >>> from smolbot.core.rig import Witness
    >>> class Blind:
    ...     def truth(self): ...
    >>> check_protocol(Blind, Witness, "Witness 'blind'")
    Traceback (most recent call last):
    ...
    smolbot.errors.PluginError: Witness 'blind' breaks its protocol, smolbot.core.rig.Witness: truth() lacks the \
parameter 'time'; it is called as truth(time).
    """
    try:
        faults = list(_protocol_faults(plugin, protocol))
    except Exception as error:  # whatever a foreign property does when it is read
        raise PluginError(f"{what} cannot be checked: {type(error).__name__}: {error}.") from error
    if faults:
        of = f"{protocol.__module__}.{protocol.__qualname__}"
        raise PluginError(f"{what} breaks its protocol, {of}: {'; '.join(faults)}.")


def _protocol_faults(plugin: object, protocol: type) -> Iterator[str]:
    """List what a plug-in lacks of a protocol, in the order of the protocol."""
    for base in reversed([b for b in protocol.__mro__ if vars(b).get("_is_protocol")]):
        for name, annotation in vars(base).get("__annotations__", {}).items():
            if ("ClassVar" in annotation or not isinstance(plugin, type)) and not hasattr(plugin, name):
                yield f"it has no attribute '{name}', {annotation}"
        for name, member in vars(base).items():
            if (name.startswith("_") and name != "__init__") or not callable(getattr(base, name)):
                continue
            if name == "__init__" and (member.__name__ != name or not isinstance(plugin, type)):
                continue  # the protocol does not define one, or the plug-in is an instance
            static = isinstance(member, staticmethod | classmethod)
            asked = _parameters(base, name, of_class=static)
            call = f"{name}({', '.join(map(_spelled, asked))})"
            found = inspect.getattr_static(plugin, name, getattr(plugin, name, None))
            if found is None or not callable(getattr(plugin, name)):
                yield f"it has no method {call}"
                continue
            of_class = static or isinstance(found, staticmethod | classmethod)
            faults = list(_signature_faults(_parameters(plugin, name, of_class=of_class), asked))
            if faults:
                yield f"{name}() {', '.join(faults)}; it is called as {call}"


def _parameters(owner: object, name: str, *, of_class: bool) -> list[Parameter]:
    """List the parameters of the callable `name`: without ``self``, unless it is called `of_class`."""
    if name == "__init__" and not vars(owner).get("_is_protocol"):
        return list(inspect.signature(owner).parameters.values())  # type: ignore[arg-type]
    found = list(inspect.signature(getattr(owner, name)).parameters.values())
    with_self = isinstance(owner, type) and not of_class and bool(found) and found[0].kind in _POSITIONAL
    return found[with_self:]


def _signature_faults(found: list[Parameter], asked: list[Parameter]) -> Iterator[str]:
    """List why a method with the parameters `found` cannot be called with those of the protocol, `asked`."""
    kinds, names = {p.kind for p in found}, [p.name for p in found]
    places = [p for p in found if p.kind in _POSITIONAL]
    given = [p for p in asked if p.kind in _POSITIONAL]
    lacking = [] if Parameter.VAR_POSITIONAL in kinds else given[len(places) :]
    if lacking:
        missing = [p for p in given if p.name not in names][-len(lacking) :] or lacking
        yield f"lacks the parameter {', '.join(repr(p.name) for p in missing)}"
    elif sorted(called := [p.name for p in given]) == sorted(names[: len(given)]) and called != names[: len(given)]:
        yield f"takes them in another order, ({', '.join(names)})"
    for mine, theirs in zip(places, given, strict=False):
        if theirs.default is not Parameter.empty and mine.default is Parameter.empty:
            yield f"cannot do without '{mine.name}'"
    by_name = {p.name for p in asked if p.kind is Parameter.KEYWORD_ONLY}
    options = any(p.kind is Parameter.VAR_KEYWORD for p in asked)  # any keyword may be among them
    for p in (*places[len(given) :], *(p for p in found if p.kind is Parameter.KEYWORD_ONLY and not options)):
        if p.default is Parameter.empty and p.name not in by_name:
            yield f"needs '{p.name}', which is not passed"
    if Parameter.VAR_KEYWORD not in kinds:
        wanted = [p for p in asked if p.kind is Parameter.VAR_KEYWORD or (p.name in by_name and p.name not in names)]
        yield from (f"lacks the parameter '{_spelled(p)}'" for p in wanted)


def _spelled(parameter: Parameter) -> str:
    """Format a parameter as in a definition, without its type."""
    return str(parameter.replace(annotation=Parameter.empty))


def load_world(name: str, document: Document) -> Any:
    """Load the world that a rig file names.

    Parameters
    ----------
    name : str
        Entry-point name.
    document : Document
        The rig file.

    Returns
    -------
    type of World

    Raises
    ------
    ConfigError
        If no world of that name is installed, as a fault of the rig file.
    PluginError
        If it cannot be loaded.
    """
    if name not in list_plugins("rigs"):
        raise document.error(
            [Fault(("world",), f"no world is named '{name}'; installed: {', '.join(list_plugins('rigs'))}.")]
        )
    return load_plugin("rigs", name)


def _load_entry_point(point: EntryPoint) -> Any:
    try:
        return point.load()
    except (Exception, SystemExit) as error:  # a foreign module may do anything on import
        package = point.value.split(":")[0].split(".")[0]
        group = point.group.removeprefix("smolbot.")
        raise PluginError(_explain(package, point, error), group=group, name=point.name) from error


def _explain(package: str, point: EntryPoint, error: BaseException) -> str:
    from importlib.util import find_spec

    kind = "" if isinstance(error, ImportError | AttributeError) else f"{type(error).__name__}: "
    message = f"'{point.name}' ({point.value}) cannot be loaded: {kind}{error}."
    if package not in _OURS:
        return message
    found = find_spec(package)
    where = found.origin if found is not None else "not there"
    return (
        f"{message} The package '{package}' that Python finds is {where}; if it is not smolbot's, "
        "it shadows ours: run from another directory, or rename it."
    )
