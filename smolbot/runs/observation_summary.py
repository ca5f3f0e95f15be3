"""The figures of merit of an observation."""

from __future__ import annotations

from typing import Any

import numpy as np

from smolbot.config.observation import Observation
from smolbot.core.pose import Pose
from smolbot.core.rotations import compute_mean_rotation, compute_rotation_error
from smolbot.runs.run import Run, get_trusted_poses
from smolbot.runs.summary import compute_common_figures, compute_errors
from smolbot.runs.trace import Moment, Trace


def summarise_observation(mission: Observation, run: Run, trace: Trace) -> dict[str, Any]:
    """Compute the figures of merit of an observation.

    `pose_rate_hz` is the number of trusted poses divided by the observed time. Errors against the ground truth,
    where a witness knows it, are those of every trusted pose. The scatter of independent measurements needs no
    witness.

    Parameters
    ----------
    mission : Observation
    run : Run
    trace : Trace

    Returns
    -------
    dict
        Units are in the keys.
    """
    out = compute_common_figures(mission, run)
    measuring = mission.sections.observe.measurements is not None
    moments = find_measurements(trace) if measuring else trace.moments
    out |= compute_errors(mission, moments)
    if measuring:
        out.pop("tracked_error_mm", None)
        out |= compute_scatter([m.cycle.pose for m in moments if m.cycle.pose is not None])
        out["shots_per_measurement"] = len(run.cycles) / max(len(moments), 1)
    else:
        out |= compute_pose_rate(run)
    out["verdict"], out["verdict_reasons"] = evaluate_observation(mission, run, out)
    return out


def find_measurements(trace: Trace) -> list[Moment]:
    """Find the cycles that count as measurements: those after a search, with a trusted pose.

    Parameters
    ----------
    trace : Trace

    Returns
    -------
    list of Moment
    """
    return [m for m in trace.moments if m.cycle.shot.mode == "hold" and m.cycle.trusted is not None]


def compute_pose_rate(run: Run) -> dict[str, Any]:
    """Compute the pose rate of a tracked device and the gaps between its trusted poses.

    A gap is a series of shots without a trusted pose, after the first trusted pose.

    Parameters
    ----------
    run : Run

    Returns
    -------
    dict
        `pose_rate_hz`, and `gaps` with `count`, `shots` and `longest_s`.
    """
    trusted = [c.trusted is not None for c in run.cycles]
    if not any(trusted):
        return {"pose_rate_hz": 0.0, "gaps": {"count": 0, "shots": 0, "longest_s": 0.0}}
    first = trusted.index(True)
    cycles = run.cycles[first:]
    times = [pose.time for pose in get_trusted_poses(cycles)]
    lost = [i for i in range(first, len(trusted)) if not trusted[i]]
    begun = [i for i in lost if trusted[i - 1]]
    watched = cycles[-1].shot.end - cycles[0].shot.start
    gaps = {
        "count": len(begun),
        "shots": len(lost),
        "longest_s": float(np.max(np.diff(times))) if lost and len(times) > 1 else 0.0,
    }
    return {"pose_rate_hz": sum(trusted) / watched, "gaps": gaps}


def compute_scatter(poses: list[Pose]) -> dict[str, Any]:
    """Compute mean and standard deviation (n - 1 in the denominator) of independent poses.

    Parameters
    ----------
    poses : list of Pose

    Returns
    -------
    dict
        `sigma_mm` has one value for each axis and `distance`, the root of the sum of their squares. `sigma_deg` has
        the same for rotations about the world axes, with `angle`. With fewer than two poses only their number.
    """
    if len(poses) < 2:
        return {"measurements": len(poses)}
    places = np.array([p.position for p in poses])
    mean = compute_mean_rotation(np.array([p.orientation for p in poses]))
    turns = np.array([compute_rotation_error(p.orientation, mean) for p in poses])
    out: dict[str, Any] = {
        "measurements": len(poses),
        "mean_mm": [float(v) for v in 1e3 * places.mean(axis=0)],
        "mean_orientation": [float(v) for v in mean],
    }
    for name, values in (("sigma_mm", 1e3 * places), ("sigma_deg", np.degrees(turns))):
        deviations = values.std(axis=0, ddof=1)
        norm = "distance" if name == "sigma_mm" else "angle"
        out[name] = {**dict(zip("xyz", deviations.tolist(), strict=True)), norm: float(np.linalg.norm(deviations))}
    return out


def evaluate_observation(mission: Observation, run: Run, figures: dict[str, Any]) -> tuple[str, list[str]]:
    """Evaluate an observation against the limits of its mission file.

    Parameters
    ----------
    mission : Observation
    run : Run
    figures : dict
        See `summarise_observation`.

    Returns
    -------
    str
        ``passed`` or ``failed``.
    list of str
        Every reason for a failure.
    """
    limits = mission.sections.verdict
    reasons = [] if run.status == "completed" else [run.stop_reason or run.status]
    error, rate, sigma = (figures.get(key) for key in ("localization_error_mm", "pose_rate_hz", "sigma_mm"))
    if limits.mean_localization_mm is not None and error is not None and error["mean"] > limits.mean_localization_mm:
        reasons.append(f"mean localization error {error['mean']:.2f} mm exceeds {limits.mean_localization_mm:g} mm")
    if limits.min_rate_hz is not None and rate is not None and rate < limits.min_rate_hz:
        reasons.append(f"{rate:.2f} trusted poses a second are fewer than {limits.min_rate_hz:g}")
    if limits.max_sigma_mm is not None and sigma is not None and sigma["distance"] > limits.max_sigma_mm:
        reasons.append(f"sigma {sigma['distance']:.3f} mm exceeds {limits.max_sigma_mm:g} mm")
    return ("passed" if not reasons else "failed"), reasons
