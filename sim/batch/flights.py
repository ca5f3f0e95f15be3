"""Many flights of one mission: flown in whatever processes there are."""

from __future__ import annotations

import logging
import os
import time
import traceback
from collections.abc import Iterator
from concurrent.futures import Executor, as_completed
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smolbot.config.mission import Mission
from smolbot.errors import SmolbotError
from smolbot.functions.simulate import Flight

if TYPE_CHECKING:
    from smolbot.config.load import AnyMission

_LOG = logging.getLogger(__name__)


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
        As they end, in any order. One that an error ended is a failed flight among them.

    Raises
    ------
    PluginError
        If a lab's own part failed: it would fail in every flight.
    """
    forget_missions()
    futures = [executor.submit(fly_one, mission, rig, settings, seed, plant) for seed in seeds]
    for future in as_completed(futures):
        yield future.result()


def make_failed_flight(mission: AnyMission, seed: int, plant: PlantModel, error: Exception) -> Flight:
    """Make the row of a flight that an unexpected error ended.

    Parameters
    ----------
    mission : Mission or Observation
    seed : int
    plant : PlantModel
    error : Exception

    Returns
    -------
    Flight
        Failed; its reason names the error's type and where it was raised.
    """
    reason = describe_error(error)
    summary: dict[str, Any] = {
        "mission": mission.name, "seed": seed, "status": "failed", "stop_reason": reason, "verdict": "failed",
        "verdict_reasons": [reason], "plant": plant.value, "ideal": False, "error": type(error).__name__,
    }  # fmt: skip
    if isinstance(mission, Mission):
        summary["path_length_mm"] = 1e3 * mission.path.length
    return Flight(summary, None, os.getpid(), time.time(), time.process_time())


def describe_error(error: Exception) -> str:
    """Describe an error with its type and the innermost line that raised it.

    Parameters
    ----------
    error : Exception

    Returns
    -------
    str

    Examples
    --------
    >>> describe_error(ValueError("no such thing"))
    'ValueError: no such thing'
    """
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if "site-packages" not in Path(frame.filename).parts] or list(frames)
    where = f" ({Path(ours[-1].filename).name}:{ours[-1].lineno}, in {ours[-1].name})" if ours else ""
    return f"{type(error).__name__}: {error}{where}"


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
        A failed one if an error ended it.

    Raises
    ------
    ConfigError, InputError
        If the files cannot be flown at all.
    PluginError
        If a lab's own part failed.
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
    try:
        run = fly(_loaded[key], seed, settings=settings, opener=opener)
    except SmolbotError:  # files that cannot be flown, or a lab's own part: every flight would end so
        raise
    except Exception as error:  # one bad world is one failed flight, and its row says where
        _LOG.warning("%s, seed %d: the flight was ended by an error", _loaded[key].name, seed, exc_info=error)
        return make_failed_flight(_loaded[key], seed, plant, error)
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
