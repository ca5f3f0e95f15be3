"""The robot as a camera saw it against the path that it was to follow."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from smolbot.errors import SmolbotError
from smolbot.optics.opticaltrack import OpticalTrack
from smolbot.optics.runposes import RunPoses

if TYPE_CHECKING:
    from smolbot.paths import Path as PlannedPath


def planned_path(run: str | Path) -> tuple[PlannedPath | None, str]:
    """The path of a run folder's mission; or None, and why there is none."""
    from smolbot.anymission import load_mission
    from smolbot.missionfile import Mission

    folder = Path(run)
    if not (folder / "mission.toml").is_file():
        return None, f"{folder} has no mission.toml"
    try:
        rig = folder / "rig.toml"
        mission = load_mission(str(folder / "mission.toml"), str(rig) if rig.is_file() else None)
    except SmolbotError as error:
        return None, str(error).splitlines()[0]
    return (mission.path, "") if isinstance(mission, Mission) else (None, "")


def tracking_error(track: OpticalTrack, path: PlannedPath, run: RunPoses) -> dict[str, float] | None:
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
