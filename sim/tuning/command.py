"""``smolbot tune``: gains that hold on robots and tanks that differ from the nominal ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sim.batch.flights import Plant
from smolbot.errors import InputError, writing
from smolbot.ui.cli.options import JsonOption, MissionArgument, RigOption, SetOption, settings_from

if TYPE_CHECKING:
    from optuna import Study

    from sim.tuning.search import Problem
    from smolbot.config.mission import Mission

LEAST_TRIALS = 2
JOURNAL = "trials.journal"


def tune(
    mission: MissionArgument,
    trials: Annotated[int, typer.Option(min=LEAST_TRIALS, help="Sets of gains to try.")] = 100,
    worlds: Annotated[int, typer.Option(min=1, help="Random simulations for each set of gains.")] = 9,
    held_out: Annotated[int, typer.Option(min=1, help="Other simulations, in the full tank, for validation.")] = 20,
    plant: Annotated[Plant, typer.Option(help="Plant of the trials; the best gains are validated in the full one.")] = (
        Plant.REDUCED
    ),
    only: Annotated[str | None, typer.Option(help="Gains to tune, with commas between; default: all.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same gains, whatever --jobs.")] = 1,
    rig: RigOption = None,
    jobs: Annotated[int, typer.Option(min=0, help="Processes; 0 for one per core.")] = 0,
    scheduler: Annotated[str | None, typer.Option(help="Address of a dask scheduler, instead of processes.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder to make; default: a new one in runs/.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the search that --out holds.")] = False,
    set_: SetOption = None,
    json: JsonOption = False,
) -> None:
    """Tune a mission's gains on random simulations and validate them on held-out ones."""
    from sim.batch.executors import open_executor
    from sim.tuning.report import draw, gains_file, importances, write_trials
    from sim.tuning.search import open_study, search
    from sim.tuning.verdict import better
    from sim.tuning.verdict import held_out as confirm
    from smolbot.config.mission import load_mission
    from smolbot.runs.folder import dated

    settings = settings_from(set_)
    loaded = load_mission(mission, rig, settings)
    problem = _problem(loaded, mission, rig, settings, only, worlds, seed, plant)
    loaded.rig.table()  # built once, before the workers need it
    if resume and out is None:
        raise InputError("--resume needs --out, the folder of the search to go on with.")
    folder = out or dated(f"tune-{loaded.name}")
    _make(folder, resume)
    kind = f"{loaded.name} {loaded.law} {plant} seed {seed} worlds {worlds} {','.join(problem.gains)}"
    study = open_study(folder / JOURNAL, seed, kind, resume=resume)
    with open_executor(jobs, scheduler) as executor:
        with _progress(loaded.name, trials) as ended:
            search(study, problem, trials, executor, ended)
        before, tuned = confirm(problem, [problem.start, study.best_params], held_out, executor)
    shares = importances(study)
    write_trials(study, folder / "trials.csv")
    (folder / "gains.toml").write_text(gains_file(problem, loaded.law, tuned, before, seed), encoding="utf-8")
    improved = better(tuned, before)
    headline = f"{loaded.name}: {'tuned gains are better' if improved else 'no better gains were found'}"
    draw(study, shares, tuned, before, headline, folder / "tune.png")
    figures: dict[str, Any] = {
        "mission": loaded.name, "law": loaded.law, "plant": str(plant), "seed": seed, "trials": trials,
        "worlds": worlds, "best_cost_mm": study.best_value, "before": before.figures(), "tuned": tuned.figures(),
        "importances": shares, "verdict": "better" if improved else "not better", "folder": str(folder),
    }  # fmt: skip
    _show(figures, json)
    raise typer.Exit(0 if improved else 1)


def _problem(
    loaded: Mission, mission: str, rig: str | None, settings: dict[str, str], only: str | None, worlds: int, seed: int,
    plant: Plant,
) -> Problem:  # fmt: skip
    """What is to be tuned; raises `InputError` for a gain that the law does not have."""
    from sim.tuning.search import Problem
    from sim.tuning.verdict import FIRST_HELD_OUT
    from smolbot.config.plugins import load

    if plant is Plant.REDUCED:
        from sim.reduced.rig import require_flyable

        require_flyable(loaded)
    declared = load("controllers", loaded.law).gains
    names = [name.strip() for name in only.split(",")] if only else list(declared)
    unknown = [name for name in names if name not in declared]
    if unknown:
        raise InputError(f"--only: {loaded.law} has no gain '{unknown[0]}'; it has {', '.join(declared)}.")
    first = (seed * 1000) % FIRST_HELD_OUT
    start = {name: float(loaded.gains.get(name, declared[name].default)) for name in names}
    chosen = {name: declared[name] for name in names}
    return Problem(mission, rig, settings, chosen, start, range(first, first + worlds), plant)


def _make(folder: Path, resume: bool) -> None:
    if resume:
        return
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: is not empty; name a new folder, or go on with --resume.")
    with writing(folder, done="made"):
        folder.mkdir(parents=True, exist_ok=True)


@contextmanager
def _progress(name: str, trials: int) -> Iterator[Callable[[Study], None]]:
    """A bar on the terminal with the best cost so far."""
    from sim.tuning.search import finished
    from smolbot.ui.cli.show import bar

    with bar(name, total=trials) as tell:

        def ended(study: Study) -> None:
            done = finished(study)
            costs = [t.value for t in done if t.value is not None]
            best = f"best {min(costs):.3f} mm" if costs else "no trial whole yet"
            tell(completed=len(done), description=f"{name}: {best}")

        yield ended


def _show(figures: dict[str, Any], json: bool) -> None:
    from smolbot.ui.cli.show import echo_json, table

    rows = []
    for key in ("before", "tuned"):
        one = figures[key]
        low, high = one["pass_rate_95"]
        rows += [
            (key, f"{one['passed']} of {one['flown']} passed ({low:.0%} to {high:.0%} with 95 % confidence)"),
            ("", f"cost {one['cost_mm']:.3f} mm; tracking rms {_mm(one['tracking_rms_mm'])}, "
                 f"robot time {_mm(one['duration_s'], 's', 1)}"),
        ]  # fmt: skip
    before = figures["before"]["gains"]
    rows += [(name, f"{before[name]:.4g} → {value:.4g}") for name, value in figures["tuned"]["gains"].items()]
    rows += [("importance", ", ".join(f"{n} {v:.0%}" for n, v in figures["importances"].items()) or "too few trials")]
    rows += [("verdict", figures["verdict"]), ("folder", figures["folder"])]
    title = f"{figures['mission']}: {figures['trials']} trials of {figures['law']}, {figures['worlds']} simulations"
    table(f"{title} each ({figures['plant']} plant), validated in the full tank", rows, err=json)
    if json:
        echo_json(figures)


def _mm(value: float | None, unit: str = "mm", digits: int = 2) -> str:
    return "unknown" if value is None else f"{value:.{digits}f} {unit}"
