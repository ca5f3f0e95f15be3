"""The command ``smolbot simulate``: one mission over many seeds, each with a newly sampled tank."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sim.batch.flights import PlantModel
from smolbot.errors import InputError
from smolbot.ui.cli.options import (
    FaultOption,
    JsonOption,
    MissionArgument,
    RigOption,
    SetOption,
    add_faults,
    parse_settings,
    require_tank,
)

if TYPE_CHECKING:
    from smolbot.functions.simulate import Flight, Simulation


def _list_faults(wanted: bool) -> None:
    """Print the faults of a tank and exit."""
    if not wanted:
        return
    from sim.tank.tank_faults import TANK_FAULTS, describe_fault
    from smolbot.ui.cli.show import print_table

    print_table("faults of a simulated tank", [describe_fault(name) for name in TANK_FAULTS], err=False)
    raise typer.Exit


def simulate(
    mission: MissionArgument,
    seeds: Annotated[str, typer.Option(help="First and last seed: A..B.")] = "1..20",
    rig: RigOption = None,
    plant: Annotated[
        PlantModel,
        typer.Option(help="The full tank, or a reduced one: motion only, with pose noise in place of signals."),
    ] = PlantModel.FULL,
    jobs: Annotated[int, typer.Option(min=0, help="Processes; 0 for one per core.")] = 0,
    scheduler: Annotated[str | None, typer.Option(help="Address of a dask scheduler, instead of processes.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder to make; default: a new one in runs/.")] = None,
    set_: SetOption = None,
    fault: FaultOption = None,
    list_faults: Annotated[
        bool,
        typer.Option("--list-faults", callback=_list_faults, is_eager=True, help="List a tank's faults and exit."),
    ] = False,
    json: JsonOption = False,
) -> None:
    """Fly a mission in a simulated tank once per seed: table, pass rate with 95 % interval, results.csv, figure."""
    from smolbot.config.load import load_mission
    from smolbot.functions.simulate import simulate as fly_seeds
    from smolbot.runs.folder import make_dated_path
    from smolbot.ui.cli.show import show_bar

    seed_list, settings = parse_seeds(seeds), add_faults(parse_settings(set_), fault)
    loaded = load_mission(mission, rig, settings)
    require_tank(loaded.rig, fault)
    name = loaded.name
    passed = 0
    with show_bar(name, total=len(seed_list)) as update:

        def progress(flight: Flight) -> None:
            nonlocal passed
            passed += flight.passed
            update(advance=1, description=f"{name}: {passed} passed")

        found = fly_seeds(
            mission, seed_list, rig=rig, plant=plant.value, jobs=jobs, scheduler=scheduler,
            out=out or make_dated_path(f"simulate-{name}"), settings=settings, progress=progress,
        )  # fmt: skip
    _print_results(found, json)
    raise typer.Exit(0 if found.passed == len(found.flights) else 1)


def parse_seeds(text: str) -> list[int]:
    """Parse a range of seeds.

    Parameters
    ----------
    text : str
        ``A..B`` (both included) or a single number.

    Returns
    -------
    list of int

    Raises
    ------
    InputError
        If it is neither, or runs downwards.

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


def _print_results(found: Simulation, json: bool) -> None:
    from smolbot.functions.simulate import COLUMNS
    from smolbot.runs.summary import format_label
    from smolbot.ui.cli.show import echo_json, print_table

    figures = found.figures()
    low, high = found.pass_rate_95
    rows = [
        ("passed", f"{figures['passed']} of {figures['flown']} ({low:.0%} to {high:.0%} with 95 % confidence)"),
        *([("ended by an error", f"{figures['errors']} of {figures['flown']}")] if figures["errors"] else []),
        *[
            (column, f"{v['mean']:.3g}   ({v['min']:.3g} to {v['max']:.3g})")
            for column in COLUMNS
            if isinstance(v := figures.get(column), dict)
        ],
        ("flights a minute", _format_rates(found.flights_per_minute)),
        *[
            (f"seed {f.summary['seed']}", "; ".join(f.summary["verdict_reasons"]))
            for f in found.flights
            if not f.passed
        ],
        ("folder", figures["folder"]),
    ]
    print_table(
        f"{figures['mission']}, {figures['flown']} flights{format_label(figures)}: mean (least to most)", rows, err=json
    )
    if json:
        echo_json(figures)


def _format_rates(rates: Mapping[str, float | None]) -> str:
    text = f"{rates['in_all']:.0f}"
    if rates["warm"] is None:
        return text
    return f"{text}; {rates['warm']:.0f} once all processes run, {rates['per_processor']:.0f} per processor in use"
