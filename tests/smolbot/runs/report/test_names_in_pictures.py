"""Names of a user's files are drawn as they are written."""

from __future__ import annotations

import io

import matplotlib
import pytest
from matplotlib.figure import Figure

from smolbot.runs.pictures.style import escape_name


@pytest.mark.parametrize("name", ["+x", "_hidden", "$\\frac{$", "_$x$ and \\$", "</text>&<b>", "a_b^{2}"])
def test_a_name_is_drawn_as_it_is_written(name: str) -> None:
    figure = Figure()
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], label=escape_name(name))
    legend = axes.legend()
    out = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        figure.savefig(out, format="svg")
    assert len(legend.get_texts()) == 1
    shown = name.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    assert f"{shown}</text>" in out.getvalue()
