"""The search: batches of gains, flown over the same simulated worlds; poor ones are stopped early."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.batch.flights import PlantModel, fly_one
from sim.tuning.cost import REFUSED_COST, compute_cost
from smolbot.errors import InputError
from smolbot.motion.controller import Gain

if TYPE_CHECKING:
    from optuna import Study, Trial

BATCH = 4
"""Trials that are requested together."""

RUNG = 3
"""Worlds after each of which a trial may be given up."""

STARTUP = 8
"""Trials before any is given up, or the sampler learns."""


@dataclass(frozen=True)
class Problem:
    """Gains to tune, and the worlds to fly them in.

    Attributes
    ----------
    mission : str
        Name or path.
    rig : str, optional
    settings : mapping of str to str
        Override the mission file in every flight.
    gains : mapping of str to Gain
        Those to be tuned, by name.
    start : mapping of str to float
        Values that the mission flies with now.
    worlds : sequence of int
        Seeds of the worlds.
    plant : PlantModel
    """

    mission: str
    rig: str | None
    settings: Mapping[str, str]
    gains: Mapping[str, Gain]
    start: Mapping[str, float]
    worlds: Sequence[int]
    plant: PlantModel

    def make_settings(self, gains: Mapping[str, float]) -> dict[str, str]:
        """Return the settings of a flight with given gains.

        Parameters
        ----------
        gains : mapping of str to float

        Returns
        -------
        dict of str to str
        """
        return {**self.settings, **{f"controller.gains.{name}": repr(value) for name, value in gains.items()}}


def open_study(path: Path | None, seed: int, name: str, *, resume: bool) -> Study:
    """Open or create an Optuna study. Trials that a killed process left running count as failed.

    Parameters
    ----------
    path : Path or None
        Of its journal; None keeps it in memory.
    seed : int
    name : str
        What is searched; a resumed journal must have the same.
    resume : bool
        Whether the journal exists.

    Returns
    -------
    optuna.Study

    Raises
    ------
    InputError
        If no such search can be resumed.
    """
    import optuna
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    if path is not None and resume and not path.is_file():
        raise InputError(f"{path.parent}: holds no search to resume.")
    storage = None if path is None else JournalStorage(JournalFileBackend(str(path)))
    held = [name] if storage is None or not resume else optuna.get_all_study_names(storage)
    if path is not None and name not in held:
        raise InputError(f"{path.parent}: holds the search '{held[0]}', not '{name}'; resume it as it was begun.")
    study = optuna.create_study(
        storage=storage,
        study_name=name,
        load_if_exists=resume,
        direction="minimize",
        pruner=optuna.pruners.MedianPruner(n_startup_trials=STARTUP, n_warmup_steps=1),
    )
    for trial in study.get_trials(deepcopy=False, states=(optuna.trial.TrialState.RUNNING,)):
        study.tell(trial.number, state=optuna.trial.TrialState.FAIL)
    done = len(list_finished(study))
    study.sampler = optuna.samplers.TPESampler(
        seed=int(np.random.SeedSequence([seed, done]).generate_state(1)[0]),
        n_startup_trials=STARTUP,
        constant_liar=True,
    )
    return study


def list_finished(study: Study) -> list[Any]:
    """Return the trials that ended, pruned ones included.

    Parameters
    ----------
    study : optuna.Study

    Returns
    -------
    list of optuna.trial.FrozenTrial
    """
    from optuna.trial import TrialState

    return study.get_trials(deepcopy=False, states=(TrialState.COMPLETE, TrialState.PRUNED))


def run_search(
    study: Study, problem: Problem, trials: int, executor: Executor, ended: Callable[[Study], None] = lambda study: None
) -> None:
    """Run trials until `trials` have ended; the first has the mission's present gains.

    Parameters
    ----------
    study : optuna.Study
    problem : Problem
    trials : int
    executor : Executor
    ended : callable
        Called with the study after each batch.
    """
    if not study.get_trials(deepcopy=False):
        study.enqueue_trial(dict(problem.start))
    while (left := trials - len(list_finished(study))) > 0:
        batch = [study.ask() for _ in range(min(BATCH, left))]
        gains = [
            {name: trial.suggest_float(name, gain.low, gain.high, log=gain.log) for name, gain in problem.gains.items()}
            for trial in batch
        ]
        for trial, values in zip(batch, fly_batch(study, problem, batch, gains, executor), strict=True):
            if len(values) == len(problem.worlds):
                study.tell(trial, float(np.mean(values)))
            else:
                from optuna.trial import TrialState

                study.tell(trial, state=TrialState.PRUNED)
            ended(study)


def fly_batch(
    study: Study, problem: Problem, batch: Sequence[Trial], gains: Sequence[Mapping[str, float]], executor: Executor
) -> list[list[float]]:
    """Fly a batch of trials over the same worlds.

    Parameters
    ----------
    study : optuna.Study
    problem : Problem
    batch : sequence of optuna.Trial
    gains : sequence of mapping of str to float
        One per trial.
    executor : Executor

    Returns
    -------
    list of list of float
        Costs of each trial, world by world, in mm; fewer for those that were pruned.
    """
    costs: list[list[float]] = [[] for _ in batch]
    alive = list(range(len(batch)))
    for begin in range(0, len(problem.worlds), RUNG):
        flights: list[tuple[int, Future[Any]]] = [
            (i, executor.submit(fly_one, problem.mission, problem.rig, problem.make_settings(gains[i]), seed,
                                problem.plant))
            for i in alive for seed in problem.worlds[begin : begin + RUNG]
        ]  # fmt: skip
        for i, future in flights:
            costs[i].append(_compute_cost(future, refusable=dict(gains[i]) != dict(problem.start)))
        for i in alive:
            batch[i].report(float(np.mean(costs[i])), len(costs[i]))
        alive = [i for i in alive if len(costs[i]) == len(problem.worlds) or not batch[i].should_prune()]
    return costs


def _compute_cost(future: Future[Any], *, refusable: bool) -> float:
    """Cost of a flight; gains that the law refuses, such as a least above a most, cost as much as not to move."""
    try:
        return compute_cost(future.result().summary)
    except InputError:
        if not refusable:
            raise
        return REFUSED_COST
