"""Figure, colours and graphic elements that every picture of a run shares."""

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
def open_sheet(
    path: Path, headline: str, subline: str, *, left: float = 0.06, heights: tuple[float, float] = (0.945, 0.905),
    sizes: tuple[float, float, float] = (11, 17, 11.5),
) -> Iterator[Figure]:  # fmt: skip
    """Yield a 16:9 figure with two title lines; write it as PNG when the block ends.

    Parameters
    ----------
    path : Path
        File to write.
    headline, subline : str
        The two lines.
    left : float
        Left end of the lines, as a fraction of the width.
    heights : tuple of float
        Heights of the two lines, as fractions of the figure's height.
    sizes : tuple of float
        Font sizes of axes and of the two lines, in points.

    Yields
    ------
    Figure
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


def format_map_axes(axes: Axes) -> None:
    """Format axes as a map: equal scales, axis labels, a faint grid and a legend above.

    Parameters
    ----------
    axes : Axes
    """
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x in mm")
    axes.set_ylabel("y in mm")
    axes.grid(color="#eeeeee", zorder=0)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncol=3, frameon=False)


def draw_true_way(axes: Axes, places: FloatArray, beside: tuple[float, float]) -> None:
    """Draw a robot's true positions from above, and its start position.

    Parameters
    ----------
    axes : Axes
    places : ndarray, shape (n, 3), in mm
    beside : tuple of float
        Offset of the start's label in points.
    """
    if len(places):
        axes.plot(places[:, 0], places[:, 1], color=TRUE, lw=2.0, label="true", zorder=3)
        axes.plot(*places[0, :2], "o", color=TRUE, ms=8, mfc="white", mew=2, zorder=4)
        axes.annotate(
            "start", (places[0, 0], places[0, 1]), xytext=beside, textcoords="offset points", color=TRUE, fontsize=10
        )


def make_two_views(figure: Figure, place: SubplotSpec, box: ContainerSection) -> tuple[Axes, Axes]:
    """Add axes for a container from above and, below them, from the front, of about the same scale.

    Parameters
    ----------
    figure : Figure
    place : SubplotSpec
    box : ContainerSection

    Returns
    -------
    above, front : Axes
    """
    sizes = 1e3 * box.high - 1e3 * box.low + 8.0
    split = place.subgridspec(2, 1, height_ratios=sizes[1:], hspace=0.17)
    above, front = figure.add_subplot(split[0]), figure.add_subplot(split[1])
    above.tick_params(labelbottom=False)
    front.set_xlabel("x in mm")
    return above, front


def draw_container(axes: Axes, box: ContainerSection, across: int) -> None:
    """Draw a container from above or from the front, and set the limits of the axes around it.

    Parameters
    ----------
    axes : Axes
    box : ContainerSection
    across : int
        World axis drawn upwards: 1 (y) from above, 2 (z) from the front.
    """
    (x0, y0), (x1, y1) = 1e3 * box.low[[0, across]], 1e3 * box.high[[0, across]]
    axes.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], color=PLANNED, lw=1.2)
    axes.set_aspect("equal")
    axes.set_xlim(x0 - 4.0, x1 + 4.0)
    axes.set_ylim(y0 - 4.0, y1 + 4.0)
    axes.set_ylabel(f"{'xyz'[across]} in mm")
    axes.grid(color="#eeeeee", zorder=0)


def draw_limit_line(axes: Axes, value: float, text: str, *, size: float = 9, zorder: float = 2) -> None:
    """Draw a dashed grey line at a limit, with a label.

    Parameters
    ----------
    axes : Axes
    value : float
    text : str
    size : float, in points
        Font size.
    zorder : float
    """
    axes.axhline(value, color="#999999", lw=1, ls="--", zorder=zorder)
    axes.text(1.0, value, text, color="#777777", fontsize=size, va="bottom", ha="right",
              transform=axes.get_yaxis_transform())  # fmt: skip


def draw_dots(
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
    """Draw many points as one stroke with round caps.

    In a vector graphic thousands of them stay small, where each marker would be an element of its own.

    Parameters
    ----------
    axes : Axes
    x, y : array_like, shape (n,)
    size : float, in points
        Diameter.
    color : str
    alpha : float
    label : str, optional
        For the legend.
    zorder : float
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


def compute_ellipse(covariance: FloatArray, sigmas: float = 1.0, n: int = 49) -> FloatArray:
    """Compute the ellipse of a covariance about the origin.

    A fraction exp(-sigmas² / 2) of normal errors lies outside: 1.1 % for three sigmas.

    Parameters
    ----------
    covariance : ndarray, shape (2, 2)
    sigmas : float
        Size in standard deviations.
    n : int
        Number of points.

    Returns
    -------
    ndarray, shape (n, 2)
    """
    values, vectors = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, n)
    circle = np.array([np.cos(angle), np.sin(angle)])
    found: FloatArray = ((vectors * (sigmas * np.sqrt(np.maximum(values, 0.0)))) @ circle).T
    return found


def draw_empty_note(axes: Axes, text: str) -> None:
    """Write in the middle of empty axes why they are empty.

    Parameters
    ----------
    axes : Axes
    text : str
    """
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", color="#888888")


def escape_name(name: str) -> str:
    """Protect a name of a user's file from matplotlib, which would read formulas in it, or leave it out of a legend.

    Parameters
    ----------
    name : str

    Returns
    -------
    str
        Text that is drawn as `name`.
    """
    return (" " if name.startswith("_") else "") + name.replace("$", r"\$")
