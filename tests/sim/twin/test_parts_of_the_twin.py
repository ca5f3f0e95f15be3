"""Relays, journal, hand and side door of the twin, each by itself."""

from __future__ import annotations

import itertools
import json
import socket
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from sim.twin.card_model import CardModel
from sim.twin.control import ControlServer, TwinControl
from sim.twin.device_server import DeviceServer
from sim.twin.faults import FAULTS, parse_fault
from sim.twin.journal import Journal, OnOffMonitor
from sim.twin.magnet_operator import MagnetOperator
from sim.twin.relays_and_amplifiers import RelaysAndAmplifiers
from smolbot.bench.hardware.waveform import get_line_bit
from smolbot.bench.hardware.wiring import BenchSection
from smolbot.errors import RigError
from tests.sim.twin.conftest import Echo

RATE = 50_000.0
Wiring = tuple[BenchSection, tuple[str, ...]]


def told(section: BenchSection, *names: str) -> int:
    """Levels of the clocked port that close the relays of loads and enable the amplifiers."""
    lines = [load.relay for load in section.loads if load.name in names] + [section.outputs.enable]
    return sum(1 << get_line_bit(line) for line in lines)


def test_two_relays_on_one_output_share_its_current_and_a_muted_amplifier_gives_none(wiring: Wiring) -> None:
    section, _ = wiring
    loads = tuple(load.name for load in section.loads)
    contacts = RelaysAndAmplifiers(section, loads)
    volts = np.zeros((len(section.used_outputs), 400))
    volts[0] = 3.0
    lines = np.full(400, told(section, "+x", "excitation x"), np.uint32)
    lines[300:] &= ~np.uint32(1 << get_line_bit(section.outputs.enable))
    currents, closed, _ = contacts.compute_currents(0, volts, lines)
    both = [loads.index("+x"), loads.index("excitation x")]
    close = round(1e-3 * section.relays.close_ms * RATE)
    gains = np.array([[load.gain_a_per_v] for load in section.loads])[both]
    np.testing.assert_allclose(currents[both, close:300], np.broadcast_to(1.5 * gains, (2, 300 - close)))
    assert not currents[:, :close].any()
    assert not currents[:, 300:].any()
    assert closed[both, 300:].all()


@given(cuts=st.lists(st.integers(1, 999), max_size=8), seed=st.integers(0, 1000))
def test_relays_do_not_care_how_time_is_cut(wiring: Wiring, cuts: list[int], seed: int) -> None:
    section, _ = wiring
    loads = tuple(load.name for load in section.loads)
    rng = np.random.default_rng(seed)
    volts = rng.uniform(-5, 5, (len(section.used_outputs), 1000))
    changes = np.sort(rng.choice(np.arange(1, 1000), 5, replace=False))
    levels = rng.integers(0, 128, 6)
    lines = levels[np.searchsorted(changes, np.arange(1000), side="right")].astype(np.uint32)
    whole = RelaysAndAmplifiers(section, loads).compute_currents(0, volts, lines)[0]
    cut, pieces = RelaysAndAmplifiers(section, loads), []
    edges = [0, *sorted(set(cuts)), 1000]
    for begin, end in itertools.pairwise(edges):
        pieces.append(cut.compute_currents(begin, volts[:, begin:end], lines[begin:end])[0])
    np.testing.assert_array_equal(np.concatenate(pieces, axis=1), whole)


@given(
    runs=st.lists(st.tuples(st.integers(1, 40), st.booleans()), min_size=1, max_size=12),
    cuts=st.lists(st.integers(1, 200), max_size=8),
)
def test_the_journal_does_not_care_how_time_is_cut(runs: list[tuple[int, bool]], cuts: list[int]) -> None:
    pause = 10
    levels = np.concatenate([np.full(length, on) for length, on in runs] + [np.zeros(30, np.bool_)])
    journal = Journal()
    line = OnOffMonitor(journal, "driven", pause)
    edges = sorted({0, len(levels), *(cut for cut in cuts if cut < len(levels))})
    for begin, end in itertools.pairwise(edges):
        line.update(begin, levels[begin:end], 100.0, RATE)
    entries = [(round((e["time"] - 100.0) * RATE), e["on"]) for e in journal.list_since()]

    # independently: bridge what is shorter than the pause, then look for edges
    bridged, since = levels.copy(), 0
    for at in np.flatnonzero(levels):
        if levels[:at].any() and at - since - 1 <= pause:
            bridged[since:at] = True
        since = int(at)
    steps = np.flatnonzero(np.diff(np.concatenate([[0], bridged.astype(int)])))
    assert entries == [(int(at), bool(bridged[at])) for at in steps]
    assert not line.on


def test_the_journal_gives_what_came_after_an_entry() -> None:
    journal = Journal()
    for number in range(5):
        journal.add("thing", which=number)
    seen = journal.list_since()
    assert [e["which"] for e in journal.list_since(seen[2]["number"])] == [3, 4]


def test_the_magnet_operator_moves_late_but_never_early() -> None:
    hand = MagnetOperator(10.0, 0.2, np.random.default_rng(1))
    took = []
    for number in range(40):
        to, begin = ("near", "away")[number % 2], 100.0 * number
        hand.update(to, begin)
        assert hand.magnet_position is None
        time = begin
        while hand.magnet_position is None:
            time += 0.1
            hand.update(to, time)
        assert hand.magnet_position == to
        hand.update(None, time + 1.0)
        assert hand.magnet_position == to
        took.append(time - begin)
    assert min(took) >= 10.0 - 1e-9
    # half of a normal: mean sqrt(2 / pi), of 2 s
    assert np.mean(took) == pytest.approx(10.0 + 2.0 * np.sqrt(2.0 / np.pi), abs=3 * 1.2 / np.sqrt(40))


def test_the_control_interface_answers_and_reports_what_it_does_not_know() -> None:
    heard: list[str] = []
    handlers: dict[str, Callable[..., object]] = {
        "inject": lambda asked: heard.append(parse_fault(asked["fault"]).name),
        "log": lambda asked: [{"number": asked["since"] + 1}],
    }
    server = ControlServer("127.0.0.1", 0, handlers)
    try:
        with TwinControl(f"127.0.0.1:{server.port}") as control:
            control.inject("overrun@listening#30:good")
            assert heard == ["overrun"]
            assert control.read_log(7) == [{"number": 8}]
            with pytest.raises(RigError, match="no fault is named 'flood'"):
                control.inject("flood")
            with pytest.raises(RigError, match='"do": inject, log'):
                control.clear()
        with socket.create_connection(("127.0.0.1", server.port), 2.0) as raw, raw.makefile("rw") as stream:
            stream.write("nonsense\n")
            stream.flush()
            assert "error" in json.loads(stream.readline())
    finally:
        server.close()


def test_a_port_that_is_taken_is_one_clear_error(wiring: Wiring) -> None:
    section, _ = wiring
    model = CardModel(section, Echo(tuple(load.name for load in section.loads)))
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(RigError, match=f"cannot listen on 127.0.0.1:{port}, which is taken.*another twin"):
            DeviceServer(model, f"127.0.0.1:{port}")
        with pytest.raises(RigError, match=f"cannot listen on 127.0.0.1:{port}"):
            ControlServer("127.0.0.1", port, {})


def test_the_command_lists_every_fault_with_its_sentence() -> None:
    from smolbot.ui.cli.app import app

    result = CliRunner().invoke(app, ["twin", "--list-faults", "--json"])
    assert result.exit_code == 0
    assert json.loads(result.stdout) == FAULTS
