"""Definition of a study: options, chunks of a Monte-Carlo that run in any process, an outcome.

A study is cut into chunks. Each has its own seed and samples its own bench, so the result does not depend on the
number of processes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.core.sensing import Device
from smolbot.localization.localizer import Estimator

if TYPE_CHECKING:
    from smolbot.config.rig import RigConfig

Columns = dict[str, Any]
"""Rows of a study: one-dimensional arrays of equal length, named with their unit. Keys with a leading underscore are
arrays of any shape for figures, which ``results.csv`` omits."""


@dataclass(frozen=True)
class Options:
    """Options of a study; `poses` and `mismatch` None mean the study's own choice.

    `mission`, `own_rig` (instead of the mission's), `settings` laid over it and `weights` of a regulator are of studies
    of a mission.
    """

    name: str
    seed: int = 1
    jobs: int = 0
    poses: int | None = None
    rig: str = "tank"
    mismatch: float | None = None
    estimators: tuple[Estimator, ...] = ("whitened", "paper")
    mission: str | None = None
    own_rig: str | None = None
    settings: tuple[tuple[str, str], ...] = ()
    weights: str | None = None

    def list_deciding(self) -> dict[str, Any]:
        """Return the options that decide the result; they must be the same when a study resumes.

        Returns
        -------
        dict
        """
        if self.mission is not None:
            return {
                "study": self.name, "seed": self.seed, "mission": self.mission, "rig": self.own_rig,
                "settings": dict(self.settings), "weights": self.weights,
            }  # fmt: skip
        return {
            "study": self.name,
            "seed": self.seed,
            "poses": self.poses,
            "rig": self.rig,
            "mismatch": self.mismatch,
            "estimators": list(self.estimators),
        }


@dataclass(frozen=True)
class Chunk:
    """One part of a study: `work(chunk)` returns its rows, in whatever process it runs.

    Attributes
    ----------
    name : str
        Unique within the study, fit for a file name.
    work : callable
        A module's function, so that it can be sent to another process.
    seed : int
        Seed of everything that the chunk samples.
    arguments : mapping
        Plain values.
    """

    name: str
    work: Callable[[Chunk], Columns]
    seed: int
    arguments: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, key: str) -> Any:
        return self.arguments[key]


@dataclass(frozen=True)
class Outcome:
    """Results of a study.

    Attributes
    ----------
    rows : list of (str, str)
        The table.
    figures : dict
        The same as numbers, for ``study.json`` and ``--json``.
    columns : Columns
        For ``results.csv``.
    """

    rows: list[tuple[str, str]]
    figures: dict[str, Any]
    columns: Columns


@dataclass(frozen=True)
class Study:
    """One study: how it is cut into chunks, how their rows are concluded, and how the result is drawn.

    `estimators` are used where the options name none. `mission` is true of a study of a mission,
    `rig_of` names the rig that is described, `files` are texts that it leaves beside its figure, by name.
    """

    name: str
    title: str
    devices: Callable[[], Mapping[str, Device]]
    chunks: Callable[[Options], list[Chunk]]
    conclude: Callable[[Options, list[Columns]], Outcome]
    draw: Callable[[Outcome, Path], None]
    estimators: tuple[Estimator, ...] = ("whitened", "paper")
    mission: bool = False
    rig_of: Callable[[Options], RigConfig] | None = None
    files: Callable[[Outcome], Mapping[str, str]] | None = None
    notes: Mapping[str, Any] = field(default_factory=dict)


def cut_chunks(
    options: Options, work: Callable[[Chunk], Columns], pieces: Sequence[tuple[str, Mapping[str, Any]]]
) -> list[Chunk]:
    """Cut a study into chunks, with seeds spawned from the study's own.

    Parameters
    ----------
    options : Options
    work : callable
        A module's function, which computes the rows of a chunk.
    pieces : sequence of (str, mapping)
        Name and arguments of each chunk.

    Returns
    -------
    list of Chunk
    """
    seeds = np.random.SeedSequence(options.seed).spawn(len(pieces))
    states = [int(s.generate_state(1, np.uint64)[0] >> np.uint64(1)) for s in seeds]
    shared = {"rig": options.rig, "estimators": options.estimators}
    return [
        Chunk(name, work, seed, {**shared, **arguments}) for (name, arguments), seed in zip(pieces, states, strict=True)
    ]


def split_evenly(total: int, size: int) -> list[int]:
    """Split a number into the fewest, nearly equal pieces of at most `size`.

    Parameters
    ----------
    total : int
    size : int

    Returns
    -------
    list of int

    Examples
    --------
    >>> split_evenly(1000, 400)
    [334, 333, 333]
    """
    count = max(math.ceil(total / size), 1)
    return [total // count + (i < total % count) for i in range(count)]


def make_rng(chunk: Chunk) -> np.random.Generator:
    """Make the random generator for what a study itself samples, separate from the bench's.

    Parameters
    ----------
    chunk : Chunk

    Returns
    -------
    numpy.random.Generator
    """
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence([chunk.seed, 2])))
