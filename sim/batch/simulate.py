"""Flies a mission over many seeds, each with a new tank: the entry point ``simulate`` of ``smolbot.functions``."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from sim.batch.executors import open_executor
from sim.batch.flights import PlantModel, compute_warm_rates, fly_seeds
from sim.batch.intervals import compute_wilson_interval
from sim.tank.settings import TankSettings
from sim.tank.tank_faults import find_channels, parse_tank_faults
from smolbot.config.load import AnyMission, load_mission
from smolbot.config.observation import Observation
from smolbot.config.rig import RigConfig
from smolbot.core.text_table import write_table
from smolbot.errors import InputError
from smolbot.flight.preview.missions import require_go
from smolbot.functions.simulate import Flight, PlantName, Simulation
from smolbot.runs.folder import RunFolder, collect_provenance
from smolbot.runs.recording.run_files import RunFiles


def simulate(
    mission: str, seeds: Iterable[int], *, rig: str | None, plant: PlantName, jobs: int, scheduler: str | None,
    out: Path | None, settings: Mapping[str, str], progress: Callable[[Flight], None] | None,
    force: str | None = None,
) -> Simulation:  # fmt: skip
    """Fly a mission once per seed.

    Parameters
    ----------
    mission, seeds, rig, plant, jobs, scheduler, out, settings, progress, force
        As of `smolbot.simulate`.

    Returns
    -------
    Simulation

    Raises
    ------
    InputError
        Without seeds, if the reduced plant cannot fly this mission, or where the preview says no-go.
    """
    seeds, settings = sorted(seeds), dict(settings)
    if not seeds:
        raise InputError("simulate needs one seed at least; got none.")
    loaded = load_mission(mission, rig, settings)
    if plant == "reduced":
        from sim.reduced.rig import require_flyable

        require_flyable(loaded)
    require_channels(loaded.rig)
    require_go(loaded, force)
    if loaded.robot.kind == "gradient":
        loaded.rig.table()  # built once, before the workers need it
    folder = None if out is None else RunFolder(out)
    if folder is not None:
        where = collect_provenance(seeds[0], settings, {"seeds": seeds, "plant": plant})
        folder.begin(RunFiles.of(loaded).contents, where)
    begin, flights = time.perf_counter(), []
    with open_executor(jobs, scheduler) as executor:
        for flight in fly_seeds(executor, mission, rig, settings, seeds, PlantModel(plant)):
            flights.append(flight)
            if progress is not None:
                progress(flight)
        wall = time.perf_counter() - begin
    flights.sort(key=lambda f: f.summary["seed"])
    rates = {"in_all": 60.0 * len(flights) / wall, **compute_warm_rates(flights)}
    interval = compute_wilson_interval(sum(f.passed for f in flights), len(flights))
    found = Simulation(loaded.name, plant, tuple(flights), interval, rates, out)
    if folder is not None:
        columns = found.columns()
        write_table(folder.path / "results.csv", columns, ([f.value(c) for c in columns] for f in flights))
        draw(loaded, flights, folder.path / "flights.png")
        folder.end(found.figures())
    return found


def require_channels(rig: RigConfig) -> None:
    """Raise `InputError` if a fault of the rig file concerns a channel that the rig does not have.

    Parameters
    ----------
    rig : RigConfig
    """
    if rig.world == "tank":
        for fault in parse_tank_faults(rig.section_of("tank", TankSettings).faults):
            find_channels(fault, rig)


def draw(mission: AnyMission, flights: list[Flight], path: Path) -> None:
    """Write the picture of all flights.

    Parameters
    ----------
    mission : Mission or Observation
    flights : list of Flight
    path : Path
    """
    if isinstance(mission, Observation):
        from sim.batch.observations_picture import draw_observations

        draw_observations(mission, flights, path)
    else:
        from sim.batch.flights_picture import draw_flights

        draw_flights(mission, flights, path)
