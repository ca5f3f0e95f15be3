"""Output of a search: a file of gains, every trial, a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.tuning.search import Problem, list_finished
from sim.tuning.verdict import Flown
from smolbot.core.text_table import write_table

if TYPE_CHECKING:
    from optuna import Study


def compute_importances(study: Study) -> dict[str, float]:
    """Compute the share of each gain in the variation of the cost among the good trials.

    Parameters
    ----------
    study : optuna.Study

    Returns
    -------
    dict of str to float
        Empty where there are too few trials.
    """
    import optuna
    from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances
    from optuna.trial import TrialState

    complete = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    if len(complete) < 10 or len({t.value for t in complete}) < 5:
        return {}
    with np.errstate(all="ignore"):
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        found = get_param_importances(study, evaluator=PedAnovaImportanceEvaluator())
    return {name: float(value) for name, value in found.items()}


def format_tuned_gains(problem: Problem, law: str, tuned: Flown, before: Flown, seed: int) -> str:
    """Format the gains as a section of a mission file, with a comment on how they were found.

    Parameters
    ----------
    problem : Problem
    law : str
    tuned, before : Flown
        Flights with the tuned and with the former gains.
    seed : int

    Returns
    -------
    str
        TOML.
    """
    after, now = tuned.figures(), before.figures()
    lines = [
        f"Gains of {law}, tuned for {problem.mission} with seed {seed} on {len(problem.worlds)} random simulations",
        f"({problem.plant} plant). Full tank, {after['flown']} held-out simulations: {after['passed']} passed, cost "
        f"{after['cost_mm']:.3f} mm; before: {now['passed']} passed, cost {now['cost_mm']:.3f} mm.",
    ]
    return format_gains(lines, tuned.gains)


def format_gains(comments: Sequence[str], gains: Mapping[str, float]) -> str:
    """Format gains as a section of a mission file.

    Parameters
    ----------
    comments : sequence of str
        Lines above it.
    gains : mapping of str to float

    Returns
    -------
    str
        TOML.
    """
    lines = [*(f"# {line}" for line in comments), "[controller.gains]"]
    return "\n".join([*lines, *(f"{name} = {value:.6g}" for name, value in gains.items())]) + "\n"


def write_trials(study: Study, path: Path) -> None:
    """Write one line for each trial: number, how it ended, cost, gains.

    Parameters
    ----------
    study : optuna.Study
    path : Path
    """
    trials = study.get_trials(deepcopy=False)
    names = sorted({name for t in trials for name in t.params})
    rows = ([t.number, t.state.name.lower(), t.value, *[t.params.get(name) for name in names]] for t in trials)
    write_table(path, ["trial", "state", "cost_mm", *names], rows)


def draw(study: Study, shares: Mapping[str, float], tuned: Flown, before: Flown, headline: str, path: Path) -> None:
    """Draw the cost of every trial, the importance of each gain, and the held-out simulations before and after.

    Parameters
    ----------
    study : optuna.Study
    shares : mapping of str to float
        Importance of each gain.
    tuned, before : Flown
    headline : str
    path : Path
    """
    from matplotlib.ticker import MaxNLocator

    from sim.batch.slide import LIMIT, PAPER, WHITENED, open_slide, set_titles

    trials: list[Any] = [t for t in list_finished(study)]
    numbers = np.array([t.number for t in trials])
    costs = np.array([t.value if t.value is not None else list(t.intermediate_values.values())[-1] for t in trials])
    complete = np.array([t.state.name == "COMPLETE" for t in trials])
    best = np.minimum.accumulate(np.where(complete, costs, np.inf))
    now, after = before.figures(), tuned.figures()
    subline = (
        f"{len(trials)} trials; held-out simulations in the full tank: passed {now['passed']} of {now['flown']} "
        f"before, {after['passed']} of {after['flown']} tuned"
    )
    with open_slide(path, headline, subline, 1, 3, wspace=0.45, left=0.06) as (left, middle, right):
        left.scatter(numbers[complete], costs[complete], s=18, color=WHITENED, alpha=0.6, label="flown in every world")
        left.scatter(numbers[~complete], costs[~complete], s=14, color=LIMIT, alpha=0.6, label="given up")
        left.step(numbers, best, where="post", color=PAPER, lw=2, label="best so far")
        left.set_yscale("log")
        left.xaxis.set_major_locator(MaxNLocator(integer=True))
        left.legend(frameon=False, fontsize=10)
        set_titles(left, "Cost of each trial, in mm", "trial")
        names = list(shares)[::-1]
        middle.barh(names, [shares[n] for n in names], color=WHITENED)
        if not names:
            middle.text(0.5, 0.5, "too few trials to tell", ha="center", color="#777777", transform=middle.transAxes)
        set_titles(middle, "What each gain matters", "share")
        for i, (one, color) in enumerate(((before, LIMIT), (tuned, WHITENED))):
            spread = i + np.linspace(-0.2, 0.2, len(one.costs))
            right.scatter(spread, one.costs, s=22, color=color)
            right.hlines(np.mean(one.costs), i - 0.3, i + 0.3, color=color, lw=3)
            right.text(
                i, max(one.costs) * 1.05, f"{np.mean(one.costs):.2f}", ha="center", fontweight="bold", color=color
            )
        right.set_xticks([0, 1], ["before", "tuned"])
        right.set_xlim(-0.6, 1.6)
        right.set_ylim(0.0, 1.2 * max(*before.costs, *tuned.costs))
        set_titles(right, "Cost in held-out simulations, in mm")
