"""Pictures of an optical track: over the scene itself, and against a run as in the paper's Fig. S9."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.runs.optics.analysis import PathAnalysis
from smolbot.runs.optics.optical_track import OpticalTrack
from smolbot.runs.optics.view import View
from smolbot.runs.pictures.style import open_sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SEEN, LOCATED, PALE, PLANNED = "#1b4965", "#e4572e", "#b9bec7", "#f7d488"
SCENE_MARGIN = 14e-3  # m of the scene shown around the track
PIXELS_PER_MM = 10  # pixels of the scene per mm
ARROWS = 26


def draw_track(
    track: OpticalTrack, view: View, height: float, scene: Any, path: Path, *, title: str, line: str,
    analysis: PathAnalysis | None = None, planned: FloatArray | None = None,
) -> None:  # fmt: skip
    """Write the picture of a track (PNG, 16:9).

    Parameters
    ----------
    track : OpticalTrack
        On the run's clock if there is an analysis.
    view : View
        As used for the track.
    height : float, in m
        z of the track.
    scene : Image
        The video's background.
    path : Path
        File to write.
    title, line : str
        The two lines above it.
    analysis : PathAnalysis, optional
    planned : ndarray, shape (k, 2) or (k, 3), in m, optional
        The planned path, in the world frame.
    """
    with open_sheet(path, title, line, left=0.05) as figure:
        grid = figure.add_gridspec(
            4, 2, width_ratios=[1.0, 1.05], wspace=0.16, hspace=0.3, left=0.05, right=0.975, top=0.84, bottom=0.08
        )
        _draw_scene(figure.add_subplot(grid[:, 0]), track, view, height, scene, analysis, planned)
        first = figure.add_subplot(grid[0, 1])
        panels = [first, *(figure.add_subplot(grid[i, 1], sharex=first) for i in (1, 2, 3))]
        _draw_panels(panels, track, analysis)


def _draw_scene(
    axes: Axes, track: OpticalTrack, view: View, height: float, scene: Any, analysis: PathAnalysis | None,
    planned: FloatArray | None,
) -> None:  # fmt: skip
    import cv2

    low = track.positions[:, :2].min(axis=0) - SCENE_MARGIN
    high = track.positions[:, :2].max(axis=0) + SCENE_MARGIN
    n = np.ceil(1e3 * PIXELS_PER_MM * (high - low)).astype(int)
    x, y = np.meshgrid(np.linspace(low[0], high[0], n[0]), np.linspace(low[1], high[1], n[1]))
    pixels = view.project(np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height)]))
    u, v = (pixels[:, i].reshape(x.shape).astype(np.float32) for i in (0, 1))
    photo = cv2.remap(scene, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(255, 255, 255))
    faded = 255 - (255 - photo[:, :, ::-1].astype(np.float64)) * 0.55
    extent = (1e3 * low[0], 1e3 * high[0], 1e3 * low[1], 1e3 * high[1])
    axes.imshow(faded.astype(np.uint8), origin="lower", extent=extent, zorder=0)
    if planned is not None:
        axes.plot(*(1e3 * planned[:, :2].T), color=PLANNED, lw=8, alpha=0.5, solid_capstyle="round", zorder=1,
                  label="planned")  # fmt: skip
    if analysis is not None:
        x, y = 1e3 * analysis.poses[:, :2].T
        axes.scatter(x, y, s=11, color=LOCATED, alpha=0.75, lw=0, zorder=3, label="located")
    split = np.nonzero(np.diff(track.frames) > 3)[0] + 1
    for i, piece in enumerate(np.split(track.positions, split)):
        axes.plot(*(1e3 * piece[:, :2].T), color=SEEN, lw=1.8, zorder=4, label="seen by camera" if i == 0 else None)
    _draw_arrows(axes, track)
    axes.set_xlabel("x in mm")
    axes.set_ylabel("y in mm")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncol=3, frameon=False)


def _draw_arrows(axes: Axes, track: OpticalTrack) -> None:
    """Draw headings at equal distances along the track."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(track.positions[:, :2], axis=0), axis=1))])
    chosen = np.unique(np.searchsorted(way, np.linspace(0.0, way[-1], ARROWS)))
    at = chosen[chosen < len(way)]
    place, heading = 1e3 * track.positions[at], track.headings[at]
    axes.quiver(place[:, 0], place[:, 1], np.cos(heading), np.sin(heading), color=SEEN, width=0.0045, scale=22,
                headwidth=4.5, zorder=5)  # fmt: skip


def _draw_panels(panels: list[Any], track: OpticalTrack, analysis: PathAnalysis | None) -> None:
    turn = 0.0 if analysis is None else 2 * np.pi * round(float(np.median(track.headings)) / (2 * np.pi))
    rows = [("x in mm", 1e3 * track.positions[:, 0]), ("y in mm", 1e3 * track.positions[:, 1]),
            ("z in mm", None), ("angle in °", np.degrees(track.headings - turn))]  # fmt: skip
    for index, (axes, (name, seen)) in enumerate(zip(panels, rows, strict=True)):
        if analysis is not None:
            value = (*(1e3 * analysis.poses.T), np.degrees(analysis.angles - turn))[index]
            axes.plot(analysis.times, value, ".", color=LOCATED, ms=3.6, label="located", zorder=2)
        if seen is not None:
            gaps = np.concatenate([[False], np.diff(track.frames) > 3])
            axes.plot(track.times, np.where(gaps, np.nan, seen), color=SEEN, lw=1.3, label="seen by camera", zorder=3)
        elif analysis is not None and analysis.plane_known:
            axes.axhline(1e3 * track.positions[0, 2], color=SEEN, lw=1.3)
        elif analysis is not None:
            axes.axhline(1e3 * float(analysis.poses[:, 2].mean()), color=PALE, lw=1.3, ls="--")
            axes.text(1.0, 1e3 * float(analysis.poses[:, 2].mean()), " mean", color="#777777", fontsize=9, ha="right",
                      va="bottom", transform=axes.get_yaxis_transform())  # fmt: skip
        else:
            axes.axhline(1e3 * track.positions[0, 2], color=PALE, lw=1.3, ls="--")
            axes.text(0.5, 0.72, "height is assumed: one camera sees none", transform=axes.transAxes, ha="center",
                      color="#888888", fontsize=9)  # fmt: skip
        axes.set_title(name, loc="left", fontsize=11, pad=4)
        axes.tick_params(labelbottom=index == 3)
    panels[3].set_xlabel("time in s" + ("" if analysis is None else ", on the run's clock"))
