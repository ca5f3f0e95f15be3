"""Find shipped files by name and a user's own by path."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from smolbot.config.document import EXTENDS, Document, Fault, read_text
from smolbot.errors import ConfigError, InputError, MissingFileError, suggest_name

KINDS = ("missions", "rigs", "robots")


def list_shipped(kind: str) -> dict[str, Path]:
    """List the shipped files of one kind.

    Parameters
    ----------
    kind : {"missions", "rigs", "robots"}

    Returns
    -------
    dict of str to Path
        Path of each file by its name.
    """
    folder = Path(str(resources.files("smolbot").joinpath(kind)))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def find_file(name: str, kind: str, beside: Path | None = None) -> Path:
    """Find a shipped file by name, or a user's own by path.

    Parameters
    ----------
    name : str
        Name of a shipped file, or a path.
    kind : {"missions", "rigs", "robots"}
    beside : Path, optional
        A folder in which a path is looked up first.

    Returns
    -------
    Path

    Raises
    ------
    MissingFileError
        With the names that exist.
    """
    if not isinstance(name, str):
        raise InputError(f"One of the {kind} is named by text, a name or a path; got {name!r}.")
    ours = list_shipped(kind)
    looks_like_path = name.endswith(".toml") or "/" in name or "\\" in name
    if not looks_like_path and name in ours:
        return ours[name]
    if looks_like_path:
        for path in [Path(name)] if beside is None else [beside / name, Path(name)]:
            if path.is_file():
                return path
        raise MissingFileError(f"{name}: no such file. Shipped {kind}: {', '.join(ours)}.", name=name, known=ours)
    raise MissingFileError(
        f"No {kind[:-1]} is named '{name}'. Shipped {kind}: {', '.join(ours)}.{suggest_name(name, ours)} "
        f"Your own is given by its path, such as ./{name}.toml.",
        name=name,
        known=ours,
    )


def open_file(name: str, kind: str, beside: Path | None = None) -> Document:
    """Read a file of one kind by name or path, with all that it extends.

    Parameters
    ----------
    name, kind, beside
        See `find_file`.

    Returns
    -------
    Document

    Raises
    ------
    MissingFileError
        If there is no such file.
    ConfigError
        If one of them cannot be read, or extends itself or what is not there, with the files concerned.
    """
    return _opened(find_file(name, kind, beside), kind, ())


def _opened(path: Path, kind: str, below: tuple[Path, ...]) -> Document:
    """Open the file at `path`, which the files `below` extend; the first of them is the requested one."""
    text = read_text(path)
    alone = Document(path, text)
    name = alone.data.get(EXTENDS)
    if name is None:
        return alone
    if not isinstance(name, str):
        raise alone.error([Fault((EXTENDS,), f"must name one of the {kind}, or a file; got {name!r}.")])
    try:
        parent = find_file(name, kind, path.parent)
    except MissingFileError as error:
        raise alone.error([Fault((EXTENDS,), str(error))]) from error
    chain = (*below, path)
    if parent.resolve() in [one.resolve() for one in chain]:
        circle = " extends ".join(str(one) for one in (*chain, parent))
        raise alone.error([Fault((EXTENDS,), f"goes round in a circle: {circle}.")])
    return Document(path, text, _opened(parent, kind, chain))


def holds_rig(path: Path) -> bool:
    """Tell whether a file that may be a rig's or a mission's is a rig's.

    Parameters
    ----------
    path : Path

    Returns
    -------
    bool
        False also of one that cannot be read as a rig's.
    """
    try:
        return "sensors" in open_file(str(path), "rigs").data
    except (ConfigError, MissingFileError):  # loading it as a mission reports what is wrong
        return False
