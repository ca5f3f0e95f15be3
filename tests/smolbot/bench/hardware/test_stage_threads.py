"""The driver's two threads, heartbeat and caller, against a line that answers when the test wants it to."""

from __future__ import annotations

import math
import threading
import time

import pytest

from smolbot.bench.hardware.stage import MagnetStage
from smolbot.bench.hardware.stage import stage as driver
from smolbot.bench.hardware.wiring import StageSection
from smolbot.errors import RigError

HEART = "magnet stage heartbeat"


class Board:
    """A board at the other end of a line that loses nothing; a heartbeat's answer can be held back on its way."""

    identity = "smolbot-magnet-stage 1.0"
    port = "nowhere"

    def __init__(self) -> None:
        self.heard: list[str] = []
        self.state = ["OFF", "IDLE", "AWAY", "NONE", "0", "0"]
        self.hold_next_beat = False
        self.held, self.let_go = threading.Event(), threading.Event()

    def exchange(self, command: str, action: str) -> tuple[str, ...]:
        self.heard.append(command)
        verb = command.split()[0]
        if verb == "ARM":
            self.state[0] = "ARMED"
        elif verb == "OFF":
            self.state[:2] = "OFF", "IDLE"
        elif verb == "MOVE":
            self.state[1] = "MOVING"
        if verb != "BEAT":
            return ()
        answer = tuple(self.state)
        if self.hold_next_beat and threading.current_thread().name == HEART:
            self.hold_next_beat = False
            self.held.set()
            self.let_go.wait(0.3)
        return answer

    def make_error(self, action: str, why: str) -> RigError:
        return RigError(f"{action}: {why}")

    def close(self) -> None:
        self.heard.append("closed")


@pytest.fixture
def board(monkeypatch):
    made = Board()
    monkeypatch.setattr(driver, "open_link", lambda port, baud: made)
    return made


@pytest.fixture
def stage(board):
    opened = MagnetStage(StageSection(port="nowhere"))
    opened.open()
    yield opened
    opened.close()


def test_an_old_heartbeat_does_not_end_a_motion_that_has_begun_since(board, stage):
    stage.arm()
    board.hold_next_beat = True
    assert board.held.wait(2.0)
    stage.turn(0.0, 1.0, 0.25)
    board.let_go.set()
    assert not stage.wait(0.15)


def test_an_old_heartbeat_does_not_undo_a_stop(board, stage):
    stage.arm()
    stage.turn(0.0, 1.0, 0.25)
    board.hold_next_beat = True
    assert board.held.wait(2.0)
    stage.stop()
    board.let_go.set()
    end = time.monotonic() + 0.05  # until the next heartbeat the old one would stand
    while time.monotonic() < end:
        stage.check_at_rest()
        time.sleep(0.002)


def test_after_arming_the_axis_is_steered_from_where_it_stands(board, stage):
    """It may have been moved since the last heartbeat: it was stopped on its way, or its board was told by another."""
    stage.arm()
    stage.stop()
    board.state[5] = "4000"  # a quarter of a turn
    stage.arm()
    stage.steer(math.radians(90.0))
    assert not [line for line in board.heard if line.startswith("MOVE")]
    stage.steer(math.radians(99.0))
    assert [line for line in board.heard if line.startswith("MOVE")] == ["MOVE 0 0 400 444"]
