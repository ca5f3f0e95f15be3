"""The sheet, colours and strokes that every picture of a run shares."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.core.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec

    from smolbot.config.rig_sections import ContainerSection

PLANNED, TRUE, LOCATED, STIFF = "#b9bec7", "#1b4965", "#e4572e", "#f3e3c3"
COILS = ("#1b4965", "#5fa8d3", "#e4572e", "#f2a541", "#7b2d8b", "#4c956c")


@contextmanager
def sheet(
    path: Path, headline: str, subline: str, *, left: float = 0.06, heights: tuple[float, float] = (0.945, 0.905),
    sizes: tuple[float, float, float] = (11, 17, 11.5),
) -> Iterator[Figure]:  # fmt: skip
    """A figure of 16:9 under two lines, which begin at `left`; written to `path` as PNG when the block ends.

    `heights` are those of the two lines, `sizes` of the type: of what stands in axes, and of the two lines.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    with plt.rc_context({"font.size": sizes[0], "axes.spines.top": False, "axes.spines.right": False}):
        figure = plt.figure(figsize=(13.6, 7.65), dpi=120)
        yield figure
        figure.text(left, heights[0], headline, fontsize=sizes[1], fontweight="bold", color="#222222")
        figure.text(left, heights[1], subline, fontsize=sizes[2], color="#555555")
        figure.savefig(path)
        plt.close(figure)


def from_above(axes: Axes) -> None:
    """Equal scales, named axes, a faint grid and a legend over it: what a map of a flight has."""
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x in mm")
    axes.set_ylabel("y in mm")
    axes.grid(color="#eeeeee", zorder=0)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncol=3, frameon=False)


def true_way(axes: Axes, places: FloatArray, beside: tuple[float, float]) -> None:
    """The way (n, 3) in mm that a robot truly went, from above, and where it was put down."""
    if len(places):
        axes.plot(places[:, 0], places[:, 1], color=TRUE, lw=2.0, label="true", zorder=3)
        axes.plot(*places[0, :2], "o", color=TRUE, ms=8, mfc="white", mew=2, zorder=4)
        axes.annotate(
            "start", (places[0, 0], places[0, 1]), xytext=beside, textcoords="offset points", color=TRUE, fontsize=10
        )


def two_views(figure: Figure, place: SubplotSpec, box: ContainerSection) -> tuple[Axes, Axes]:
    """Axes for a container seen from above and from the front, one over the other, of about the same scale."""
    sizes = 1e3 * box.high - 1e3 * box.low + 8.0
    split = place.subgridspec(2, 1, height_ratios=sizes[1:], hspace=0.17)
    above, front = figure.add_subplot(split[0]), figure.add_subplot(split[1])
    above.tick_params(labelbottom=False)
    front.set_xlabel("x in mm")
    return above, front


def outline(axes: Axes, box: ContainerSection, across: int) -> None:
    """A container from above (`across` 1) or from the front (2), and the space around it that is shown."""
    (x0, y0), (x1, y1) = 1e3 * box.low[[0, across]], 1e3 * box.high[[0, across]]
    axes.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], color=PLANNED, lw=1.2)
    axes.set_aspect("equal")
    axes.set_xlim(x0 - 4.0, x1 + 4.0)
    axes.set_ylim(y0 - 4.0, y1 + 4.0)
    axes.set_ylabel(f"{'xyz'[across]} in mm")
    axes.grid(color="#eeeeee", zorder=0)


def limit_line(axes: Axes, value: float, text: str, *, size: float = 9, zorder: float = 2) -> None:
    """A dashed grey line at a value that is asked for, and what it is."""
    axes.axhline(value, color="#999999", lw=1, ls="--", zorder=zorder)
    axes.text(1.0, value, text, color="#777777", fontsize=size, va="bottom", ha="right",
              transform=axes.get_yaxis_transform())  # fmt: skip


def dots(
    axes: Axes,
    x: Any,
    y: Any,
    size: float,
    color: str,
    *,
    alpha: float = 1.0,
    label: str | None = None,
    zorder: float = 2,
) -> None:
    """Points `size` wide, in points of type, as one stroke with round caps: as vectors, thousands of them stay small.

    Markers would be an element of the drawing each.
    """
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    places = np.column_stack([np.asarray(x, dtype=float), np.asarray(y, dtype=float)])
    places = places[np.isfinite(places).all(axis=1)]
    if label is not None:
        axes.plot([], [], ".", ms=max(2.0 * size, 7.0), color=color, label=label)
    if not len(places):
        return
    there = places + 1e-6 * np.maximum(np.abs(places).max(axis=0), 1e-12) * np.array(
        [1.0, 0.0]
    )  # no length draws no cap
    codes = np.tile(np.array([Path.MOVETO, Path.LINETO]), len(places))
    stroke = Path(np.stack([places, there], axis=1).reshape(-1, 2), codes)
    patch = PathPatch(stroke, fill=False, ec=color, lw=size, capstyle="round", alpha=alpha, zorder=zorder)
    patch.set_snap(False)
    axes.add_patch(patch)
    axes.update_datalim(places)
    axes.autoscale_view()


def ellipse(covariance: FloatArray, sigmas: float = 1.0, n: int = 49) -> FloatArray:
    """Points (n, 2) of the ellipse `sigmas` standard deviations from the origin of a covariance (2, 2).

    Of normal errors, one in exp(-sigmas² / 2) lies outside: 1.1 % for three.
    """
    values, vectors = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, n)
    circle = np.array([np.cos(angle), np.sin(angle)])
    found: FloatArray = ((vectors * (sigmas * np.sqrt(np.maximum(values, 0.0)))) @ circle).T
    return found


def nothing(axes: Axes, text: str) -> None:
    """A line in the middle of an empty picture that says why it is empty."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", color="#888888")
