"""The run folder: both files as used, provenance, cycles, summary and picture."""

from __future__ import annotations

import csv
import json
import platform
import subprocess
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TextIO

import smolbot
from smolbot.blas import kernel
from smolbot.errors import InputError
from smolbot.records.trace import Moment, row

_PACKAGES = ("numpy", "scipy", "numba", "magpylib", "pybullet", "pydantic")


class RunFolder:
    """Written as the run goes on; whatever was flushed before a kill is readable after it.

    Attributes
    ----------
    rows : int
        Cycles that were recorded.
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

    def begin(self, contents: Mapping[str, bytes], provenance: Mapping[str, Any]) -> None:
        """Make the folder and write what the run starts from: files by their names, and where it came from."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{self.path}: the run folder cannot be made: {error}.") from error
        for name, content in contents.items():
            (self.path / name).write_bytes(content)
        self._json("provenance.json", provenance)

    def record(self, moment: Moment) -> None:
        """Append one cycle to ``cycles.csv``."""
        line = row(self.rows, moment)
        if self._writer is None:
            self._file = (self.path / "cycles.csv").open("w", newline="", encoding="utf-8")
            self._writer = csv.DictWriter(self._file, fieldnames=list(line))
            self._writer.writeheader()
        self._writer.writerow(line)
        self.rows += 1
        assert self._file is not None
        self._file.flush()

    def end(self, summary: dict[str, Any]) -> None:
        """Close the record and write the summary."""
        if self._file is not None:
            self._file.close()
        self._json("summary.json", summary)

    def _json(self, name: str, data: Any) -> None:
        (self.path / name).write_text(json.dumps(data, indent=2, default=str) + "\n", encoding="utf-8")


def provenance(seed: int, settings: Mapping[str, str], world: Mapping[str, Any]) -> dict[str, Any]:
    """Where a run came from: version, commit, seed, settings, drawn mismatches, packages."""
    return {
        "smolbot": smolbot.__version__,
        "commit": _commit(),
        "seed": seed,
        "settings": dict(settings),
        "world": dict(world),
        "python": platform.python_version(),
        "platform": platform.system(),
        "linear_algebra": kernel(),
        "packages": packages(),
    }


def packages() -> dict[str, str]:
    """Versions of the packages on which figures depend."""
    found: dict[str, str] = {}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def _commit() -> str | None:
    """Commit of the source tree that is running, if it is one and git is there."""
    home = Path(smolbot.__file__).parent.parent
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
