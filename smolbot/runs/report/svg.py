"""Figures as SVG elements inside a page, with colours that follow the reader's light or dark mode."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from markupsafe import Markup
    from matplotlib.figure import Figure

INK, FAINT, GRID = "#333333", "#8a8f98", "#e7e9ec"

DARK = {
    INK: "#d8dce2",
    FAINT: "#8f959e",
    GRID: "#31363d",
    "#ffffff": "#16191d",
    "#eeeeee": "#2b3036",
    "#999999": "#8f959e",
    "#888888": "#8f959e",
    "#777777": "#a0a6ae",
    "#b9bec7": "#4b535d",
    "#1b4965": "#8cc3ec",
    "#5fa8d3": "#4f8fb8",
    "#e4572e": "#ff8360",
    "#f2a541": "#f2b25c",
    "#7b2d8b": "#c78bd6",
    "#4c956c": "#74c296",
    "#f3e3c3": "#4a412c",
    "#9a7b3a": "#d1b06a",
}
"""Colours of figures, each with the one that takes its place on a dark page."""

_STYLE: dict[Any, Any] = {
    "font.size": 10,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "grid.color": GRID,
    "svg.fonttype": "none",
    "path.simplify_threshold": 0.3,
}


@contextmanager
def apply_page_style() -> Iterator[None]:
    """Apply the pages' figure style within a ``with`` block.

    Yields
    ------
    None
    """
    import matplotlib

    with matplotlib.rc_context(_STYLE):
        yield


def make_wide_figure(height: float) -> Figure:
    """Make an empty figure of the width of a page, with automatic layout.

    Parameters
    ----------
    height : float, in inches

    Returns
    -------
    Figure
    """
    from matplotlib.figure import Figure

    return Figure(figsize=(11.2, height), layout="constrained")


def to_svg(figure: Figure, name: str, alternative: str) -> Markup:
    """Convert a figure to an ``svg`` element.

    Parameters
    ----------
    figure : Figure
    name : str
        Unique in the page; it keeps the ids of the figure's parts apart from those of others.
    alternative : str
        Description for screen readers.

    Returns
    -------
    str
        HTML.
    """
    import matplotlib
    from markupsafe import Markup

    out = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": name}):
        figure.savefig(out, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    return Markup(_strip_svg(out.getvalue(), alternative))


def _strip_svg(text: str, alternative: str) -> str:
    """Remove from an SVG what a page does not need: declarations, metadata, unused ids."""
    import html

    body = text[text.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.S)
    body = re.sub(r"<!--.*?-->", "", body, flags=re.S)
    body = re.sub(r'\s(xmlns(:\w+)?|version)="[^"]*"', "", body)
    body = body.replace("xlink:href", "href")
    used = set(re.findall(r"#([A-Za-z][\w-]*)", body))
    body = re.sub(r'\sid="([^"]*)"', lambda m: m.group(0) if m.group(1) in used else "", body)
    for color in DARK:
        body = body.replace(color, f"var(--c{color[1:]})")
    body = re.sub(
        r'<svg[^>]*?viewBox="([^"]*)"[^>]*>', _make_opening_tag(html.escape(alternative, quote=True)), body, count=1
    )
    return re.sub(r">\s+<", "><", re.sub(r"\s*\n\s*", " ", body)).strip()


def _make_opening_tag(alternative: str) -> str:
    return rf'<svg viewBox="\1" role="img" aria-label="{alternative}">'.replace("\\1", "\\g<1>")
