"""How a flight of either kind turned out: its figures, and its picture."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from smolbot.anymission import AnyMission
from smolbot.flown import Run
from smolbot.observationfile import Observation
from smolbot.records.observation_summary import summarise_observation
from smolbot.records.summary import summarise
from smolbot.records.trace import Trace


def sum_up(mission: AnyMission, run: Run, trace: Trace, seed: int, drawn: Mapping[str, Any]) -> dict[str, Any]:
    """Figures of a run; `drawn` is what its world said of itself."""
    if isinstance(mission, Observation):
        figures = summarise_observation(mission, run, trace)
    else:
        figures = summarise(mission, run, trace)
    figures["seed"] = seed
    figures["ideal"] = bool(drawn.get("ideal", False))
    figures["plant"] = str(drawn.get("plant", "full"))
    figures["run"] = run.folder
    return figures


def draw(mission: AnyMission, run: Run, trace: Trace, path: Path) -> None:
    """The picture of a run, as a file that is there whole or not at all."""
    part = path.with_name(f"{path.stem}.part{path.suffix}")
    if isinstance(mission, Observation):
        from smolbot.records.observation_picture import draw_observation

        draw_observation(mission, run, trace, part)
    else:
        from smolbot.records.picture import draw_run

        draw_run(mission, run, trace, part)
    part.replace(path)
