"""The result of a flight, and the protocols of the listeners that are notified during it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.results import Readable, as_columns
from smolbot.core.sensing import Recording
from smolbot.core.shots import Shot
from smolbot.motion.controller import Command

Status = Literal["completed", "stuck", "stopped", "lost", "timeout", "failed"]


@dataclass(frozen=True)
class CycleRecord:
    """One cycle.

    Attributes
    ----------
    shot : Shot
    pose : Pose or None
        As located.
    tracked : Pose or None
        The tracker's estimate.
    command : Command
    compute : float, in s
        Computing time.
    ended : float, in s
        When the rig finished playing the shot; moving a magnet may take longer than planned.
    rig : str
        Status line of the rig, if it has one.
    """

    shot: Shot
    pose: Pose | None
    tracked: Pose | None
    command: Command
    compute: float
    ended: float = float("inf")
    rig: str = ""

    @property
    def trusted(self) -> Pose | None:
        """The located pose if it is trusted, else None."""
        return self.pose if self.pose is not None and self.pose.trusted else None


@dataclass(frozen=True)
class Event:
    """A change of what is assumed, or of the flight.

    Attributes
    ----------
    time : float, in s
        On the rig's clock.
    what : str
    detail : dict
    """

    time: float
    what: str
    detail: dict[str, object] = field(default_factory=dict)


def get_trusted_poses(cycles: Iterable[CycleRecord]) -> list[Pose]:
    """Return the trusted poses of some cycles, in order.

    Parameters
    ----------
    cycles : iterable of CycleRecord

    Returns
    -------
    list of Pose
    """
    return [pose for cycle in cycles if (pose := cycle.trusted) is not None]


@dataclass(repr=False)
class Run(Readable):
    """A flown mission: how it ended, every cycle and event, and (once summarised) its figures and folder.

    `begun` is when the first cycle started, after the noise was learned; `duration` counts from the start.
    `recovered` counts what went wrong and ended nothing, by kind; `safety` has duty and heat of the coils.

    `error` is what ended it, with its fields (limit, value, channel, …), where an error did.

    `true_trail` (n, 3), in m, is where the robot truly went, known with a witness only. `report` says where the report
    is, or why there is none.

    Examples
    --------
    >>> import smolbot
    >>> smolbot.Run("timeout", "max_duration_s reached after 300 s", duration=300.0).status
    'timeout'
    """

    status: Status = "stopped"
    stop_reason: str = ""
    duration: float = 0.0
    wall: float = 0.0
    begun: float = 0.0
    events: list[Event] = field(default_factory=list)
    cycles: list[CycleRecord] = field(default_factory=list)
    summary: dict[str, object] = field(default_factory=dict)
    folder: str | None = None
    true_trail: FloatArray | None = None
    report: str = ""
    recovered: dict[str, int] = field(default_factory=dict)
    safety: dict[str, object] = field(default_factory=dict)
    error: Exception | None = None

    def table(self) -> dict[str, np.ndarray[Any, Any]]:
        """Collect every cycle as arrays: begin of its shot, mode, located and tracked position, computing time.

        Returns
        -------
        dict of str to ndarray, shape (n_cycles,)
            Times in s, places in m in the world frame; nan where there is no pose.
        """
        places = {"x": 0, "y": 1, "z": 2}
        return as_columns(
            (
                {"time": cycle.shot.start, "mode": cycle.shot.mode, "compute": cycle.compute}
                | {name: cycle.pose.position[i] for name, i in places.items() if cycle.pose is not None}
                | {f"tracked_{n}": cycle.tracked.position[i] for n, i in places.items() if cycle.tracked is not None}
                for cycle in self.cycles
            ),
            ["time", "mode", "x", "y", "z", "tracked_x", "tracked_y", "tracked_z", "compute"],
        )


class Listener(Protocol):
    """A callable that is notified of every cycle at its end: recorder, progress."""

    def __call__(self, record: CycleRecord) -> None:
        """Receive one cycle.

        Parameters
        ----------
        record : CycleRecord
        """


class RecorderSink(Protocol):
    """A recorder sink: it is notified of every played shot and every event, such as the recorder or a live page.

    It is called in the loop's thread and must neither wait nor raise.
    """

    def record_shot(self, shot: Shot, recording: Recording | None, ended: float) -> None:
        """Record a played shot.

        Parameters
        ----------
        shot : Shot
        recording : Recording or None
            As the rig returned it.
        ended : float, in s
            When the shot ended, on the rig's clock.
        """

    def record_event(self, event: Event) -> None:
        """Record an event.

        Parameters
        ----------
        event : Event
        """
