"""Shots on the twin's card through the real client library: what is told arrives at the loads, sample by sample."""

from __future__ import annotations

import numpy as np
import pytest

from smolbot.bench.hardware.waveform import Waveform, WaveformCompiler
from smolbot.core.arrays import FloatArray
from smolbot.core.shots import Actuate, Excite, Listen, Rest, Shot
from tests.sim.twin.conftest import Bench, NoGuard

pytestmark = pytest.mark.realtime

RATE = 50_000


def compiled(bench: Bench, *windows: Actuate | Excite | Rest | Listen) -> Waveform:
    return WaveformCompiler(bench.section, bench.coils, RATE).compile(Shot(windows))


def played(bench: Bench, waveform: Waveform) -> FloatArray:
    """Currents (n_loads, samples) in A from the start of the latest shot on."""
    assert bench.model.wait_until_at_rest(1.0)
    shot = [entry for entry in bench.model.journal.list_since() if entry["what"] == "shot"][-1]
    first = round((shot["time"] - bench.model.compute_time(0)) * RATE)
    currents = bench.echo.currents[:, first : first + waveform.samples]
    before = bench.echo.currents[:, max(first - 100, 0) : first]
    assert not before.any()
    return currents


def test_a_shot_reaches_its_loads_in_its_windows_and_no_other(bench: Bench, no_guard: NoGuard) -> None:
    windows = Actuate((1.5, 0.0, 0.0, 3.0), 0.02), Excite((4.0, -2.0), 100.0, 2), Rest(0.01), Listen(2, 100.0)
    waveform = compiled(bench, *windows)
    heard, _ = bench.card.play(waveform, no_guard)
    currents = played(bench, waveform)

    loads, lead = list(bench.echo.loads), bench.section.relays.close_ms * 1e-3
    expected = np.zeros_like(currents)
    time = np.arange(currents.shape[1]) / RATE - lead
    pulling = (time > -1e-9) & (time < 0.02 - 1e-9)
    expected[loads.index("+x"), pulling], expected[loads.index("-y"), pulling] = 1.5, 3.0
    # +x and the first excitation coil share an output: its relay opens first, the sine begins 2 ms late
    for name, current, blanked in (("excitation x", 4.0, 2e-3), ("excitation y", -2.0, 0.0)):
        row = currents[loads.index(name)]
        driving = (time > 0.02 + blanked - 1e-9) & (time < 0.04 - 1e-9)
        sine = current * np.sin(2 * np.pi * 100.0 * (time - 0.02))
        scale = row[driving] @ sine[driving] / (sine[driving] @ sine[driving])
        assert 1.0 <= scale < 1.5  # made larger by what the coil's lag takes
        expected[loads.index(name), driving] = scale * sine[driving]
    np.testing.assert_allclose(currents, expected, atol=1e-9)

    assert heard is not None
    first, count = waveform.listen or (0, 0)
    number = np.rint(1e6 * (heard - np.arange(10)[:, None])).astype(int)
    assert heard.shape == (10, count)
    assert np.all(np.diff(number, axis=1) == 1)  # none lost, none twice
    shot = [entry for entry in bench.model.journal.list_since() if entry["what"] == "shot"][-1]
    assert number[0, 0] == round((shot["time"] - bench.model.compute_time(0)) * RATE) + first


def test_a_shot_that_only_listens_closes_nothing(bench: Bench, no_guard: NoGuard) -> None:
    heard, _ = bench.card.play(compiled(bench, Listen(4, 100.0)), no_guard)
    assert heard is not None
    assert not bench.echo.currents.any()
    assert not [e for e in bench.model.journal.list_since() if e["what"] in ("driven", "closed", "enabled")]


def test_the_journal_tells_each_phase_of_each_shot_and_one_drive(bench: Bench, no_guard: NoGuard) -> None:
    waveform = compiled(bench, Excite((4.0, 0.0), 100.0, 3), Rest(0.01), Listen(2, 100.0))
    for _ in range(2):
        bench.card.play(waveform, no_guard)
    assert bench.model.wait_until_at_rest(1.0)
    entries = bench.model.journal.list_since()
    phases = [(e["phase"], e["shot"]) for e in entries if e["what"] == "phase"]
    assert phases == [("actuation", 1), ("listening", 1), ("actuation", 2), ("listening", 2)]
    for what in ("driven", "closed", "enabled"):
        assert [e["on"] for e in entries if e["what"] == what] == [True, False] * 2  # a sine's zeros end nothing
    on, off = ([e["time"] for e in entries if e["what"] == "driven" and e["on"] is value] for value in (True, False))
    np.testing.assert_allclose(np.subtract(off, on), 0.03, atol=2e-4)


def test_a_stop_from_another_thread_ends_a_shot_at_once(bench: Bench, no_guard: NoGuard) -> None:
    import threading

    from smolbot.errors import RigError

    waveform = compiled(bench, Actuate((2.0, 0.0, 0.0, 0.0), 2.0))
    stopper = threading.Timer(0.1, bench.card.stop)
    stopper.start()
    with pytest.raises(RigError):
        bench.card.play(waveform, no_guard)
    stopper.join()
    assert bench.model.wait_until_at_rest(1.0)
    assert np.count_nonzero(bench.echo.currents[0]) < RATE  # of the 2 s, no more than half
