"""The picture of a run: planned, true and localized path; errors over time; currents."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.config.mission import Mission
from smolbot.runs.pictures import helix_run as helixpicture
from smolbot.runs.pictures.style import (
    COILS,
    LOCATED,
    PLANNED,
    TRUE,
    draw_dots,
    draw_empty_note,
    draw_limit_line,
    draw_true_way,
    escape_name,
    format_map_axes,
    open_sheet,
)
from smolbot.runs.run import Run
from smolbot.runs.summary import compute_tracking_distance, format_label
from smolbot.runs.trace import Trace, get_located_poses, pair_with_truth

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_run(mission: Mission, run: Run, trace: Trace, path: Path) -> None:
    """Write the picture of a run (PNG, 16:9).

    Parameters
    ----------
    mission : Mission
    run : Run
        With its summary.
    trace : Trace
    path : Path
        File to write.
    """
    with open_sheet(path, format_headline(mission, run), format_subline(run.summary)) as figure:
        grid = figure.add_gridspec(
            3, 2, width_ratios=[1.0, 1.25], height_ratios=[1.0, 1.0, 1.0], wspace=0.2, hspace=0.28,
            left=0.06, right=0.975, top=0.845, bottom=0.085,
        )  # fmt: skip
        left, errors = figure.add_subplot(grid[:, 0]), figure.add_subplot(grid[0, 1])
        middle, low = figure.add_subplot(grid[1, 1], sharex=errors), figure.add_subplot(grid[2, 1], sharex=errors)
        if mission.robot.kind == "helical":
            helixpicture.draw_axes_on_path(left, mission, trace)
            helixpicture.draw_distance(errors, mission, trace)
            helixpicture.draw_axis_error(middle, mission, trace)
            helixpicture.draw_turns(low, mission, trace)
        else:
            draw_path(left, mission, trace)
            draw_tracking(errors, mission, trace)
            draw_localization(middle, trace)
            draw_currents(low, mission, trace)


def format_headline(mission: Mission, run: Run) -> str:
    """Format the title: what was flown and how it ended.

    Parameters
    ----------
    mission : Mission
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
    parts = [f"{summary['duration_s']:.0f} s", f"{summary['cycles']} cycles at {summary['loop_rate_hz']:.1f} Hz"]
    if "turns" in summary:
        parts = [f"{summary['duration_s']:.0f} s", *helixpicture.format_subline_parts(summary)]
    if "tracking_error_mm" in summary:
        t = summary["tracking_error_mm"]
        parts.append(f"tracking error {t['mean']:.2f} mm mean, {t['max']:.2f} max")
    if "localization_error_mm" in summary:
        e = summary["localization_error_mm"]
        parts.append(f"localization error {e['mean']:.2f} ± {e['std']:.2f} mm")
    return "   ·   ".join([*parts, f"seed {summary.get('seed', '-')}"])


def draw_path(axes: Axes, mission: Mission, trace: Trace) -> None:
    """Draw planned path, true positions and trusted poses, from above.

    Parameters
    ----------
    axes : Axes
    mission : Mission
    trace : Trace
    """
    planned = mission.path.points * 1e3
    axes.plot(planned[:, 0], planned[:, 1], color=PLANNED, lw=9, solid_capstyle="round", label="planned", zorder=1)
    poses = get_located_poses(trace.moments)
    if poses:
        places = np.array([p.position for p in poses]) * 1e3
        draw_dots(axes, places[:, 0], places[:, 1], 3.0, LOCATED, alpha=0.55, label="localized")
    draw_true_way(axes, trace.true_positions() * 1e3, (6, -13))
    axes.margins(0.08)
    format_map_axes(axes)


def draw_tracking(axes: Axes, mission: Mission, trace: Trace) -> None:
    """Draw the distance of the true robot to the path over time.

    Parameters
    ----------
    axes : Axes
    mission : Mission
    trace : Trace
    """
    moments = [m for m in trace.following if m.truth_at_end is not None]
    if moments:
        times = [t for m in moments for t in (m.truth.time if m.truth else m.cycle.shot.end, m.cycle.shot.end)]
        axes.plot(times, compute_tracking_distance(mission, moments) * 1e3, color=TRUE, lw=1.3)
        draw_limit_line(axes, mission.tolerance * 1e3, " arrival ")
    else:
        draw_empty_note(axes, "path not reached" if trace.knows_truth else "no ground truth on this rig")
    axes.set_ylim(bottom=0.0)
    axes.set_title("True robot to path, in mm", loc="left", fontsize=11)
    axes.tick_params(labelbottom=False)


def draw_localization(axes: Axes, trace: Trace) -> None:
    """Draw the error of each trusted pose, and of the tracked ones, over time.

    Parameters
    ----------
    axes : Axes
    trace : Trace
    """
    known = pair_with_truth(trace.moments)
    if known:
        times = [truth.time for _, truth in known]
        raw = [np.linalg.norm(pose.position - truth.position) * 1e3 for pose, truth in known]
        draw_dots(axes, times, raw, 2.2, LOCATED, alpha=0.6, label="each pose")
        both = [(m.truth.time, np.linalg.norm(m.cycle.tracked.position - m.truth.position) * 1e3)
                for m in trace.moments if m.cycle.trusted and m.cycle.tracked and m.truth]  # fmt: skip
        axes.plot(*np.array(both).T, color=TRUE, lw=1.3, label="tracked")
        axes.set_ylim(0.0, 1.15 * float(np.percentile(raw, 99.5)))
        axes.legend(loc="upper right", ncol=2, frameon=False, fontsize=9, borderaxespad=0.0)
    else:
        draw_empty_note(axes, "no ground truth on this rig")
    axes.set_title("Localization error, in mm", loc="left", fontsize=11)
    axes.tick_params(labelbottom=False)


def draw_currents(axes: Axes, mission: Mission, trace: Trace) -> None:
    """Draw the current of each coil in every actuation window.

    Parameters
    ----------
    axes : Axes
    mission : Mission
    trace : Trace
    """
    names = mission.rig.coil_names
    starts, _, currents = trace.currents(len(names))
    for index, name in enumerate(names):
        if len(starts):
            draw_dots(axes, starts, currents[:, index], 2.2, COILS[index % len(COILS)], label=escape_name(name))
    axes.set_ylim(0.0 if mission.rig.limits.unipolar else None, mission.rig.limits.max_current * 1.08)
    axes.set_title("Coil currents while actuating, in A", loc="left", fontsize=11)
    axes.set_xlabel("time in s")
    if len(starts):
        axes.legend(loc="lower right", ncol=len(names), frameon=False, fontsize=9,
                    bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0, handletextpad=0.1)  # fmt: skip
