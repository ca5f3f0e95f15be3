"""Cache of computed tables on disk; the key is a hash of all their inputs."""

from __future__ import annotations

import hashlib
import json
import os
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
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
MAX_CACHE_BYTES = 1_000_000_000
"""Bytes that the cache may hold: the tables of all shipped missions take 80 MB, those of a large rig 200 MB."""
ABANDONED_AFTER = 86_400.0
"""Age, in s, at which an unfinished file is deleted: writing one takes seconds."""
_warned: set[Path] = set()


def cached_table(
    coils: Sequence[Coil],
    x: FloatArray,
    y: FloatArray,
    z: FloatArray,
    *,
    cache_dir: str | os.PathLike[str] | None = None,
) -> FieldTable:
    """Build a table as `build` does, or read the same table from the cache.

    The key covers the coils, the mesh, this package's format and magpylib's version. A file that cannot be read is
    built anew. If the folder cannot be written, the table is built without a cache, with one warning per folder.

    Parameters
    ----------
    coils : sequence of Coil
        See `build`.
    x, y, z : ndarray, shape (nx,), (ny,), (nz,), in m
        See `build`.
    cache_dir : path, optional
        Folder of the cache; by default `get_default_cache_dir`.

    Returns
    -------
    FieldTable
    """
    folder = Path(cache_dir) if cache_dir is not None else get_default_cache_dir()
    path = folder / f"table-{compute_table_key(coils, x, y, z)}.npz"
    with suppress(TableError, OSError):
        table = FieldTable.read(path)
        mark_used(path)
        return table
    table = build(coils, x, y, z)
    write_to_cache(path, table.write)
    return table


def compute_table_key(coils: Sequence[Coil], x: FloatArray, y: FloatArray, z: FloatArray) -> str:
    """Compute the key of all inputs that a built table depends on.

    Parameters
    ----------
    coils : sequence of Coil
    x, y, z : ndarray, shape (nx,), (ny,), (nz,), in m

    Returns
    -------
    str
        64 hexadecimal digits.
    """
    recipe = {
        "format": FORMAT_VERSION,
        "magpylib": version("magpylib"),
        "threads": 1,  # of the fit; tables of earlier versions depend on their number
        "coils": [coil.parameters() for coil in coils],
        "mesh": [np.asarray(axis, dtype=np.float64).tolist() for axis in (x, y, z)],
    }
    return hashlib.sha256(json.dumps(recipe, sort_keys=True).encode()).hexdigest()


def get_default_cache_dir() -> Path:
    """Return `$SMOLBOT_CACHE`, or the smolbot folder of the user's cache: XDG's, on Windows LOCALAPPDATA.

    Returns
    -------
    Path
    """
    if named := os.environ.get("SMOLBOT_CACHE"):
        return Path(named)
    if sys.platform == "win32" and (local := os.environ.get("LOCALAPPDATA")):
        return Path(local) / "smolbot" / "cache"
    if xdg := os.environ.get("XDG_CACHE_HOME"):
        return Path(xdg) / "smolbot"
    return Path.home() / ".cache" / "smolbot"


def mark_used(path: Path) -> None:
    """Mark a cached file as used, so that others are deleted first; a folder that cannot be written is ignored.

    Parameters
    ----------
    path : Path
    """
    with suppress(OSError):
        os.utime(path)


def write_to_cache(path: Path, write: Callable[[str], None]) -> None:
    """Write a file under a temporary name and rename it, so that no reader ever finds half a file.

    The least recently used files are deleted until the folder's fields take at most `MAX_CACHE_BYTES`. A folder that
    cannot be written is no error: there is one warning for each.

    Parameters
    ----------
    path : Path
    write : callable
        Writes the file whose name it is given.
    """
    temporary = ""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(suffix=path.suffix, prefix=".table-", dir=path.parent)
        os.close(handle)
        write(temporary)
        size = os.path.getsize(temporary)
        os.replace(temporary, path)
        _make_room(path, size)
    except (OSError, TableError) as error:
        if path.parent not in _warned:
            _warned.add(path.parent)
            warnings.warn(
                f"Built tables cannot be kept in {path.parent} ({error}); they are rebuilt each time. "
                "Set SMOLBOT_CACHE to another folder.",
                RuntimeWarning,
                stacklevel=3,
            )
    finally:
        with suppress(OSError):
            os.unlink(temporary)  # exists only if something failed


def _make_room(newest: Path, total: int) -> None:
    """Delete the least recently used fields, and unfinished files of killed processes.

    Never `newest`, of `total` bytes, nor a file that another process may be writing. A process that reads a file
    has read all of it before it uses any; one that finds no file builds it anew.
    """
    found = []
    for file in newest.parent.iterdir():
        with suppress(OSError):  # another process has deleted it
            state = file.stat()
            if file.name.startswith((".table-", ".tank-")) and time.time() - state.st_mtime > ABANDONED_AFTER:
                file.unlink()
            elif file.name.startswith(("table-", "tank-coil-")) and file != newest:
                found.append((state.st_mtime, state.st_size, file))
    for _, size, file in sorted(found, reverse=True):
        total += size
        if total > MAX_CACHE_BYTES:
            with suppress(OSError):  # open in another process, on Windows
                file.unlink(missing_ok=True)
