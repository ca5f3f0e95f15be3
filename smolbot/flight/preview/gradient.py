"""Preview of a mission with gradient forces: a typical cycle, the duration, and where the robot would stall."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from smolbot.config.expected_errors import compute_horizontal_rms, compute_mean_distance
from smolbot.config.mission import Mission
from smolbot.core.arrays import FloatArray
from smolbot.core.results import Readable
from smolbot.core.shots import Actuate, Shot
from smolbot.errors import report_plugin_errors
from smolbot.flight.preview.drawn_worlds import DrawnWorlds, fly_drawn_worlds
from smolbot.flight.preview.pose_trust import find_pose_faults
from smolbot.flight.preview.remedies import find_remedy
from smolbot.flight.preview.rollout import Outcome, Rollout, RolloutParts
from smolbot.motion.controller import ForceForecast, ForceProfile
from smolbot.paths.corners import compute_curvature, find_corners


@dataclass(frozen=True, repr=False)
class Preview(Readable):
    """Prediction for a mission before it is flown. SI units.

    Attributes
    ----------
    shot : Shot
        A typical cycle.
    rate_limit : float, in Hz
        Cycle rate of the timeline alone.
    rate : float, in Hz
        Cycle rate with the turnaround time included.
    length : float, in m
        Of the path.
    corners : int
        Number of corners that are kept in the path.
    tightest_radius : float, in m
        Radius of the tightest bend between corners; infinite where all is straight.
    remarks : tuple of str
        On how the path was made.
    duration : float, in s
        Expected, search and approach included; nan where the end is not reached. This, `path_time` and `coil_energy`
        are means over the drawn worlds.
    path_time : float, in s
        From the path's start to its end alone.
    requested_time : float, in s, or None
        The same at the speed that the path requests; None if it requests none.
    cycles : int
        Number of cycles.
    trail : ndarray, shape (n, 3), in m
        Where the robot is expected to go.
    localization_error : ndarray, shape (n,), in m
        Horizontal rms error of one pose along the path, with sensors and device as uncertain as half the flight leaves
        them.
    noise_error : ndarray, shape (n,), in m
        The same by noise alone.
    mean_localization_error : float, in m
        Mean error of one pose in space, over the path: what the verdict is about.
    force_profile : ForceProfile or None
        The controller's force along the path; None if the controller does not compute it.
    coil_energy : float, in J
    worlds : DrawnWorlds or None
        Flights in worlds that differ from the files a little; None where the mission does not end even in its own.
    remedy : str
        Settings with which a mission would end that does not; empty if none was sought or found.
    reasons : list of str
        Why not to fly; empty means go.
    """

    shot: Shot
    rate_limit: float
    rate: float
    length: float
    corners: int
    tightest_radius: float
    remarks: tuple[str, ...]
    duration: float
    path_time: float
    requested_time: float | None
    cycles: int
    trail: FloatArray
    force_profile: ForceProfile | None
    localization_error: FloatArray
    noise_error: FloatArray
    mean_localization_error: float
    coil_energy: float
    worlds: DrawnWorlds | None = None
    remedy: str = ""
    reasons: list[str] = field(default_factory=list)

    @property
    def go(self) -> bool:
        """True if there is no reason not to fly."""
        return not self.reasons


def preview(mission: Mission, *, seek_remedy: bool = True) -> Preview:
    """Time a mission and simulate it on the controller's own model, with the pose errors to be expected.

    Parameters
    ----------
    mission : Mission
        With a robot that is moved by gradient forces.
    seek_remedy : bool
        Whether to seek what would mend a mission that would not end, which takes some rollouts more.

    Returns
    -------
    Preview
    """
    parts = RolloutParts.prepare(mission)
    rollout = Rollout(parts)
    found = rollout.fly()
    expected = parts.errors.expected
    covariances = expected.compute_covariances(0.5 * found.cycles)
    mean_error = compute_mean_distance(covariances)
    reasons, worlds = [found.reason] if found.reason else [], None
    remedy = find_remedy(mission, late=found.late) if reasons and seek_remedy else ""
    if not reasons:
        reasons = find_pose_faults(mission, parts.errors) or _find_error_faults(mission, mean_error)
    if not reasons:
        worlds = fly_drawn_worlds(parts)
        if not worlds.suffices:
            reasons = [worlds.describe_failures()]
            remedy = find_remedy(mission, late=worlds.late, failed=worlds.failed) if seek_remedy else ""
    duration, path_time, energy = _compute_means(found, worlds)
    cycling = found.duration - mission.sections.localization.background_noise_duration
    played = cycling - found.cycles * mission.rig.turnaround
    bend = np.max(compute_curvature(mission.path.points))
    law = rollout.controller
    with report_plugin_errors("Controller", law, "reach"):
        forecast = law.reach(mission.path) if isinstance(law, ForceForecast) else None
    return Preview(
        shot=pick_typical_shot(found.shots),
        rate_limit=found.cycles / played,
        rate=found.cycles / cycling,
        length=mission.path.length,
        corners=len(find_corners(mission.path.points)),
        tightest_radius=float(1.0 / bend) if bend > 0.0 else float("inf"),
        remarks=mission.path_remarks,
        duration=duration,
        path_time=path_time,
        requested_time=None if mission.path.speed is None else mission.path.speed.duration,
        cycles=found.cycles,
        trail=found.trail,
        force_profile=forecast,
        localization_error=compute_horizontal_rms(covariances),
        noise_error=compute_horizontal_rms(expected.noise),
        mean_localization_error=mean_error,
        coil_energy=energy,
        worlds=worlds,
        remedy=remedy,
        reasons=reasons,
    )


def _find_error_faults(mission: Mission, mean_error: float) -> list[str]:
    """Return why poses are too poor for the verdict; empty if they are not."""
    most = mission.sections.verdict.mean_localization_mm
    if most is None or mean_error <= most * 1e-3:
        return []
    return [
        f"poses would err by {mean_error * 1e3:.2f} mm in the mean, more than mean_localization_mm = {most:g}; "
        "listen longer ([cycle] half_periods), or excite more."
    ]


def _compute_means(found: Outcome, worlds: DrawnWorlds | None) -> tuple[float, float, float]:
    """Compute duration in s, time on the path in s and coil energy in J: means over the drawn worlds that ended."""
    if found.reason:
        return float("nan"), float("nan"), found.energy
    if worlds is None or not np.isfinite(worlds.durations).any():
        return found.duration, found.path_time, found.energy
    duration, path_time, energy = (
        float(np.nanmean(values)) for values in (worlds.durations, worlds.path_times, worlds.energies)
    )
    return duration, path_time, energy


def pick_typical_shot(shots: list[Shot]) -> Shot:
    """Pick the shot of the median length among those that drive the robot, or among all if none does.

    Parameters
    ----------
    shots : list of Shot

    Returns
    -------
    Shot
    """
    driving = [shot for shot in shots if any(isinstance(window, Actuate) for window in shot.windows)] or shots
    return sorted(driving, key=lambda shot: shot.duration)[len(driving) // 2]
