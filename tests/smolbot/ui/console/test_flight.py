"""What the page knows of a run is what its record says, at its end and at every time before."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from smolbot.errors import InputError
from smolbot.runs.recording.reader import read_run
from smolbot.runs.recording.recorder import McapFile
from smolbot.runs.recording.scan import Scan
from smolbot.ui.console.bar import describe_state, make_bar_state
from smolbot.ui.console.figures_panel import MAX_POINTS, collect_series, format_table, thin_rows
from smolbot.ui.console.flight_state import FlightState
from smolbot.ui.console.runs_panel import list_runs, read_flight


@pytest.fixture(scope="module")
def flight(runs: Path) -> FlightState:
    return read_flight(runs / "line")


def test_every_cycle_of_the_record_is_there(flight: FlightState, runs: Path) -> None:
    recorded = read_run(runs / "line")
    cycles = [moment.cycle for moment in recorded.moments]
    estimated = np.array([1e3 * c.tracked.position for c in cycles if c.tracked is not None])
    assert np.array_equal(flight.tracked.get_values()[:, :3], estimated)
    assert np.array_equal(flight.cycles.get_times(), [c.ended for c in cycles])
    run = recorded.run()
    assert run.true_trail is not None
    assert np.allclose(flight.true.get_values(), 1e3 * run.true_trail)
    assert flight.ending is not None
    assert (flight.ending.status, flight.ending.reason) == (run.status, run.stop_reason)


def test_heat_of_the_coils_is_what_the_flight_estimated(flight: FlightState, runs: Path) -> None:
    peaks = read_run(runs / "line").run().safety["coil_temperature_peak_c"]
    assert isinstance(peaks, dict)
    shown = flight.heat.get_values().max(axis=0)
    assert shown == pytest.approx([peaks[name] for name in flight.heated], abs=0.05)


def test_a_look_back_shows_only_what_was_known_then(flight: FlightState) -> None:
    middle = 0.5 * (flight.cycles.get_times()[0] + flight.latest)
    assert 0 < flight.cycles.count_until(middle) < len(flight.cycles)
    for times, _ in collect_series(flight, middle).values():
        assert len(times) == 0 or times[-1] <= middle
    assert make_bar_state(flight, False, "", middle)["state"] not in ("TIMEOUT", "COMPLETED")
    assert make_bar_state(flight, False, "")["state"] == flight.ending.status.upper()  # type: ignore[union-attr]


def test_a_flight_of_which_nothing_came_yet_can_be_looked_at() -> None:
    empty = FlightState("m")
    assert describe_state(empty)[0] == "STARTING"
    assert make_bar_state(empty, True, "")["error"] == "–"
    assert format_table(empty, None).startswith("<table")
    assert all(len(times) == 0 for times, _ in collect_series(empty, None).values())


def test_thinning_keeps_the_last_point() -> None:
    times = np.arange(12345.0)
    thin, values = thin_rows(times, times[:, None])
    assert thin[-1] == times[-1]
    assert len(thin) <= MAX_POINTS
    assert np.array_equal(thin, values[:, 0])


def test_runs_are_found_by_their_record(runs: Path, tmp_path: Path) -> None:
    assert list_runs(runs) == ["line"]
    assert list_runs(tmp_path) == []


def test_what_is_no_record_is_one_clear_error(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_bytes(b"not at all")
    with pytest.raises(InputError, match=r"is no MCAP file"):
        read_flight(tmp_path)


def test_a_record_that_was_cut_short_shows_what_is_in_it(runs: Path, tmp_path: Path, flight: FlightState) -> None:
    often = McapFile(tmp_path / "often.mcap")  # flushed as by a run that does not fly past in a second
    for number, found in enumerate(Scan(runs / "line" / "run.mcap").read_messages()):
        assert found.topic is not None
        often.append(found.topic, found.time, found.data)
        if number % 20 == 0:
            often.flush()
    often.close()
    whole = (tmp_path / "often.mcap").read_bytes()
    (tmp_path / "run.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    cut = read_flight(tmp_path)
    n = len(cut.cycles)
    assert 0 < n < len(flight.cycles)
    assert np.array_equal(cut.cycles.get_values(), flight.cycles.get_values()[:n], equal_nan=True)
    assert cut.ending is None
