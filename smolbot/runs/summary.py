"""The figures of merit of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from smolbot.config.mission import Mission
from smolbot.config.mission_base import MissionBase
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.rotations import choose_nearer_orientation, compute_rotation_error
from smolbot.core.shots import Actuate, Rotate
from smolbot.paths.visits import Visits
from smolbot.runs.run import Run, get_trusted_poses
from smolbot.runs.trace import Moment, Trace, pair_with_truth


def summarise(mission: Mission, run: Run, trace: Trace) -> dict[str, Any]:
    """Compute the figures of merit of a run.

    Those that need the ground truth are present only where it is known. Tracking error is the true robot's
    horizontal distance to the path as a curve, from the path's start on (the approach is left out). Localization
    error is the located pose minus the truth, in three dimensions, of every trusted pose; `tracked_error_mm` is the
    same for the tracked pose. `progress_mm` is how far the controller says that it came; `visited_share` is measured
    on the robot's trail, whatever the controller says.

    Parameters
    ----------
    mission : Mission
    run : Run
    trace : Trace

    Returns
    -------
    dict
        Units are in the keys.
    """
    out = compute_common_figures(mission, run)
    out["coil_energy_j"] = compute_coil_energy(mission, run)
    out["path_length_mm"] = mission.path.length * 1e3
    out["progress_mm"] = max((c.command.progress for c in run.cycles), default=0.0) * 1e3
    visits = compute_visits(mission, trace.moments)
    out["visited_share"], out["longest_skip"] = visits.share, visits.describe_longest_skip(mission.path)
    out["path_time_s"] = compute_path_time(trace)
    out |= compute_errors(mission, trace.moments)
    if mission.robot.kind == "helical":
        out |= _count_turns(run) | _compute_axis_errors(mission, trace)
    distance = compute_tracking_distance(mission, trace.following)
    if distance.size:
        out["tracking_error_mm"] = compute_statistics(distance * 1e3, "mean", "rms", "p95", "max")
    out["verdict"], out["verdict_reasons"] = evaluate_run(mission, run, visits, out)
    return out


def compute_common_figures(mission: MissionBase, run: Run) -> dict[str, Any]:
    """Compute the figures that steering missions and observations have in common.

    Parameters
    ----------
    mission : MissionBase
    run : Run

    Returns
    -------
    dict
        Units are in the keys.
    """
    cycles = run.cycles
    played = sum(c.shot.duration for c in cycles)
    duration = run.duration
    cycling = duration - run.begun
    poses = get_trusted_poses(cycles)
    return {
        "mission": mission.name,
        "rig": mission.rig.name,
        "status": run.status,
        "stop_reason": run.stop_reason,
        "cycles": len(cycles),
        "duration_s": duration,
        "loop_rate_hz": len(cycles) / cycling if cycling > 0 else 0.0,
        "timeline_limit_hz": len(cycles) / played if played else 0.0,
        "turnaround_ms": mission.rig.turnaround * 1e3,
        "compute_ms": _summarise_compute_time(run),
        "r_squared_median": _as_finite(np.median([p.r_squared for p in poses]) if poses else None),
        "poses_untrusted": sum(c.trusted is None for c in cycles if c.shot.listen is not None),
        **run.safety,
        "recovered": run.recovered,
        "events": [{"time_s": e.time, "what": e.what, **e.detail} for e in run.events],
        "wall_s": run.wall,
        "realtime_factor": duration / run.wall if run.wall else 0.0,
    }


def evaluate_run(mission: Mission, run: Run, visits: Visits, figures: dict[str, Any]) -> tuple[str, list[str]]:
    """Evaluate a run against the limits of its mission file.

    Parameters
    ----------
    mission : Mission
    run : Run
    visits : Visits
        See `compute_visits`.
    figures : dict
        See `summarise`.

    Returns
    -------
    str
        ``passed`` or ``failed``.
    list of str
        Every reason for a failure.
    """
    limits = mission.sections.verdict
    reasons = [] if run.status == "completed" else [run.stop_reason or run.status]
    for name, limit in (("tracking", limits.mean_tracking_mm), ("localization", limits.mean_localization_mm)):
        error = figures.get(f"{name}_error_mm")
        if limit is not None and error is not None and error["mean"] > limit:
            reasons.append(f"mean {name} error {error['mean']:.2f} mm exceeds {limit:g} mm")
    skipped = mission.find_skip_fault(visits)
    reasons += [] if skipped is None else [skipped]
    return ("passed" if not reasons else "failed"), reasons


def format_label(figures: Mapping[str, Any]) -> str:
    """Format the label to show beside figures: mismatches switched off, or a reduced plant.

    Parameters
    ----------
    figures : mapping
        See `summarise`.

    Returns
    -------
    str
        Empty for a normal run.

    Examples
    --------
    >>> format_label({"ideal": False, "plant": "reduced"})
    ' (reduced plant: pose noise in place of signals)'
    """
    parts = ["ideal: all mismatches off"] if figures.get("ideal") else []
    if figures.get("plant", "full") != "full":
        parts.append(f"{figures['plant']} plant: pose noise in place of signals")
    return f" ({'; '.join(parts)})" if parts else ""


def compute_coil_energy(mission: Mission, run: Run) -> float:
    """Compute the heat in the actuation coils from the commanded currents.

        E = sum R I² t

    Parameters
    ----------
    mission : Mission
    run : Run

    Returns
    -------
    float, in J
    """
    resistance = mission.rig.coil_resistances
    return float(
        sum(
            window.duration * np.sum(resistance * np.square(window.currents))
            for cycle in run.cycles
            for window in cycle.shot.windows
            if isinstance(window, Actuate)
        )
    )


def compute_path_time(trace: Trace) -> float | None:
    """Compute the time from the path's start to its end, or as far as it was followed.

    Parameters
    ----------
    trace : Trace

    Returns
    -------
    float, in s, or None
        None if the path was not followed.
    """
    following = trace.following
    return following[-1].cycle.shot.end - following[0].cycle.shot.end if following else None


def compute_errors(mission: MissionBase, moments: list[Moment]) -> dict[str, Any]:
    """Compute the errors of trusted poses against the ground truth.

    Parameters
    ----------
    mission : MissionBase
    moments : list of Moment

    Returns
    -------
    dict
        Units are in the keys; empty if no ground truth is known.
    """
    along = mission.robot.device.along_cantilever
    known = pair_with_truth(moments)
    tracked = [(m.cycle.tracked, m.truth) for m in moments if m.cycle.shot.listen is not None]
    out: dict[str, Any] = {}
    if known:
        errors = np.array([pose.position - truth.position for pose, truth in known])
        angles = np.array([compute_orientation_error(pose, truth, along) for pose, truth in known])
        out["localization_error_mm"] = compute_statistics(np.linalg.norm(errors, axis=1) * 1e3, "mean", "std", "p95")
        out["localization_bias_mm"] = [float(v) for v in errors.mean(axis=0) * 1e3]
        out["localization_scatter_mm"] = [float(v) for v in errors.std(axis=0) * 1e3]
        out["orientation_error_deg"] = compute_statistics(np.degrees(angles), "mean", "p95")
        out["flips"] = int(np.sum(angles > np.radians(90.0)))
        estimated = np.array([p.position - t.position for p, t in tracked if p is not None and t is not None])
        out["tracked_error_mm"] = compute_statistics(np.linalg.norm(estimated, axis=1) * 1e3, "mean", "std", "p95")
    return out


def compute_visits(mission: Mission, moments: Sequence[Moment]) -> Visits:
    """Compute which parts of the path the robot visited, in the path's order.

    Parameters
    ----------
    mission : Mission
        Its `visit_tolerance` is the distance that counts as a visit.
    moments : sequence of Moment

    Returns
    -------
    Visits
        Of the true robot; where no ground truth is known, of the tracked one.
    """
    true = np.vstack([np.zeros((0, 3)), *(m.positions for m in moments)])
    return mission.find_visits(true if len(true) else collect_tracked_trail(moments))


def collect_tracked_trail(moments: Sequence[Moment]) -> FloatArray:
    """Collect the trusted tracked positions of some cycles, in order.

    Parameters
    ----------
    moments : sequence of Moment

    Returns
    -------
    ndarray, shape (n, 3), in m, world frame
    """
    tracked = [m.cycle.tracked for m in moments]
    return np.array([p.position for p in tracked if p is not None and p.trusted]).reshape(-1, 3)


def compute_tracking_distance(mission: Mission, moments: list[Moment]) -> FloatArray:
    """Compute the distance of the true robot to the path, at pose times and shot ends.

    Parameters
    ----------
    mission : Mission
    moments : list of Moment

    Returns
    -------
    ndarray, shape (n,), in m
    """
    truths = np.vstack([np.zeros((0, 3)), *(m.positions for m in moments)])
    if not len(truths):
        return np.zeros(0)
    return mission.path.project(truths)[1]


def compute_orientation_error(pose: Pose, truth: Pose, along_cantilever: bool) -> float:
    """Compute the angle between two orientations.

    Parameters
    ----------
    pose, truth : Pose
    along_cantilever : bool
        The moment lies along the cantilever, so that a half turn about it changes nothing: the nearer of the two
        equivalent orientations is used.

    Returns
    -------
    float, in rad
    """
    estimate = choose_nearer_orientation(pose.orientation, truth.orientation) if along_cantilever else pose.orientation
    return float(np.linalg.norm(compute_rotation_error(estimate, truth.orientation)))


def _count_turns(run: Run) -> dict[str, Any]:
    """Count turns of the magnet, pauses and step-outs."""
    rotations = [[w for w in c.shot.windows if isinstance(w, Rotate)] for c in run.cycles]
    return {
        "turns": float(sum(w.turns for windows in rotations for w in windows)),
        "pauses": sum(bool(windows) for windows in rotations),
        "step_outs": sum(e.what in ("step-out", "gave up") for e in run.events),
    }


def _compute_axis_errors(mission: Mission, trace: Trace) -> dict[str, Any]:
    """Compute angles between estimated and true propulsion axis, of every pose and as tracked when a pause ends.

    ``axis_to_path_deg`` is the horizontal angle between the true axis and the path when a pause ends. It differs
    from zero because a helix in a bend, with drift and delay, does not move exactly where it points.
    """
    ends = [m for m in trace.moments if m.cycle.command.mechanical and m.cycle.tracked and m.truth]
    out = {}
    located = [compute_axis_angle(pose, truth) for pose, truth in pair_with_truth(trace.moments)]
    if located:
        out["axis_error_deg"] = compute_statistics(np.degrees(located), "mean", "rms", "p95", "max")
    if ends:
        tracked = [compute_axis_angle(m.cycle.tracked, m.truth) for m in ends if m.cycle.tracked and m.truth]
        out["axis_error_tracked_deg"] = compute_statistics(np.degrees(tracked), "mean", "rms", "p95", "max")
        truths = [m.truth for m in ends if m.truth and m.cycle.command.phase == "follow"]
        if truths:
            arc, _ = mission.path.project(np.array([t.position for t in truths]))
            along = mission.path.tangent(arc)[:, :2]
            axes = np.array([t.body_axis("z")[:2] for t in truths])
            axes /= np.linalg.norm(axes, axis=1, keepdims=True)
            angles = np.degrees(np.arccos(np.clip(np.sum(along * axes, axis=1), -1.0, 1.0)))
            out["axis_to_path_deg"] = compute_statistics(angles, "mean", "p95")
    return out


def compute_axis_angle(pose: Pose, truth: Pose) -> float:
    """Compute the angle between the propulsion axes (body z) of two poses.

    Parameters
    ----------
    pose, truth : Pose

    Returns
    -------
    float, in rad
    """
    return float(np.arccos(np.clip(pose.body_axis("z") @ truth.body_axis("z"), -1.0, 1.0)))


def _summarise_compute_time(run: Run) -> dict[str, float | None]:
    times = np.array([c.compute for c in run.cycles]) * 1e3
    if not times.size:
        return {"median": None, "p99": None}
    return {"median": float(np.median(times)), "p99": float(np.percentile(times, 99))}


def compute_statistics(values: FloatArray, *names: str) -> dict[str, float]:
    """Compute some of mean, std, rms, p95 and max.

    Parameters
    ----------
    values : ndarray, shape (n,)
    *names : str
        Which of them.

    Returns
    -------
    dict of str to float
        In the unit of `values`.
    """
    functions: dict[str, Callable[[FloatArray], Any]] = {
        "mean": np.mean,
        "std": np.std,
        "rms": lambda v: np.sqrt(np.mean(np.square(v))),
        "p95": lambda v: np.percentile(v, 95),
        "max": np.max,
    }
    return {name: float(functions[name](values)) for name in names}


def _as_finite(value: Any) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)
