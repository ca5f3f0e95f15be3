"""Errors of the robot in a video against its planned path."""

from __future__ import annotations

import numpy as np

from smolbot.paths.curve import Curve
from smolbot.runs.optics.optical_track import OpticalTrack
from smolbot.runs.optics.run_poses import RunPoses


def compute_tracking_error(track: OpticalTrack, path: Curve, run: RunPoses) -> dict[str, float] | None:
    """Compute the distance of the robot in the video to the path, from reaching its start to the last pose.

    Parameters
    ----------
    track : OpticalTrack
        On the run's clock.
    path : Curve
        In the world frame.
    run : RunPoses

    Returns
    -------
    dict of str to float, in mm, or None
        `mean`, `std`, `rms`, `p95` and `max`; None if no frame shows the robot during that time.
    """
    times = run.times[run.following]
    if not len(times):
        return None
    kept = (track.times >= times[0]) & (track.times <= times[-1])
    if not kept.any():
        return None
    distance = 1e3 * path.project(track.positions[kept])[1]
    return {
        "mean": float(np.mean(distance)), "std": float(np.std(distance)), "rms": float(np.sqrt(np.mean(distance**2))),
        "p95": float(np.percentile(distance, 95)), "max": float(np.max(distance)),
    }  # fmt: skip
