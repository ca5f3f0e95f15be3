"""``simulate``: one mission over many seeds; its interface and results. The package ``sim`` implements it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol, get_args

import numpy as np

from smolbot.config.plugins import load_plugin
from smolbot.core.arrays import as_count
from smolbot.core.results import Readable, as_columns
from smolbot.errors import InputError, suggest_name
from smolbot.flight.preview.missions import Force
from smolbot.functions.settings import merge_settings

PlantName = Literal["full", "reduced"]
"""The full tank, or its motion alone with pose noise in place of signals."""

COLUMNS = {
    "seed": ("seed",),
    "status": ("status",),
    "verdict": ("verdict",),
    "plant": ("plant",),
    "duration_s": ("duration_s",),
    "cycles": ("cycles",),
    "loop_rate_hz": ("loop_rate_hz",),
    "timeline_limit_hz": ("timeline_limit_hz",),
    "visited_share": ("visited_share",),
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
"""Columns of results.csv, and the key of each in a run's summary."""


@dataclass(frozen=True, repr=False)
class Flight(Readable):
    """One simulated run.

    Attributes
    ----------
    summary : dict
        Its figures, as ``run --json`` prints them.
    trail : ndarray, shape (n, 3), in m
        True positions of the robot.
    process : int
        Process that ran it; it ended at `ended`, in s since the epoch, and at `used`, in s of the process's CPU time.
    """

    summary: dict[str, Any]
    trail: Any
    process: int = 0
    ended: float = 0.0
    used: float = 0.0

    @property
    def passed(self) -> bool:
        """Whether the mission's verdict is passed."""
        return bool(self.summary["verdict"] == "passed")

    def value(self, column: str) -> Any:
        """Return one figure of this flight.

        Parameters
        ----------
        column : str
            One of the `COLUMNS`.

        Returns
        -------
        object
            None if this flight has no such figure.
        """
        found: Any = self.summary
        for key in COLUMNS[column]:
            found = found.get(key) if isinstance(found, dict) else None
        return found

    def row(self) -> dict[str, Any]:
        """Return this flight as a row of the table.

        Returns
        -------
        dict
            All `COLUMNS`.
        """
        return {column: self.value(column) for column in COLUMNS}


@dataclass(frozen=True, repr=False)
class Simulation(Readable):
    """Many simulated flights of one mission.

    Attributes
    ----------
    mission, plant : str
    flights : tuple of Flight
        By rising seed.
    pass_rate_95 : (float, float)
        95 % interval of the rate at which flights pass.
    flights_per_minute : mapping of str to float or None
        ``in_all``; ``warm`` once all processes run; ``per_processor`` in use.
    folder : Path or None
        Folder of results.csv and the figure; None if not requested.
    """

    mission: str
    plant: str
    flights: tuple[Flight, ...]
    pass_rate_95: tuple[float, float]
    flights_per_minute: Mapping[str, float | None]
    folder: Path | None = None

    @property
    def passed(self) -> int:
        """Number of flights that passed."""
        return sum(flight.passed for flight in self.flights)

    @property
    def ideal(self) -> bool:
        """Whether any flight had poses without error, which no bench has."""
        return any(flight.summary["ideal"] for flight in self.flights)

    def columns(self) -> list[str]:
        """Return the names of the columns.

        Returns
        -------
        list of str
            Those of the `COLUMNS` that any flight has.
        """
        return [column for column in COLUMNS if any(f.value(column) is not None for f in self.flights)]

    def table(self) -> dict[str, np.ndarray[Any, Any]]:
        """Return all flights as columns.

        Returns
        -------
        dict of str to ndarray
            A value for each flight.
        """
        return as_columns((flight.row() for flight in self.flights), self.columns())

    def figures(self) -> dict[str, Any]:
        """Compute the figures over all flights.

        Returns
        -------
        dict
            Mean, min and max of each column, as ``simulate --json`` prints them.
        """
        spread = {}
        for column in COLUMNS:
            values = [v for f in self.flights if isinstance(v := f.value(column), int | float)]
            if values and column != "seed":
                spread[column] = {
                    name: float(of(values)) for name, of in (("mean", np.mean), ("min", min), ("max", max))
                }
        return {
            "mission": self.mission,
            "plant": self.plant,
            "ideal": self.ideal,
            "flown": len(self.flights),
            "passed": self.passed,
            "pass_rate": self.passed / len(self.flights),
            "pass_rate_95": self.pass_rate_95,
            **spread,
            "flights_per_minute": dict(self.flights_per_minute),
            "folder": None if self.folder is None else str(self.folder),
        }


def check_plant(plant: PlantName) -> PlantName:
    """Return the name of a plant; raise `InputError` if there is none of that name.

    Parameters
    ----------
    plant : {"full", "reduced"}

    Returns
    -------
    str
    """
    if plant not in (known := get_args(PlantName)):
        raise InputError(f"plant must be one of {', '.join(known)}; got {plant!r}.{suggest_name(str(plant), known)}")
    return plant


class Simulate(Protocol):
    """Protocol of the entry point ``simulate`` of ``smolbot.functions``; see `simulate` for the parameters."""

    def __call__(
        self, mission: str, seeds: Iterable[int], *, rig: str | None, plant: PlantName, jobs: int,
        scheduler: str | None, out: Path | None, settings: Mapping[str, str],
        progress: Callable[[Flight], None] | None, force: str | None,
    ) -> Simulation:  # fmt: skip
        """Fly the mission once per seed."""


def simulate(
    mission: str,
    seeds: Iterable[int] = range(1, 21),
    *,
    rig: str | None = None,
    plant: PlantName = "full",
    jobs: int = 1,
    scheduler: str | None = None,
    out: str | Path | None = None,
    settings: Mapping[str, str] | None = None,
    progress: Callable[[Flight], None] | None = None,
    force: Force | None = None,
    **overrides: Any,
) -> Simulation:
    """Fly a mission in a simulated tank once per seed, with mismatches sampled anew for each.

    Parameters
    ----------
    mission : str
        Shipped name, or path of a mission file.
    seeds : iterable of int
        The same seed gives the same flight, whatever `jobs`.
    rig : str, optional
        A rig to use instead of the mission's own.
    plant : {"full", "reduced"}
        The full tank, or motion alone with pose noise in place of signals: some hundred times as fast.
    jobs : int
        Processes; 1 flies in this one, 0 means one per core. A script that starts more than one needs
        ``if __name__ == "__main__":``.
    scheduler : str, optional
        Address of a dask scheduler, instead of processes.
    out : path, optional
        Folder to make for results.csv, the figure and the files; none is made without it.
    settings : mapping of str to str, optional
        Override the files; keys with dots.
    progress : callable, optional
        Called with each flight as it ends, in any order.
    force : {"preview"}, optional
        Fly even where the preview says no-go.
    **overrides
        Settings with ``__`` for the dot.

    Returns
    -------
    Simulation

    Raises
    ------
    ConfigError, InputError
        For every fault of the files, and where the preview says no-go, before anything flies.
    PluginError
        If no package that simulates is installed.

    Examples
    --------
    >>> import smolbot
    >>> smolbot.simulate("line", [], plant="reduced")
    Traceback (most recent call last):
    smolbot.errors.InputError: simulate needs one seed at least; got none.
    """
    try:
        wanted = [as_count(seed, 0, "each of seeds") for seed in seeds]
    except TypeError as error:
        raise InputError(f"seeds must be whole numbers, such as range(1, 21); got {seeds!r}.") from error
    jobs, plant = as_count(jobs, 0, "jobs"), check_plant(plant)
    fly: Simulate = load_plugin("functions", "simulate")
    return fly(
        mission, wanted, rig=rig, plant=plant, jobs=jobs, scheduler=scheduler, out=None if out is None else Path(out),
        settings=merge_settings(settings, overrides), progress=progress, force=force,
    )  # fmt: skip
