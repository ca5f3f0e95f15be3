"""Compare several runs of one kind of robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError
from smolbot.runs.report.intervals import (
    METHOD,
    Estimate,
    Statistic,
    compute_mean,
    compute_median,
    compute_p95,
    estimate_difference,
    estimate_with_interval,
)
from smolbot.runs.report.recorded_flight import RecordedFlight
from smolbot.runs.report.setting_differences import find_changes
from smolbot.runs.run import get_trusted_poses
from smolbot.runs.summary import compute_orientation_error, compute_tracking_distance


@dataclass(frozen=True)
class ComparedFigure:
    """One figure of several runs.

    Attributes
    ----------
    key : str
    name : str
    values : list of Estimate or None
        The value of each run.
    differences_to_first : list of Estimate or None
        Its difference to that of the first run.
    """

    key: str
    name: str
    values: list[Estimate | None]
    differences_to_first: list[Estimate | None]


@dataclass
class Comparison:
    """Differences of several runs in settings and figures.

    Attributes
    ----------
    flights : list of RecordedFlight
    labels : list of str
        Short names of the runs.
    settings : list of tuple
        Name of each setting that differs, and its value in each run.
    figures : list of ComparedFigure
    notes : list of str
        Warnings for the reader: different paths, records that are cut short.
    """

    flights: list[RecordedFlight]
    labels: list[str]
    settings: list[tuple[str, list[str | None]]]
    figures: list[ComparedFigure]
    notes: list[str] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        """Convert to a dictionary for JSON output.

        Returns
        -------
        dict
        """

        def told(estimate: Estimate | None) -> dict[str, Any] | None:
            return None if estimate is None else {"value": estimate.value, "low": estimate.low, "high": estimate.high}

        return {
            "runs": [str(flight.record.path) for flight in self.flights],
            "labels": self.labels,
            "notes": self.notes,
            "changed": dict(self.settings),
            "figures": {
                figure.key: {
                    "name": figure.name,
                    "runs": [told(estimate) for estimate in figure.values],
                    "over_first": [told(estimate) for estimate in figure.differences_to_first],
                }
                for figure in self.figures
            },
            "intervals": METHOD,
        }


def compare(runs: Sequence[str | Path]) -> Comparison:
    """Read and compare runs.

    Parameters
    ----------
    runs : sequence of str or Path
        Run folders, or their records.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        If one cannot be read, the robots differ, or one run steers and another only localizes.
    """
    flights = [RecordedFlight.read(run) for run in runs]
    _check_same_kind(flights)
    notes = [
        f"{flight.record.path}: the record is cut short; its figures cover the recorded part only."
        for flight in flights
        if not flight.record.whole
    ]
    if _has_different_paths(flights):
        notes.insert(0, "These runs followed different paths: overlays show all, errors are along each run's own.")
    return Comparison(flights, _make_labels(flights), find_changes(flights), _compare_figures(flights), notes)


def _check_same_kind(flights: list[RecordedFlight]) -> None:
    first = flights[0]
    for other in flights[1:]:
        if (first.steered is None) != (other.steered is None):
            looks, steers = (first, other) if first.steered is None else (other, first)
            raise InputError(
                f"{steers.record.folder} steered ('{steers.mission.name}') and {looks.record.folder} only observed "
                f"('{looks.mission.name}'): runs of one kind can be compared."
            )
        mine, theirs = first.mission.robot, other.mission.robot
        if (mine.kind, mine.name) != (theirs.kind, theirs.name):
            raise InputError(
                f"{first.record.folder} is a run of the robot '{mine.name}' ({mine.kind}) and {other.record.folder} "
                f"one of '{theirs.name}' ({theirs.kind}): runs of the same robot can be compared."
            )


def _has_different_paths(flights: list[RecordedFlight]) -> bool:
    paths = [flight.steered.path.points for flight in flights if flight.steered is not None]
    return any(points.shape != paths[0].shape or not np.allclose(points, paths[0]) for points in paths[1:])


def _make_labels(flights: list[RecordedFlight]) -> list[str]:
    """Return the names of the folders, numbered where two are equal."""
    names = [flight.record.folder.resolve().name or flight.record.path.stem for flight in flights]
    return [f"{n} ({i})" if names.count(n) > 1 else n for i, n in enumerate(names, 1)]


def _compare_figures(flights: list[RecordedFlight]) -> list[ComparedFigure]:
    if flights[0].steered is not None:
        rows: list[tuple[str, str, str, Statistic]] = [
            ("tracking_error_mm.mean", "mean tracking error", "tracking", compute_mean),
            ("tracking_error_mm.p95", "tracking error, 95th percentile", "tracking", compute_p95),
        ]
        single = [("path_time_s", "time on the path"), ("coil_energy_j", "heat in the coils"), ("turns", "turns")]
    else:
        rows, single = [], [("pose_rate_hz", "trusted poses")]
    rows += [
        ("localization_error_mm.mean", "mean localization error", "localization", compute_mean),
        ("localization_error_mm.p95", "localization error, 95th percentile", "localization", compute_p95),
        ("orientation_error_deg.mean", "mean orientation error", "orientation", compute_mean),
        ("unexplained_median", "median unexplained share, 1 - R²", "unexplained", compute_median),
        ("compute_ms.median", "median computing time", "compute", compute_median),
    ]
    single += [("loop_rate_hz", "loop rate"), ("duration_s", "duration"), ("cycles", "cycles")]
    series = [compute_series(flight) for flight in flights]
    found = [
        _compare_series(key, name, [one.get(kind) for one in series], statistic) for key, name, kind, statistic in rows
    ]
    found += [_compare_numbers(key, name, [flight.summary.get(key) for flight in flights]) for key, name in single]
    return [figure for figure in found if any(figure.values)]


def _compare_series(key: str, name: str, values: list[FloatArray | None], statistic: Statistic) -> ComparedFigure:
    own = [None if v is None or not len(v) else estimate_with_interval(v, statistic) for v in values]
    first = values[0]
    over: list[Estimate | None] = [None]
    for value in values[1:]:
        known = value is not None and len(value) and first is not None and len(first)
        over.append(
            estimate_difference(value, first, statistic) if known and value is not None and first is not None else None
        )
    return ComparedFigure(key, name, own, over)


def _compare_numbers(key: str, name: str, values: list[Any]) -> ComparedFigure:
    own = [None if v is None else Estimate(float(v)) for v in values]
    first = own[0]
    over = [None if e is None or first is None else Estimate(e.value - first.value) for e in own[1:]]
    return ComparedFigure(key, name, own, [None, *over])


def compute_series(flight: RecordedFlight) -> dict[str, FloatArray]:
    """Compute the values over time on which the figures are based.

    Parameters
    ----------
    flight : RecordedFlight

    Returns
    -------
    dict of str to ndarray, shape (n,)
        In the units of the summary; without those that are not known.
    """
    cycles = flight.run.cycles
    poses = get_trusted_poses(cycles)
    out = {
        "unexplained": np.array([1.0 - pose.r_squared for pose in poses]),
        "compute": 1e3 * np.array([cycle.compute for cycle in cycles]),
    }
    if flight.steered is not None:
        out["tracking"] = 1e3 * compute_tracking_distance(flight.steered, flight.trace.following)
    along = flight.mission.robot.device.along_cantilever
    pairs = flight.compared_poses
    if pairs:
        out["localization"] = 1e3 * np.array([np.linalg.norm(p.position - t.position) for p, t in pairs])
        out["orientation"] = np.degrees([compute_orientation_error(p, t, along) for p, t in pairs])
    return out
