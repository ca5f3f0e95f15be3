"""The picture of a loop's margins: gain margin along the path, step responses, loci at the worst place."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.analysis.loop import SampledLoop
from sim.studies.margins_report import find_median_place, find_worst_place
from sim.studies.study import Columns, Outcome

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAX_RADIUS = 2.0
"""Offset, in mm, above which a response is not drawn."""

MAX_DB = 14.0
"""Gain margin, in dB, above which the colour does not change."""


def rebuild_loop(columns: Columns, index: int) -> SampledLoop:
    """Rebuild the loop of one place from a study's columns.

    Parameters
    ----------
    columns : Columns
    index : int

    Returns
    -------
    SampledLoop
    """
    drifts = np.array([[1.0], [0.0]])
    motion, feedback, kalman = (columns[f"_{name}"][index] for name in ("motion", "feedback", "kalman"))
    return SampledLoop(
        motion, feedback, kalman, drifts, float(columns["_period"][index]), float(columns["_wait"][index])
    )


def draw_margins(outcome: Outcome, path: Path) -> None:
    """Draw the gain margin along the path, and loci and step responses at the median and the worst place.

    Parameters
    ----------
    outcome : Outcome
    path : Path
        PNG to write.
    """
    from sim.batch.slide import PAPER, WHITENED, open_slide

    figures, columns = outcome.figures, outcome.columns
    worst, median = find_worst_place(columns), find_median_place(columns)
    gain, delay = figures["gain_margin_db"], figures["delay_margin_ms"]
    headline = f"{figures['mission']}, {figures['law']}: margins of {_format_value(gain['median'], 'dB')}"
    headline += f" and {_format_value(delay['median'], 'ms')} at the median place"
    unstable = figures["unstable_places"]
    held = (
        f"stable at {figures['places'] - unstable} of {figures['places']} places" if unstable else "stable everywhere"
    )
    subline = (
        f"loop frozen at each cycle of {figures['cycle_ms']:.0f} ms, tracker included; {held}; worst "
        f"{figures['worst_place']['arc_mm']:.0f} mm along the path"
    )
    with open_slide(path, headline, subline, 1, 3, width_ratios=[1.15, 1.0, 1.0], wspace=0.3, left=0.05) as axes:
        _draw_path(axes[0], columns, worst)
        shown = [(median, "median place", WHITENED), (worst, "worst place", PAPER)]
        _draw_loci(axes[1], columns, shown)
        _draw_steps(axes[2], columns, shown)


def _format_value(value: float, unit: str) -> str:
    return f"{value:.0f} {unit}" if math.isfinite(value) else f"no limit (in {unit})"


def _draw_path(axes: Axes, columns: Columns, worst: int) -> None:
    from matplotlib.collections import LineCollection

    from sim.batch.slide import PAPER, set_titles

    points = np.column_stack([columns["x_mm"], columns["y_mm"]])
    margin = np.minimum(columns["gain_margin_db"], MAX_DB)
    axes.plot(points[:, 0], points[:, 1], color="#dddddd", lw=9, solid_capstyle="round", zorder=1)
    pieces: Any = np.stack([points[:-1], points[1:]], axis=1)
    lines = LineCollection(pieces, cmap="viridis", lw=5, capstyle="round", zorder=2)
    lines.set_array(0.5 * (margin[1:] + margin[:-1]))
    lines.set_clim(0.0, MAX_DB)
    axes.add_collection(lines)
    axes.plot(*points[worst], "o", ms=17, mfc="none", mec=PAPER, mew=2.5, zorder=3)
    left = points[worst, 0] < points[:, 0].mean()  # the label is toward the middle, where there is room
    axes.annotate("worst place", points[worst], color=PAPER, fontweight="bold", xytext=(14 if left else -14, -22),
                  textcoords="offset points", ha="left" if left else "right",
                  bbox={"fc": "white", "ec": "none", "alpha": 0.7, "pad": 1.0})  # fmt: skip
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.12)
    bar = axes.figure.colorbar(lines, ax=axes, shrink=0.55, pad=0.02)
    bar.set_label(f"gain margin in dB ({MAX_DB:g} and more)", fontsize=10)
    bar.outline.set_visible(False)
    set_titles(axes, "Gain margin along the path", "x in mm", "y in mm")


def _draw_loci(axes: Axes, columns: Columns, shown: list[tuple[int, str, str]]) -> None:
    from sim.batch.slide import LIMIT, set_titles

    angles = np.linspace(0.02, math.pi, 800)
    circle = np.exp(1j * np.linspace(0.0, 2.0 * math.pi, 200))
    axes.plot(circle.real, circle.imag, color=LIMIT, lw=1, ls=":")
    for index, name, color in shown:
        loci = rebuild_loop(columns, index).compute_loci(angles)
        for column in range(loci.shape[1]):
            order = np.linspace(0, len(angles) - 1, len(angles)).astype(int)
            axes.plot(loci[order, column].real, loci[order, column].imag, ".", ms=2.2, color=color,
                      label=name if column == 0 else None)  # fmt: skip
    axes.plot([-1.0], [0.0], "+", color="#222222", ms=13, mew=2.2, zorder=5)
    axes.annotate("-1: limit of stability", (-1.0, 0.0), xytext=(0, 12), textcoords="offset points", ha="center",
                  fontsize=10, color="#222222")  # fmt: skip
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlim(-1.6, 1.2)
    axes.set_ylim(-2.6, 1.2)
    axes.legend(frameon=False, markerscale=6, loc="lower right")
    set_titles(axes, "Characteristic loci of the open loop", "real part", "imaginary part")


def _draw_steps(axes: Axes, columns: Columns, shown: list[tuple[int, str, str]]) -> None:
    from sim.batch.slide import set_titles

    length = max(4.0 * float(np.median(np.minimum(columns["settle_s"], 30.0))), 1.0)
    for index in np.linspace(0, len(columns["arc_mm"]) - 1, 25).astype(int):
        _draw_step(axes, rebuild_loop(columns, int(index)), length, color="#b9bec7", lw=0.8, alpha=0.8)
    for index, name, color in shown:
        _draw_step(axes, rebuild_loop(columns, index), length, color=color, lw=2.4, label=name, zorder=4)
    axes.plot([], [], color="#b9bec7", lw=1, label="25 places along the path")
    axes.axhline(0.0, color="#999999", lw=1, ls="--", zorder=0)
    axes.set_xlim(0.0, length)
    axes.set_ylim(-0.6, 1.6)
    axes.legend(frameon=False, loc="upper right")
    set_titles(axes, "Response to an offset of 1 mm, in mm", "time in s")


def _draw_step(axes: Axes, loop: SampledLoop, length: float, **style: Any) -> None:
    response = loop.simulate_step(math.ceil(length / loop.period))[:, 0]
    gone = np.flatnonzero(np.abs(response) > MAX_RADIUS)  # a linear model is not valid there
    response = response[: gone[0] + 1] if gone.size else response
    axes.step(np.arange(len(response)) * loop.period, response, where="post", **style)
