"""The promise of a rig, kept by the bench on its twin: it refuses what the tank refuses; faults bring it to rest."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from sim.measure.fault_cases import copy_rig_with_ports
from sim.twin.faults import parse_fault
from sim.twin.twin import Twin
from smolbot.bench.check.checkup import check_rig
from smolbot.bench.hardware.rig import BenchRig
from smolbot.bench.hardware.world import BenchWorld
from smolbot.config.rig import RigConfig, load_rig
from smolbot.config.robot import load_robot
from smolbot.core.operator import SilentOperator
from smolbot.core.rig import Checkable, Rig, Witness
from smolbot.core.shots import Actuate, Excite, Listen, MoveMagnet, RingDown, Shot
from smolbot.errors import InterlockError, OperatorStopError, RigError

pytestmark = pytest.mark.realtime

CYCLE = Shot((Actuate((8.0, 0.0, 3.0, 0.0), 0.03), Excite((6.0, 6.0), 103.5, 5), RingDown(0.02), Listen(2, 103.5)))
QUIET = Shot((Listen(4, 103.5),), mode="quiet")
PULL = Shot((Actuate((0.0, 2.0, 0.0, 0.0), 0.02),))


def free_ports(count: int) -> int:
    """The first of `count` ports in a row that nobody has."""
    for first in range(33_000, 60_000, 10):
        with ExitStack() as held:
            try:
                for port in range(first, first + count):
                    held.enter_context(socket.create_server(("127.0.0.1", port)))
            except OSError:
                continue
            return first
    raise AssertionError("no ports are free")


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> RigConfig:
    folder: Path = tmp_path_factory.mktemp("rig")
    return load_rig(str(copy_rig_with_ports("twin", folder, free_ports(4))))


@pytest.fixture(scope="module")
def twin(config: RigConfig) -> Iterator[Twin]:
    running = Twin(config, load_robot("gradient"), np.zeros(2), 4, control="127.0.0.1:0")
    yield running
    running.close()


@pytest.fixture
def rig(config: RigConfig, twin: Twin) -> Iterator[BenchRig]:
    twin.card.faults.clear()
    opened = BenchWorld.open(config, load_robot("gradient"), (0.0, 0.0), 0, operator=SilentOperator())
    yield opened
    opened.close()
    twin.card.faults.clear()


def at_rest(twin: Twin) -> bool:
    state = twin.card.read_state()
    return not state["driven"] and not state["relays_closed"] and not any(state["outputs_v"])


def test_bench_keeps_the_shape_of_the_promise(rig: BenchRig) -> None:
    assert isinstance(rig, Rig)
    assert isinstance(rig, Checkable)
    assert isinstance(rig.witness, Witness)
    assert all(item.ok for item in rig.checks())


def test_a_cycle_is_recorded_as_in_the_tank(rig: BenchRig, twin: Twin) -> None:
    asked = rig.now()
    heard = rig.play(CYCLE)
    assert heard is not None
    assert heard.field.shape == (10, round(CYCLE.listen.duration * 50_000))
    assert heard.time_since_drive == pytest.approx(0.02, abs=5e-5)
    assert heard.drive == CYCLE.excite
    assert heard.clock > asked + CYCLE.duration - CYCLE.listen.duration
    assert np.ptp(heard.field, axis=1).max() > 2e-8
    assert not heard.saturated.any()
    assert at_rest(twin)


def test_pulls_that_nothing_listens_to_and_quiet_shots_are_played(rig: BenchRig, twin: Twin) -> None:
    assert rig.play(PULL) is None
    quiet = rig.play(QUIET)
    assert quiet is not None
    assert quiet.drive is None
    assert quiet.time_since_drive > 1e3
    assert at_rest(twin)


@pytest.mark.parametrize(
    "bad",
    [
        Shot((Actuate((9.0, 0, 0, 0), 0.03),)),
        Shot((Excite((11.0, 0.0), 103.5, 5),)),
        Shot((MoveMagnet("near", 1.0),)),
        Shot((Excite((1.0, 0.0), 103.5, 5), Listen(2, 103.5))),
    ],
)
def test_what_the_tank_refuses_the_bench_refuses(rig: BenchRig, twin: Twin, bad: Shot) -> None:
    shots = twin.card.read_state()["shots"]
    with pytest.raises(InterlockError, match="Nothing was played"):
        rig.play(bad)
    assert twin.card.read_state()["shots"] == shots


def test_stop_latches(rig: BenchRig, twin: Twin) -> None:
    rig.stop()
    rig.stop()
    with pytest.raises(RigError, match="open it anew"):
        rig.play(QUIET)
    assert at_rest(twin)


def test_one_lost_window_is_counted_and_two_end_it(rig: BenchRig, twin: Twin) -> None:
    twin.inject(parse_fault("read_timeout@now"))
    assert rig.play(CYCLE) is None
    assert rig.recovered["lost windows"] == 1
    assert rig.play(CYCLE) is not None
    twin.inject(parse_fault("overrun@now:good"))
    assert rig.play(CYCLE) is None
    shots = twin.card.read_state()["shots"]
    with pytest.raises(RigError, match="2 windows in a row were lost"):
        rig.play(CYCLE)
    assert twin.card.read_state()["shots"] == shots  # nothing was driven again
    assert at_rest(twin)


def test_the_operators_button_stops_a_shot(rig: BenchRig, twin: Twin) -> None:
    twin.inject(parse_fault("button@now:good"))
    with pytest.raises(OperatorStopError, match="button"):
        for _ in range(5):
            rig.play(CYCLE)
    assert at_rest(twin)


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("device_gone@now:good", r"Dev1.*-201003"),
        ("value_out_of_range@now:good", r"Dev1 did not play a shot.*-200077"),
        ("relay_stuck@now:good", r"Dev1: a relay did not open"),
        ("watchdog_expired@actuation#1", r"Dev1.*watchdog"),
    ],
)
def test_a_fault_names_device_and_action(rig: BenchRig, twin: Twin, fault: str, said: str) -> None:
    twin.inject(parse_fault(fault))
    with pytest.raises(RigError, match=said):
        for _ in range(3):
            rig.play(CYCLE)
    with pytest.raises(RigError, match=said):  # latched
        rig.play(QUIET)


def test_a_second_client_cannot_begin_while_the_button_is_pressed(config: RigConfig, twin: Twin) -> None:
    twin.card.faults.clear()
    twin.inject(parse_fault("button@now:good"))
    with pytest.raises(RigError, match="button.*\n.*nothing was energised"):
        BenchWorld.open(config, load_robot("gradient"), (0.0, 0.0), 0, operator=SilentOperator())
    twin.card.faults.clear()


def test_a_healthy_bench_passes_its_check_and_its_relays_are_timed(
    rig: BenchRig, twin: Twin, config: RigConfig
) -> None:
    found = check_rig(rig, config, noise_duration=2.0)
    assert found.faults == []
    for coil in found.coils:
        assert coil.closes == pytest.approx(1e-3, abs=1e-4)  # the twin's relays take what the rig file says
        assert coil.opens == pytest.approx(1e-3, abs=1e-4)
        assert coil.gain == pytest.approx(1.0, abs=0.15)
    assert at_rest(twin)


def test_slow_relays_a_dead_sensor_and_swapped_wires_are_found(
    rig: BenchRig, twin: Twin, config: RigConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    contacts = twin.card._contacts
    monkeypatch.setattr(contacts, "_close", round(4e-3 * 50_000))
    monkeypatch.setattr(contacts, "_bits", contacts._bits[[0, 1, 3, 2, 4, 5]])  # +y and -y
    monkeypatch.setattr(contacts, "_output", contacts._output[[0, 1, 3, 2, 4, 5]])
    twin.inject(parse_fault("sensor_dead@now:good"))
    faults = check_rig(rig, config, noise_duration=2.0).faults
    assert "sensor 0 (ai0): dead: every sample is the same" in faults
    assert "coil +y: this is the field of -y" in faults
    assert "coil -y: this is the field of +y" in faults
    late = [fault for fault in faults if "its field comes 4.0 ms late, limit 1.5 ms" in fault]
    assert len(late) == 6
    assert at_rest(twin)


def test_without_sensors_no_coil_is_blamed(rig: BenchRig, twin: Twin, config: RigConfig) -> None:
    twin.inject(parse_fault("sensors_saturated@now:good"))
    found = check_rig(rig, config, noise_duration=2.0)
    assert len([fault for fault in found.faults if fault.endswith("saturated")]) == 10
    assert not found.coils
    assert "Fewer than 3 sensors" in found.notes[0]


def test_a_probe_that_breaks_a_limit_is_refused(rig: BenchRig, twin: Twin) -> None:
    shots = twin.card.read_state()["shots"]
    with pytest.raises(InterlockError, match="Nothing was played"):
        rig.probe("+x", 9.0)
    assert twin.card.read_state()["shots"] == shots
