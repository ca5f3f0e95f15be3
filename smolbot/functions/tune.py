"""``tune``: search gains on random simulations; its interface and results. The package ``sim`` implements it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from smolbot.config.plugins import load_plugin
from smolbot.core.arrays import as_count
from smolbot.core.results import Readable, as_columns
from smolbot.flight.preview.missions import Force
from smolbot.functions.settings import merge_settings
from smolbot.functions.simulate import PlantName, check_plant


@dataclass(frozen=True, repr=False)
class HeldOut(Readable):
    """Results of one set of gains in the full tank, on held-out seeds.

    Attributes
    ----------
    gains : mapping of str to float
    flown, passed : int
    pass_rate_95 : (float, float)
        95 % interval of the rate at which flights pass.
    cost_mm : float
        Mean of `costs_mm`, the cost of each flight.
    costs_mm : tuple of float
    tracking_rms_mm, duration_s : float or None
        Means over the flights that reached the path's end; None if none did.
    """

    gains: Mapping[str, float]
    flown: int
    passed: int
    pass_rate_95: tuple[float, float]
    cost_mm: float
    costs_mm: tuple[float, ...]
    tracking_rms_mm: float | None
    duration_s: float | None

    def figures(self) -> dict[str, Any]:
        """Return the figures of the held-out worlds.

        Returns
        -------
        dict
            As ``tune --json`` prints them.
        """
        return {key: value for key, value in asdict(self).items() if key != "costs_mm"}


@dataclass(frozen=True)
class Trial:
    """One set of gains of the search: its number, how it ended, its cost in mm if it was flown in every world."""

    number: int
    state: str
    cost_mm: float | None
    gains: Mapping[str, float]


@dataclass(frozen=True, repr=False)
class Tuning(Readable):
    """Result of a search for gains.

    Attributes
    ----------
    mission, law, plant : str
    seed : int
    worlds : int
        Random simulations that each trial was flown in.
    trials : tuple of Trial
    best_cost_mm : float
        In those simulations.
    before, tuned : HeldOut
        The mission's own gains and the best of the search, on held-out seeds.
    improved : bool
        Tuned gains pass at least as often, and cost less on average over the same held-out seeds.
    importances : mapping of str to float
        Share of each gain in how the cost varies; empty if trials are too few.
    folder : Path or None
        Folder of trials, gains.toml and the figure; None if not requested.
    """

    mission: str
    law: str
    plant: str
    seed: int
    worlds: int
    trials: tuple[Trial, ...]
    best_cost_mm: float
    before: HeldOut
    tuned: HeldOut
    improved: bool
    importances: Mapping[str, float]
    folder: Path | None = None

    def table(self) -> dict[str, np.ndarray[Any, Any]]:
        """Return all trials as columns.

        Returns
        -------
        dict of str to ndarray
            Number, state, cost and every gain, a value for each trial.
        """
        rows = [{"trial": t.number, "state": t.state, "cost_mm": t.cost_mm, **t.gains} for t in self.trials]
        return as_columns(rows, ["trial", "state", "cost_mm", *self.tuned.gains])

    def figures(self) -> dict[str, Any]:
        """Return the figures of the tuning.

        Returns
        -------
        dict
            As ``tune --json`` prints them.
        """
        return {
            "mission": self.mission, "law": self.law, "plant": self.plant, "seed": self.seed,
            "trials": len(self.trials), "worlds": self.worlds, "best_cost_mm": self.best_cost_mm,
            "before": self.before.figures(), "tuned": self.tuned.figures(), "importances": dict(self.importances),
            "verdict": "better" if self.improved else "not better",
            "folder": None if self.folder is None else str(self.folder),
        }  # fmt: skip


class Tune(Protocol):
    """Protocol of the entry point ``tune`` of ``smolbot.functions``; see `tune` for the parameters."""

    def __call__(
        self, mission: str, *, trials: int, worlds: int, held_out: int, plant: PlantName, only: Sequence[str] | None,
        seed: int, rig: str | None, jobs: int, scheduler: str | None, out: Path | None, resume: bool,
        settings: Mapping[str, str], progress: Callable[[int, float | None], None] | None, force: str | None,
    ) -> Tuning:  # fmt: skip
        """Search gains for the mission."""


def tune(
    mission: str,
    *,
    trials: int = 100,
    worlds: int = 9,
    held_out: int = 20,
    plant: PlantName = "reduced",
    only: Sequence[str] | None = None,
    seed: int = 1,
    rig: str | None = None,
    jobs: int = 1,
    scheduler: str | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    settings: Mapping[str, str] | None = None,
    progress: Callable[[int, float | None], None] | None = None,
    force: Force | None = None,
    **overrides: Any,
) -> Tuning:
    """Tune a mission's gains on random simulations, and validate the best on held-out ones.

    Parameters
    ----------
    mission : str
        Shipped name, or path of a mission file.
    trials : int
        Sets of gains to try.
    worlds : int
        Random simulations that each is flown in.
    held_out : int
        Simulations of the full tank that the best is validated in.
    plant : {"full", "reduced"}
        Plant in which trials fly.
    only : sequence of str, optional
        Gains to tune; by default all.
    seed : int
        The same seed gives the same gains, whatever `jobs`.
    rig : str, optional
        A rig to use instead of the mission's own.
    jobs : int
        Processes; 1 flies in this one, 0 means one per core.
    scheduler : str, optional
        Address of a dask scheduler, instead of processes.
    out : path, optional
        Folder for the journal of trials, gains.toml and the figure; none is made without it.
    resume : bool
        Continue the search in `out`.
    settings : mapping of str to str, optional
        Override the files; keys with dots.
    progress : callable, optional
        Called after each trial with the number of ended trials and the best cost so far, in mm or None.
    force : {"preview"}, optional
        Tune even where the preview says no-go with the present gains.
    **overrides
        Settings with ``__`` for the dot.

    Returns
    -------
    Tuning

    Raises
    ------
    ConfigError, InputError
        For every fault of the files, and where the preview says no-go, before anything flies.
    PluginError
        If no package that tunes is installed.

    Examples
    --------
    >>> import smolbot
    >>> smolbot.tune("line", only=["agility"])
    Traceback (most recent call last):
    smolbot.errors.InputError: --only: current_ratio has no gain 'agility'; it has ...
    """
    seed, jobs, plant = as_count(seed, 0, "seed"), as_count(jobs, 0, "jobs"), check_plant(plant)
    trials, worlds = as_count(trials, 1, "trials"), as_count(worlds, 1, "worlds")
    held_out = as_count(held_out, 1, "held_out")
    search: Tune = load_plugin("functions", "tune")
    return search(
        mission, trials=trials, worlds=worlds, held_out=held_out, plant=plant, only=only, seed=seed, rig=rig, jobs=jobs,
        scheduler=scheduler, out=None if out is None else Path(out), resume=resume,
        settings=merge_settings(settings, overrides), progress=progress,
        force=force,
    )  # fmt: skip
