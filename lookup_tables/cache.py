"""Built tables kept on disk, keyed by what they were built from."""

from __future__ import annotations

import hashlib
import json
import os
import sys
import tempfile
import warnings
from collections.abc import Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

import numpy as np
import numpy.typing as npt

from lookup_tables.builder import build
from lookup_tables.coils import Coil
from lookup_tables.errors import TableError
from lookup_tables.files import FORMAT_VERSION
from lookup_tables.table import FieldTable

FloatArray = npt.NDArray[np.float64]
_warned: set[Path] = set()


def cached_table(
    coils: Sequence[Coil],
    x: FloatArray,
    y: FloatArray,
    z: FloatArray,
    *,
    cache_dir: str | os.PathLike[str] | None = None,
) -> FieldTable:
    """`build`, or the same table from an earlier call.

    The key covers the coils, the mesh, this package's format and magpylib's version. A file that cannot be read is
    built anew; a folder that cannot be written means a table without a cache, and one warning for each folder.

    Parameters
    ----------
    coils, x, y, z
        As `build` takes them.
    cache_dir : path, optional
        Folder of the cache; by default `default_cache_dir`.
    """
    folder = Path(cache_dir) if cache_dir is not None else default_cache_dir()
    path = folder / f"table-{table_key(coils, x, y, z)}.npz"
    if path.is_file():
        with suppress(TableError, OSError):
            return FieldTable.read(path)
    table = build(coils, x, y, z)
    try:
        write_atomically(table, path)
    except (OSError, TableError) as error:
        if folder not in _warned:
            _warned.add(folder)
            warnings.warn(
                f"Built tables cannot be kept in {folder} ({error}); they are built anew each time. "
                "SMOLBOT_CACHE names another folder.",
                RuntimeWarning,
                stacklevel=2,
            )
    return table


def table_key(coils: Sequence[Coil], x: FloatArray, y: FloatArray, z: FloatArray) -> str:
    """Key, 64 hexadecimal digits, of all that a built table depends on."""
    recipe = {
        "format": FORMAT_VERSION,
        "magpylib": version("magpylib"),
        "coils": [coil.parameters() for coil in coils],
        "mesh": [np.asarray(axis, dtype=np.float64).tolist() for axis in (x, y, z)],
    }
    return hashlib.sha256(json.dumps(recipe, sort_keys=True).encode()).hexdigest()


def default_cache_dir() -> Path:
    """`$SMOLBOT_CACHE`, else the smolbot folder of the user's cache: XDG's, on Windows LOCALAPPDATA."""
    if named := os.environ.get("SMOLBOT_CACHE"):
        return Path(named)
    if sys.platform == "win32" and (local := os.environ.get("LOCALAPPDATA")):
        return Path(local) / "smolbot" / "cache"
    if xdg := os.environ.get("XDG_CACHE_HOME"):
        return Path(xdg) / "smolbot"
    return Path.home() / ".cache" / "smolbot"


def write_atomically(table: FieldTable, path: Path) -> None:
    """Write the table under another name and rename it, so that no reader ever sees half a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(suffix=".npz", prefix=".table-", dir=path.parent)
    os.close(handle)
    try:
        table.write(temporary)
        os.replace(temporary, path)
    except BaseException:
        with suppress(OSError):
            os.unlink(temporary)
        raise
