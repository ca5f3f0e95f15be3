"""Measure the cost of recording: the same flights with and without a recorder, alternating, in one process."""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from smolbot.config.load import AnyMission, load_mission
from smolbot.flight.session import fly
from smolbot.runs.recording.converter import Converter
from smolbot.runs.recording.message_queue import MessageQueue
from smolbot.runs.recording.recorder import Recorder
from smolbot.runs.run import Run


@dataclass(frozen=True)
class Flight:
    """One flight: processor time in s of the process, the loop's thread and the recorder's; wall time; per cycle.

    `calls` is the processor time of the calls by which the loop hands things to the recorder, in s.
    """

    recorded: bool
    process: float
    loop: float
    pump: float
    calls: float
    wall: float
    cycles: int
    robot: float
    compute_median: float
    size: int
    dropped: int


def fly_once(mission: AnyMission, seed: int, folder: Path | None) -> Flight:
    """Fly once; with a folder, the flight is recorded in it.

    Parameters
    ----------
    mission : Mission
    seed : int
    folder : Path or None

    Returns
    -------
    Flight
    """
    made: list[Recorder] = []

    def recorder(converter: Converter) -> MessageQueue:
        assert folder is not None
        made.append(Recorder(folder, converter))
        return made[0]

    with _time_calls() as calls:
        process, loop, wall = time.process_time(), time.thread_time(), time.perf_counter()
        run: Run = fly(mission, seed, make_live_sink=recorder if folder is not None else None)
        process, loop, wall = time.process_time() - process, time.thread_time() - loop, time.perf_counter() - wall
    size = made[0].path.stat().st_size if made else 0
    return Flight(
        bool(made), process, loop, made[0].computing if made else 0.0, calls[0], wall, len(run.cycles), run.duration,
        statistics.median(c.compute for c in run.cycles), size, made[0].dropped if made else 0,
    )  # fmt: skip


@contextmanager
def _time_calls() -> Iterator[list[float]]:
    """Sums the processor time of what the loop's thread spends in a pump's calls."""
    spent = [0.0]
    originals = {name: getattr(MessageQueue, name) for name in ("played", "cycle", "happened")}

    def timed(original: Any) -> Any:
        def call(*arguments: Any, **options: Any) -> Any:
            begin = time.perf_counter()
            try:
                return original(*arguments, **options)
            finally:
                spent[0] += time.perf_counter() - begin

        return call

    for name, original in originals.items():
        setattr(MessageQueue, name, timed(original))
    try:
        yield spent
    finally:
        for name, original in originals.items():
            setattr(MessageQueue, name, original)


def fly_pairs(mission: AnyMission, pairs: int, seed: int) -> Iterator[tuple[Flight, Flight]]:
    """Fly pairs of the same seed, without and with a recorder, in alternating order.

    Parameters
    ----------
    mission : Mission
    pairs : int
    seed : int

    Yields
    ------
    without, with_recorder : Flight
    """
    fly_once(mission, seed, None)  # compiled kernels, warm caches
    for number in range(pairs):
        found: dict[bool, Flight] = {}
        for recorded in ((False, True), (True, False))[number % 2]:
            with tempfile.TemporaryDirectory() as folder:
                found[recorded] = fly_once(mission, seed, Path(folder) if recorded else None)
        yield found[False], found[True]


def compute_figures(found: list[tuple[Flight, Flight]]) -> dict[str, Any]:
    """Compute ratios of pairs, and the cost of one cycle.

    Parameters
    ----------
    found : list of (Flight, Flight)

    Returns
    -------
    dict
    """

    def ratios(name: str) -> dict[str, float]:
        each = [getattr(a, name) / getattr(b, name) for b, a in found]
        return {"median": statistics.median(each), "min": min(each), "max": max(each)}

    recorded = [with_ for _, with_ in found]
    per_cycle = [f.pump / f.cycles for f in recorded]
    return {
        "pairs": len(found),
        "cycles": recorded[0].cycles,
        "process_ratio": ratios("process"),
        "loop_thread_ratio": ratios("loop"),
        "cycle_compute_ratio": ratios("compute_median"),
        "recorder_thread_us_per_cycle": 1e6 * statistics.median(per_cycle),
        "loop_calls_us_per_cycle": 1e6 * statistics.median(f.calls / f.cycles for f in recorded),
        "share_of_process_percent": 100 * statistics.median((f.pump + f.calls) / f.process for f in recorded),
        "share_of_robot_time_percent": 100 * statistics.median((f.pump + f.calls) / f.robot for f in recorded),
        "record_mb": max(f.size for f in recorded) / 1e6,
        "dropped": sum(f.dropped for f in recorded),
    }


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(
        prog="python -m sim.measure.recording_cost", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--mission", default="r_path")
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--set", action="append", default=[], help="key=value laid over the mission file")
    parser.add_argument("--json", action="store_true", help="print one JSON object on standard output")
    given = parser.parse_args()
    mission = load_mission(given.mission, settings=dict(pair.split("=", 1) for pair in given.set))
    err = sys.stderr if given.json else sys.stdout
    found = []
    for without, with_ in fly_pairs(mission, given.pairs, given.seed):
        found.append((without, with_))
        print(
            f"without {without.process:6.2f} s, with {with_.process:6.2f} s of processor time; "
            f"recorder's thread {with_.pump:.3f} s, calls {with_.calls:.3f} s; {with_.cycles} cycles; "
            f"{with_.size / 1e6:.1f} MB",
            file=err, flush=True,
        )  # fmt: skip
    figures = compute_figures(found)
    for name, value in figures.items():
        shown = value if not isinstance(value, dict) else ", ".join(f"{k} {v:.3f}" for k, v in value.items())
        print(f"{name:30} {shown if not isinstance(shown, float) else format(shown, '.3g')}", file=err)
    if given.json:
        print(json.dumps({**figures, "flights": [asdict(f) for pair in found for f in pair]}))


if __name__ == "__main__":
    main()
