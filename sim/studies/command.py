"""``smolbot study``: how well localization does, and how firmly a mission's loop holds; tables and figures."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from smolbot.config.plugins import list_plugins, load_plugin
from smolbot.errors import InputError, PluginError, report_plugin_errors, suggest_name
from smolbot.ui.cli.options import JsonOption, SetOption

if TYPE_CHECKING:
    from sim.studies.study import Options, Outcome, Study

app = typer.Typer(add_completion=False)


@app.command("study")
def study(
    name: Annotated[str, typer.Argument(help="One of: " + ", ".join(list_plugins("studies")) + ".", metavar="NAME")],
    mission: Annotated[
        str | None,
        typer.Argument(help="For margins: a shipped mission by name, or your own by path.", metavar="[MISSION]"),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Random seed; results do not depend on --jobs.")] = 1,
    jobs: Annotated[int, typer.Option(min=0, help="Processes; 0 for one per core.")] = 0,
    poses: Annotated[int | None, typer.Option(min=1, help="Number of poses, or of repeats, of each kind.")] = None,
    rig: Annotated[
        str | None, typer.Option(help="Rig file, by name or path; default: tank, or the mission's own.")
    ] = None,
    mismatch: Annotated[float | None, typer.Option(min=0, help="Scale of the rig's mismatches; 0 for none.")] = None,
    estimator: Annotated[str | None, typer.Option(help="whitened, paper or both; default: the study's own.")] = None,
    weights: Annotated[
        str | None,
        typer.Option(
            help="For margins: cross-track error (mm), heading error (deg) and share of the full current of equal cost."
        ),
    ] = None,
    set_: SetOption = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the results; default: a new one in runs/.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the study in --out.")] = False,
    json: JsonOption = False,
) -> None:
    """A study of localization, or of a mission's loop: a table, a figure and results.csv in a folder of its own."""
    from smolbot.ui.cli.show import echo_json, print_table

    loaded = load_study(name)
    if loaded.mission:
        given = {"--poses": poses, "--mismatch": mismatch, "--estimator": estimator}
        options = replace(_make_mission_options(loaded, mission, seed, jobs, rig, set_, given), weights=weights)
    elif mission is not None or set_ or weights is not None:
        what = f"MISSION '{mission}'" if mission is not None else "--set" if set_ else "--weights"
        raise InputError(f"study {name} simulates localization on a bench: it takes no {what}.")
    else:
        options = _make_options(loaded, seed, jobs, poses, rig or "tank", mismatch, estimator)
    if resume and out is None:
        raise InputError("--resume needs --out: the folder of the study to continue.")
    outcome, folder = run_study(loaded, options, out, resume=resume)
    rows = [*outcome.rows, ("wall time", f"{outcome.figures['wall_s']:.1f} s"), ("folder", str(folder))]
    about = f"mission {mission}" if loaded.mission else f"rig {options.rig}"
    print_table(f"{loaded.title} (seed {seed}, {about})", rows, err=json)
    if json:
        echo_json(outcome.figures)


def load_study(name: str) -> Study:
    """Load a study, one of ours or of an installed package.

    Parameters
    ----------
    name : str

    Returns
    -------
    Study

    Raises
    ------
    InputError
        If no study has that name.
    PluginError
        If it cannot be imported or is no study.
    """
    known = list_plugins("studies")
    if name not in known:
        raise InputError(f"No study is named '{name}'; there are: {', '.join(known)}.{suggest_name(name, known)}")
    found: Study = load_plugin("studies", name)
    return found


def run_study(study: Study, options: Options, out: Path | None, *, resume: bool = False) -> tuple[Outcome, Path]:
    """Run all chunks that are not done, conclude, and write ``study.json``, ``results.csv`` and the figure.

    Parameters
    ----------
    study : Study
    options : Options
    out : Path or None
        Folder to write; by default a new one in ``runs/``.
    resume : bool
        Whether to go on with a folder that exists.

    Returns
    -------
    outcome : Outcome
    folder : Path
    """
    from sim.studies.benches import load_rig_once
    from sim.studies.running import StudyFolder, describe_study, open_study_executor, run_chunks
    from sim.studies.study import Outcome
    from smolbot.runs.folder import make_dated_path

    begin = time.perf_counter()
    config = study.rig_of(options) if study.rig_of is not None else load_rig_once(options.rig)
    folder = StudyFolder(out or make_dated_path(f"study-{study.name}"), options.list_deciding(), resume=resume)
    with report_plugin_errors("Study", study.chunks, ""):
        chunks = list(study.chunks(options))
    with (
        open_study_executor(options.jobs if len(chunks) > 1 else 1) as executor,
        _show_progress(study.name) as progress,
    ):
        parts = run_chunks(chunks, folder, executor, progress)
    with report_plugin_errors("Study", study.conclude, ""):
        outcome = study.conclude(options, parts)
    if not isinstance(outcome, Outcome):
        raise PluginError(f"Study '{study.name}': conclude() must return an Outcome; got {outcome!r}.")
    outcome.figures.update({"wall_s": time.perf_counter() - begin, "folder": str(folder.path)})
    folder.finish({**describe_study(options, study, config), **outcome.figures}, outcome.columns)
    for file, text in (study.files(outcome) if study.files is not None else {}).items():
        (folder.path / file).write_text(text, encoding="utf-8")
    with report_plugin_errors("Study", study.draw, ""):
        study.draw(outcome, folder.path / f"{study.name}.png")
    return outcome, folder.path


def _make_options(
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


def _make_mission_options(
    study: Study, mission: str | None, seed: int, jobs: int, rig: str | None, pairs: list[str] | None,
    given: Mapping[str, object],
) -> Options:  # fmt: skip
    from sim.studies.study import Options
    from smolbot.ui.cli.options import parse_settings

    if mission is None:
        raise InputError(f"study {study.name} needs a mission: smolbot study {study.name} MISSION, such as r_path.")
    refused = [option for option, value in given.items() if value is not None]
    if refused:
        raise InputError(f"study {study.name} samples no poses: it takes no {', '.join(refused)}.")
    settings = tuple(sorted(parse_settings(pairs).items()))
    return Options(study.name, seed, jobs, mission=mission, own_rig=rig, settings=settings)


@contextmanager
def _show_progress(name: str) -> Iterator[Callable[[int, int], None]]:
    """A bar with the time left on a terminal, nothing elsewhere."""
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

    from smolbot.ui.cli.show import show_bar

    columns = TextColumn("{task.description}"), BarColumn(bar_width=24), MofNCompleteColumn(), TimeRemainingColumn()
    with show_bar(name, *columns) as tell:
        yield lambda done, total: tell(completed=done, total=total)
