"""The robot as a camera saw it against the path that it was to follow."""

from __future__ import annotations

import numpy as np

from smolbot.paths.curve import Curve
from smolbot.runs.optics.opticaltrack import OpticalTrack
from smolbot.runs.optics.runposes import RunPoses


def tracking_error(track: OpticalTrack, path: Curve, run: RunPoses) -> dict[str, float] | None:
    """Distance of the robot as seen to the path, in mm, from when its start was reached to the last pose.

    `track` must be on the run's clock. None where no frame shows the robot then.
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
