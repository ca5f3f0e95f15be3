"""The picture of a helical robot's run: propulsion axes on the path, tracking and axis error, turns."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.config.mission import Mission
from smolbot.core.arrays import FloatArray
from smolbot.core.shots import Rotate
from smolbot.paths.arc_lengths import assign_arc_lengths
from smolbot.runs.pictures.style import LOCATED, PLANNED, STIFF, TRUE, draw_empty_note, draw_true_way, format_map_axes
from smolbot.runs.summary import compute_axis_angle
from smolbot.runs.trace import Moment, Trace, pair_with_truth

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ARROW_LENGTH = 3.5
"""Length of an arrow along a propulsion axis, in mm."""


def draw_axes_on_path(axes: Axes, mission: Mission, trace: Trace) -> None:
    """Draw planned path, true positions, and the tracked and true propulsion axis at every pause.

    Parameters
    ----------
    axes : Axes
    mission : Mission
    trace : Trace
    """
    from matplotlib.patches import Circle

    for lump in mission.rig.sections.tank.get("gel", {}).get("inclusions", []):
        axes.add_patch(Circle(lump["center_mm"], lump["radius_mm"], color=STIFF, lw=0, zorder=0.5))
        axes.annotate("stiffer gel", lump["center_mm"], xytext=(0, -lump["radius_mm"] - 1.2), ha="center", va="top",
                      textcoords="data", fontsize=9, color="#9a7b3a")  # fmt: skip
    planned = mission.path.points * 1e3
    axes.plot(planned[:, 0], planned[:, 1], color=PLANNED, lw=9, solid_capstyle="round", label="planned", zorder=1)
    draw_true_way(axes, trace.true_positions() * 1e3, (8, -4))
    for moment in find_pauses(trace):
        for pose, color, width, order in ((moment.truth, TRUE, 0.006, 5), (moment.cycle.tracked, LOCATED, 0.004, 6)):
            if pose is not None:
                tip = ARROW_LENGTH * pose.body_axis("z")[:2]
                axes.quiver(*(1e3 * pose.position[:2]), *tip, color=color, angles="xy", scale_units="xy", scale=1.0,
                            width=width, headwidth=4.5, headlength=5, zorder=order)  # fmt: skip
    axes.plot([], [], color=LOCATED, lw=2, label="tracked propulsion axis")
    axes.margins(0.08)
    format_map_axes(axes)


def find_pauses(trace: Trace) -> list[Moment]:
    """Find the last cycle of every pause: the one that calls for the magnet, or ends the mission.

    Parameters
    ----------
    trace : Trace

    Returns
    -------
    list of Moment
    """
    return [m for m in trace.moments if m.cycle.command.mechanical or m.cycle.command.done or m.cycle.command.stuck]


def draw_distance(axes: Axes, mission: Mission, trace: Trace) -> None:
    """Draw the distance of the true robot to the path against its arc length.

    Parameters
    ----------
    axes : Axes
    mission : Mission
    trace : Trace
    """
    places = [m.positions for m in trace.following]
    if places and trace.knows_truth:
        trail = np.vstack(places)
        arc, distance = assign_arc_lengths(mission.path, trail), mission.path.project(trail)[1]
        axes.plot(arc * 1e3, distance * 1e3, color=TRUE, lw=1.3)
        moments = [m for m in find_pauses(trace) if m.truth is not None and m.cycle.command.phase == "follow"]
        if moments:
            stops = np.array([m.truth.position for m in moments if m.truth])
            at, off = assign_arc_lengths(mission.path, stops), mission.path.project(stops)[1]
            axes.plot(at * 1e3, off * 1e3, "o", color=TRUE, ms=4.5, mfc="white", mew=1.4, label="pauses")
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=9, borderaxespad=0.0)
    else:
        draw_empty_note(axes, "no ground truth on this rig")
    axes.set_ylim(bottom=0.0)
    axes.set_title("True robot to path, in mm", loc="left", fontsize=11)
    axes.tick_params(labelbottom=False)


def draw_axis_error(axes: Axes, mission: Mission, trace: Trace) -> None:
    """Draw the angle between estimated and true propulsion axis against arc length.

    Parameters
    ----------
    axes : Axes
    mission : Mission
    trace : Trace
    """
    known = pair_with_truth(trace.moments)
    if known:
        arc = assign_arc_lengths(mission.path, np.array([truth.position for _, truth in known]))
        angles = np.degrees([compute_axis_angle(pose, truth) for pose, truth in known])
        axes.plot(arc * 1e3, angles, ".", color=LOCATED, ms=5, alpha=0.7)
    else:
        draw_empty_note(axes, "no ground truth on this rig")
    axes.set_ylim(bottom=0.0)
    axes.set_title("Propulsion axis of each pose against the true one, in degrees", loc="left", fontsize=11)
    axes.tick_params(labelbottom=False)


def draw_turns(axes: Axes, mission: Mission, trace: Trace) -> None:
    """Draw the turns before each pause and their rotation frequency, against the arc length at their start.

    Parameters
    ----------
    axes : Axes
    mission : Mission
    trace : Trace
    """
    starts: list[FloatArray] = []
    maneuvers: list[tuple[float, float]] = []
    for before, moment in zip(trace.moments, trace.moments[1:], strict=False):
        rotations = [w for w in moment.cycle.shot.windows if isinstance(w, Rotate)]
        pose = before.cycle.tracked
        if rotations and pose is not None:
            starts.append(pose.position)
            maneuvers.append((sum(w.turns for w in rotations), rotations[-1].frequency))
    if starts:
        rows: FloatArray = np.column_stack([1e3 * assign_arc_lengths(mission.path, np.array(starts)), maneuvers])
        full = mission.rig.limits.max_rotation_frequency
        for slow, color, label in ((False, TRUE, f"{full:g} Hz"), (True, LOCATED, "slower, after a step-out")):
            chosen = rows[(rows[:, 2] < full - 1e-9) == slow]
            if len(chosen):
                axes.bar(chosen[:, 0], chosen[:, 1], width=1.2, color=color, alpha=0.85, label=label)
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncol=2, frameon=False, fontsize=9, borderaxespad=0.0)
    axes.set_title("Turns of the magnet before each pause", loc="left", fontsize=11)
    axes.set_xlabel("along the path, in mm")


def format_subline_parts(summary: dict[str, Any]) -> list[str]:
    """Format the figures of a helical robot for the line below the title.

    Parameters
    ----------
    summary : dict

    Returns
    -------
    list of str
    """
    parts = [f"{summary['turns']:.0f} turns, {summary['pauses']} pauses, {summary['step_outs']} step-outs"]
    if "axis_error_deg" in summary:
        parts.append(f"axis error {summary['axis_error_deg']['mean']:.1f}°")
    return parts
