"""Compare several runs of one kind of robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError
from smolbot.runs.report.flight import Flight
from smolbot.runs.report.intervals import METHOD, Estimate, Statistic, difference, estimated, mean, median, p95
from smolbot.runs.report.setting_differences import changed
from smolbot.runs.run import trusted_poses
from smolbot.runs.summary import orientation_error, tracking_distance


@dataclass(frozen=True)
class Compared:
    """One figure of several runs.

    Attributes
    ----------
    key : str
    name : str
    of_run : list of Estimate or None
        The value of each run.
    over_first : list of Estimate or None
        Its difference to that of the first run.
    """

    key: str
    name: str
    of_run: list[Estimate | None]
    over_first: list[Estimate | None]


@dataclass
class Comparison:
    """Differences of several runs in settings and figures.

    Attributes
    ----------
    flights : list of Flight
    labels : list of str
        Short names of the runs.
    settings : list of tuple
        Name of each setting that differs, and its value in each run.
    figures : list of Compared
    notes : list of str
        Warnings for the reader: different paths, records that are cut short.
    """

    flights: list[Flight]
    labels: list[str]
    settings: list[tuple[str, list[str | None]]]
    figures: list[Compared]
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
                    "runs": [told(estimate) for estimate in figure.of_run],
                    "over_first": [told(estimate) for estimate in figure.over_first],
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
    flights = [Flight.read(run) for run in runs]
    _same_kind(flights)
    notes = [
        f"{flight.record.path}: the record is cut short; its figures are of what is in it."
        for flight in flights
        if not flight.record.whole
    ]
    if _different_paths(flights):
        notes.insert(0, "These runs followed different paths: overlays show each with its own, errors are along it.")
    return Comparison(flights, _labels(flights), changed(flights), _figures(flights), notes)


def _same_kind(flights: list[Flight]) -> None:
    first = flights[0]
    for other in flights[1:]:
        if (first.steered is None) != (other.steered is None):
            looks, steers = (first, other) if first.steered is None else (other, first)
            raise InputError(
                f"{steers.record.folder} steered ('{steers.mission.name}') and {looks.record.folder} only looked "
                f"('{looks.mission.name}'): runs of one kind can be compared."
            )
        mine, theirs = first.mission.robot, other.mission.robot
        if (mine.kind, mine.name) != (theirs.kind, theirs.name):
            raise InputError(
                f"{first.record.folder} is a run of the robot '{mine.name}' ({mine.kind}) and {other.record.folder} "
                f"one of '{theirs.name}' ({theirs.kind}): runs of the same robot can be compared."
            )


def _different_paths(flights: list[Flight]) -> bool:
    paths = [flight.steered.path.points for flight in flights if flight.steered is not None]
    return any(points.shape != paths[0].shape or not np.allclose(points, paths[0]) for points in paths[1:])


def _labels(flights: list[Flight]) -> list[str]:
    """Return the names of the folders, numbered where two are equal."""
    names = [flight.record.folder.resolve().name or flight.record.path.stem for flight in flights]
    return [f"{n} ({i})" if names.count(n) > 1 else n for i, n in enumerate(names, 1)]


def _figures(flights: list[Flight]) -> list[Compared]:
    if flights[0].steered is not None:
        rows: list[tuple[str, str, str, Statistic]] = [
            ("tracking_error_mm.mean", "mean tracking error", "tracking", mean),
            ("tracking_error_mm.p95", "tracking error, 95th percentile", "tracking", p95),
        ]
        single = [("path_time_s", "time on the path"), ("coil_energy_j", "heat in the coils"), ("turns", "turns")]
    else:
        rows, single = [], [("pose_rate_hz", "trusted poses")]
    rows += [
        ("localization_error_mm.mean", "mean localization error", "localization", mean),
        ("localization_error_mm.p95", "localization error, 95th percentile", "localization", p95),
        ("orientation_error_deg.mean", "mean orientation error", "orientation", mean),
        ("unexplained_median", "median unexplained share, 1 - R²", "unexplained", median),
        ("compute_ms.median", "median computing time", "compute", median),
    ]
    single += [("loop_rate_hz", "loop rate"), ("duration_s", "duration"), ("cycles", "cycles")]
    told = [series_of(flight) for flight in flights]
    found = [_of_series(key, name, [one.get(kind) for one in told], statistic) for key, name, kind, statistic in rows]
    found += [_of_numbers(key, name, [flight.summary.get(key) for flight in flights]) for key, name in single]
    return [figure for figure in found if any(figure.of_run)]


def _of_series(key: str, name: str, values: list[FloatArray | None], statistic: Statistic) -> Compared:
    own = [None if v is None or not len(v) else estimated(v, statistic) for v in values]
    first = values[0]
    over: list[Estimate | None] = [None]
    for value in values[1:]:
        known = value is not None and len(value) and first is not None and len(first)
        over.append(difference(value, first, statistic) if known and value is not None and first is not None else None)
    return Compared(key, name, own, over)


def _of_numbers(key: str, name: str, values: list[Any]) -> Compared:
    own = [None if v is None else Estimate(float(v)) for v in values]
    first = own[0]
    over = [None if e is None or first is None else Estimate(e.value - first.value) for e in own[1:]]
    return Compared(key, name, own, [None, *over])


def series_of(flight: Flight) -> dict[str, FloatArray]:
    """Compute the values over time on which the figures are based.

    Parameters
    ----------
    flight : Flight

    Returns
    -------
    dict of str to ndarray, shape (n,)
        In the units of the summary; without those that are not known.
    """
    cycles = flight.run.cycles
    poses = trusted_poses(cycles)
    out = {
        "unexplained": np.array([1.0 - pose.r_squared for pose in poses]),
        "compute": 1e3 * np.array([cycle.compute for cycle in cycles]),
    }
    if flight.steered is not None:
        out["tracking"] = 1e3 * tracking_distance(flight.steered, flight.trace.following)
    along = flight.mission.robot.device.along_cantilever
    pairs = flight.compared
    if pairs:
        out["localization"] = 1e3 * np.array([np.linalg.norm(p.position - t.position) for p, t in pairs])
        out["orientation"] = np.degrees([orientation_error(p, t, along) for p, t in pairs])
    return out
