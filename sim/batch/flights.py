"""Many flights of one mission: flown in whatever processes there are."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from concurrent.futures import Executor, as_completed
from enum import StrEnum
from typing import Any

from smolbot.functions.simulate import Flight


class Plant(StrEnum):
    """The whole tank, or its motion alone with pose noise in place of signals."""

    FULL = "full"
    REDUCED = "reduced"


def fly_seeds(
    executor: Executor,
    mission: str,
    rig: str | None,
    settings: dict[str, str],
    seeds: list[int],
    plant: Plant = Plant.FULL,
) -> Iterator[Flight]:
    """Flights as they end, in any order, over any `concurrent.futures.Executor`."""
    forget_missions()
    futures = [executor.submit(fly_one, mission, rig, settings, seed, plant) for seed in seeds]
    for future in as_completed(futures):
        yield future.result()


_loaded: dict[tuple[Any, ...], Any] = {}


def forget_missions() -> None:
    """Read files anew where they are needed next in this process: they may have changed since it flew last."""
    _loaded.clear()


def fly_one(mission: str, rig: str | None, settings: dict[str, str], seed: int, plant: Plant = Plant.FULL) -> Flight:
    """One flight, in whatever process this is; files are read once per process."""
    from smolbot.config.load import load_mission
    from smolbot.flight.session import fly

    key = (mission, rig, tuple(sorted(settings.items())))
    if key not in _loaded:
        _loaded[key] = load_mission(mission, rig, settings)
    opener = None
    if plant is Plant.REDUCED:
        from sim.reduced.rig import open_reduced

        opener = open_reduced
    run = fly(_loaded[key], seed, settings=settings, opener=opener)
    return Flight(run.summary, run.true_trail, os.getpid(), time.time(), time.process_time())


def warm_rates(flights: list[Flight]) -> dict[str, float | None]:
    """Flights a minute from each process' first flight on, since that one loads what the others find.

    `warm` is that of all processes together, `per_processor` what one would make that has a core to itself. None
    where no process flew twice.

    Examples
    --------
    >>> flown = ((1, 9.0, 2.0), (2, 9.5, 2.1), (1, 10.0, 2.5), (1, 11.0, 3.0))
    >>> warm_rates([Flight({}, None, process, ended, used) for process, ended, used in flown])
    {'warm': 60.0, 'per_processor': 120.0}
    """
    own: dict[int, list[Flight]] = {}
    for flight in flights:
        own.setdefault(flight.process, []).append(flight)
    again = [sorted(f, key=lambda f: f.ended) for f in own.values() if len(f) > 1]
    if not again:
        return {"warm": None, "per_processor": None}
    warm = sum(60.0 * (len(f) - 1) / (f[-1].ended - f[0].ended) for f in again)
    used = sum(f[-1].used - f[0].used for f in again)
    return {"warm": warm, "per_processor": 60.0 * sum(len(f) - 1 for f in again) / used}
