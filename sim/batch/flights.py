"""Many flights of one mission: flown in whatever processes there are, and their figures together."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from smolbot.core.text_table import write_rows

COLUMNS = {
    "seed": ("seed",),
    "status": ("status",),
    "verdict": ("verdict",),
    "plant": ("plant",),
    "duration_s": ("duration_s",),
    "cycles": ("cycles",),
    "loop_rate_hz": ("loop_rate_hz",),
    "timeline_limit_hz": ("timeline_limit_hz",),
    "localization_mean_mm": ("localization_error_mm", "mean"),
    "localization_p95_mm": ("localization_error_mm", "p95"),
    "tracked_mean_mm": ("tracked_error_mm", "mean"),
    "orientation_mean_deg": ("orientation_error_deg", "mean"),
    "axis_error_mean_deg": ("axis_error_deg", "mean"),
    "axis_error_max_deg": ("axis_error_deg", "max"),
    "axis_tracked_mean_deg": ("axis_error_tracked_deg", "mean"),
    "axis_to_path_deg": ("axis_to_path_deg", "mean"),
    "pauses": ("pauses",),
    "turns": ("turns",),
    "step_outs": ("step_outs",),
    "tracking_mean_mm": ("tracking_error_mm", "mean"),
    "tracking_rms_mm": ("tracking_error_mm", "rms"),
    "tracking_p95_mm": ("tracking_error_mm", "p95"),
    "tracking_max_mm": ("tracking_error_mm", "max"),
    "pose_rate_hz": ("pose_rate_hz",),
    "gaps": ("gaps", "count"),
    "longest_gap_s": ("gaps", "longest_s"),
    "measurements": ("measurements",),
    "sigma_x_mm": ("sigma_mm", "x"),
    "sigma_y_mm": ("sigma_mm", "y"),
    "sigma_z_mm": ("sigma_mm", "z"),
    "sigma_mm": ("sigma_mm", "distance"),
    "sigma_deg": ("sigma_deg", "angle"),
    "r_squared_median": ("r_squared_median",),
    "flips": ("flips",),
    "compute_p99_ms": ("compute_ms", "p99"),
    "realtime_factor": ("realtime_factor",),
    "stop_reason": ("stop_reason",),
}
"""Columns of results.csv, and where each stands in a run's summary."""


class Plant(StrEnum):
    """The whole tank, or its motion alone with pose noise in place of signals."""

    FULL = "full"
    REDUCED = "reduced"


@dataclass(frozen=True)
class Flight:
    """One simulated run: its summary and where the robot truly went, (n, 2) in mm.

    `process` flew it, and had it done at `ended`, in s since the epoch, and at `used`, in s of its processor time.
    """

    summary: dict[str, Any]
    trail: Any
    process: int = 0
    ended: float = 0.0
    used: float = 0.0

    def value(self, column: str) -> Any:
        found: Any = self.summary
        for key in COLUMNS[column]:
            found = found.get(key) if isinstance(found, dict) else None
        return found


def fly_seeds(
    executor: Executor,
    mission: str,
    rig: str | None,
    settings: dict[str, str],
    seeds: list[int],
    plant: Plant = Plant.FULL,
) -> Iterator[Flight]:
    """Flights as they end, in any order, over any `concurrent.futures.Executor`."""
    futures = [executor.submit(fly_one, mission, rig, settings, seed, plant) for seed in seeds]
    for future in as_completed(futures):
        yield future.result()


_loaded: dict[tuple[Any, ...], Any] = {}


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


def combine(mission: str, flights: list[Flight]) -> dict[str, Any]:
    """Figures over all flights."""
    import numpy as np

    from sim.batch.intervals import wilson_interval

    passed = sum(f.summary["verdict"] == "passed" for f in flights)
    out: dict[str, Any] = {
        "mission": mission,
        "plant": flights[0].summary["plant"],
        "ideal": any(f.summary["ideal"] for f in flights),
        "flown": len(flights),
        "passed": passed,
        "pass_rate": passed / len(flights),
        "pass_rate_95": wilson_interval(passed, len(flights)),
    }
    for column in COLUMNS:
        values = [v for f in flights if isinstance(v := f.value(column), int | float)]
        if values and column != "seed":
            out[column] = {"mean": float(np.mean(values)), "min": float(np.min(values)), "max": float(np.max(values))}
    return out


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


def write_results(path: Path, flights: list[Flight]) -> None:
    """One line per flight."""
    told = [column for column in COLUMNS if any(f.value(column) is not None for f in flights)]
    write_rows(path, told, ([f.value(column) for column in told] for f in flights))
