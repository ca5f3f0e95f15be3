"""Searches gains for a mission and validates the best: the entry point ``tune`` of ``smolbot.functions``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sim.batch.executors import open_executor
from sim.batch.flights import PlantModel, forget_missions
from sim.tuning.report import compute_importances, draw, format_tuned_gains, write_trials
from sim.tuning.search import Problem, list_finished, open_study, run_search
from sim.tuning.verdict import FIRST_HELD_OUT, fly_held_out, is_better
from smolbot.config.mission import Mission, load_steering_mission
from smolbot.config.plugins import load_plugin
from smolbot.errors import InputError, report_write_errors
from smolbot.flight.preview.missions import require_go
from smolbot.functions.simulate import PlantName
from smolbot.functions.tune import Trial, Tuning

if TYPE_CHECKING:
    from optuna import Study

JOURNAL = "trials.journal"


def tune(
    mission: str, *, trials: int, worlds: int, held_out: int, plant: PlantName, only: Sequence[str] | None, seed: int,
    rig: str | None, jobs: int, scheduler: str | None, out: Path | None, resume: bool, settings: Mapping[str, str],
    progress: Callable[[int, float | None], None] | None, force: str | None = None,
) -> Tuning:  # fmt: skip
    """Tune a mission's gains.

    Parameters
    ----------
    mission, trials, worlds, held_out, plant, only, seed, rig, jobs, scheduler, out, resume, settings, progress, force
        As of `smolbot.tune`.

    Returns
    -------
    Tuning

    Raises
    ------
    InputError
        For a gain that the law does not have, a folder that cannot be used, or where the preview says no-go.
    """
    laid = dict(settings)
    loaded = load_steering_mission(mission, rig, laid)
    problem = _make_problem(loaded, mission, rig, laid, only, worlds, seed, PlantModel(plant))
    require_go(loaded, force)
    if loaded.robot.kind == "gradient":
        loaded.rig.table()  # built once, before the workers need it
    forget_missions()
    if resume and out is None:
        raise InputError("--resume needs --out, the folder of the search to go on with.")
    if out is not None and not resume:
        _make_folder(out)
    kind = f"{loaded.name} {loaded.law} {plant} seed {seed} worlds {worlds} {','.join(problem.gains)}"
    study = open_study(None if out is None else out / JOURNAL, seed, kind, resume=resume)

    def report_trial(study: Study) -> None:
        costs = [t.value for t in list_finished(study) if t.value is not None]
        if progress is not None:
            progress(len(list_finished(study)), min(costs, default=None))

    with open_executor(jobs, scheduler) as executor:
        run_search(study, problem, trials, executor, report_trial)
        before, tuned = fly_held_out(problem, [problem.start, study.best_params], held_out, executor)
    shares, improved = compute_importances(study), is_better(tuned, before)
    if out is not None:
        write_trials(study, out / "trials.csv")
        (out / "gains.toml").write_text(format_tuned_gains(problem, loaded.law, tuned, before, seed), encoding="utf-8")
        headline = f"{loaded.name}: {'tuned gains are better' if improved else 'no better gains were found'}"
        draw(study, shares, tuned, before, headline, out / "tune.png")
    tried = tuple(Trial(t.number, t.state.name.lower(), t.value, dict(t.params)) for t in study.get_trials())
    return Tuning(
        loaded.name, loaded.law, plant, seed, worlds, tried, study.best_value, before.summarize(), tuned.summarize(),
        improved, shares, out,
    )  # fmt: skip


def _make_problem(
    loaded: Mission, mission: str, rig: str | None, settings: dict[str, str], only: Sequence[str] | None, worlds: int,
    seed: int, plant: PlantModel,
) -> Problem:  # fmt: skip
    """Build the problem; raises `InputError` for a gain that the law does not have."""
    if plant is PlantModel.REDUCED:
        from sim.reduced.rig import require_flyable

        require_flyable(loaded)
    declared = load_plugin("controllers", loaded.law).gains
    names = list(only or declared)
    unknown = [name for name in names if name not in declared]
    if unknown:
        raise InputError(f"--only: {loaded.law} has no gain '{unknown[0]}'; it has {', '.join(declared)}.")
    first = (seed * 1000) % FIRST_HELD_OUT
    start = {name: float(loaded.gains.get(name, declared[name].default)) for name in names}
    chosen = {name: declared[name] for name in names}
    return Problem(mission, rig, settings, chosen, start, range(first, first + worlds), plant)


def _make_folder(folder: Path) -> None:
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: is not empty; name a new folder, or go on with --resume.")
    with report_write_errors(folder, done="made"):
        folder.mkdir(parents=True, exist_ok=True)
