"""Faults of the twin, as the real client library meets them: a stated error, and everything at rest."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from sim.twin.faults import FAULTS, FaultInjector, parse_fault
from smolbot.bench.hardware.card import LostWindow
from smolbot.bench.hardware.guard import Guard
from smolbot.bench.hardware.waveform import Waveform, WaveformCompiler
from smolbot.core.shots import Actuate, Excite, Listen, Rest, Shot
from smolbot.errors import InputError, RigError
from tests.sim.twin.conftest import Bench, NoGuard

pytestmark = pytest.mark.realtime


def shot(bench: Bench, pulling: float = 0.02) -> Waveform:
    windows = Actuate((1.0, 0.0, 2.0, 0.0), pulling), Excite((4.0, -2.0), 100.0, 2), Rest(0.01), Listen(2, 100.0)
    return WaveformCompiler(bench.section, bench.coils, 50_000).compile(Shot(windows))


@pytest.mark.parametrize(
    ("fault", "kind", "said"),
    [
        ("device_gone", RigError, "Dev1 did not play a shot.*-201003"),
        ("value_out_of_range", RigError, "Dev1 did not play a shot.*-200077"),
        ("overrun", LostWindow, "-200279"),
        ("read_timeout", LostWindow, "-200284"),
    ],
)
def test_a_fault_that_occurs_once_is_one_stated_error_and_the_next_shot_plays(
    bench: Bench, no_guard: NoGuard, fault: str, kind: type[Exception], said: str
) -> None:
    waveform = shot(bench)
    bench.model.faults.add(parse_fault(f"{fault}@now"))
    with pytest.raises(kind, match=said):
        bench.card.play(waveform, no_guard)
    assert bench.model.wait_until_at_rest(1.0)
    heard, _ = bench.card.play(waveform, no_guard)
    assert heard is not None


def test_a_fault_that_stays_fails_every_shot_until_it_is_cleared(bench: Bench, no_guard: NoGuard) -> None:
    waveform = shot(bench)
    bench.model.faults.add(parse_fault("overrun@now:good"))
    for _ in range(2):
        with pytest.raises(LostWindow):
            bench.card.play(waveform, no_guard)
    bench.model.faults.clear()
    assert bench.card.play(waveform, no_guard)[0] is not None


@pytest.mark.parametrize("phase", ["before", "actuation", "listening"])
def test_a_fault_occurs_in_the_requested_phase_and_shot(bench: Bench, no_guard: NoGuard, phase: str) -> None:
    waveform = shot(bench)
    bench.model.faults.add(parse_fault(f"overrun@{phase}#2"))
    assert bench.card.play(waveform, no_guard)[0] is not None
    with pytest.raises(LostWindow):
        bench.card.play(waveform, no_guard)
    entries = bench.model.journal.list_since()
    came = next(e for e in entries if e["what"] == "fault")
    shots = [e["time"] for e in entries if e["what"] == "shot"]
    begins, ends = {"before": (0, 0.0), "actuation": (1, 0.02), "listening": (1, 0.07)}[phase]
    assert came["time"] > shots[begins]
    assert (came["time"] < shots[1]) is (phase == "before")
    assert ends == 0.0 or came["time"] > shots[1]


def test_a_server_that_dies_is_named_and_the_watchdog_opens_every_relay(bench: Bench) -> None:
    guard = Guard(bench.section, bench.driver, lambda reason: None)
    guard.open()
    threading.Timer(0.08, bench.server.kill).start()
    with pytest.raises(RigError, match=r"device server at 127\.0\.0\.1:\d+ is gone \(UNAVAILABLE\)"):
        bench.card.play(shot(bench, pulling=0.6), guard)
    assert bench.model.wait_until_at_rest(2.0)
    assert bench.model.expired
    assert np.count_nonzero(bench.echo.currents[0]) < 0.4 * 50_000  # of the 0.6 s
    guard.close()


def test_a_server_that_stalls_runs_into_deadlines_and_the_watchdog_opens_every_relay(bench: Bench) -> None:
    tripped = threading.Event()
    guard = Guard(bench.section, bench.driver, lambda reason: tripped.set())
    guard.open()
    bench.model.faults.add(parse_fault("stalled@actuation#1:good"))
    with pytest.raises(RigError, match="did not answer in time"):
        bench.card.play(shot(bench, pulling=0.6), guard)
    assert tripped.wait(2.0)
    assert bench.model.wait_until_at_rest(2.0)
    assert bench.model.expired
    assert np.count_nonzero(bench.echo.currents[0]) < 0.4 * 50_000
    bench.model.faults.clear()
    guard.close()


def test_an_unfed_watchdog_opens_every_relay_in_time_and_reports_it(bench: Bench) -> None:
    class Unfed(Guard):
        def _feed_and_watch(self) -> None:
            pass

    guard = Unfed(bench.section, bench.driver, lambda reason: None)
    guard.open()
    bench.card.play(shot(bench, pulling=0.4), guard)  # nobody told the card's client
    with pytest.raises(bench.driver.errors, match="-200678"):
        guard.arm()
        expired = time.monotonic() + 1.0
        while not bench.model.expired and time.monotonic() < expired:
            time.sleep(0.01)
        guard._watchdog.reset_timer()
    entries = bench.model.journal.list_since()
    shot_at = next(e["time"] for e in entries if e["what"] == "shot")
    opened = next(e["time"] for e in entries if e["what"] == "closed" and not e["on"])
    # armed some calls before the shot began; a step of the card and the relays' opening come on top
    assert opened - shot_at < 1e-3 * (bench.section.watchdog.timeout_ms + bench.section.relays.open_ms) + 0.006
    guard.close()


def test_a_stuck_relay_is_detected_at_the_contacts_and_a_pressed_button_at_its_line(bench: Bench) -> None:
    guard = Guard(bench.section, bench.driver, lambda reason: None)
    guard.open()
    guard.check_relays_open()
    bench.model.faults.add(parse_fault("relay_stuck@now:good"))
    with pytest.raises(RigError, match="a relay did not open"):
        bench.card.play(shot(bench), guard)
    assert guard.describe_pressed_button() is None
    bench.model.faults.add(parse_fault("button@now:good"))
    with pytest.raises(RigError, match="a relay did not open"):
        guard.check_relays_open()  # looks at all lines
    assert "button" in (guard.describe_pressed_button() or "")
    guard.close()


def test_dead_and_saturated_sensors_read_zero_and_full_scale(bench: Bench, no_guard: NoGuard) -> None:
    waveform = shot(bench)
    bench.model.faults.add(parse_fault("sensor_dead@now:good"))
    heard, _ = bench.card.play(waveform, no_guard)
    assert heard is not None
    assert not heard[0].any()
    assert np.all(heard[1:] > 0)
    bench.model.faults.clear()
    bench.model.faults.add(parse_fault("sensors_saturated@now:good"))
    heard, _ = bench.card.play(waveform, no_guard)
    assert heard is not None
    assert np.all(heard == bench.section.inputs.range_v)


def test_frozen_outputs_keep_driving_until_they_are_written_at_once(bench: Bench, no_guard: NoGuard) -> None:
    bench.model.faults.add(parse_fault("outputs_frozen@actuation#1:good"))
    bench.card.play(shot(bench), no_guard)
    state = bench.model.read_state()
    assert state["driven"]
    assert state["relays_closed"] == ["+x", "+y"]
    bench.card.zero_outputs()
    assert bench.model.wait_until_at_rest(1.0)


def test_faults_wait_for_their_second_after_the_first_shot() -> None:
    now, came = [0.0], []
    box = FaultInjector(came.append, lambda: now[0])
    box.add(parse_fault("button@2.5s"))
    now[0] = 100.0
    box.activate_due()
    assert came == []  # no shot yet
    box.notify_phase("actuation", 1)
    now[0] = 102.4
    box.activate_due()
    assert came == []
    now[0] = 102.6
    box.activate_due()
    assert came == ["button"]
    assert box.is_active("button")
    now[0] = 110.0
    assert not box.is_active("button")  # it came once


@pytest.mark.parametrize("text", ["flood", "overrun@noon", "overrun@actuation#x", "overrun@now:twice"])
def test_a_fault_that_cannot_be_read_names_those_that_can(text: str) -> None:
    with pytest.raises(InputError, match=f"--fault {text}: "):
        parse_fault(text)


def test_every_fault_has_a_sentence() -> None:
    assert all(len(sentence.split()) > 2 for sentence in FAULTS.values())
