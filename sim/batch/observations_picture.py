"""The picture of many observations: every track, or how measurements scattered, and the spread of errors and rates."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.batch.flights_picture import draw_bars, headline
from smolbot.config.observation import Observation
from smolbot.runs.pictures.style import PLANNED, TRUE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.gridspec import SubplotSpec

    from sim.batch.flights import Flight

Row = tuple[str, list[str], float | None]


def draw_observations(mission: Observation, flights: list[Flight], path: Path) -> None:
    """Write the picture of one observation over many seeds to `path` (PNG, 16:9)."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    wanted = mission.sections.verdict
    error: Row = ("Mean localization error, in mm", ["localization_mean_mm"], wanted.mean_localization_mm)
    turn: Row = ("Mean orientation error, in degrees", ["orientation_mean_deg"], None)
    if mission.sections.observe.measurements is None:
        rows = [error, turn, ("Trusted poses a second", ["pose_rate_hz"], wanted.min_rate_hz)]
    else:
        rows = [("Sigma of the measurements in space, in mm", ["sigma_mm"], wanted.max_sigma_mm), error, turn]
    with plt.rc_context({"font.size": 11, "axes.spines.top": False, "axes.spines.right": False}):
        figure = plt.figure(figsize=(13.6, 7.65), dpi=120)
        grid = figure.add_gridspec(
            3, 2, width_ratios=[1.15, 1.0], wspace=0.17, hspace=0.5, left=0.06, right=0.97, top=0.845, bottom=0.09
        )
        _draw_tracks(figure, grid[:, 0], mission, flights)
        for index, (title, columns, limit) in enumerate(rows):
            draw_bars(figure.add_subplot(grid[index, 1]), flights, title, columns, limit)
        figure.text(0.06, 0.945, headline(mission, flights), fontsize=17, fontweight="bold", color="#222222")
        text = "full tank, each observation a device, a bench and a hand drawn anew"
        figure.text(0.06, 0.905, text, fontsize=11.5, color="#555555")
        figure.savefig(path)
        plt.close(figure)


def _draw_tracks(figure: Any, place: SubplotSpec, mission: Observation, flights: list[Flight]) -> None:
    """Where each device truly was, from above and from the front."""
    box = mission.rig.container
    sides = 1e3 * np.column_stack([box.low, box.high])
    heights = [sides[k][1] - sides[k][0] + 8.0 for k in (1, 2)]
    split = place.subgridspec(2, 1, height_ratios=heights, hspace=0.17)
    views: list[Axes] = [figure.add_subplot(split[0]), figure.add_subplot(split[1])]
    for axes, across in zip(views, (1, 2), strict=True):
        (x0, x1), (y0, y1) = sides[0], sides[across]
        axes.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], color=PLANNED, lw=1.2)
        for flight in flights:
            trail = flight.trail
            if trail is not None and len(trail):
                axes.plot(1e3 * trail[:, 0], 1e3 * trail[:, across], color=TRUE, lw=0.8, alpha=0.5)
                axes.plot(1e3 * trail[-1, 0], 1e3 * trail[-1, across], "o", color=TRUE, ms=3.5, alpha=0.7)
        axes.set_aspect("equal")
        axes.set_xlim(x0 - 4.0, x1 + 4.0)
        axes.set_ylim(y0 - 4.0, y1 + 4.0)
        axes.set_ylabel(f"{'xyz'[across]} in mm")
        axes.grid(color="#eeeeee")
    views[0].set_title("True places, every seed", loc="left", fontsize=11)
    views[0].tick_params(labelbottom=False)
    views[1].set_xlabel("x in mm")
