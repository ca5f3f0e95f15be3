"""Figures of the robot's true and estimated position, and of their difference."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.config.mission import Mission
from smolbot.config.observation import Observation
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.paths.arc_lengths import assign_arc_lengths
from smolbot.runs.pictures import gradient_run as picture
from smolbot.runs.pictures import helix_run as helixpicture
from smolbot.runs.pictures import observation_run as observation_picture
from smolbot.runs.pictures.style import LOCATED, PLANNED, TRUE, compute_ellipse, draw_dots, draw_empty_note
from smolbot.runs.report.recorded_flight import RecordedFlight
from smolbot.runs.report.svg import make_wide_figure
from smolbot.runs.summary import compute_tracking_distance
from smolbot.runs.trace import Moment, get_located_poses

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIGMAS = 3.0
"""Standard deviations of the ellipses."""

MAX_ELLIPSES = 40
"""Most ellipses along a complete path; in a close-up, every pose has its own."""

TRACKED_COLOR = "#f2a541"
_CLOSE_UP_HALF = 1.1  # mm from the centre to each side of a close-up


def draw_path_figure(flight: RecordedFlight) -> Figure:
    """Draw the path from above, and a close-up of where the robot was farthest from it.

    Parameters
    ----------
    flight : RecordedFlight

    Returns
    -------
    Figure
    """
    mission = flight.steered
    assert mission is not None
    figure = make_wide_figure(6.0)
    whole, close = figure.subplots(1, 2, width_ratios=[1.0, 1.0])
    if flight.is_helical:
        helixpicture.draw_axes_on_path(whole, mission, flight.trace)
    else:
        picture.draw_path(whole, mission, flight.trace)
    draw_ellipses(whole, choose_spread([m.cycle.tracked for m in _list_listening_cycles(flight)], MAX_ELLIPSES))
    worst = _find_worst(flight, mission)
    if worst is None:
        draw_empty_note(close, "the path was not reached")
        return figure
    half = max(_CLOSE_UP_HALF, 4.0 * worst[1])
    _draw_close(close, flight, worst[0], half, mission)
    _draw_frame(whole, worst[0], half)
    return figure


def draw_track_figure(flight: RecordedFlight, mission: Observation) -> Figure:
    """Draw the track of an observed device from above and from the front, and a close-up.

    Parameters
    ----------
    flight : RecordedFlight
    mission : Observation

    Returns
    -------
    Figure
    """
    figure = make_wide_figure(6.0)
    if mission.sections.observe.measurements is not None:
        _draw_measurements(figure, flight)
        return figure
    grid = figure.add_gridspec(2, 2, height_ratios=[1.5, 1.0], width_ratios=[1.35, 1.0])
    above, front, close = (figure.add_subplot(grid[at]) for at in ((0, 0), (1, 0), (slice(None), 1)))
    for axes, across in ((above, 1), (front, 2)):
        observation_picture.draw_view(axes, flight.trace, mission.rig.container, across)
    above.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncol=3, fontsize=9)
    front.set_xlabel("x in mm")
    tracked = [m for m in flight.trace.moments if m.cycle.tracked is not None and m.cycle.tracked.trusted]
    if tracked:
        off = [_compute_tracked_error(m) for m in tracked]
        chosen = tracked[int(np.argmax(off))] if max(off) > 0 else tracked[len(tracked) // 2]
        assert chosen.cycle.tracked is not None
        half = 2.5
        _draw_close(close, flight, 1e3 * chosen.cycle.tracked.position[:2], half, None)
        _draw_frame(above, 1e3 * chosen.cycle.tracked.position[:2], half)
    return figure


def draw_errors_figure(flight: RecordedFlight) -> Figure:
    """Draw tracking and localization error, over time and along the path.

    Parameters
    ----------
    flight : RecordedFlight

    Returns
    -------
    Figure
    """
    mission = flight.steered
    assert mission is not None
    figure = make_wide_figure(5.0)
    rows: Any = figure.subplots(2, 2, sharey="row", sharex="col")
    moments = [m for m in flight.trace.following if m.truth_at_end is not None]
    if moments:
        positions = np.vstack([m.positions for m in moments])
        off = 1e3 * compute_tracking_distance(mission, moments)
        arc = 1e3 * assign_arc_lengths(mission.path, positions)
        times = np.concatenate([_list_times(m) for m in moments])
        rows[0, 0].plot(times, off, color=TRUE, lw=1.1)
        draw_dots(rows[0, 1], arc, off, 2.4, TRUE, alpha=0.8)
        for axes in rows[0]:
            axes.axhline(float(off.mean()), color=LOCATED, lw=1, ls="--")
            axes.set_ylim(0.0, 1.08 * float(off.max()))
    else:
        for axes in rows[0]:
            draw_empty_note(axes, "path not reached" if flight.knows_truth else "no ground truth on this rig")
    draw_localization_errors(rows[1, 0], rows[1, 1], flight)
    mean_text = f"; dashed: mean, {off.mean():.3f}" if moments else ""
    rows[0, 0].set_title(f"Tracking error: true robot to path, in mm{mean_text}")
    rows[0, 1].set_title("The same along the path")
    rows[1, 0].set_title("Localization error in space, in mm")
    rows[1, 0].set_xlabel("time in s")
    rows[1, 1].set_xlabel("along the path, in mm")
    rows[1, 1].set_xlim(0.0, 1e3 * mission.path.length)
    for axes in rows.flat:
        axes.grid(axis="y")
    return figure


def draw_localization_errors(over_time: Axes, along: Axes, flight: RecordedFlight) -> None:
    """Draw the error of each trusted pose, and of the tracked ones, over time and along the path.

    Parameters
    ----------
    over_time, along : Axes
    flight : RecordedFlight
    """
    mission = flight.steered
    known = [m for m in flight.trace.moments if m.cycle.trusted and m.truth]
    if mission is None or not known:
        for axes in (over_time, along):
            draw_empty_note(axes, "no ground truth on this rig")
        return
    raw = np.array([1e3 * _compute_error(m.cycle.pose, m.truth) for m in known])
    tracked = np.array([1e3 * _compute_error(m.cycle.tracked, m.truth) for m in known])
    times = [m.truth.time for m in known if m.truth]
    draw_dots(over_time, times, raw, 2.2, LOCATED, alpha=0.6, label="each pose")
    over_time.plot(times, tracked, color=TRUE, lw=1.1, label="tracked")
    follows = np.array([m.cycle.command.phase == "follow" for m in known])
    places = np.array([m.truth.position for m, follow in zip(known, follows, strict=True) if m.truth and follow])
    arc = 1e3 * assign_arc_lengths(mission.path, places.reshape(-1, 3))
    draw_dots(along, arc, raw[follows], 2.2, LOCATED, alpha=0.6)
    draw_dots(along, arc, tracked[follows], 2.2, TRUE, alpha=0.8)
    over_time.set_ylim(0.0, 1.1 * float(np.nanpercentile(raw, 99.5)))
    over_time.legend(loc="upper right", ncol=2)


def draw_observation_figure(flight: RecordedFlight, mission: Observation) -> Figure:
    """Draw errors and pose rate of an observed device over time.

    Parameters
    ----------
    flight : RecordedFlight
    mission : Observation

    Returns
    -------
    Figure
    """
    figure = make_wide_figure(5.4)
    errors, turns, rate = figure.subplots(3, 1, sharex=True)
    observation_picture.draw_errors(errors, turns, flight.trace, along_cantilever=mission.robot.device.along_cantilever)
    observation_picture.draw_rate(rate, mission, flight.trace)
    for axes in (errors, turns, rate):
        axes.set_title(axes.get_title(loc="left"), fontsize=10.5)
        axes.grid(axis="y")
    return figure


def draw_helix_figure(flight: RecordedFlight) -> Figure:
    """Draw distance, axis error and turns of a helical robot along the path.

    Parameters
    ----------
    flight : RecordedFlight

    Returns
    -------
    Figure
    """
    assert flight.steered is not None
    figure = make_wide_figure(5.4)
    distance, axis, turns = figure.subplots(3, 1, sharex=True)
    helixpicture.draw_distance(distance, flight.steered, flight.trace)
    helixpicture.draw_axis_error(axis, flight.steered, flight.trace)
    helixpicture.draw_turns(turns, flight.steered, flight.trace)
    for axes in (distance, axis, turns):
        axes.set_title(axes.get_title(loc="left"), fontsize=10.5)
        axes.grid(axis="y")
    return figure


def draw_ellipses(axes: Axes, poses: list[Pose], *, width: float = 0.8, label: str | None = None) -> None:
    """Draw ellipses of the horizontal covariance of poses, `SIGMAS` standard deviations in size.

    Parameters
    ----------
    axes : Axes
        In mm.
    poses : list of Pose
    width : float, in points
        Line width.
    label : str, optional
        For the legend.
    """
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    if label is not None:
        axes.plot([], [], color=TRACKED_COLOR, lw=1.4, label=label)
    rings = [1e3 * (p.position[:2] + compute_ellipse(p.covariance[:2, :2], SIGMAS)) for p in poses]
    if rings:
        compound = Path.make_compound_path(*(Path(ring, closed=True) for ring in rings))
        axes.add_patch(PathPatch(compound, fill=False, ec=TRACKED_COLOR, lw=width, zorder=5))


def choose_spread(poses: list[Pose | None], most: int) -> list[Pose]:
    """Choose trusted poses at equal steps.

    Parameters
    ----------
    poses : list of Pose or None
    most : int
        Largest number of poses.

    Returns
    -------
    list of Pose
    """
    good = [pose for pose in poses if pose is not None and pose.trusted]
    return good[:: max(-(-len(good) // most), 1)]


def _draw_close(axes: Axes, flight: RecordedFlight, center: FloatArray, half: float, mission: Mission | None) -> None:
    """Draw a close-up: path, truth, each pose, and tracked poses with their ellipses."""
    if mission is not None:
        planned = 1e3 * mission.path.points
        axes.plot(planned[:, 0], planned[:, 1], color=PLANNED, lw=5, solid_capstyle="round", label="planned", zorder=1)
    moments = [m for m in _list_listening_cycles(flight) if m.cycle.tracked is not None]
    inside = [m for m in moments if m.cycle.tracked and np.all(abs(1e3 * m.cycle.tracked.position[:2] - center) < half)]
    truth = 1e3 * flight.trace.true_positions()
    if len(truth):
        near = np.all(abs(truth[:, :2] - center) < 2.0 * half, axis=1)
        axes.plot(*np.where(near[:, None], truth[:, :2], np.nan).T, color=TRUE, lw=1.6, label="true", zorder=3)
    poses = get_located_poses(inside)
    if poses:
        places = 1e3 * np.array([p.position for p in poses])
        draw_dots(axes, places[:, 0], places[:, 1], 4.5, LOCATED, alpha=0.6, label="each pose", zorder=4)
    tracked = choose_spread([m.cycle.tracked for m in inside], 30)
    if tracked:
        places = 1e3 * np.array([p.position for p in tracked])
        draw_dots(axes, places[:, 0], places[:, 1], 3.2, TRACKED_COLOR, zorder=6)
        draw_ellipses(axes, tracked, label=f"tracked, {SIGMAS:g} sigma")
    axes.set_aspect("equal")
    axes.set_xlim(center[0] - half, center[0] + half)
    axes.set_ylim(center[1] - half, center[1] + half)
    axes.set_xlabel("x in mm")
    axes.set_ylabel("y in mm")
    axes.grid()
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncol=4)


def _draw_measurements(figure: Figure, flight: RecordedFlight) -> None:
    above, front = figure.subplots(1, 2)
    observation_picture.draw_measurements(above, front, flight.trace)


def _list_listening_cycles(flight: RecordedFlight) -> list[Moment]:
    """Return the cycles with a recording; in others the tracker only predicts."""
    return [m for m in flight.trace.moments if m.cycle.shot.listen is not None]


def _draw_frame(axes: Axes, center: FloatArray, half: float) -> None:
    from matplotlib.patches import Rectangle

    corner = center[0] - half, center[1] - half
    axes.add_patch(Rectangle(corner, 2 * half, 2 * half, fill=False, ec="#777777", lw=1, ls=":", zorder=7))


def _find_worst(flight: RecordedFlight, mission: Mission) -> tuple[FloatArray, float] | None:
    """Find where (x, y) in mm the robot, or its tracked pose, was farthest from the path, and how far."""
    moments = flight.trace.following
    known = [m.truth if m.truth is not None else m.cycle.tracked for m in moments if m.cycle.tracked is not None]
    places = np.array([p.position for p in known if p is not None]).reshape(-1, 3)
    if not len(places):
        return None
    off = mission.path.project(places)[1]
    worst = int(np.argmax(off))
    return 1e3 * places[worst, :2], 1e3 * float(off[worst])


def _list_times(moment: Moment) -> FloatArray:
    """Return the times of `Moment.positions`; those without recorded times are spread over the shot."""
    shot = moment.cycle.shot
    on_way = np.linspace(shot.start, shot.end, len(moment.way) + 2)[1:-1]
    known = [p.time for p in (moment.truth, moment.truth_at_end) if p is not None]
    return np.concatenate([on_way, known])


def _compute_error(pose: Pose | None, truth: Pose | None) -> float:
    return float("nan") if pose is None or truth is None else float(np.linalg.norm(pose.position - truth.position))


def _compute_tracked_error(moment: Moment) -> float:
    off = _compute_error(moment.cycle.tracked, moment.truth)
    return off if np.isfinite(off) else 0.0
