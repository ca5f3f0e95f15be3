"""Figures of merit and picture of a run of either kind."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from smolbot.config.load import AnyMission
from smolbot.config.observation import Observation
from smolbot.runs.observation_summary import summarise_observation
from smolbot.runs.run import Run
from smolbot.runs.summary import summarise
from smolbot.runs.trace import Trace


def summarise_run(mission: AnyMission, run: Run, trace: Trace, seed: int, world: Mapping[str, Any]) -> dict[str, Any]:
    """Compute the figures of merit of a run.

    Parameters
    ----------
    mission : Mission or Observation
    run : Run
    trace : Trace
    seed : int
    world : mapping
        What the world reports of itself, such as sampled mismatches.

    Returns
    -------
    dict
        Units are in the keys.
    """
    if isinstance(mission, Observation):
        figures = summarise_observation(mission, run, trace)
    else:
        figures = summarise(mission, run, trace)
    figures["seed"] = seed
    figures["ideal"] = bool(world.get("ideal", False))
    figures["plant"] = str(world.get("plant", "full"))
    figures["run"] = run.folder
    return figures


def draw_run_picture(mission: AnyMission, run: Run, trace: Trace, path: Path) -> None:
    """Draw the picture of a run, as a file that is complete or absent.

    Parameters
    ----------
    mission : Mission or Observation
    run : Run
    trace : Trace
    path : Path
        The PNG file to write.
    """
    part = path.with_name(f"{path.stem}.part{path.suffix}")
    if isinstance(mission, Observation):
        from smolbot.runs.pictures.observation_run import draw_observation

        draw_observation(mission, run, trace, part)
    else:
        from smolbot.runs.pictures.gradient_run import draw_run

        draw_run(mission, run, trace, part)
    part.replace(path)
