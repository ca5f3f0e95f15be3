"""Lines of the magnet stage: what is sent can be read, and nothing that was changed on the way passes."""

from __future__ import annotations

import binascii
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smolbot.bench.hardware.stage import MagnetStage, ports
from smolbot.bench.hardware.stage.protocol import (
    GarbledError,
    compute_checksum,
    find_version_fault,
    format_line,
    parse_reply,
    parse_state,
)
from smolbot.bench.hardware.wiring import StageSection
from smolbot.errors import RigError


@given(st.binary(max_size=80))
def test_the_checksum_is_the_one_of_the_standard_library(text):
    assert compute_checksum(text) == binascii.crc_hqx(text, 0xFFFF)


@given(st.integers(0, 255), st.integers(0, 200), st.integers(0, 6))
def test_a_reply_with_one_bit_changed_is_not_taken(sequence, place, bit):
    good = bytearray(format_line(sequence, "OK ARMED MOVING AWAY NONE 1600 -200")[:-1])
    good[place % len(good)] ^= 1 << bit
    with pytest.raises(GarbledError):
        parse_reply(bytes(good))


@given(st.binary(max_size=80))
def test_noise_is_no_reply(text):
    with pytest.raises(GarbledError):
        parse_reply(text)


def test_states_are_read_and_others_are_not():
    state = parse_state(("ARMED", "MOVING", "NEAR", "NONE", "-5", "7"))
    assert (state.armed, state.moving, state.at, state.turn, state.steering) == (True, True, "near", -5, 7)
    assert parse_state(("OFF", "IDLE", "BOTH", "NONE", "0", "0")).at is None
    for wrong in ((), ("ARMED", "MOVING", "FAR", "NONE", "0", "0"), ("ARMED", "IDLE", "NEAR", "NONE", "x", "0")):
        with pytest.raises(GarbledError):
            parse_state(wrong)


@pytest.mark.parametrize(
    ("identity", "good"),
    [
        (("smolbot-magnet-stage", "1.0"), True), (("smolbot-magnet-stage", "1.7"), True),
        (("smolbot-magnet-stage", "2.0"), False), (("smolbot-magnet-stage", "0.9"), False),
        (("grbl", "1.1"), False), (("smolbot-magnet-stage",), False),
        (("smolbot-magnet-stage", "x"), False), ((), False),
    ],
)  # fmt: skip
def test_only_firmware_of_the_same_major_version_is_taken(identity, good):
    fault = find_version_fault(identity)
    assert (fault is None) == good
    if fault is not None:
        assert "smolbot-magnet-stage 1.0" in fault
        assert all(word in fault for word in identity)


def test_an_absent_port_is_named():
    with pytest.raises(RigError, match=r"magnet stage on /nowhere/tty: opening the port: there is no such port"):
        MagnetStage(StageSection(port="/nowhere/tty")).open()


def test_no_board_on_any_port_says_what_to_do(monkeypatch):
    monkeypatch.setattr(ports, "BOARDS", frozenset())
    with pytest.raises(RigError, match=r"no Arduino Uno on any USB port.*bench\.stage\.port"):
        MagnetStage(StageSection()).open()


def test_a_stage_that_is_not_open_says_so_and_can_be_stopped_and_closed():
    stage = MagnetStage(StageSection(port="/nowhere/tty"))
    stage.stop()
    stage.close()
    with pytest.raises(RigError, match="not open"):
        stage.arm()


def test_importing_the_driver_loads_no_serial_library():
    code = "import sys, smolbot.bench.hardware.stage; sys.exit('serial' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
