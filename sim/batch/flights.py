"""Many flights of one mission: flown in whatever processes there are."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from concurrent.futures import Executor, as_completed
from enum import StrEnum
from typing import Any

from smolbot.functions.simulate import Flight


class PlantModel(StrEnum):
    """The full tank, or its motion alone with pose noise in place of signals."""

    FULL = "full"
    REDUCED = "reduced"


def fly_seeds(
    executor: Executor,
    mission: str,
    rig: str | None,
    settings: dict[str, str],
    seeds: list[int],
    plant: PlantModel = PlantModel.FULL,
) -> Iterator[Flight]:
    """Fly a mission once per seed, in parallel.

    Parameters
    ----------
    executor : concurrent.futures.Executor
    mission : str
        Name or path.
    rig : str or None
        Name or path; None for the mission's own.
    settings : dict of str to str
        Overrides, as ``--set`` takes them.
    seeds : list of int
    plant : PlantModel

    Yields
    ------
    Flight
        As they end, in any order.
    """
    forget_missions()
    futures = [executor.submit(fly_one, mission, rig, settings, seed, plant) for seed in seeds]
    for future in as_completed(futures):
        yield future.result()


_loaded: dict[tuple[Any, ...], Any] = {}


def forget_missions() -> None:
    """Forget the loaded missions: their files may have changed since this process flew last."""
    _loaded.clear()


def fly_one(
    mission: str, rig: str | None, settings: dict[str, str], seed: int, plant: PlantModel = PlantModel.FULL
) -> Flight:
    """Fly a mission once, in the calling process; files are read once per process.

    Parameters
    ----------
    mission : str
        Name or path.
    rig : str or None
        Name or path; None for the mission's own.
    settings : dict of str to str
        Overrides, as ``--set`` takes them.
    seed : int
    plant : PlantModel

    Returns
    -------
    Flight
    """
    from smolbot.config.load import load_mission
    from smolbot.flight.session import fly

    key = (mission, rig, tuple(sorted(settings.items())))
    if key not in _loaded:
        _loaded[key] = load_mission(mission, rig, settings)
    opener = None
    if plant is PlantModel.REDUCED:
        from sim.reduced.rig import open_reduced

        opener = open_reduced
    run = fly(_loaded[key], seed, settings=settings, opener=opener)
    return Flight(run.summary, run.true_trail, os.getpid(), time.time(), time.process_time())


def compute_warm_rates(flights: list[Flight]) -> dict[str, float | None]:
    """Compute flights per minute without each process's first flight, which loads the files that the others reuse.

    Parameters
    ----------
    flights : list of Flight

    Returns
    -------
    dict of str to float or None
        ``warm`` is the rate of all processes together, ``per_processor`` that of one which has a core to itself.
        None if no process flew twice.

    Examples
    --------
    >>> flown = ((1, 9.0, 2.0), (2, 9.5, 2.1), (1, 10.0, 2.5), (1, 11.0, 3.0))
    >>> compute_warm_rates([Flight({}, None, process, ended, used) for process, ended, used in flown])
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
