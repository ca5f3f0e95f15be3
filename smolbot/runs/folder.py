"""The run folder: files as used, provenance, cycles, summary and picture."""

from __future__ import annotations

import contextlib
import csv
import json
import logging
import platform
import subprocess
from collections.abc import Mapping
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TextIO

from smolbot.core.blas_threads import describe_blas
from smolbot.core.version import __version__
from smolbot.errors import InputError, report_write_errors
from smolbot.runs.trace import Moment, make_cycle_row

SUMMARY, PROVENANCE, CYCLES, PICTURE = "summary.json", "provenance.json", "cycles.csv", "path.png"
"""Files of a run folder, besides those that the run started from and its record."""

_LOG = logging.getLogger(__name__)

_PACKAGES = ("numpy", "scipy", "numba", "magpylib", "pybullet", "pydantic")


class RunFolder:
    """A run folder, written during the run; whatever was flushed before a kill can be read after it.

    Parameters
    ----------
    path : Path
        A new or empty folder.

    Attributes
    ----------
    path : Path
    rows : int
        Number of recorded cycles.
    error : str or None
        Why ``cycles.csv`` ends before the run.

    Raises
    ------
    InputError
        If `path` is a file, or a folder that is not empty.
    """

    def __init__(self, path: Path) -> None:
        if path.exists() and not path.is_dir():
            raise InputError(f"{path}: is a file; name a folder for the run.")
        if path.is_dir() and any(path.iterdir()):
            raise InputError(f"{path}: is not empty; name a new folder, so that no run is lost.")
        self.path = path
        self._file: TextIO | None = None
        self._writer: csv.DictWriter[str] | None = None
        self.rows = 0
        self.error: str | None = None

    def begin(self, contents: Mapping[str, bytes], provenance: Mapping[str, Any]) -> None:
        """Create the folder and write the files that the run starts from.

        Parameters
        ----------
        contents : mapping of str to bytes
            File contents by file name.
        provenance : mapping
            See `provenance`.

        Raises
        ------
        InputError
            If the folder cannot be written.
        """
        with report_write_errors(self.path, "the run folder", "made"):
            self.path.mkdir(parents=True, exist_ok=True)
            for name, content in contents.items():
                write_atomically(self.path / name, content)
            write_atomically(self.path / PROVENANCE, encode_json(provenance))

    def record(self, moment: Moment) -> None:
        """Append one cycle to ``cycles.csv``; a write error ends that table, not the run.

        Parameters
        ----------
        moment : Moment
        """
        try:
            if self.error is None:
                self._append(make_cycle_row(self.rows, moment))
        except OSError as error:
            self.error = f"{CYCLES}: {error.strerror or error}"
            _LOG.warning("%s/%s", self.path, self.error)
        self.rows += 1

    def _append(self, line: dict[str, Any]) -> None:
        if self._file is None:
            self._file = (self.path / CYCLES).open("w", newline="", encoding="utf-8")
            self._writer = csv.DictWriter(self._file, fieldnames=list(line))
            self._writer.writeheader()
        assert self._writer is not None
        self._writer.writerow(line)
        self._file.flush()

    def end(self, summary: dict[str, Any]) -> None:
        """Close the table of cycles and write the summary.

        Parameters
        ----------
        summary : dict
            Figures of the run.
        """
        if self._file is not None:
            with contextlib.suppress(OSError):  # of what could not be flushed, which is known
                self._file.close()
        write_atomically(self.path / SUMMARY, encode_json(summary))


def make_dated_path(name: str) -> Path:
    """Build a folder path below ``runs/`` from a name and the current time.

    Parameters
    ----------
    name : str

    Returns
    -------
    Path
    """
    return Path("runs") / f"{name}-{datetime.now():%Y%m%d-%H%M%S}"


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file so that it is complete or absent, however the process ends.

    Parameters
    ----------
    path : Path
    content : bytes
    """
    part = path.with_name(f"{path.name}.part")
    part.write_bytes(content)
    part.replace(path)


def encode_json(data: Any) -> bytes:
    """Encode data as every JSON file of a run folder is encoded.

    Parameters
    ----------
    data : object
        Values that JSON does not know are written as text.

    Returns
    -------
    bytes
    """
    return (json.dumps(data, indent=2, default=str) + "\n").encode()


def collect_provenance(seed: int, settings: Mapping[str, str], world: Mapping[str, Any]) -> dict[str, Any]:
    """Collect the provenance of a run: version, commit, seed, settings, sampled mismatches, packages.

    Parameters
    ----------
    seed : int
    settings : mapping of str to str
        The ``--set`` options.
    world : mapping
        What the world reports of itself, such as sampled mismatches.

    Returns
    -------
    dict
    """
    return {
        "smolbot": __version__,
        "commit": _find_commit(),
        "seed": seed,
        "settings": dict(settings),
        "world": dict(world),
        "python": platform.python_version(),
        "platform": platform.system(),
        "linear_algebra": describe_blas(),
        "packages": find_package_versions(),
    }


def find_package_versions() -> dict[str, str]:
    """Find the versions of the packages that affect the figures.

    Returns
    -------
    dict of str to str
        Version by package name.
    """
    found: dict[str, str] = {}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def _find_commit() -> str | None:
    """Return the commit of the running source tree; None outside a git checkout."""
    home = Path(__file__).parents[2]
    if not (home / ".git").exists():
        return None
    try:
        done = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=12"],
            cwd=home,
            capture_output=True,
            text=True,
            timeout=5,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() or None
