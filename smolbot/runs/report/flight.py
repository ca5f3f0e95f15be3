"""A recorded run, made ready to be looked at."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from smolbot.config.load import AnyMission
from smolbot.config.mission import Mission
from smolbot.config.observation import Observation
from smolbot.core.pose import Pose
from smolbot.runs.observation_summary import measurements
from smolbot.runs.outcome import sum_up
from smolbot.runs.recording.reader import RecordedRun, read_run
from smolbot.runs.run import Run
from smolbot.runs.trace import Trace, compared

NO_TRUTH = "This needs ground truth, which this rig does not provide."
NO_SIGNALS = "This needs the sensors' raw samples, and this record holds none."


@dataclass
class Flight:
    """A record with its mission and its figures.

    Attributes
    ----------
    record : RecordedRun
    mission : Mission or Observation
        From the record itself.
    run : Run
    trace : Trace
    summary : dict
        Figures, reckoned from the record as they were after the flight.
    """

    record: RecordedRun
    mission: AnyMission
    run: Run
    trace: Trace
    summary: dict[str, Any]

    @classmethod
    def read(cls, run: str | Path, mission: AnyMission | None = None) -> Flight:
        """Read a run by its folder or its record; a `mission` that is at hand is not loaded again.

        Raises
        ------
        InputError
            Where there is no record, or it is none of smolbot's.
        """
        return cls.of(read_run(run), mission)

    @classmethod
    def of(cls, record: RecordedRun, mission: AnyMission | None = None) -> Flight:
        """The flight of a record that was read."""
        mission = record.mission() if mission is None else mission
        run, trace = record.run(), record.trace()
        where = record.provenance
        run.summary = sum_up(mission, run, trace, int(where["seed"]), where.get("world", {}))
        return cls(record, mission, run, trace, run.summary)

    @cached_property
    def steered(self) -> Mission | None:
        """The mission if it steers; None where it only looks."""
        return self.mission if isinstance(self.mission, Mission) else None

    @property
    def helical(self) -> bool:
        """Whether a helix is steered."""
        return self.steered is not None and self.mission.robot.kind == "helical"

    @property
    def knows_truth(self) -> bool:
        return self.record.knows_truth

    @property
    def compared(self) -> list[tuple[Pose, Pose]]:
        """Poses that are held against the truth, and the truth: all trusted ones, or those that measured."""
        mission = self.mission
        only = isinstance(mission, Observation) and mission.sections.observe.measurements is not None
        return compared(measurements(self.trace) if only else self.trace.moments)

    @property
    def seed(self) -> int:
        return int(self.record.provenance["seed"])

    @property
    def title(self) -> str:
        """Short name for legends and headings."""
        return f"{self.mission.name}, seed {self.seed}"
