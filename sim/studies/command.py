"""``smolbot study``: how well localization does, by Monte-Carlo on a simulated bench; tables and figures."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from smolbot.errors import InputError

if TYPE_CHECKING:
    from sim.studies.study import Options, Outcome, Study

STUDIES = {
    "bound": "error over the Cramer-Rao bound, and how honest the covariance is",
    "accuracy": "differential errors over translations and rotations (Figs. 2A to 2D, S4, S5)",
    "precision": "precision and rate against the number of half-periods (Fig. 2F)",
    "damping": "precision against damping (Fig. 2G)",
    "depth": "how deep a pose can be found, against magnet size (Fig. 2E)",
    "cold": "poses from nothing, anywhere and in any orientation",
    "speed": "time of a pose, against the same fit in numpy and scipy",
    "superfast": "one excitation cut into segments while the device steps (Figs. 2H, S6)",
    "scalpel": "a magnetic tool passing by, against static magnets",
    "allocation": "coil currents for a wanted force: direction, size and heat against brute force, and time",
    "layout": "sensor places: bound, correlation of z with amplitude, an optimised layout",
}
"""Every study, a module of this package, and what it finds out."""

app = typer.Typer(add_completion=False)


@app.command("study")
def study(
    name: Annotated[str, typer.Argument(help="One of: " + ", ".join(STUDIES) + ".", metavar="NAME")],
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same result, whatever --jobs.")] = 1,
    jobs: Annotated[int, typer.Option(min=0, help="Processes; 0 for one per core.")] = 0,
    poses: Annotated[int | None, typer.Option(min=1, help="Poses, or repeats, of each kind.")] = None,
    rig: Annotated[str, typer.Option(help="Rig file, by name or path: sensors, noise, mismatches.")] = "tank",
    mismatch: Annotated[float | None, typer.Option(min=0, help="Scale of the rig's mismatches; 0 for none.")] = None,
    estimator: Annotated[str | None, typer.Option(help="whitened, paper or both; default: the study's own.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder to make; default: a new one in runs/.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the study that --out holds.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output.")] = False,
) -> None:
    """A study of localization: a table, a figure and results.csv in a folder of its own."""
    from smolbot.cli.show import echo_json, table

    loaded = load_study(name)
    options = _options(loaded, seed, jobs, poses, rig, mismatch, estimator)
    if resume and out is None:
        raise InputError("--resume needs --out: the folder of the study to go on with.")
    outcome, folder = carry_out(loaded, options, out, resume=resume)
    rows = [*outcome.rows, ("wall time", f"{outcome.figures['wall_s']:.1f} s"), ("folder", str(folder))]
    table(f"{loaded.title} (seed {seed}, rig {rig})", rows, err=json)
    if json:
        echo_json(outcome.figures)


def load_study(name: str) -> Study:
    """The study of that name; its module is imported only now.

    Raises
    ------
    InputError
        If there is none.
    """
    if name not in STUDIES:
        from difflib import get_close_matches

        close = get_close_matches(name, STUDIES, 1)
        hint = f" Did you mean {close[0]}?" if close else ""
        raise InputError(f"No study is named '{name}'; there are: {', '.join(STUDIES)}.{hint}")
    found: Study = importlib.import_module(f"sim.studies.{name}").STUDY
    return found


def carry_out(study: Study, options: Options, out: Path | None, *, resume: bool = False) -> tuple[Outcome, Path]:
    """Run all chunks that are not done, conclude, and leave ``study.json``, ``results.csv`` and the figure."""
    from sim.studies.benches import rig_named
    from sim.studies.running import StudyFolder, described, executor_for, new_folder, run_chunks

    begin = time.perf_counter()
    config = rig_named(options.rig)
    folder = StudyFolder(out if out is not None else new_folder(study.name), options.asked(), resume=resume)
    chunks = study.chunks(options)
    with executor_for(options.jobs if len(chunks) > 1 else 1) as executor, _shown(study.name) as progress:
        parts = run_chunks(chunks, folder, executor, progress)
    outcome = study.conclude(options, parts)
    outcome.figures.update({"wall_s": time.perf_counter() - begin, "folder": str(folder.path)})
    folder.finish({**described(options, study, config), **outcome.figures}, outcome.columns)
    study.draw(outcome, folder.path / f"{study.name}.png")
    return outcome, folder.path


def _options(
    study: Study, seed: int, jobs: int, poses: int | None, rig: str, mismatch: float | None, estimator: str | None
) -> Options:
    from sim.studies.study import Options

    if estimator not in (None, "whitened", "paper", "both"):
        raise InputError(f"--estimator must be whitened, paper or both; got '{estimator}'.")
    found = Options(study.name, seed, jobs, poses, rig, mismatch, study.estimators)
    if estimator == "both":
        return replace(found, estimators=("whitened", "paper"))
    if estimator == "whitened":
        return replace(found, estimators=("whitened",))
    return found if estimator is None else replace(found, estimators=("paper",))


@contextmanager
def _shown(name: str) -> Iterator[Callable[[int, int], None]]:
    """A bar with the time left on a terminal, nothing elsewhere."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
    with bar:
        task = bar.add_task(name, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
