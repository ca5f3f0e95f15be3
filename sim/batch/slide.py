"""The style of the studies' figures: one slide with a headline that states the result, and few colours."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smolbot.runs.pictures.style import LOCATED, PLANNED, TRUE, open_sheet
from smolbot.runs.pictures.style import draw_limit_line as level_line

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WHITENED, PAPER, BOUND, LIMIT = TRUE, LOCATED, PLANNED, "#999999"
COLORS = {"whitened": WHITENED, "paper": PAPER}
OTHERS = ("#5fa8d3", "#f2a541", "#7b2d8b", "#4c956c")


@contextmanager
def open_slide(
    path: Path, headline: str, subline: str, rows: int = 1, columns: int = 1, **spacing: Any
) -> Iterator[list[Axes]]:
    """Open a 16:9 slide under a headline; it is written as PNG when the block ends.

    Parameters
    ----------
    path : Path
    headline, subline : str
    rows, columns : int
        Grid of the axes.
    **spacing : Any
        Goes to the grid of axes (``width_ratios``, ``wspace``, ``hspace``, …).

    Yields
    ------
    list of matplotlib.axes.Axes
        Row by row.
    """
    with open_sheet(path, headline, subline, heights=(0.94, 0.895), sizes=(12, 19, 12)) as figure:
        place = {"left": 0.07, "right": 0.97, "top": 0.82, "bottom": 0.1, "wspace": 0.22, "hspace": 0.42, **spacing}
        grid = figure.add_gridspec(rows, columns, **place)
        yield [figure.add_subplot(grid[i // columns, i % columns]) for i in range(rows * columns)]


def label_line(axes: Axes, x: float, y: float, text: str, color: str, **kwargs: Any) -> None:
    """Write a curve's name beside it, in its colour.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    x, y : float
        Position in data coordinates.
    text : str
    color : str
    **kwargs : Any
        Go to `Axes.annotate`.
    """
    axes.annotate(text, (x, y), color=color, fontweight="bold", **{"xytext": (6, 0), "textcoords": "offset points",
                                                                   "va": "center", **kwargs})  # fmt: skip


def draw_limit_line(axes: Axes, value: float, text: str, *, vertical: bool = False) -> None:
    """Draw a dashed grey line at a limit, with a label.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    value : float
    text : str
    vertical : bool
    """
    if vertical:
        axes.axvline(value, color=LIMIT, lw=1, ls="--", zorder=0)
        axes.text(value, 0.98, f" {text}", color="#777777", fontsize=10, va="top", transform=axes.get_xaxis_transform())
    else:
        level_line(axes, value, text, size=10, zorder=0)


def set_titles(axes: Axes, title: str, x: str = "", y: str = "") -> None:
    """Set the title at the left, the axis labels and a faint grid.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    title : str
    x, y : str
        Axis labels.
    """
    axes.set_title(title, loc="left", fontsize=12.5)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(color="#eeeeee", zorder=0)
    axes.set_axisbelow(True)


def set_ticks(axes: Axes, values: Sequence[float]) -> None:
    """Show only given ticks on the x axis.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    values : sequence of float
    """
    axes.set_xticks(list(values), [f"{v:g}" for v in values])
    axes.minorticks_off()
