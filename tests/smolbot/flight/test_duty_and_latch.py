"""Shares of the time, against an integral of what was driven; and a latch that shuts once."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smolbot.flight.safety.duty_cycle import DutyCycle
from smolbot.flight.safety.stop_latch import Latch

PULLS = st.lists(st.tuples(st.integers(0, 1), st.floats(0.0, 4.0), st.floats(0.01, 15.0)), min_size=1, max_size=15)


def driven_within(spans, begin, end):
    return sum(max(min(stop, end) - max(start, begin), 0.0) for start, stop in spans)


@settings(max_examples=40)
@given(PULLS, st.sampled_from([2.0, 10.0]))
def test_the_share_of_each_coil_is_the_driven_part_of_the_time_just_past(pulls, window):
    duty, clock = DutyCycle(("+x", "-x"), window), 0.0
    spans, most = ([], []), [0.0, 0.0]
    for coil, pause, length in pulls:
        start, clock = clock + pause, clock + pause + length
        spans[coil].append((start, clock))
        share = duty.add_span(coil, start, clock)
        assert share == pytest.approx(driven_within(spans[coil], clock - window, clock) / window, abs=1e-9)
        most[coil] = max(most[coil], share)
    assert duty.peaks == most
    assert duty.coil_names == ("+x", "-x")


def test_a_latch_is_not_tripped_until_somebody_trips_it_and_the_end_of_a_run_does_not_trip_it():
    latch = Latch()
    assert (latch.tripped, latch.over, latch.reason, latch.ending) == (False, False, "", "failed")
    latch.end()
    assert latch.over
    assert not latch.tripped
    assert latch.trip("too hot")
    assert (latch.tripped, latch.reason, latch.ending) == (True, "too hot", "failed")


def test_a_signal_handler_trips_the_latch_without_calling_the_halt_that_it_may_have_interrupted():
    latch, halted = Latch(), []
    latch.bind(lambda: halted.append("rig"))
    latch.bind(lambda: halted.append("supply"))
    assert halted == []
    assert latch.trip("killed", "stopped", halt=False)
    assert halted == []
    assert not latch.trip("killed again")
    assert halted == ["rig", "supply"]
    assert (latch.reason, latch.ending) == ("killed", "stopped")


def test_the_same_reason_twice_trips_once():
    latch = Latch()
    assert [latch.trip("Ctrl-C", "stopped") for _ in range(2)] == [True, False]
