"""``smolbot simulate``: one mission over many seeds, each a tank drawn anew."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sim.batch.flights import COLUMNS, Flight, Plant, combine, fly_seeds, warm_rates, write_results
from smolbot.errors import InputError
from smolbot.ui.cli.options import JsonOption, MissionArgument, RigOption, SetOption, settings_from

if TYPE_CHECKING:
    from smolbot.config.load import AnyMission


def simulate(
    mission: MissionArgument,
    seeds: Annotated[str, typer.Option(help="First and last seed: A..B.")] = "1..20",
    rig: RigOption = None,
    plant: Annotated[
        Plant, typer.Option(help="The full tank, or a reduced one: motion only, with pose noise in place of signals.")
    ] = Plant.FULL,
    jobs: Annotated[int, typer.Option(min=0, help="Processes; 0 for one per core.")] = 0,
    scheduler: Annotated[str | None, typer.Option(help="Address of a dask scheduler, instead of processes.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder to make; default: a new one in runs/.")] = None,
    set_: SetOption = None,
    json: JsonOption = False,
) -> None:
    """Fly a mission in a simulated tank once per seed: table, pass rate with 95 % interval, results.csv, figure."""
    from sim.batch.executors import open_executor
    from smolbot.config.load import load_mission
    from smolbot.runs.folder import RunFolder, dated, provenance
    from smolbot.runs.recording.files import RunFiles

    wanted = parse_seeds(seeds)
    settings = settings_from(set_)
    loaded = load_mission(mission, rig, settings)
    if plant is Plant.REDUCED:
        from sim.reduced.rig import require_flyable

        require_flyable(loaded)
    if loaded.robot.kind == "gradient":
        loaded.rig.table()  # built once, before the workers need it
    folder = RunFolder(out or dated(f"simulate-{loaded.name}"))
    where = provenance(wanted[0], settings, {"seeds": wanted, "plant": str(plant)})
    folder.begin(RunFiles.of(loaded).contents, where)
    begin = time.perf_counter()
    with open_executor(jobs, scheduler) as executor:
        flown = fly_seeds(executor, mission, rig, settings, wanted, plant)
        flights = list(_watched(flown, loaded.name, len(wanted)))
        wall = time.perf_counter() - begin
    flights.sort(key=lambda f: f.summary["seed"])
    write_results(folder.path / "results.csv", flights)
    draw(loaded, flights, folder.path / "flights.png")
    figures = combine(loaded.name, flights)
    figures["flights_per_minute"] = {"in_all": 60.0 * len(flights) / wall, **warm_rates(flights)}
    figures["folder"] = str(folder.path)
    folder.end(figures)
    _show(figures, flights, json)
    raise typer.Exit(0 if figures["passed"] == figures["flown"] else 1)


def parse_seeds(text: str) -> list[int]:
    """Seeds of ``A..B`` (both included) or of a single number.

    Examples
    --------
    >>> parse_seeds("3..5")
    [3, 4, 5]
    """
    first, dots, last = text.partition("..")
    try:
        a, b = int(first), int(last if dots else first)
    except ValueError:
        raise InputError(f"--seeds must be A..B, such as 1..20; got '{text}'.") from None
    if a < 0 or b < a:
        raise InputError(f"--seeds must run from low to high and not below 0; got '{text}'.")
    return list(range(a, b + 1))


def draw(mission: AnyMission, flights: list[Flight], path: Path) -> None:
    """Write the picture of all flights."""
    from smolbot.config.observation import Observation

    if isinstance(mission, Observation):
        from sim.batch.observations_picture import draw_observations

        draw_observations(mission, flights, path)
    else:
        from sim.batch.flights_picture import draw_flights

        draw_flights(mission, flights, path)


def _watched(flights: Iterator[Flight], name: str, total: int) -> Iterator[Flight]:
    from smolbot.ui.cli.show import bar

    passed = 0
    with bar(name, total=total) as tell:
        for flight in flights:
            passed += flight.summary["verdict"] == "passed"
            tell(advance=1, description=f"{name}: {passed} passed")
            yield flight


def _show(figures: dict[str, Any], flights: list[Flight], json: bool) -> None:
    from smolbot.runs.summary import label_of
    from smolbot.ui.cli.show import echo_json, table

    low, high = figures["pass_rate_95"]
    rows = [
        ("passed", f"{figures['passed']} of {figures['flown']} ({low:.0%} to {high:.0%} with 95 % confidence)"),
        *[
            (column, f"{v['mean']:.3g}   ({v['min']:.3g} to {v['max']:.3g})")
            for column in COLUMNS
            if isinstance(v := figures.get(column), dict)
        ],
        ("flights a minute", _rates(figures["flights_per_minute"])),
        *[
            (f"seed {f.summary['seed']}", "; ".join(f.summary["verdict_reasons"]))
            for f in flights
            if f.summary["verdict"] != "passed"
        ],
        ("folder", figures["folder"]),
    ]
    table(f"{figures['mission']}, {figures['flown']} flights{label_of(figures)}: mean (least to most)", rows, err=json)
    if json:
        echo_json(figures)


def _rates(rates: dict[str, float | None]) -> str:
    text = f"{rates['in_all']:.0f}"
    if rates["warm"] is None:
        return text
    return f"{text}; {rates['warm']:.0f} once all processes run, {rates['per_processor']:.0f} per processor in use"
