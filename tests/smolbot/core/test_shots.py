"""Shots are data: they say what happens when, and what cannot be one shot is refused."""

from __future__ import annotations

import dataclasses
from typing import get_args

import numpy as np
import pytest

from smolbot.core.shots import Actuate, Excite, Listen, Mode, MoveMagnet, Rest, RingDown, Rotate, Shot
from smolbot.errors import InputError
from smolbot.motion.controller import Cycle

F = 103.5
CYCLE = (Actuate((6.2, 0.0, 8.0, 0.0), 0.03), Excite((2.0, -1.0), F, 5), RingDown(0.02), Listen(2, F))


def test_a_shot_prints_as_a_timeline_with_the_names_of_the_coils():
    text = Shot(CYCLE).timeline(("+x", "-x", "+y", "-y"))
    assert text.startswith("0.0 ms actuate +x 6.2 A, +y 8.0 A | 30.0 excite")
    parts = text.split(" | ")
    assert [float(p.split()[0]) for p in parts] == pytest.approx(
        1e3 * np.cumsum([0, 0.03, 5 / F, 0.02, 2 / (2 * F)]), abs=0.051
    )
    assert "-x" not in text
    assert str(Shot((Rest(0.5),))) == "0.0 ms rest | 500.0"


def test_a_shot_of_the_paper_lasts_as_long_as_the_sum_of_its_windows():
    shot = Shot(CYCLE, start=4.0)
    assert shot.duration == pytest.approx(0.03 + 5 / F + 0.02 + 1 / F)
    assert shot.end == pytest.approx(4.0 + shot.duration)
    assert [at for at, _ in shot.timed()] == pytest.approx([0, 0.03, 0.03 + 5 / F, 0.05 + 5 / F])


def test_the_cycle_of_the_paper_runs_at_9_point_2_hertz():
    cycle = Cycle(excite_cycles=5, ring_down=0.020, half_periods=2)
    period = 0.030 + cycle.duration(F)
    assert period == pytest.approx(0.10797, abs=1e-5)
    assert int(10 / period) / 10 == 9.2
    assert Shot(CYCLE).duration == pytest.approx(period)


def test_a_shot_listens_at_most_once():
    with pytest.raises(InputError, match="at most one Listen"):
        Shot((Listen(2, F), Rest(0.1), Listen(2, F)))


@pytest.mark.parametrize("electrical", CYCLE)
@pytest.mark.parametrize("mechanical", [Rotate((0, 0, 1), 0.25, 1.0), MoveMagnet("away", 2.0)])
def test_electrical_and_mechanical_windows_do_not_mix(electrical, mechanical):
    with pytest.raises(InputError, match="either electrical or mechanical"):
        Shot((electrical, mechanical))
    assert Shot((mechanical, Rest(1.0))).duration == pytest.approx(mechanical.duration + 1.0)


@pytest.mark.parametrize(
    "window", [Actuate((1.0,), 0.0), RingDown(-1.0), Rest(float("nan")), Rest(float("inf")), Listen(0, F)]
)
def test_a_window_lasts_a_positive_time(window):
    with pytest.raises(InputError, match="positive and finite"):
        Shot((window,))


def test_an_empty_shot_and_an_unknown_mode_are_refused():
    with pytest.raises(InputError, match="at least one window"):
        Shot(())
    with pytest.raises(InputError, match="quiet, search, track, lost, hold"):
        Shot((Rest(1.0),), mode="panic")


def test_a_shot_cannot_be_changed():
    with pytest.raises(dataclasses.FrozenInstanceError):
        Shot(CYCLE).mode = "hold"


def test_the_drive_of_a_recording_is_the_last_one_before_it_listens():
    first, last = Excite((1.0, 0.0), F, 5), Excite((0.0, 1.0), F, 5)
    assert Shot((first, last, RingDown(0.02), Listen(2, F), first)).excite == last
    assert Shot((Listen(2, F), first)).excite is None
    assert Shot((first,)).listen is None


def test_every_mode_is_a_word_the_record_can_hold():
    for mode in get_args(Mode):
        assert Shot((Rest(0.1),), mode=mode).mode == mode
