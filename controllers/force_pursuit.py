"""Pursuit of a point ahead on the path with the true force: the simplest controller."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from controllers.force_allocator import Allocation, ForceAllocator, UnreachableForceError
from controllers.pace import Pace
from controllers.path_progress import PathProgress
from controllers.table_edge import make_outside_command, move_into_table
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.shots import Actuate
from smolbot.errors import InputError
from smolbot.flight.scheduler import compute_actuation_time
from smolbot.motion.controller import Command, ForceProfile, Gain, Phase, Setup, complete_gains
from smolbot.paths.curve import Curve


class ForcePursuit:
    """Pulls toward a point a little ahead on the path, at most as hard as needed to get there in one window.

    Parameters
    ----------
    setup : Setup
    gains : mapping of str to float
        Values that differ from the defaults.
    """

    gains: ClassVar[Mapping[str, Gain]] = {
        "lookahead_mm": Gain(0.8, 0.2, 5.0, True, meaning="distance along the path of the point that is pursued"),
        "force_un": Gain(120.0, 10.0, 500.0, True, meaning="greatest force that is requested"),
        "least_field_mt": Gain(1.5, 0.05, 5.0, True, meaning="weaker fields do not turn the robot in time"),
        "t_min_ms": Gain(60.0, 5.0, 100.0, meaning="actuation per cycle"),
        "t_max_ms": Gain(100.0, 5.0, 200.0, meaning="actuation per cycle for a turn of 180 degrees"),
        "sharp_deg": Gain(30.0, 0.0, 180.0, meaning="turns beyond this stretch the actuation"),
        "handover_mm": Gain(0.3, 0.05, 2.0, True, meaning="distance at which start, corners and end count as reached"),
        "tail_first": Gain(0.0, 0.0, 1.0, meaning="1: may be pulled tail first where that reaches further"),
    }

    def __init__(self, setup: Setup, gains: Mapping[str, float]) -> None:
        self.setup = setup
        values = complete_gains(self.gains, gains, "force_pursuit", ("t_min_ms", "t_max_ms"))
        self._lookahead = values["lookahead_mm"] * 1e-3
        self._force = values["force_un"] * 1e-6
        self._t_min, self._t_max = values["t_min_ms"] * 1e-3, values["t_max_ms"] * 1e-3
        self._sharp = float(np.radians(values["sharp_deg"]))
        self._handover = min(values["handover_mm"] * 1e-3, setup.tolerance)
        self._allocator = ForceAllocator.of(
            setup, head_first=values["tail_first"] < 0.5, least_field=values["least_field_mt"] * 1e-3
        )
        self._rest = setup.cycle.duration(setup.device.frequency)
        self._progress: PathProgress | None = None
        self._pace: Pace | None = None

    def reset(self, path: Curve, pose: Pose) -> None:
        """Start a path: first go to its start.

        Parameters
        ----------
        path : Curve
        pose : Pose
        """
        self._progress = PathProgress(path)
        self._pace = None if path.speed is None else Pace(path.speed, self._rest + self._t_min)

    def command(self, pose: Pose) -> Command:
        """Compute the currents toward the pursued point.

        Parameters
        ----------
        pose : Pose

        Returns
        -------
        Command

        Raises
        ------
        InputError
            Before the first `reset`.
        """
        progress = self._progress
        if progress is None:
            raise InputError("force_pursuit has no path yet: call reset first.")
        inside = move_into_table(self.setup.table, pose, self.setup.tolerance)
        if inside is None:
            return make_outside_command(pose, progress.progress, "approach" if progress.leg < 0 else "follow")
        pose = inside
        progress.locate(pose.position, self._handover)
        if progress.done:
            return Command(None, note="path's end reached", progress=progress.progress, done=True)
        phase: Phase = "approach" if progress.leg < 0 else "follow"
        goal = progress.interpolate(
            min(progress.arc_length + self._lookahead, progress.leg_end) if progress.leg >= 0 else 0.0
        )
        way = goal - pose.position[:2]
        distance = float(np.linalg.norm(way))
        if self._pace is not None and progress.leg >= 0:
            distance = min(distance, self._pace.compute_stride(pose.time, progress.arc_length))
            if distance <= 0.0:
                return Command(None, note="ahead of the requested speed", progress=progress.progress, phase=phase)
        heading = (pose.rotation @ self.setup.device.moment_in_body)[:2]
        turn = abs(float(np.arctan2(heading[0] * way[1] - heading[1] * way[0], heading @ way)))
        duration = compute_actuation_time(turn, self._t_min, self._t_max, self._sharp)
        requested = self.setup.robot.drag * distance / duration
        found, note = self._allocate(pose.position, way, min(requested, self._force))
        if found is None:
            return Command(None, True, note, progress=progress.progress, phase=phase)
        saturated = bool(note) or requested > self._force
        window = Actuate(tuple(float(c) for c in found.currents), duration)
        return Command(window, saturated, note, progress=progress.progress, phase=phase)

    def reach(self, path: Curve) -> ForceProfile:
        """Compute the strongest possible force along the path; 0 where none points along it.

        Parameters
        ----------
        path : Curve

        Returns
        -------
        ForceProfile
        """
        arc = path.sampled(0.5e-3)
        points, tangents = path.at(arc), path.tangent(arc)
        force, error = np.zeros(len(arc)), np.zeros(len(arc))
        for i, (point, tangent) in enumerate(zip(points, tangents, strict=True)):
            found, _ = self._allocate(point, tangent[:2], self._force)
            if found is not None:
                force[i], error[i] = np.linalg.norm(found.force[:2]), found.direction_error
        return ForceProfile(points, force, error)

    def _allocate(self, position: FloatArray, way: FloatArray, size: float) -> tuple[Allocation | None, str]:
        direction = np.array([way[0], way[1], 0.0])
        try:
            return self._allocator.allocate(position, direction, size), ""
        except UnreachableForceError as error:
            if error.most <= 0.0:
                return None, str(error)
        return self._allocator.allocate(position, direction), "as strong as the coils allow"
