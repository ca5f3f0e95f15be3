"""Colours and strokes that every picture of a run shares."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.core.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PLANNED, TRUE, LOCATED, STIFF = "#b9bec7", "#1b4965", "#e4572e", "#f3e3c3"
COILS = ("#1b4965", "#5fa8d3", "#e4572e", "#f2a541", "#7b2d8b", "#4c956c")


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
