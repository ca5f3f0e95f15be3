"""What a flight, a replay or a fit answered, as plain numbers and words; and by how much two of them differ."""

from __future__ import annotations

import json
import lzma
from collections.abc import Iterator
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

FORMAT = 1
"""Of the files of answers; a file of another is told, not guessed at."""

UNITS = {
    "position": "m", "positions_m": "m", "progress": "m", "orientation": "rad", "axes": "rad", "axis": "rad",
    "currents": "A", "time": "s", "start": "s", "duration": "s", "ended": "s",
}  # fmt: skip
"""Unit of what stands under a key; all else is compared relative to its size."""

ELSEWHERE = {"m": 1e-9, "rad": 1e-9, "A": 1e-9, "s": 1e-9, "": 1e-6}
"""By how much answers may differ on another machine, by unit; relative where there is none."""

FEW, FURTHER = 0.05, 1e3
"""Share of the numbers that may differ by `FURTHER` times as much there: last bits decide now and then whether a fit
ends one step sooner, and its last step is larger than a nanometre."""


class GoldenFileError(Exception):
    """A file of the corpus cannot be used; says which, why, and what to do."""


@dataclass(frozen=True)
class Difference:
    """Where two answers differ first, by how much at most in each unit, and which share differs beyond `ELSEWHERE`."""

    first: str
    most: dict[str, float]
    share: float

    @property
    def small(self) -> bool:
        """Whether last bits can be its cause."""
        return all(size <= FURTHER * ELSEWHERE[unit] for unit, size in self.most.items())

    def allowed(self, same_machine: bool) -> bool:
        """Whether such a difference is none: no bit on the machine that made the answers, 1 nm and so on elsewhere."""
        return not same_machine and self.small and self.share <= FEW

    def __str__(self) -> str:
        sizes = ", ".join(f"{size:.3g} {unit or '(relative)'}" for unit, size in self.most.items())
        return f"{self.first}; at most {sizes}"


def plain(value: Any) -> Any:
    """A value as numbers, words, lists and dicts, every bit kept; a pose's covariance as its upper triangle."""
    if is_dataclass(value) and not isinstance(value, type):
        fields = {name: getattr(value, name) for name in value.__dataclass_fields__}
        named = {name: plain(field) for name, field in fields.items()}
        if "covariance" in fields:
            named["covariance"] = fields["covariance"][np.triu_indices(6)].tolist()
        return {"is": type(value).__name__, **named}
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return value


def compare(was: Any, now: Any) -> Difference | None:
    """Where and by how much two answers differ; None if in no bit. What is no number differs without measure."""
    first, most, beyond = "", dict[str, float](), 0
    for place, unit, size in _differences(was, now, "", ""):
        first = first or place
        most[unit] = max(size, most.get(unit, 0.0))
        beyond += size > ELSEWHERE[unit]
    return Difference(first, most, beyond / max(_numbers(was), 1)) if first else None


def _numbers(value: Any) -> int:
    if isinstance(value, dict):
        return sum(map(_numbers, value.values()))
    return sum(map(_numbers, value)) if isinstance(value, list) else int(_is_number(value))


def _differences(was: Any, now: Any, place: str, unit: str) -> Iterator[tuple[str, str, float]]:
    if isinstance(was, dict) and isinstance(now, dict):
        for key in dict.fromkeys((*was, *now)):
            if key not in was or key not in now:
                yield f"{place}.{key}: {'new' if key in now else 'missing'}", "", np.inf
            else:
                yield from _differences(was[key], now[key], f"{place}.{key}", UNITS.get(key, unit))
    elif isinstance(was, list) and isinstance(now, list):
        if len(was) != len(now):
            yield f"{place}: {len(was)} became {len(now)}", "", np.inf
        elif not unit and was and all(map(_is_number, (*was, *now))):
            yield from _of_numbers(was, now, place)
            return
        for index, (a, b) in enumerate(zip(was, now, strict=False)):
            yield from _differences(a, b, f"{place}[{index}]", unit)
    elif _is_number(was) and _is_number(now):
        if was != now and not (was != was and now != now):
            size = abs(now - was) / (1.0 if unit else max(abs(was), 1e-300))
            yield f"{place}: {was!r} became {now!r}", unit, size if size == size else np.inf
    elif was != now:
        yield f"{place}: {was!r} became {now!r}", "", np.inf


def _of_numbers(was: list[float], now: list[float], place: str) -> Iterator[tuple[str, str, float]]:
    """Of a list without unit, relative to its largest; of a covariance, to the standard deviations of its entry."""
    scale = np.full(len(was), np.max(np.abs(was)))
    if place.endswith(".covariance"):
        row, column = np.triu_indices(6)
        sigma = np.sqrt(np.abs(np.array(was)[row == column]))
        scale = sigma[row] * sigma[column]
    for index, (a, b) in enumerate(zip(was, now, strict=True)):
        if a != b and not (a != a and b != b):
            size = float(abs(b - a) / max(scale[index], 1e-300))
            yield f"{place}[{index}]: {a!r} became {b!r}", "", size if size == size else np.inf


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def machine() -> dict[str, str]:
    """All that decides the last bits of a result: processor as compilers see it, linear algebra, libraries."""
    import platform
    from importlib.metadata import version

    import llvmlite.binding as llvm
    from numba.core import config

    from smolbot.core.blas_threads import describe_blas

    cpu = config.CPU_NAME or llvm.get_host_cpu_name()
    packages = ("numpy", "scipy", "numba", "llvmlite", "pybullet")
    libc = " ".join(platform.libc_ver())
    return {"cpu": cpu, "linear_algebra": describe_blas(), "libc": libc, **{name: version(name) for name in packages}}


def save(path: Path, answers: Any) -> None:
    """Write answers, with the machine that gave them."""
    text = json.dumps({"format": FORMAT, "machine": machine(), "answers": answers}, separators=(",", ":"))
    path.write_bytes(lzma.compress(text.encode(), preset=9))


def load(path: Path) -> tuple[dict[str, str], Any]:
    """The machine that gave answers, and the answers.

    Raises
    ------
    GoldenFileError
        If the file is missing, torn, or of another format.
    """
    again = (
        f"Take it from version control again (git checkout {path.name}), or make it anew as README.md beside it says."
    )
    try:
        found = json.loads(lzma.decompress(path.read_bytes()))
    except FileNotFoundError:
        raise GoldenFileError(f"{path}: is missing. {again}") from None
    except (lzma.LZMAError, ValueError, EOFError) as error:
        raise GoldenFileError(f"{path}: is torn: {error}. {again}") from error
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        told = found.get("format") if isinstance(found, dict) else None
        raise GoldenFileError(f"{path}: is of format {told}; these tests read {FORMAT}. {again}")
    return found["machine"], found["answers"]


def as_answers(value: Any) -> Any:
    """As `load` would give it back."""
    return json.loads(json.dumps(plain(value)))
