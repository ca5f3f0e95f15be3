"""Replay of a recorded run: the loop locates again in its recordings, with the same settings or with others.

With the same settings the poses are equal bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from smolbot.config.load import AnyMission
from smolbot.config.mission import Mission
from smolbot.config.mission_base import MissionBase
from smolbot.core.blas_threads import describe_blas
from smolbot.core.pose import Pose
from smolbot.core.results import Readable, as_columns
from smolbot.core.version import __version__
from smolbot.flight.assembly import make_loop
from smolbot.flight.loop import Loop, StopRules
from smolbot.flight.playback import ReplayPilot, ReplayRig, ReplayScheduler, check_windows
from smolbot.flight.safety.supervisor import SafetyRules
from smolbot.runs.folder import find_package_versions
from smolbot.runs.recording.reader import RecordedRun, read_run
from smolbot.runs.run import CycleRecord
from smolbot.runs.summary import collect_tracked_trail, compute_errors
from smolbot.runs.trace import Moment, get_located_poses


@dataclass(frozen=True, repr=False)
class Replay(Readable):
    """A recorded run and the result of its replay.

    Attributes
    ----------
    record : RecordedRun
    mission : Mission or Observation
        With the settings of the replay.
    changed : dict
        Settings that differ from those of the flight; empty if none does.
    cycles : list of CycleRecord
        As replayed: one for each recorded cycle, until the replay ended.
    stop_reason : str
        Why the replay ended before the record did; empty if it did not.
    """

    record: RecordedRun
    mission: AnyMission
    changed: dict[str, str]
    cycles: list[CycleRecord]
    stop_reason: str = ""

    @property
    def moments(self) -> list[Moment]:
        """The replayed cycles with the recorded ground truth.

        If listening windows were shortened, their middle is earlier than the time of the recorded truth. The
        difference is at most half of what was cut, in which a robot hardly moves.
        """
        return [replace(m, cycle=c) for m, c in zip(self.record.moments, self.cycles, strict=False)]

    def table(self) -> dict[str, np.ndarray[Any, Any]]:
        """Trusted places of each cycle as arrays: recorded, replayed and true.

        Returns
        -------
        dict of str to ndarray, shape (n_cycles,)
            ``time`` in s, and ``recorded_x`` to ``true_z`` in m in the world frame; nan where there is none.
        """
        rows: list[dict[str, float]] = []
        for moment, cycle in zip(self.record.moments, self.cycles, strict=False):
            rows.append({"time": cycle.shot.start})
            poses = {"recorded": moment.cycle.trusted, "replayed": cycle.trusted, "true": moment.truth}
            for name, pose in poses.items():
                if pose is not None:
                    rows[-1] |= {f"{name}_{axis}": float(v) for axis, v in zip("xyz", pose.position, strict=True)}
        names = [f"{name}_{axis}" for name in ("recorded", "replayed", "true") for axis in "xyz"]
        return as_columns(rows, ["time", *names])

    def first_difference(self) -> str | None:
        """Describe the first difference between replay and record.

        Returns
        -------
        str or None
            None if all poses are equal bit for bit.
        """
        recorded = self.record.moments
        for index, (moment, cycle) in enumerate(zip(recorded, self.cycles, strict=False)):
            for name in ("pose", "tracked"):
                what = _describe_difference(getattr(moment.cycle, name), getattr(cycle, name))
                if what:
                    return f"cycle {index}, {name} pose: {what}{self._describe_other_machine()}"
        if len(self.cycles) < len(recorded):
            return f"the replay ended after {len(self.cycles)} of {len(recorded)} cycles: {self.stop_reason}"
        return None

    def _describe_other_machine(self) -> str:
        """Describe how the recording computer differed from this one, since last bits may then differ."""
        there = {name: self.record.provenance.get(name) for name in ("linear_algebra", "packages", "smolbot")}
        here = {"linear_algebra": describe_blas(), "packages": find_package_versions(), "smolbot": __version__}
        other = [name.replace("_", " ") for name, value in here.items() if there[name] != value]
        return f" (recorded with other {', '.join(other)})" if other else ""


def replay(
    run: str | Path | RecordedRun,
    *,
    estimator: str | None = None,
    half_periods: int | None = None,
    device: str | Path | None = None,
) -> Replay:
    """Locate again in all recordings of a run, with the learning in flight, as the loop did.

    Parameters
    ----------
    run : path or RecordedRun
        Run folder, or the record.
    estimator : {"whitened", "paper"}, optional
    half_periods : int, optional
        Length of each listening window to use; the complete window unless given.
    device : path, optional
        Device file to use instead of the robot's.

    Returns
    -------
    Replay

    Raises
    ------
    InputError
        If the record holds no listening windows, or if they are shorter than requested.

    Examples
    --------
    >>> import smolbot
    >>> smolbot.replay("runs/monday", estimator="paper")
    Traceback (most recent call last):
    smolbot.errors.InputError: runs/monday: no such run.
    """
    record = run if isinstance(run, RecordedRun) else read_run(run)
    check_windows(record, half_periods)
    changed = {}
    if estimator is not None:
        changed["estimator"] = estimator
    if half_periods is not None:
        changed["half_periods"] = str(half_periods)
    mission = record.mission({} if estimator is None else {"localization.estimator": estimator})
    if device is not None:
        from smolbot.config.device import load_device

        mission.robot.calibrated = load_device(device, mission.robot.name).device
        changed["device"] = str(device)
    flown = make_replay_loop(record, mission, half_periods, bool(changed)).fly()
    return Replay(record, mission, changed, flown.cycles, "" if flown.status == "completed" else flown.stop_reason)


def make_replay_loop(record: RecordedRun, mission: Any, half_periods: int | None = None, changed: bool = False) -> Loop:
    """Build the loop of a flight with the record in place of its rig, scheduler and pilot.

    Parameters
    ----------
    record : RecordedRun
    mission : Mission or Observation
        With the settings of the replay.
    half_periods : int, optional
        Length of each listening window to use; the complete window unless given.
    changed : bool
        Whether the settings differ from those of the flight. Safety rules about poses then do not apply, since
        replayed poses steer nothing.

    Returns
    -------
    Loop
    """
    rig = ReplayRig(record, mission.rig.sensors, mission.rig.limits, half_periods)
    loop = make_loop(rig, mission)
    loop.scheduler = ReplayScheduler(record, rig, loop.scheduler.cycle, rig.limits, loop.scheduler.belief)  # type: ignore[assignment]
    loop.pilot = ReplayPilot(record)
    loop.rules = StopRules(float("inf"), len(record.moments) + 1)
    learned = [p for p in record.played if p.shot.mode == "quiet"]
    if not learned:  # the flight had no learning phase
        loop.preparation = replace(loop.preparation, duration=0.0, learn_ring_down=False)
    if changed:  # replayed poses steer nothing, so that none of them can do harm
        loop.safety.rules = SafetyRules(stale_shots=len(record.played) + 1)
    return loop


_SHOWN_IN = {
    "time": (1e3, " ms"),
    "position": (1e3, " mm"),
    "orientation": (1.0, " in a component of the quaternion"),
    "covariance": (1.0, " m², m·rad or rad²"),
    "r_squared": (1.0, ""),
    "flip_margin": (1.0, ""),
    "trusted": (1.0, ""),
}
"""Parts of a pose, with the factor and the unit in which a difference is printed."""


def _describe_difference(recorded: Pose | None, found: Pose | None) -> str:
    """Describe how two poses differ; empty if they are equal bit for bit."""
    if recorded is None or found is None:
        return "" if recorded is found else f"{'none' if recorded is None else 'one'} was recorded"
    for name, (scale, unit) in _SHOWN_IN.items():
        was, now = np.asarray(getattr(recorded, name)), np.asarray(getattr(found, name))
        if not np.array_equal(was, now, equal_nan=was.dtype.kind == "f"):
            most = float(np.nanmax(np.abs(now.astype(float) - was.astype(float))))
            return f"{name} differs by up to {scale * most:.3g}{unit}"
    return ""


def compute_figures(replayed: Replay) -> dict[str, dict[str, Any]]:
    """Compute the figures of the record and of the replay over the cycles that both have.

    Parameters
    ----------
    replayed : Replay

    Returns
    -------
    dict
        With the keys ``recorded`` and ``replayed``; each holds the same figures.
    """
    moments = replayed.moments
    both = {"recorded": replayed.record.moments[: len(moments)], "replayed": moments}
    return {name: _compute_figures(replayed.mission, of) for name, of in both.items()}


def _compute_figures(mission: MissionBase, moments: Sequence[Moment]) -> dict[str, Any]:
    trusted = get_located_poses(moments)
    sigma = [1e3 * float(np.sqrt(p.covariance[:3, :3].trace() / 3.0)) for p in trusted]
    out: dict[str, Any] = {
        "windows": sum(m.cycle.shot.listen is not None for m in moments),
        "poses_trusted": len(trusted),
        "r_squared_median": float(np.median([p.r_squared for p in trusted])) if trusted else None,
        "sigma_mm_median": float(np.median(sigma)) if sigma else None,
    }
    if isinstance(mission, Mission):
        out["visited_share"] = mission.find_visits(collect_tracked_trail(moments)).share
    return out | compute_errors(mission, list(moments))


def compute_pose_differences(replayed: Replay) -> dict[str, Any]:
    """Compute the difference between replayed and recorded poses, where both are trusted.

    Parameters
    ----------
    replayed : Replay

    Returns
    -------
    dict
        Number of poses, statistics of the distance in mm and of the angle in deg; empty if there are no such poses.
    """
    from smolbot.core.rotations import choose_nearer_orientation, compute_rotation_error
    from smolbot.runs.summary import compute_statistics

    pairs = [
        (first, second)
        for m, c in zip(replayed.record.moments, replayed.cycles, strict=False)
        if (first := m.cycle.trusted) is not None and (second := c.trusted) is not None
    ]
    if not pairs:
        return {}
    distance = np.array([np.linalg.norm(b.position - a.position) for a, b in pairs])
    turned = [
        compute_rotation_error(choose_nearer_orientation(b.orientation, a.orientation), a.orientation) for a, b in pairs
    ]
    angle = np.degrees(np.linalg.norm(np.array(turned), axis=1))
    return {
        "poses": len(pairs),
        "distance_mm": compute_statistics(distance * 1e3, "mean", "rms", "p95", "max"),
        "angle_deg": compute_statistics(angle, "mean", "rms", "p95", "max"),
    }
