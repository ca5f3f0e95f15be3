"""``smolbot tune``: gains that hold on robots and tanks that differ from the nominal ones."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from sim.batch.flights import PlantModel
from smolbot.errors import InputError
from smolbot.ui.cli.options import ForceOption, JsonOption, MissionArgument, RigOption, SetOption, parse_settings

MIN_TRIALS = 2


def tune(
    mission: MissionArgument,
    trials: Annotated[int, typer.Option(min=MIN_TRIALS, help="Sets of gains to try.")] = 100,
    worlds: Annotated[int, typer.Option(min=1, help="Random simulations for each set of gains.")] = 9,
    held_out: Annotated[int, typer.Option(min=1, help="Other simulations, in the full tank, for validation.")] = 20,
    plant: Annotated[
        PlantModel, typer.Option(help="Plant of the trials; the best gains are validated in the full one.")
    ] = (PlantModel.REDUCED),
    only: Annotated[str | None, typer.Option(help="Gains to tune, with commas between; default: all.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same gains, whatever --jobs.")] = 1,
    rig: RigOption = None,
    jobs: Annotated[int, typer.Option(min=0, help="Processes; 0 for one per core.")] = 0,
    scheduler: Annotated[str | None, typer.Option(help="Address of a dask scheduler, instead of processes.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder to make; default: a new one in runs/.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the search that --out holds.")] = False,
    set_: SetOption = None,
    force: ForceOption = None,
    json: JsonOption = False,
) -> None:
    """Tune a mission's gains on random simulations and validate them on held-out ones."""
    from smolbot.config.mission import load_steering_mission
    from smolbot.functions.tune import tune as search_gains
    from smolbot.runs.folder import make_dated_path
    from smolbot.ui.cli.show import show_bar

    if resume and out is None:
        raise InputError("--resume needs --out, the folder of the search to go on with.")
    settings = parse_settings(set_)
    name = load_steering_mission(mission, rig, settings).name
    with show_bar(name, total=trials) as update:

        def progress(done: int, best: float | None) -> None:
            cost = "no trial complete yet" if best is None else f"best {best:.3f} mm"
            update(completed=done, description=f"{name}: {cost}")

        found = search_gains(
            mission, trials=trials, worlds=worlds, held_out=held_out, plant=plant.value,
            only=[gain.strip() for gain in only.split(",")] if only else None, seed=seed, rig=rig, jobs=jobs,
            scheduler=scheduler, out=out or make_dated_path(f"tune-{name}"), resume=resume, settings=settings,
            progress=progress, force=force,
        )  # fmt: skip
    _show(found.figures(), json)
    raise typer.Exit(0 if found.improved else 1)


def _show(figures: dict[str, Any], json: bool) -> None:
    from smolbot.ui.cli.show import echo_json, print_table

    rows = []
    for key in ("before", "tuned"):
        one = figures[key]
        low, high = one["pass_rate_95"]
        rows += [
            (key, f"{one['passed']} of {one['flown']} passed ({low:.0%} to {high:.0%} with 95 % confidence)"),
            ("", f"cost {one['cost_mm']:.3f} mm; tracking rms {_format_length(one['tracking_rms_mm'])}, "
                 f"robot time {_format_length(one['duration_s'], 's', 1)}"),
        ]  # fmt: skip
    before = figures["before"]["gains"]
    rows += [(name, f"{before[name]:.4g} → {value:.4g}") for name, value in figures["tuned"]["gains"].items()]
    rows += [("importance", ", ".join(f"{n} {v:.0%}" for n, v in figures["importances"].items()) or "too few trials")]
    rows += [("verdict", figures["verdict"]), ("folder", figures["folder"])]
    title = f"{figures['mission']}: {figures['trials']} trials of {figures['law']}, {figures['worlds']} simulations"
    print_table(f"{title} each ({figures['plant']} plant), validated in the full tank", rows, err=json)
    if json:
        echo_json(figures)


def _format_length(value: float | None, unit: str = "mm", digits: int = 2) -> str:
    return "unknown" if value is None else f"{value:.{digits}f} {unit}"
