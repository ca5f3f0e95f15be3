"""TOML text in layers: one file or setting laid over another's text, comments kept.

A comment at the end of a line belongs to the value before it and goes where the value goes. Comment lines above a key
or header stay unless the upper layer has its own there. Tables are merged key by key; all else is a value, and is
replaced as a unit: arrays, inline tables ``{ … }``, arrays of tables ``[[ … ]]``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smolbot.errors import report_write_errors

if TYPE_CHECKING:
    from tomlkit.items import Item

KeyPath = tuple[str, ...]

Line = tuple[str, Any, str]
"""Key, value and comment."""

LONGEST_ROW = 3
"""Entries of a list that is written in one line."""

BEGAN = "# What it extends says:\n"
"""Stands between the comment lines at the top of two texts."""


@dataclass(frozen=True)
class Entry:
    """A key or header of a TOML text.

    Attributes
    ----------
    above : str
        Comment lines and empty lines above it.
    item : Item or None
        Value of a key, its comment included; None of a header.
    comment : str
        Text after a header.
    """

    above: str = ""
    item: Item | None = None
    comment: str = ""


Layer = dict[KeyPath, Entry]
"""Keys and headers of a text by their path, in its order; at ``()`` the lines with which it begins and ends."""


def lay_over(base: str, upper: str, without: Iterable[KeyPath]) -> str:
    """Lay one TOML text over another.

    Parameters
    ----------
    base, upper : str
        Its values replace those of `base`.
    without : iterable of key paths
        Keys and tables that are left out of either.

    Returns
    -------
    str
        One text, with the comments of what was taken from each.
    """
    without = list(without)
    layer, over = (_without(read_layer(text), without) for text in (base, upper))
    ours, theirs = layer.pop(()), over.pop(())
    between = BEGAN if theirs.above and ours.above else ""
    layer = {(): Entry(theirs.above + between + ours.above, comment=ours.comment + theirs.comment), **layer}
    for key, entry in over.items():
        _put(layer, key, entry)
    return write_layer(layer).rstrip() + "\n"


def set_values(
    text: str, values: Mapping[KeyPath, Any], without: Iterable[KeyPath] = (), begin: str | None = None
) -> str:
    r"""Set values in a TOML text.

    Parameters
    ----------
    text : str
    values : mapping
        Values by their key paths; each keeps the comment of what it replaces.
    without : iterable of key paths
        Keys and tables that are left out.
    begin : str, optional
        Takes the place of the comment lines with which the text begins.

    Returns
    -------
    str
        The text, otherwise as it was.

    Examples
    --------
    >>> print(set_values('[limits]\nmax_current_a = 8.0  # of the supply\n', {("limits", "max_current_a"): 6.0}))
    [limits]
    max_current_a = 6.0  # of the supply
    <BLANKLINE>
    """
    layer = _without(read_layer(text), without)
    for key, value in values.items():
        holder = next((key[:n] for n in range(1, len(key)) if layer.get(key[:n], Entry()).item is not None), None)
        if holder is None:
            _put(layer, key, Entry(item=_valued(value, layer.get(key, Entry()).item)))
        else:  # inside an inline table
            inline: Any = layer[holder].item
            for part in key[len(holder) : -1]:
                inline = inline.setdefault(part, {})
            inline[key[-1]] = value
    if begin is not None:
        layer[()] = replace(layer[()], above=begin)
    return write_layer(layer)


def _without(layer: Layer, keys: Iterable[KeyPath]) -> Layer:
    return {known: entry for known, entry in layer.items() if not any(known[: len(key)] == key for key in keys)}


def _valued(value: Any, old: Item | None) -> Item:
    """Make an item of a value, with the comment of the one that it replaces."""
    import tomlkit

    item: Any = tomlkit.inline_table() if isinstance(value, dict) else tomlkit.item(value)
    if isinstance(value, dict):
        item.update(value)
    if old is not None and old.trivia.comment:
        room = len(old.as_string()) + len(old.trivia.comment_ws) - len(item.as_string())
        item.trivia.comment, item.trivia.comment_ws = old.trivia.comment, " " * max(room, 1)
    return item


def _put(layer: Layer, key: KeyPath, entry: Entry) -> None:
    """Lay one entry over others: a value takes the place of all that stood under its key, or around it."""
    for known in list(layer):
        replaced = entry.item is not None and known[: len(key)] == key and known != key
        around = 0 < len(known) < len(key) and known == key[: len(known)] and layer[known].item is not None
        if replaced or around:
            del layer[known]
    old = layer.get(key, Entry())
    layer[key] = replace(
        entry,
        above=entry.above if "#" in entry.above or key not in layer else old.above,
        comment=entry.comment or ("" if entry.item is not None else old.comment),
    )


def write_file(path: str | Path, above: Sequence[str], tables: Mapping[str, Sequence[Line]]) -> None:
    """Write a TOML file.

    Parameters
    ----------
    path : path
    above : sequence of str
        Comment lines with which it begins.
    tables : mapping of sequence of (key, value, comment)
        Lines of each table by its name; of the name ``""`` those that stand before all tables. Values None are left
        out; a list longer than a vector gets a line for each of its entries, and its comment above it.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    import tomlkit

    document = tomlkit.document()
    for line in above:
        document.add(tomlkit.comment(line))
    for name, lines in tables.items():
        table: Any = tomlkit.table() if name else document
        for key, value, comment in lines:
            if value is None:
                continue
            item: Any = tomlkit.item(value)
            if isinstance(value, list) and len(value) > LONGEST_ROW:
                item.multiline(True)
                if comment:
                    table.add(tomlkit.comment(comment))
            elif comment:
                item.comment(comment)
            table.add(key, item)
        if name:
            document.add(name, table)
    with report_write_errors(path):
        Path(path).write_text(tomlkit.dumps(document), encoding="utf-8")


def read_layer(text: str) -> Layer:
    """Take a TOML text apart.

    Parameters
    ----------
    text : str

    Returns
    -------
    dict
        Every key and header by its path; see `Layer`.
    """
    import tomlkit

    lines = text.splitlines(keepends=True)
    begin = next((number for number, line in enumerate(lines) if not line.startswith("#")), len(lines))
    layer: Layer = {(): Entry()}
    end = _read(layer, tomlkit.parse("".join(lines[begin:])).body, (), "")
    layer[()] = Entry("".join(lines[:begin]), comment=end)
    return layer


def _read(layer: Layer, body: Iterable[tuple[Any, Any]], at: KeyPath, above: str) -> str:
    """Enter what a table holds; return the lines below it, which belong to what follows."""
    from tomlkit.items import AoT, Table

    for key, item in body:
        if key is None:
            above += item.as_string()
            continue
        path = (*at, key.key)
        if isinstance(item, Table):
            if not item.is_super_table():
                layer[path] = Entry(above, comment=item.trivia.comment_ws + item.trivia.comment)
                above = ""
            above = _read(layer, item.value.body, path, above)
        else:
            layer[path] = Entry(above, item)
            above = _take_lines_below(item.body[-1]) if isinstance(item, AoT) else ""
    return above


def _take_lines_below(table: Any) -> str:
    """Take the comment lines and empty lines away with which a table ends."""
    from tomlkit.items import AoT, Table

    below, body = "", table.value.body
    while body and body[-1][0] is None:
        below = body.pop()[1].as_string() + below
    if body and isinstance(body[-1][1], Table | AoT):
        last = body[-1][1]
        return _take_lines_below(last.body[-1] if isinstance(last, AoT) else last) + below
    return below


def write_layer(layer: Layer) -> str:
    """Put a TOML text together: in each table the plain keys, then its tables.

    Parameters
    ----------
    layer : dict
        As `read_layer` returns it.

    Returns
    -------
    str
    """
    import tomlkit

    document = tomlkit.document()
    _fill(document, layer, ())
    ends = layer.get((), Entry())
    return ends.above + tomlkit.dumps(document) + ends.comment


def _fill(table: Any, layer: Layer, at: KeyPath) -> None:
    import tomlkit
    from tomlkit.items import AoT

    depth = len(at)
    below = {key: entry for key, entry in layer.items() if len(key) > depth and key[:depth] == at}
    names = dict.fromkeys(key[depth] for key in below)
    items = {name: below.get((*at, name), Entry()).item for name in names}
    plain = [name for name, item in items.items() if item is not None and not isinstance(item, AoT)]
    for name in [*plain, *(name for name in names if name not in plain)]:
        entry = below.get((*at, name))
        if entry is not None and entry.above:
            table.add(tomlkit.ws(entry.above))
        if entry is not None and entry.item is not None:
            table.add(name, entry.item)
            continue
        inner = tomlkit.table(is_super_table=entry is None)
        inner.trivia.comment = "" if entry is None else entry.comment
        table.add(name, inner)
        _fill(inner, layer, (*at, name))
