"""The figure of many observations: every trajectory or the scatter of measurements, and errors and rates."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from sim.batch.flights_picture import draw_bars, format_headline
from smolbot.config.observation import Observation
from smolbot.runs.pictures.style import TRUE, draw_container, make_two_views, open_sheet

if TYPE_CHECKING:
    from matplotlib.gridspec import SubplotSpec

    from smolbot.functions.simulate import Flight

Row = tuple[str, list[str], float | None]


def draw_observations(mission: Observation, flights: list[Flight], path: Path) -> None:
    """Write the figure of one observation over many seeds (PNG, 16:9).

    Parameters
    ----------
    mission : Observation
    flights : list of Flight
    path : Path
    """
    limits = mission.sections.verdict
    error: Row = ("Mean localization error, in mm", ["localization_mean_mm"], limits.mean_localization_mm)
    turn: Row = ("Mean orientation error, in degrees", ["orientation_mean_deg"], None)
    if mission.sections.observe.measurements is None:
        rows = [error, turn, ("Trusted poses a second", ["pose_rate_hz"], limits.min_rate_hz)]
    else:
        rows = [("Sigma of the measurements in space, in mm", ["sigma_mm"], limits.max_sigma_mm), error, turn]
    text = "full tank, each observation with a newly sampled device, bench and operator"
    with open_sheet(path, format_headline(mission, flights), text) as figure:
        grid = figure.add_gridspec(
            3, 2, width_ratios=[1.15, 1.0], wspace=0.17, hspace=0.5, left=0.06, right=0.97, top=0.845, bottom=0.09
        )
        _draw_tracks(figure, grid[:, 0], mission, flights)
        for index, (title, columns, limit) in enumerate(rows):
            draw_bars(figure.add_subplot(grid[index, 1]), flights, title, columns, limit)


def _draw_tracks(figure: Any, place: SubplotSpec, mission: Observation, flights: list[Flight]) -> None:
    """Draw each device's true trajectory, from above and from the front."""
    above, front = make_two_views(figure, place, mission.rig.container)
    for axes, across in ((above, 1), (front, 2)):
        draw_container(axes, mission.rig.container, across)
        for flight in flights:
            trail = flight.trail
            if trail is not None and len(trail):
                axes.plot(1e3 * trail[:, 0], 1e3 * trail[:, across], color=TRUE, lw=0.8, alpha=0.5)
                axes.plot(1e3 * trail[-1, 0], 1e3 * trail[-1, across], "o", color=TRUE, ms=3.5, alpha=0.7)
    above.set_title("True places, every seed", loc="left", fontsize=11)
