"""Finds shipped files by name and a user's own by path."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from smolbot.errors import MissingFileError, did_you_mean

KINDS = ("missions", "rigs", "robots")


def shipped(kind: str) -> dict[str, Path]:
    """Name and path of every shipped file of one kind (``missions``, ``rigs`` or ``robots``)."""
    folder = Path(str(resources.files("smolbot").joinpath(kind)))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def find_file(name: str, kind: str, beside: Path | None = None) -> Path:
    """Path of a shipped `name`, or of a user's file, also looked for in the folder `beside`.

    Raises
    ------
    MissingFileError
        With the names that exist.
    """
    ours = shipped(kind)
    looks_like_path = name.endswith(".toml") or "/" in name or "\\" in name
    if not looks_like_path and name in ours:
        return ours[name]
    if looks_like_path:
        for path in [Path(name)] if beside is None else [beside / name, Path(name)]:
            if path.is_file():
                return path
        raise MissingFileError(f"{name}: no such file. Shipped {kind}: {', '.join(ours)}.", name=name, known=ours)
    raise MissingFileError(
        f"No {kind[:-1]} is named '{name}'. Shipped {kind}: {', '.join(ours)}.{did_you_mean(name, ours)} "
        f"Your own is given by its path, such as ./{name}.toml.",
        name=name,
        known=ours,
    )
