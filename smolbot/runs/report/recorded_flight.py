"""A recorded run, prepared for reports."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from smolbot.config.load import AnyMission
from smolbot.config.mission import Mission
from smolbot.config.observation import Observation
from smolbot.core.pose import Pose
from smolbot.runs.observation_summary import find_measurements
from smolbot.runs.outcome import summarise_run
from smolbot.runs.recording.reader import RecordedRun, read_run
from smolbot.runs.run import Run
from smolbot.runs.trace import Trace, pair_with_truth

NO_TRUTH = "This needs ground truth, which this rig does not provide."
NO_SIGNALS = "This needs the sensors' raw samples, and this record holds none."


@dataclass
class RecordedFlight:
    """A record with its mission and its figures.

    Attributes
    ----------
    record : RecordedRun
    mission : Mission or Observation
        From the record itself.
    run : Run
    trace : Trace
    summary : dict
        Figures of merit, computed from the record as they were after the flight.
    """

    record: RecordedRun
    mission: AnyMission
    run: Run
    trace: Trace
    summary: dict[str, Any]

    @classmethod
    def read(cls, run: str | Path, mission: AnyMission | None = None) -> RecordedFlight:
        """Read a run.

        Parameters
        ----------
        run : str or Path
            Run folder, or its record.
        mission : Mission or Observation, optional
            Its mission, if that is already loaded.

        Returns
        -------
        RecordedFlight

        Raises
        ------
        InputError
            If there is no record, or it is not one of smolbot's.
        """
        return cls.from_record(read_run(run), mission)

    @classmethod
    def from_record(cls, record: RecordedRun, mission: AnyMission | None = None) -> RecordedFlight:
        """Build the flight of a record.

        Parameters
        ----------
        record : RecordedRun
        mission : Mission or Observation, optional
            Its mission, if that is already loaded.

        Returns
        -------
        RecordedFlight
        """
        mission = record.mission() if mission is None else mission
        run, trace = record.run(), record.trace()
        where = record.provenance
        run.summary = summarise_run(mission, run, trace, int(where["seed"]), where.get("world", {}))
        return cls(record, mission, run, trace, run.summary)

    @cached_property
    def steered(self) -> Mission | None:
        """The mission if it steers; None for an observation."""
        return self.mission if isinstance(self.mission, Mission) else None

    @property
    def is_helical(self) -> bool:
        """Whether a helical robot is steered."""
        return self.steered is not None and self.mission.robot.kind == "helical"

    @property
    def knows_truth(self) -> bool:
        """Whether a witness provided the ground truth."""
        return self.record.knows_truth

    @property
    def compared_poses(self) -> list[tuple[Pose, Pose]]:
        """Pairs of pose and truth to compare: of all trusted poses, or of an observation's measurements."""
        mission = self.mission
        only = isinstance(mission, Observation) and mission.sections.observe.measurements is not None
        return pair_with_truth(find_measurements(self.trace) if only else self.trace.moments)

    @property
    def seed(self) -> int:
        """Seed of the run."""
        return int(self.record.provenance["seed"])

    @property
    def title(self) -> str:
        """Short name for legends and headings."""
        return f"{self.mission.name}, seed {self.seed}"
