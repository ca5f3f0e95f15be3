"""The watchdog is fed in time while anything is driven, and only then; a pressed button and a dead card are told of.

On a card of the test's own, and on a clock that only the feeder's pauses and the card's answers move.
"""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from nidaqmx.constants import Level
from nidaqmx.errors import DaqError

from smolbot.bench.hardware.driver import Driver
from smolbot.bench.hardware.guard import Guard
from smolbot.bench.hardware.wiring import BenchSection
from smolbot.config.document import validate
from smolbot.config.rig import load_rig
from smolbot.errors import OperatorStopError, RigError

GONE = DaqError("The device was removed.", -201003)
BUSY = DaqError("The resource is reserved.", -50103)


class NightFall(BaseException):
    """The clock has come as far as a test lets it."""


@dataclass
class Desk:
    """A card with its lines, and a day on which nothing else takes time; `said` is what the card was told, and when."""

    section: BenchSection
    driver: Driver | None = None
    inside: object = None
    now: float = 0.0
    until: float = 0.0
    reading: float = 0.0
    lines: dict[str, bool] = field(default_factory=dict)
    said: list[tuple[float, str]] = field(default_factory=list)
    broken: dict[str, Exception] = field(default_factory=dict)
    plans: list[tuple[float, Callable[[], object]]] = field(default_factory=list)
    safe: list[Any] = field(default_factory=list)
    told: list[RigError] = field(default_factory=list)
    threads: list[Any] = field(default_factory=list)

    def say(self, what: str) -> None:
        self.said.append((round(self.now, 6), what))
        if what in self.broken:
            raise self.broken[what]

    def times(self, what: str) -> list[float]:
        return [at for at, one in self.said if one == what]

    def at(self, time: float, plan: Callable[[], object]) -> None:
        self.plans.append((time, plan))

    def pass_by(self, seconds: float) -> None:
        """Let time go on, and let happen what is to happen by then."""
        end, over = min(self.now + seconds, self.until), self.now + seconds >= self.until
        for plan in sorted((p for p in self.plans if p[0] <= end), key=lambda p: p[0]):
            self.plans.remove(plan)
            self.now = max(self.now, plan[0])
            plan[1]()
        self.now = end
        if over:
            raise NightFall

    def live(self, seconds: float) -> None:
        """Let the guard's thread run for so long; it comes back to life at the next call."""
        self.until = self.now + seconds
        try:
            self.threads[-1].target()
            self.threads[-1].alive = False
        except NightFall:
            self.until = self.now

    # what stands for the client library

    def task(self, *, urgent: bool = False) -> Any:
        assert urgent  # a long recording keeps the other connection busy
        names: list[str] = []
        self.wired = names
        add = SimpleNamespace(add_di_chan=lambda lines, line_grouping: names.extend(lines.split(", ")))
        return SimpleNamespace(
            di_channels=add,
            in_stream=self,
            stop=lambda: self.say("inputs stop"),
            close=lambda: self.say("inputs close"),
        )

    def make_watchdog(self, name: str, timeout: float) -> Any:
        self.say("watchdog made")
        self.device, self.timeout = name, timeout
        return SimpleNamespace(
            cfg_watchdog_do_expir_states=self.safe.extend, start=lambda: self.say("start"),
            reset_timer=lambda: self.say("feed"), stop=lambda: self.say("stop"), close=lambda: self.say("close"),
        )  # fmt: skip

    def read(self, levels: Any, timeout: float) -> None:
        assert timeout == pytest.approx(1e-3 * self.section.call_timeout_ms)
        self.say("read")
        levels[:] = [self.lines[line.partition("/")[2]] for line in self.wired]
        if self.now < self.until:
            self.pass_by(self.reading)


class Reader:
    """Reads a sample of each line, as the client library does; it would ask for an array's shape unless told not to."""

    verify_array_shape = True

    def __init__(self, desk: Desk) -> None:
        self.desk = desk

    def read_one_sample_one_line(self, levels: Any, timeout: float) -> None:
        assert not self.verify_array_shape
        self.desk.read(levels, timeout)


@pytest.fixture(scope="module")
def section() -> BenchSection:
    found, faults = validate(BenchSection, load_rig("twin").raw_section("bench"), ("bench",))
    assert found is not None, faults
    return found


@pytest.fixture
def desk(section: BenchSection, monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    made = Desk(section, lines=dict.fromkeys(section.input_lines, True))

    class Bell(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            assert timeout is not None
            assert timeout >= 0.0
            made.pass_by(timeout)
            return self.is_set()

    class Thread:
        begun, alive = False, False

        def __init__(self, target: Callable[[], None], name: str, daemon: bool) -> None:
            self.target, self.name, self.daemon = target, name, daemon
            made.threads.append(self)

        def start(self) -> None:
            self.begun = self.alive = True

        def is_alive(self) -> bool:
            return self.alive

        def join(self, timeout: float) -> None:
            assert 0.0 < timeout < 10.0  # a card that hangs must not hold up the end
            self.alive = False
            made.say("joined")

    threads = SimpleNamespace(Event=Bell, Thread=Thread, Lock=threading.Lock, current_thread=lambda: made.inside)
    monkeypatch.setattr("smolbot.bench.hardware.guard.threading", threads)
    monkeypatch.setattr("smolbot.bench.hardware.guard.time", SimpleNamespace(monotonic=lambda: made.now))
    monkeypatch.setattr("nidaqmx.stream_readers.DigitalMultiChannelReader", Reader)
    yield made
    gc.enable()


def a_guard(desk: Desk, **wiring: Any) -> Guard:
    desk.section = desk.section.model_copy(update=wiring)
    desk.driver = Driver("", 0.5)
    desk.driver.task, desk.driver.make_watchdog = desk.task, desk.make_watchdog  # type: ignore[method-assign]
    return Guard(desk.section, desk.driver, desk.told.append)


def opened(desk: Desk, **wiring: Any) -> Guard:
    guard = a_guard(desk, **wiring)
    guard.open()
    return guard


def release(desk: Desk, line: str | None) -> None:
    assert line is not None
    desk.lines[line] = False


def unwired(section: BenchSection, *, contacts: bool = False, button: bool = False) -> dict[str, Any]:
    relays = section.relays if contacts else section.relays.model_copy(update={"all_open": None})
    operator = section.operator if button else section.operator.model_copy(update={"stop_line": None})
    return {"relays": relays, "operator": operator}


def test_an_unfed_watchdog_is_to_open_every_relay_and_disable_the_amplifiers(desk, section):
    guard = opened(desk)
    assert desk.device == section.device
    assert desk.timeout == pytest.approx(1e-3 * section.watchdog.timeout_ms)
    assert [(state.physical_channel, state.expiration_state) for state in desk.safe] == [
        (f"{section.device}/{line}", Level.LOW) for line in section.clocked_lines
    ]
    assert desk.wired == [f"{section.device}/{line}" for line in section.input_lines]
    assert not desk.times("start")  # nothing is driven yet
    assert guard.lines == dict.fromkeys(section.input_lines, True)
    assert desk.threads[0].begun
    assert desk.threads[0].daemon  # it would keep a program alive that is to end


def test_while_armed_it_is_fed_at_its_pace_and_lines_are_looked_at_as_often(desk, section):
    guard = opened(desk)
    guard.arm()
    assert desk.times("start") == [0.0]
    desk.live(1.0)
    pace = 1e-3 * section.watchdog.feed_ms
    feeds = desk.times("feed")
    assert feeds == pytest.approx(pace * np.arange(len(feeds)))
    assert feeds[-1] > 1.0 - 2.0 * pace
    assert len(desk.times("read")) == len(feeds) + 1  # and once at the opening
    assert desk.told == []


def test_between_two_drives_it_is_not_fed_but_the_button_is_looked_at(desk):
    guard = opened(desk)
    desk.live(0.3)
    assert not desk.times("feed")
    assert len(desk.times("read")) > 15
    guard.arm()
    guard.disarm()
    assert len(desk.times("stop")) == 1
    guard.disarm()  # it stands already
    desk.live(0.3)
    assert not desk.times("feed")
    assert len(desk.times("stop")) == 1
    release(desk, desk.section.operator.stop_line)
    desk.live(0.1)
    assert len(desk.told) == 1


@pytest.mark.parametrize("reading", [0.005, 0.01, 0.014])
def test_time_that_the_card_takes_to_answer_does_not_make_feeding_later_and_later(desk, section, reading):
    guard = opened(desk)
    desk.reading = reading
    guard.arm()
    desk.live(1.0)
    assert desk.times("feed") == pytest.approx(1e-3 * section.watchdog.feed_ms * np.arange(len(desk.times("feed"))))


def test_a_late_feed_is_not_made_up_for(desk, section):
    guard = opened(desk)
    guard.arm()
    desk.reading = 0.1
    desk.at(0.35, lambda: setattr(desk, "reading", 0.0))
    desk.live(1.0)
    gaps = np.diff(desk.times("feed"))
    assert gaps[:3] == pytest.approx([0.1] * 3)  # as soon as the card answers
    assert gaps[4:] == pytest.approx(1e-3 * section.watchdog.feed_ms)


def test_a_search_through_memory_waits_until_nothing_is_driven(desk):
    guard = opened(desk)
    for end in (guard.disarm, guard.abandon):
        guard.arm()
        assert not gc.isenabled()
        end()
        assert gc.isenabled()


def test_what_may_still_be_driven_is_left_to_the_watchdog(desk):
    guard = opened(desk)
    guard.arm()
    guard.abandon()
    desk.live(0.3)
    guard.disarm()
    assert not desk.times("feed")
    assert not desk.times("stop")


@pytest.mark.parametrize("driven", [True, False])
def test_a_pressed_button_is_told_of_once_within_two_looks_and_ends_the_feeding(desk, section, driven):
    guard = opened(desk)
    if driven:
        guard.arm()
    desk.at(0.2, lambda: release(desk, section.operator.stop_line))
    desk.at(0.5, lambda: None)
    desk.live(1.0)
    (error,) = desk.told
    assert isinstance(error, OperatorStopError)
    assert str(error) == guard.describe_pressed_button()
    assert f"{section.device}/{section.operator.stop_line} is low" in str(error)
    assert not desk.threads[0].alive
    assert desk.times("read")[-1] <= 0.2 + 2e-3 * section.watchdog.feed_ms
    assert bool(desk.times("feed")) == driven


def test_a_button_that_is_pressed_from_the_start_lets_nothing_begin(desk, section):
    release(desk, section.operator.stop_line)
    guard = a_guard(desk)
    with pytest.raises(RigError, match=r"operator's button .* is low: pressed, or its cable is broken"):
        guard.open()
    assert not desk.threads[0].begun
    guard.close()
    assert desk.times("close")
    assert desk.times("inputs close")


@pytest.mark.parametrize(("error", "answers"), [(GONE, False), (BUSY, True)])
@pytest.mark.parametrize("call", ["feed", "read"])
def test_a_card_that_fails_its_guard_is_told_of_once_with_a_remedy_and_fed_no_more(desk, section, call, error, answers):
    guard = opened(desk)
    guard.arm()
    desk.at(0.1, lambda: desk.broken.update({call: error}))
    desk.live(1.0)
    (told,) = desk.told
    assert not isinstance(told, OperatorStopError)
    assert str(told).startswith(
        f"{section.device} did not answer to its watchdog's feeding: {str(error).split('.')[0]}"
    )
    assert f"({error.error_code})." in str(told)
    assert str(told).endswith(desk.driver.suggest_remedy(error))
    assert desk.driver.answers == answers
    assert not desk.threads[0].alive
    desk.broken.clear()
    guard.disarm()
    assert not desk.times("stop")  # it is to expire


def test_a_card_that_fails_while_the_guard_is_closed_is_nobodys_fault(desk):
    guard = opened(desk)
    guard.arm()

    def leave() -> None:
        desk.broken["feed"] = GONE
        guard.close()
        raise GONE

    desk.inside = desk.threads[0]
    desk.at(0.107, leave)  # while it reads
    desk.reading = 0.004
    desk.live(1.0)
    assert desk.told == []
    assert not desk.times("joined")  # a thread does not wait for itself


def test_closing_ends_the_thread_stops_the_watchdog_and_lets_go_of_both_tasks_once(desk):
    guard = opened(desk)
    guard.arm()
    desk.live(0.1)
    guard.close()
    last = [what for _, what in desk.said][-5:]
    assert last == ["joined", "stop", "close", "inputs stop", "inputs close"]
    before = len(desk.said)
    guard.close()
    assert len(desk.said) == before
    desk.threads[0].alive = True
    desk.live(0.1)
    assert not desk.told
    assert len(desk.said) == before


def test_a_guard_that_was_never_opened_closes_without_a_word(desk):
    a_guard(desk).close()
    assert desk.said == []


def test_a_card_that_fails_while_it_is_let_go_changes_nothing(desk):
    guard = opened(desk)
    guard.arm()
    desk.broken.update({"stop": BUSY, "inputs stop": BUSY})
    guard.disarm()
    guard.close()
    assert desk.times("close")
    assert desk.times("inputs close")


@pytest.mark.parametrize("call", ["watchdog made", "read"])
def test_a_watchdog_that_cannot_be_set_up_is_one_stated_error(desk, section, call):
    desk.broken[call] = BUSY
    with pytest.raises(RigError, match=rf"The watchdog of {section.device} cannot be set up: .*\(-50103\)"):
        opened(desk)
    assert not desk.threads[0].begun


def test_relays_that_stay_closed_are_told_of_and_contacts_that_are_not_wired_are_not_asked(desk, section):
    guard = opened(desk)
    guard.check_relays_open()
    release(desk, section.relays.all_open)
    with pytest.raises(RigError, match=rf"a relay did not open after a shot \({section.relays.all_open} is low\)"):
        guard.check_relays_open()
    blind = opened(desk, **unwired(section, button=True))
    reads = len(desk.times("read"))
    blind.check_relays_open()
    assert len(desk.times("read")) == reads


def test_without_lines_nothing_is_read_and_the_watchdog_is_fed_all_the_same(desk, section):
    guard = opened(desk, **unwired(section))
    guard.arm()
    desk.live(0.2)
    assert not desk.times("read")
    assert len(desk.times("feed")) > 10
    assert guard.describe_pressed_button() is None
    assert [item.what for item in guard.checks("card")] == ["watchdog"]
    guard.close()
    assert not desk.times("inputs close")


def test_a_button_that_was_not_read_yet_is_not_pressed(desk):
    assert a_guard(desk).describe_pressed_button() is None


def test_a_check_starts_feeds_and_stops_it_and_reads_the_lines_anew(desk, section):
    guard = opened(desk)
    before = len(desk.said)
    items = list(guard.checks("card Dev1"))
    assert [what for _, what in desk.said[before:]] == ["start", "feed", "stop", "read"]
    assert [(item.device, item.what, item.found, item.ok) for item in items] == [
        ("card Dev1", "watchdog", "starts, is fed and stops; opens relays after 130 ms", True),
        ("card Dev1", "relays", "all open", True),
        ("card Dev1", "operator's button", "not pressed", True),
    ]
    release(desk, section.relays.all_open)
    release(desk, section.operator.stop_line)
    _, relays, button = guard.checks("card Dev1")
    assert (relays.found, relays.ok, relays.limit) == ("one is closed", False, "all open")
    assert (button.found, button.ok, button.limit) == ("pressed", False, "not pressed")


def test_a_check_of_a_watchdog_that_does_not_start_says_so_and_ends(desk):
    guard = opened(desk)
    desk.broken["start"] = BUSY
    (item,) = guard.checks("card Dev1")
    assert not item.ok
    assert "-50103" in item.found
    assert item.limit == "starts and is fed"
