"""Whether tuned gains are better: both are flown in the full tank, on worlds that the search did not use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.batch.flights import PlantModel, fly_one
from sim.batch.intervals import compute_wilson_interval
from sim.tuning.cost import compute_cost
from sim.tuning.search import Problem
from smolbot.functions.tune import HeldOut

FIRST_HELD_OUT = 1_000_000
"""Held-out worlds begin here; those of the search lie below."""


@dataclass(frozen=True)
class Flown:
    """Gains, and how they did on the held-out worlds in the full tank."""

    gains: Mapping[str, float]
    summaries: Sequence[Mapping[str, Any]]

    @property
    def passed(self) -> int:
        """Number of flights that passed."""
        return sum(s["verdict"] == "passed" for s in self.summaries)

    @property
    def costs(self) -> list[float]:
        """Cost of each flight, in mm."""
        return [compute_cost(s) for s in self.summaries]

    def figures(self) -> dict[str, Any]:
        """Return pass rate, cost and errors for tables and JSON.

        Returns
        -------
        dict
        """
        return self.summarize().figures()

    def summarize(self) -> HeldOut:
        """Summarize the flights for `smolbot.tune`.

        Returns
        -------
        HeldOut
        """
        done = [s for s in self.summaries if s["status"] == "completed"]
        return HeldOut(
            dict(self.gains), len(self.summaries), self.passed,
            compute_wilson_interval(self.passed, len(self.summaries)),
            float(np.mean(self.costs)), tuple(self.costs), _compute_mean([s["tracking_error_mm"]["rms"] for s in done]),
            _compute_mean([s["duration_s"] for s in done]),
        )  # fmt: skip


def fly_held_out(problem: Problem, gains: Sequence[Mapping[str, float]], count: int, executor: Executor) -> list[Flown]:
    """Fly each set of gains over the same held-out worlds, in the full tank.

    Parameters
    ----------
    problem : Problem
    gains : sequence of mapping of str to float
    count : int
        Number of worlds.
    executor : Executor

    Returns
    -------
    list of Flown
    """
    seeds = range(FIRST_HELD_OUT, FIRST_HELD_OUT + count)
    flights = [
        [executor.submit(fly_one, problem.mission, problem.rig, problem.make_settings(one), seed, PlantModel.FULL)
         for seed in seeds]
        for one in gains
    ]  # fmt: skip
    return [Flown(one, [f.result().summary for f in group]) for one, group in zip(gains, flights, strict=True)]


def is_better(tuned: Flown, before: Flown) -> bool:
    """Return whether the tuned gains pass at least as often and cost less on average over the same worlds.

    Parameters
    ----------
    tuned, before : Flown

    Returns
    -------
    bool
    """
    return tuned.passed >= before.passed and float(np.mean(tuned.costs)) < float(np.mean(before.costs))


def _compute_mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None
