"""The picture of a replay: poses located in flight, and those located with other settings in the same windows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from smolbot.paths.curve import Curve
from smolbot.runs.pictures.style import escape_name
from smolbot.runs.trace import Moment, get_located_poses, pair_with_truth

RECORDED, REPLAYED, TRUE = "tab:blue", "tab:orange", "0.3"


def draw_replay(
    path: Path, curve: Curve | None, recorded: Sequence[Moment], replayed: Sequence[Moment], changed: str
) -> None:
    """Draw positions from above, and over time errors (or the distance of both without ground truth) and R squared.

    Parameters
    ----------
    path : Path
        File to write.
    curve : Curve or None
        The planned path, if there is one.
    recorded, replayed : sequence of Moment
        Of the same cycles.
    changed : str
        The settings that differ.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplot_mosaic([["map", "error"], ["map", "fit"]], figsize=(11, 5.4), width_ratios=(1, 1.35))
    try:
        _draw_map(axes["map"], curve, recorded, replayed)
        _draw_errors(axes["error"], recorded, replayed)
        _draw_fits(axes["fit"], recorded, replayed)
        figure.suptitle(
            f"Replayed with {escape_name(changed)}" if changed else "Replayed with the same settings", x=0.02, ha="left"
        )
        figure.tight_layout()
        figure.savefig(path, dpi=140)
    finally:
        plt.close(figure)


def _draw_map(axes: Any, curve: Curve | None, recorded: Sequence[Moment], replayed: Sequence[Moment]) -> None:
    if curve is not None:
        axes.plot(*(1e3 * curve.points[:, :2].T), color="0.75", lw=4, solid_capstyle="round", label="planned")
    true = np.array([m.truth.position for m in recorded if m.truth is not None]).reshape(-1, 3)
    if len(true):
        axes.plot(*(1e3 * true[:, :2].T), color=TRUE, lw=1, label="true")
    for moments, color, label in ((recorded, RECORDED, "recorded"), (replayed, REPLAYED, "replayed")):
        places = np.array([p.position for p in get_located_poses(moments)]).reshape(-1, 3)
        axes.plot(*(1e3 * places[:, :2].T), ".", ms=3, color=color, label=label)
    axes.set_aspect("equal", "datalim")
    axes.set(xlabel="x (mm)", ylabel="y (mm)", title="Located poses that were trusted")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=4, fontsize=8, frameon=False)


def _draw_errors(axes: Any, recorded: Sequence[Moment], replayed: Sequence[Moment]) -> None:
    known = any(m.truth is not None for m in recorded)
    if known:
        for moments, color, label in ((recorded, RECORDED, "recorded"), (replayed, REPLAYED, "replayed")):
            found = [
                (p.time, 1e3 * np.linalg.norm(p.position - truth.position)) for p, truth in pair_with_truth(moments)
            ]
            if found:
                times, errors = np.array(found).T
                axes.plot(times, errors, ".", ms=3, color=color, label=f"{label}, mean {errors.mean():.2f} mm")
        axes.set(ylabel="pose to truth (mm)", title="Localization error")
    else:
        both = [
            (first.time, 1e3 * np.linalg.norm(first.position - second.position))
            for a, b in zip(recorded, replayed, strict=True)
            if (first := a.cycle.trusted) is not None and (second := b.cycle.trusted) is not None
        ]
        if both:
            times, apart = np.array(both).T
            axes.plot(times, apart, ".", ms=3, color=REPLAYED, label=f"mean {apart.mean():.2f} mm")
        axes.set(ylabel="replayed to recorded (mm)", title="Distance between the poses of one window")
    axes.set_ylim(0, 1.15 * axes.get_ylim()[1])
    axes.set_xlabel("time (s)")
    if axes.has_data():
        axes.legend(fontsize=8, frameon=False)


def _draw_fits(axes: Any, recorded: Sequence[Moment], replayed: Sequence[Moment]) -> None:
    for moments, color in ((recorded, RECORDED), (replayed, REPLAYED)):
        found = [(m.cycle.pose.time, 1.0 - m.cycle.pose.r_squared) for m in moments if m.cycle.pose is not None]
        if found:
            times, residuals = np.array(found).T
            axes.semilogy(times, np.maximum(residuals, 1e-7), ".", ms=3, color=color)
    axes.set(xlabel="time (s)", ylabel="1 - R²", title="Unexplained share of the signal")
