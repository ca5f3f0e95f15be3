"""The loop that a newcomer writes himself: cycle by cycle, and at zero whatever happens; `fly` is the same loop."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest

from smolbot import load_mission
from smolbot.core.shots import Actuate
from smolbot.errors import InputError, InterlockError, RigError
from smolbot.flight.assembly import make_loop
from smolbot.flight.session import open_rig

SHORT = {"path.points_mm": "[[-1.0, 0.0], [1.5, 0.0]]", "localization.quiet_s": "2.0"}


@pytest.fixture(scope="module")
def short():
    return load_mission("line", settings=SHORT)


@pytest.fixture
def flying(short):
    """A loop on an open tank that notes each stop."""
    with closing(open_rig(short, 3)) as rig:
        stops, real = [], rig.stop

        def stop():
            stops.append(rig.now())
            real()

        rig.stop = stop
        loop = make_loop(rig, short)
        loop.stops = stops
        yield loop


def test_cycle_by_cycle_it_is_the_flight_of_fly_bit_for_bit(short):
    with closing(open_rig(short, 3)) as rig:
        theirs = make_loop(rig, short).fly()
    records = []
    with closing(open_rig(short, 3)) as rig, make_loop(rig, short) as loop:
        while not loop.done:
            records.append(loop.step())
    mine = loop.run
    assert records == mine.cycles
    assert (mine.status, mine.stop_reason, mine.duration) == (theirs.status, theirs.stop_reason, theirs.duration)
    assert [(e.time, e.what) for e in mine.events] == [(e.time, e.what) for e in theirs.events]
    assert (mine.safety, mine.recovered) == (theirs.safety, theirs.recovered)
    for a, b in zip(mine.cycles, theirs.cycles, strict=True):
        assert a.shot == b.shot
        assert a.command == b.command
        assert np.array_equal(a.tracked.position, b.tracked.position)


@pytest.mark.parametrize(
    ("error", "status", "reason"),
    [
        (RigError("the amplifier tripped"), "failed", "the amplifier tripped"),
        (InterlockError("too much"), "failed", "too much"),
        (ZeroDivisionError("mine"), "failed", "ZeroDivisionError: mine"),
        (KeyboardInterrupt("Ctrl-C"), "stopped", "Ctrl-C"),
        (SystemExit(3), "stopped", "SystemExit"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, BaseException) else "",
)
def test_whatever_is_raised_in_the_block_outputs_are_at_zero_and_the_run_has_the_reason(flying, error, status, reason):
    def own_loop():
        with flying:
            while not flying.done:
                record = flying.step()
                if any(isinstance(window, Actuate) for window in record.shot.windows):
                    raise error

    with pytest.raises(type(error)):
        own_loop()
    assert flying.stops
    assert flying.safety.latch.over
    assert (flying.run.status, flying.run.stop_reason) == (status, reason)
    assert flying.run.cycles
    with pytest.raises(InputError, match="with loop"):
        flying.step()


def test_a_block_that_is_left_early_stops_the_run(flying):
    with flying as loop:
        for _ in range(4):
            loop.step()
    assert len(loop.run.cycles) == 4
    assert (loop.run.status, loop.run.stop_reason) == ("stopped", "the loop was left before it was done")
    assert loop.stops
    assert loop.run.duration == loop.rig.now()


def test_nothing_is_played_outside_of_a_block(flying):
    begun = flying.rig.now()
    with pytest.raises(InputError, match=r"with loop:.*outputs at zero"):
        flying.step()
    assert flying.rig.now() == begun
    assert not flying.run.cycles


def test_nothing_is_played_once_it_is_done(flying):
    with flying as loop:
        while not loop.done:
            loop.step()
        with pytest.raises(InputError, match="it is done"):
            loop.step()
    assert loop.run.status == "completed"


def test_an_error_while_a_run_is_ended_leaves_outputs_at_zero_too(flying, monkeypatch):
    def broken():
        raise OSError("no room to keep the heat of the coils")

    monkeypatch.setattr(flying.safety, "end", broken)

    def own_loop():
        with flying:
            flying.step()

    with pytest.raises(OSError, match="no room"):
        own_loop()
    assert flying.stops
    assert flying.run.stop_reason.startswith("OSError: no room")
