"""The figure of many flights: every trajectory, and their errors."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.config.load import AnyMission
from smolbot.config.mission import Mission
from smolbot.runs.pictures.style import LOCATED, PLANNED, TRUE, draw_limit_line, format_map_axes, open_sheet
from smolbot.runs.summary import format_label

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from smolbot.functions.simulate import Flight


def draw_flights(mission: Mission, flights: list[Flight], path: Path) -> None:
    """Write the figure of all flights of one mission (PNG, 16:9).

    Parameters
    ----------
    mission : Mission
    flights : list of Flight
    path : Path
    """
    world = "full tank" if flights[0].summary["plant"] == "full" else "reduced plant, not the full tank"
    with open_sheet(
        path, format_headline(mission, flights), f"{world}, each flight with a newly sampled robot and bench"
    ) as figure:
        grid = figure.add_gridspec(
            3, 2, width_ratios=[1.0, 1.1], wspace=0.22, hspace=0.5, left=0.06, right=0.97, top=0.845, bottom=0.09
        )
        _draw_trails(figure.add_subplot(grid[:, 0]), mission, flights)
        rows = [
            ("Mean tracking error, in mm", ["tracking_mean_mm"], mission.sections.verdict.mean_tracking_mm),
            ("Mean localization error, in mm", ["localization_mean_mm", "tracked_mean_mm"],
             mission.sections.verdict.mean_localization_mm),
            ("Robot time, in s", ["duration_s"], None),
        ]  # fmt: skip
        for index, (title, columns, limit) in enumerate(rows):
            draw_bars(figure.add_subplot(grid[index, 1]), flights, title, columns, limit)


def format_headline(mission: AnyMission, flights: list[Flight]) -> str:
    """Format the number of passed flights, with a label if they are not of the full tank with mismatches.

    Parameters
    ----------
    mission : Mission or Observation
    flights : list of Flight

    Returns
    -------
    str
    """
    passed = sum(f.summary["verdict"] == "passed" for f in flights)
    figures = {"ideal": any(f.summary["ideal"] for f in flights), "plant": flights[0].summary["plant"]}
    return f"{mission.name}: {passed} of {len(flights)} flights passed{format_label(figures)}"


def _draw_trails(axes: Axes, mission: Mission, flights: list[Flight]) -> None:
    planned = mission.path.points * 1e3
    axes.plot(planned[:, 0], planned[:, 1], color=PLANNED, lw=9, solid_capstyle="round", label="planned")
    for number, flight in enumerate(f for f in flights if f.trail is not None):
        trail: Any = flight.trail * 1e3
        good = flight.summary["verdict"] == "passed"
        label = {0: "true, each flight"}.get(number)
        axes.plot(trail[:, 0], trail[:, 1], color=TRUE if good else LOCATED, lw=0.9, alpha=0.6, label=label)
    format_map_axes(axes)


def draw_bars(axes: Axes, flights: list[Flight], title: str, columns: list[str], limit: float | None) -> None:
    """Draw one bar per seed for each of some columns of the results, and their limit.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    flights : list of Flight
    title : str
    columns : list of str
        Keys of `COLUMNS`.
    limit : float or None
        In the unit of the columns; None draws no line.
    """
    names = {"localization_mean_mm": "each pose", "tracked_mean_mm": "tracked"}
    seeds = np.array([f.summary["seed"] for f in flights])
    width = 0.8 / len(columns)
    for index, column in enumerate(columns):
        values = [f.value(column) for f in flights]
        heights = np.array([np.nan if v is None else v for v in values], dtype=float)
        color = (TRUE, "#5fa8d3")[index] if len(columns) == 1 else (LOCATED, TRUE)[index]
        axes.bar(
            seeds + (index - 0.5 * (len(columns) - 1)) * width, heights, width, color=color, label=names.get(column)
        )
    if limit is not None:
        draw_limit_line(axes, limit, "limit ")
    if len(columns) > 1:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncol=2, frameon=False, fontsize=9, borderaxespad=0.0)
    axes.set_title(title, loc="left", fontsize=11)
    axes.set_xlabel("seed")
    axes.locator_params(axis="x", integer=True)
