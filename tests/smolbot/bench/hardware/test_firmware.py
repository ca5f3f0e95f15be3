"""The firmware on a simulated board: it turns what it is told, and nothing else ever moves."""

from __future__ import annotations

import subprocess
import time

import numpy as np
import pytest

from sim.measure import firmware_figures as figures
from sim.twin.firmware import build_firmware, find_missing_tools, find_sketch
from smolbot.bench.hardware.stage.protocol import format_line
from smolbot.errors import RigError

pytestmark = pytest.mark.realtime


def rising(edges, pin):
    return edges[(edges["pin"] == pin) & (edges["level"] == 1)]


def test_it_boots_disarmed_and_says_who_it_is(uno, wire):
    uno.reset()
    assert wire.ask(b"\n" + format_line(1, "BEAT"), b"1 OK OFF IDLE NONE NONE 0 0*")
    assert b"! HELLO smolbot-magnet-stage 1.0 NONE*" in wire.received
    assert not uno.enabled
    assert wire.ask(format_line(2, "MOVE 100 800 0 0"), b"2 ERR DISARMED*")
    assert uno.steps == (0, 0)


def test_motors_are_not_armed_without_a_heartbeat(uno, wire):
    assert wire.ask(b"\n" + format_line(1, "ARM"), b"1 ERR HEARTBEAT*")
    assert not uno.enabled


def test_both_axes_make_the_steps_they_are_told_with_ramps_and_at_their_rates(uno, wire):
    wire.send(b"\n" + format_line(1, "BEAT") + format_line(2, "ARM"))
    assert wire.ask(format_line(3, "MOVE -700 800 300 444"), b"3 OK")
    uno_moved = [wire.ask(format_line(4 + n, "BEAT"), b"*") and time.sleep(0.1) for n in range(16)]
    assert len(uno_moved) == 16
    assert wire.ask(format_line(99, "BEAT"), b"99 OK ARMED IDLE NONE NONE -700 300*")
    assert uno.steps == (-700, 300)
    edges = uno.take_edges()
    for pin, rate, count in ((0, 800.0, 700), (2, 444.0, 300)):
        gaps = np.diff(rising(edges, pin)["cycle"].astype(np.int64)) / 16e6
        assert gaps.size == count - 1
        assert 1.0 / np.median(gaps) == pytest.approx(rate, rel=1e-3)
        assert 1.0 / gaps.min() == pytest.approx(rate, rel=0.03)
        assert gaps[0] > 0.0075  # 133 steps a second: reached 4.4 steps from rest
        assert gaps[-1] > 0.0075
        rates = 1.0 / gaps
        change = np.abs(np.diff(rates)) / gaps[1:]
        assert np.median(change[rates[1:] < 0.9 * rate]) == pytest.approx(2000.0, rel=0.3)


def test_a_repeated_line_gets_the_same_answer_and_moves_nothing_twice(uno, wire):
    wire.send(b"\n" + format_line(1, "BEAT") + format_line(2, "ARM"))
    for _ in range(3):
        assert wire.ask(format_line(3, "MOVE 40 800 0 0"), b"3 OK*")
    assert wire.ask(format_line(4, "BEAT"), b"4 OK")
    time.sleep(0.4)
    assert wire.ask(format_line(5, "BEAT"), b"5 OK ARMED IDLE")
    assert uno.steps == (40, 0)


def test_a_second_move_is_refused_while_one_runs(uno, wire):
    wire.send(b"\n" + format_line(1, "BEAT") + format_line(2, "ARM"))
    assert wire.ask(format_line(3, "MOVE 4000 800 0 0"), b"3 OK")
    assert wire.ask(format_line(4, "MOVE 1 800 0 0"), b"4 ERR BUSY")


def test_without_a_heartbeat_the_motors_go_off_and_only_a_clear_lifts_the_fault(uno, wire):
    off = figures.measure_heartbeat_loss(uno, wire)
    assert 0.4 < off < 0.6
    wire.send(format_line(10, "BEAT"))
    assert wire.ask(format_line(11, "ARM"), b"11 ERR FAULT*")
    assert wire.ask(format_line(12, "BEAT"), b" HEARTBEAT ")
    assert not uno.enabled
    assert wire.ask(format_line(13, "CLEAR"), b"13 OK")
    assert not uno.enabled
    wire.send(format_line(14, "BEAT"))
    assert wire.ask(format_line(15, "ARM"), b"15 OK")
    assert uno.enabled


def test_a_lamp_asks_for_nothing_once_the_host_is_silent(uno, wire):
    assert wire.ask(b"\n" + format_line(1, "LAMP NEAR"), b"1 ERR HEARTBEAT*")
    wire.send(format_line(2, "BEAT"))
    assert wire.ask(format_line(3, "LAMP NEAR"), b"3 OK*")
    assert uno.lamp == "near"
    lit = uno.state.read_number("cycles")
    while uno.lamp is not None and uno.state.read_number("cycles") < lit + 48e6:
        time.sleep(0.005)
    assert uno.lamp is None
    assert wire.ask(format_line(4, "LAMP NONE"), b"4 OK*")
    assert wire.ask(format_line(5, "BEAT"), b"5 OK OFF IDLE NONE NONE 0 0*")


def test_a_hung_main_loop_goes_off_although_its_interrupts_step_on(uno, wire):
    off = figures.measure_hung_loop(uno, wire)
    assert off < 0.25
    assert uno.resets == 1
    assert wire.ask(b"\n" + format_line(20, "BEAT"), b"20 OK OFF IDLE NONE WATCHDOG 0 0*")


def test_off_is_at_once_and_no_step_follows(uno, wire):
    figures._run_up(uno, wire)
    assert wire.ask(format_line(5, "OFF"), b"5 OK")
    at = uno.steps
    assert not uno.enabled
    assert wire.ask(format_line(6, "BEAT"), b"6 OK OFF IDLE")
    time.sleep(0.1)
    assert uno.steps == at


@pytest.mark.parametrize(
    ("command", "error"),
    [
        ("MOVE 1000001 800 0 0", "STEPS"), ("MOVE 10 4001 0 0", "RATE"), ("MOVE 10 39 0 0", "RATE"),
        ("MOVE 10 800 0", "ARGUMENTS"), ("MOVE 10 800 0 0 0", "ARGUMENTS"), ("MOVE 10 800 0 1.5", "ARGUMENTS"),
        ("JUMP", "COMMAND"), ("LAMP FAR", "ARGUMENTS"), ("LAMP NEAR 1", "ARGUMENTS"), ("OFF now", "ARGUMENTS"),
    ],
)  # fmt: skip
def test_what_is_forbidden_is_refused_by_name(uno, wire, command, error):
    wire.send(b"\n" + format_line(1, "BEAT") + format_line(2, "ARM"))
    assert wire.ask(format_line(3, command), b"3 ERR %s*" % error.encode())
    assert uno.steps == (0, 0)


def test_spoiled_lines_move_nothing_and_reset_nothing(uno, wire):
    found = figures.fuzz(uno, wire, 150)
    assert found.armed_throughout
    assert found.alive_after
    assert (found.steps, found.resets) == (0, 0)


@pytest.mark.slow
def test_ten_thousand_spoiled_lines_move_nothing_and_reset_nothing(uno, wire):
    found = figures.fuzz(uno, wire, 10_000, seed=2)
    assert found.armed_throughout
    assert found.alive_after
    assert (found.steps, found.resets) == (0, 0)


@pytest.mark.slow
def test_steps_come_on_time_while_both_axes_and_the_line_are_busy(uno, wire):
    for mean, spread, most in figures.measure_jitter(uno, wire, 1.0).values():
        assert spread < 0.005 * mean
        assert most < 30e-6


def test_the_sketch_is_one_file_that_a_c_plus_plus_compiler_takes_too(tools, tmp_path):
    """The Arduino IDE compiles it as C++."""
    command = ["avr-gcc", "-x", "c++", "-std=gnu++11", "-Os", "-Wall", "-mmcu=atmega328p", "-c", str(find_sketch())]
    done = subprocess.run([*command, "-o", str(tmp_path / "sketch.o")], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert find_sketch().parent.name == find_sketch().stem


def test_a_missing_tool_is_one_clear_error(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "avr-gcc" in (find_missing_tools() or "")
    with pytest.raises(RigError, match=r"avr-gcc.*not found; .*gcc-avr"):
        build_firmware()


def test_a_sketch_that_does_not_compile_is_told_with_the_compilers_words(tools, tmp_path, monkeypatch):
    monkeypatch.setenv("SMOLBOT_CACHE", str(tmp_path))
    broken = tmp_path / "broken.ino"
    broken.write_text("int main(void) { return nothing; }\n")
    with pytest.raises(RigError, match=r"(?s)avr-gcc could not build.*nothing"):
        build_firmware(broken)
