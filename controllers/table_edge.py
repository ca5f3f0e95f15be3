"""What a law does with a pose that the field table does not cover: the nearest place inside, or nothing at all."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from smolbot.core.pose import Pose
from smolbot.motion.controller import Command, Phase

if TYPE_CHECKING:
    from lookup_tables import FieldTable


def move_into_table(table: FieldTable, pose: Pose, farthest: float) -> Pose | None:
    """Move a pose to the nearest place that a field table covers.

    Parameters
    ----------
    table : FieldTable
    pose : Pose
    farthest : float, in m
        Distance beyond which the field there says nothing about the field at the robot.

    Returns
    -------
    Pose or None
        `pose` itself if the table covers it; None if it is too far outside.
    """
    if table.contains(pose.position[None, :])[0]:
        return pose
    low, high = table.bounds
    inside = np.where(low == high, pose.position, np.clip(pose.position, low, high))  # one sample covers every value
    return replace(pose, position=inside) if np.linalg.norm(inside - pose.position) <= farthest else None


def make_outside_command(pose: Pose, progress: float, phase: Phase) -> Command:
    """Make the command for a pose too far outside the field table: to drive nothing, and to say why.

    Parameters
    ----------
    pose : Pose
    progress : float, in m
    phase : {"approach", "follow"}

    Returns
    -------
    Command
    """
    x, y, z = 1e3 * pose.position
    note = f"the pose at ({x:.1f}, {y:.1f}, {z:.1f}) mm is outside the field table: nothing is driven"
    return Command(None, note=note, progress=progress, phase=phase)
