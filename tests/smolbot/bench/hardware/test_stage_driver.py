"""The driver on the real firmware: turns in SI, bad lines made good, and an error that names port and action."""

from __future__ import annotations

import math
import time

import pytest

from smolbot.bench.hardware.stage import MagnetStage
from smolbot.bench.hardware.stage import link as links
from smolbot.bench.hardware.wiring import StageSection
from smolbot.errors import RigError

pytestmark = pytest.mark.realtime


def settle(holds, seconds=3.0):
    end = time.monotonic() + seconds
    while not holds() and time.monotonic() < end:
        time.sleep(0.01)
    return holds()


def finish(stage, seconds=8.0):
    assert stage.wait(seconds)


def fails(action, seconds=2.0):
    """The first RigError that `action` raises within `seconds`."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            action()
        except RigError as error:
            return str(error)
        time.sleep(0.02)
    raise AssertionError("nothing was raised")


def test_it_opens_with_the_motors_off_and_knows_where_the_magnet_is(uno, stage):
    assert stage.identity == "smolbot-magnet-stage 1.0"
    assert settle(lambda: stage.place == "away")
    assert not uno.enabled
    uno.set_switches(near=False, away=False)
    assert settle(lambda: stage.place is None)
    uno.set_switches(near=True, away=False)
    assert settle(lambda: stage.place == "near")
    stage.arm()
    assert uno.enabled


def test_the_lamp_asks_and_goes_out_when_the_port_is_closed(uno, stage):
    for place in ("near", "away", None, "near"):
        stage.set_lamp(place)
        assert uno.lamp == place
    stage.close()
    assert uno.lamp is None


@pytest.mark.parametrize(("heading_deg", "steering", "sign"), [(-20.0, -889, 1), (170.0, -444, -1)])
def test_it_steers_to_the_nearer_end_of_the_axis_and_turns_to_suit(uno, section, heading_deg, steering, sign):
    with_fast_axis = MagnetStage(section, steering_rate=math.radians(80.0))
    with_fast_axis.open()
    with_fast_axis.arm()
    with_fast_axis.turn(math.radians(heading_deg), 0.25, 1.0)
    assert not with_fast_axis.wait(0.0)
    finish(with_fast_axis)
    with_fast_axis.check_at_rest()
    with_fast_axis.close()
    assert uno.steps == (sign * 800, steering)


def test_steering_does_not_gather_rounding(uno, section):
    stage = MagnetStage(section, steering_rate=math.radians(80.0))
    stage.open()
    stage.arm()
    for heading_deg in (2.01, 4.02, 0.0):
        stage.steer(math.radians(heading_deg))
        finish(stage)
    stage.close()
    assert uno.steps == (0, 0)


def test_one_spoiled_line_each_way_is_made_good_and_counted(uno, stage):
    stage.arm()
    for spoil in (uno.garble, uno.garble, uno.truncate, uno.truncate):
        before = uno.corrupted_lines
        spoil(1)
        assert settle(lambda before=before: uno.corrupted_lines > before)
        time.sleep(0.25)
    stage.check_at_rest()
    assert stage.take_recovered() == {"magnet stage: garbled line": 2, "magnet stage: lost line": 2}
    assert not stage.take_recovered()
    assert uno.enabled


def test_a_line_that_stays_bad_ends_it_with_port_and_action_and_motors_off(uno, stage, section):
    stage.arm()
    stage.turn(0.0, 2.0, 0.25)
    uno.garble(1000)
    said = fails(lambda: stage.wait(0.0))
    assert said.startswith(f"magnet stage on {section.port}: heartbeat: twice no answer")
    assert settle(lambda: not uno.enabled, 1.0)


def test_a_pulled_cable_ends_it_and_the_motors_go_off(uno, stage, section):
    stage.arm()
    stage.turn(0.0, 2.0, 0.25)
    pulled = time.monotonic()
    uno.unplug()
    said = fails(lambda: stage.wait(0.0))
    assert said.startswith(f"magnet stage on {section.port}: heartbeat: ")
    assert settle(lambda: not uno.enabled, 1.0)
    edges = uno.take_edges()
    assert edges[edges["pin"] == 4]["time"][-1] - pulled < 1.0


def test_a_reset_of_the_board_is_noticed(uno, stage):
    stage.arm()
    uno.reset()
    assert not uno.enabled
    assert "started anew" in fails(stage.check_at_rest)
    assert not uno.enabled


def test_a_hung_main_loop_is_noticed(uno, stage):
    stage.arm()
    uno.hang()
    assert "magnet stage on" in fails(stage.check_at_rest)
    assert not uno.enabled


def test_a_fault_that_an_earlier_run_left_does_not_stop_the_next(uno, wire, section):
    wire.send(b"\n" + links.format_line(1, "BEAT"))
    assert wire.ask(links.format_line(2, "ARM"), b"2 OK")
    assert settle(lambda: not uno.enabled, 1.0)
    assert wire.ask(links.format_line(3, "BEAT"), b"HEARTBEAT")
    stage = MagnetStage(section)
    stage.open()
    stage.arm()
    assert uno.enabled
    stage.close()
    assert not uno.enabled


def test_stop_switches_off_and_nothing_moves_afterwards(uno, stage):
    stage.arm()
    stage.turn(0.0, 2.0, 0.25)
    stage.stop()
    assert not uno.enabled
    stage.check_at_rest()
    with pytest.raises(RigError, match="turning the magnet: the motors are off"):
        stage.turn(0.0, 1.0, 0.25)


@pytest.mark.parametrize(("turns", "frequency", "what"), [(1.0, 2.0, "6400 steps a second"), (400.0, 0.25, "1000000")])
def test_what_the_firmware_would_refuse_is_refused_before(uno, stage, turns, frequency, what):
    stage.arm()
    with pytest.raises(RigError, match=what):
        stage.turn(0.0, turns, frequency)
    assert uno.steps == (0, 0)


def test_a_busy_port_is_said_to_be_busy(uno, stage, section):
    with pytest.raises(RigError, match=r"opening the port: it is busy"):
        MagnetStage(section).open()


def test_another_firmware_is_named_with_what_is_needed(tools, tmp_path):
    from sim.twin.firmware import build_firmware, find_sketch
    from sim.twin.simulated_uno import SimulatedUno

    source = tmp_path / "other.ino"
    source.write_text(find_sketch().read_text().replace("smolbot-magnet-stage 1.0", "smolbot-magnet-stage 2.3"))
    board = SimulatedUno()
    try:
        board.start(tmp_path / "stage", build_firmware(source).firmware)
        with pytest.raises(
            RigError, match=r"version: got 'smolbot-magnet-stage 2\.3', needs 'smolbot-magnet-stage 1\.0'"
        ):
            MagnetStage(StageSection(port=str(tmp_path / "stage"))).open()
    finally:
        board.close()


def test_a_port_where_nobody_answers_is_said_to_be_silent(tmp_path):
    import os
    import pty

    master, slave = pty.openpty()
    try:
        with pytest.raises(RigError, match=r"waiting for the banner: received nothing within 0\.3 s"):
            links.Link(os.ttyname(slave), 115200, boot=0.3)
    finally:
        os.close(master)
        os.close(slave)


def test_after_a_reset_the_axis_can_be_put_on_its_mark(uno, section):
    """The board counts from zero anew, but the axis stands where it was left."""
    with_fast_axis = MagnetStage(section, steering_rate=math.radians(80.0))
    with_fast_axis.open()
    with_fast_axis.arm()
    with_fast_axis.steer(math.radians(10.0))
    finish(with_fast_axis)
    uno.reset()
    with_fast_axis.close()
    assert uno.steps == (0, 444)
    uno.turn_to_marks()
    again = MagnetStage(section, steering_rate=math.radians(80.0))
    again.open()
    again.arm()
    again.steer(math.radians(5.0))
    finish(again)
    again.close()
    assert uno.steps == (0, 222)
