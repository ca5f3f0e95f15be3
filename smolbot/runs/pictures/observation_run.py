"""The picture of an observation: track and errors of a moving device, or scatter of a resting one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.config.observation import Observation
from smolbot.config.rig_sections import ContainerSection
from smolbot.core.arrays import FloatArray
from smolbot.runs.observation_summary import find_measurements
from smolbot.runs.pictures.style import (
    LOCATED,
    TRUE,
    compute_ellipse,
    draw_container,
    draw_dots,
    draw_empty_note,
    draw_limit_line,
    make_two_views,
    open_sheet,
)
from smolbot.runs.run import Run
from smolbot.runs.summary import compute_orientation_error, format_label
from smolbot.runs.trace import Trace, get_located_poses, pair_with_truth

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ARROW_LENGTH = 6.5  # mm: length of a tip's arrow
MAX_ARROWS = 36  # shown of a whole track


def draw_observation(mission: Observation, run: Run, trace: Trace, path: Path) -> None:
    """Write the picture of an observation (PNG, 16:9).

    Parameters
    ----------
    mission : Observation
    run : Run
        With its summary.
    trace : Trace
    path : Path
        File to write.
    """
    with open_sheet(path, format_headline(mission, run), format_subline(run.summary)) as figure:
        if mission.sections.observe.measurements is None:
            _draw_watched(figure, mission, trace)
        else:
            _draw_measured(figure, mission, trace)


def format_headline(mission: Observation, run: Run) -> str:
    """Format the title: what was observed and how it ended.

    Parameters
    ----------
    mission : Observation
    run : Run
        With its summary.

    Returns
    -------
    str
    """
    return f"{mission.name}: {run.status}, verdict {run.summary['verdict']}{format_label(run.summary)}"


def format_subline(summary: dict[str, Any]) -> str:
    """Format the line below the title: the main figures of merit.

    Parameters
    ----------
    summary : dict

    Returns
    -------
    str
    """
    parts = [f"{summary['duration_s']:.0f} s"]
    if "pose_rate_hz" in summary:
        gaps = summary["gaps"]["count"]
        parts += [f"{summary['pose_rate_hz']:.1f} poses a second", f"{gaps or 'no'} gap{'' if gaps == 1 else 's'}"]
    if "sigma_mm" in summary:
        sigma = summary["sigma_mm"]["distance"]
        parts.append(f"{summary['measurements']} independent measurements, sigma {sigma:.3f} mm")
    if "localization_error_mm" in summary:
        e, a = summary["localization_error_mm"], summary["orientation_error_deg"]
        parts.append(f"localization error {e['mean']:.2f} ± {e['std']:.2f} mm, {a['mean']:.1f}°")
    return "   ·   ".join([*parts, f"seed {summary.get('seed', '-')}"])


def _draw_watched(figure: Figure, mission: Observation, trace: Trace) -> None:
    grid = figure.add_gridspec(
        3, 2, width_ratios=[1.25, 1.0], height_ratios=[1.0, 1.0, 1.0], wspace=0.17, hspace=0.34,
        left=0.06, right=0.975, top=0.845, bottom=0.085,
    )  # fmt: skip
    above, front = make_two_views(figure, grid[:, 0], mission.rig.container)
    for axes, across in ((above, 1), (front, 2)):
        draw_view(axes, trace, mission.rig.container, across)
    above.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncol=3, frameon=False)
    errors = figure.add_subplot(grid[0, 1])
    turns = figure.add_subplot(grid[1, 1], sharex=errors)
    rates = figure.add_subplot(grid[2, 1], sharex=errors)
    draw_errors(errors, turns, trace, along_cantilever=mission.robot.device.along_cantilever)
    draw_rate(rates, mission, trace)


def draw_view(axes: Axes, trace: Trace, box: ContainerSection, across: int) -> None:
    """Draw the track in the container, from above or from the front.

    Parameters
    ----------
    axes : Axes
    trace : Trace
    box : ContainerSection
    across : int
        World axis drawn upwards: 1 (y) from above, 2 (z) from the front.
    """
    draw_container(axes, box, across)
    truth = 1e3 * trace.true_positions()
    if len(truth):
        axes.plot(truth[:, 0], truth[:, across], color=TRUE, lw=0.9, label="true", zorder=4)
    poses = get_located_poses(trace.moments)
    if poses:
        places = 1e3 * np.array([p.position for p in poses])
        draw_dots(axes, places[:, 0], places[:, across], 3.7, LOCATED, alpha=0.4, label="localized", zorder=3)
        chosen = poses[:: max(len(poses) // MAX_ARROWS, 1)]
        start, ahead = 1e3 * np.array([p.position for p in chosen]), np.array([p.rotation[:, 2] for p in chosen])
        axes.quiver(
            start[:, 0], start[:, across], ARROW_LENGTH * ahead[:, 0], ARROW_LENGTH * ahead[:, across],
            angles="xy", scale_units="xy", scale=1.0, width=0.0028, headwidth=4.0, color="#f2a541", zorder=2,
            label="the tip's axis, localized",
        )  # fmt: skip


def draw_errors(errors: Axes, turns: Axes, trace: Trace, *, along_cantilever: bool) -> None:
    """Draw position and orientation error of each trusted pose over time.

    Parameters
    ----------
    errors, turns : Axes
        For position and for orientation errors.
    trace : Trace
    along_cantilever : bool
        Whether the moment lies along the cantilever, see `compute_orientation_error`.
    """
    known = pair_with_truth(trace.moments)
    if known:
        times = [p.time for p, _ in known]
        away = [1e3 * float(np.linalg.norm(p.position - t.position)) for p, t in known]
        angle = [float(np.degrees(compute_orientation_error(p, t, along_cantilever))) for p, t in known]
        draw_dots(errors, times, away, 1.6, LOCATED, alpha=0.7)
        errors.axhline(float(np.mean(away)), color=TRUE, lw=1)
        draw_dots(turns, times, angle, 1.6, LOCATED, alpha=0.7)
        turns.axhline(float(np.mean(angle)), color=TRUE, lw=1)
    else:
        for axes in (errors, turns):
            draw_empty_note(axes, "no ground truth on this rig")
    errors.set_title("Localization error of each pose, in mm; line: mean", loc="left", fontsize=11)
    turns.set_title("Orientation error, in degrees", loc="left", fontsize=11)
    for axes in (errors, turns):
        axes.set_ylim(bottom=0.0)
        axes.tick_params(labelbottom=False)


def draw_rate(axes: Axes, mission: Observation, trace: Trace) -> None:
    """Draw the trusted poses in every second, and the shots without one.

    Parameters
    ----------
    axes : Axes
    mission : Observation
    trace : Trace
    """
    times = np.array([pose.time for pose in get_located_poses(trace.moments)])
    if len(times) > 1:
        edges = np.arange(times[0], times[-1] + 1e-9, 1.0)
        if len(edges) > 1:
            counts = np.histogram(times, edges)[0]
            axes.step(edges, np.append(counts, counts[-1]), where="post", color=TRUE, lw=1.3)
    lost = [m.cycle.shot.end for m in trace.moments if m.cycle.trusted is None]
    if lost:
        axes.plot(lost, np.zeros(len(lost)), "|", color=LOCATED, ms=9, clip_on=False, label="shot without a pose")
        axes.legend(loc="lower right", frameon=False, fontsize=9)
    required = mission.sections.verdict.min_rate_hz
    if required is not None:
        draw_limit_line(axes, required, "wanted ")
    axes.set_ylim(bottom=0.0)
    axes.set_title("Trusted poses in every second", loc="left", fontsize=11)
    axes.set_xlabel("time in s")


def _draw_measured(figure: Figure, mission: Observation, trace: Trace) -> None:
    """Draw each measurement about the mean, from above and from the front, with the one-sigma ellipse."""
    grid = figure.add_gridspec(1, 2, wspace=0.22, left=0.07, right=0.975, top=0.835, bottom=0.1)
    draw_measurements(figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1]), trace)


def draw_measurements(above: Axes, front: Axes, trace: Trace) -> None:
    """Draw each measurement about the mean, from above and from the front, with the mean's error against the truth.

    Parameters
    ----------
    above, front : Axes
    trace : Trace
    """
    moments = find_measurements(trace)
    places = 1e3 * np.array([m.cycle.pose.position for m in moments if m.cycle.pose is not None]).reshape(-1, 3)
    for axes, i, j in ((above, 0, 1), (front, 0, 2)):
        if len(places) < 2:
            draw_empty_note(axes, "fewer than two measurements")
        else:
            draw_scatter(axes, places[:, [i, j]], ("xyz"[i], "xyz"[j]))
        truth = next((m.truth for m in moments if m.truth is not None), None)
        if truth is not None and len(places) > 1:
            off = places.mean(axis=0) - 1e3 * truth.position
            axes.set_title(
                f"mean minus truth: {'xyz'[i]} {1e3 * off[i]:+.0f} µm, {'xyz'[j]} {1e3 * off[j]:+.0f} µm",
                loc="left", fontsize=11,
            )  # fmt: skip


def draw_scatter(axes: Axes, places: FloatArray, names: tuple[str, str]) -> None:
    """Draw measurements about their mean, with the one-sigma ellipse.

    Parameters
    ----------
    axes : Axes
    places : ndarray, shape (n, 2), in mm
    names : tuple of str
        Names of the two world axes.
    """
    away = 1e3 * (places - places.mean(axis=0))
    axes.plot(*compute_ellipse(np.cov(away.T), n=181).T, color=TRUE, lw=1.4, label="one standard deviation")
    axes.plot(away[:, 0], away[:, 1], "o", color=LOCATED, ms=7, alpha=0.8, mew=0, label="measurements")
    for number, (x, y) in enumerate(away, 1):
        axes.annotate(str(number), (x, y), xytext=(5, 4), textcoords="offset points", fontsize=9, color="#777777")
    axes.plot(0.0, 0.0, "+", color=TRUE, ms=12, mew=1.5, label="their mean")
    size = 1.25 * max(float(np.abs(away).max()), 1e-3)
    axes.set_xlim(-size, size)
    axes.set_ylim(-size, size)
    axes.set_aspect("equal")
    axes.set_xlabel(f"{names[0]}, from the mean, in µm")
    axes.set_ylabel(f"{names[1]}, from the mean, in µm")
    axes.grid(color="#eeeeee")
    axes.legend(loc="upper right", frameon=False, fontsize=9)
