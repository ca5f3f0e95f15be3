"""Robots keep to the speed that a path asks for, by the clock, under every law."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.pace import MAX_CATCH_UP, MAX_DELAY, MIN_STRIDE, Pace
from sim.reduced.rig import open_reduced
from smolbot.config.mission import load_steering_mission
from smolbot.flight.preview.gradient import preview
from smolbot.flight.session import fly
from smolbot.paths.speed_profile import SpeedProfile

PERIOD, SPEED, LENGTH = 0.15, 1e-3, 50e-3


def walked(gain: float, period: float = PERIOD, speed: float = SPEED) -> tuple[float, list[float]]:
    """Time that a robot needs which goes `gain` of every stride that is asked for, and the strides."""
    pace = Pace(SpeedProfile(np.array([0.0, LENGTH]), np.full(2, speed)), PERIOD)
    time, s, strides = 7.0, 0.0, []
    while s < LENGTH - 1e-4:
        strides.append(pace.compute_stride(time, s))
        s += gain * strides[-1]
        time += period
        assert time < 1000.0
    return time - 7.0, strides


@pytest.mark.parametrize("gain", [0.8, 1.0, 1.2])
@pytest.mark.parametrize("period", [0.12, 0.15, 0.2])
@pytest.mark.parametrize("speed", [0.1e-3, 0.3e-3, 1e-3])
def test_the_clock_makes_up_for_robots_and_cycles_that_differ_from_the_plan(gain, period, speed):
    time, strides = walked(gain, period, speed)
    assert time == pytest.approx(LENGTH / speed, rel=0.02)
    assert max(strides) <= max(MAX_CATCH_UP * speed * max(period, PERIOD) * (1 + 1e-9), MIN_STRIDE)
    assert all(stride == 0.0 or stride >= MIN_STRIDE * (1 - 1e-9) for stride in strides)


def test_a_long_wait_is_not_made_up_for():
    pace = Pace(SpeedProfile(np.array([0.0, LENGTH]), np.full(2, SPEED)), PERIOD)
    pace.compute_stride(0.0, 0.0)
    first = pace.compute_stride(100.0, 1e-3)
    assert first == pytest.approx(2.0 * MAX_CATCH_UP * SPEED * PERIOD)  # of a cycle that was missed, and no more
    # it is behind by what patience allows, no more: when it has caught up, it goes as wanted
    s, time = 1e-3, 100.0
    for _ in range(400):
        s += (step := pace.compute_stride(time, s))
        time += PERIOD
        if step < 1.2 * SPEED * PERIOD:
            break
    assert s == pytest.approx(1e-3 + MAX_CATCH_UP / (MAX_CATCH_UP - 1.0) * MAX_DELAY * SPEED, rel=0.1)


@pytest.mark.parametrize(
    ("law", "speed"),
    [("predictive", "0.5"), ("force_pursuit", "0.6"), ("current_ratio", "0.3")],
)
def test_a_mission_takes_as_long_as_its_path_asks_for_and_preview_says_so(law, speed):
    settings = {
        "controller.law": law,
        "path.glyph": "L",
        "path.width_mm": "5.0",
        "path.height_mm": "9.0",
        "path.speed_mm_s": speed,
    }
    mission = load_steering_mission("r_small", None, settings)
    wanted = 14.0 / float(speed)
    expected = preview(mission)
    assert expected.requested_time == pytest.approx(wanted)
    assert expected.path_time == pytest.approx(wanted, rel=0.06)
    run = fly(mission, 3, settings=settings, opener=open_reduced)
    assert run.status == "completed"
    early = 2.0 * mission.tolerance * 1e3 / float(speed) if law == "current_ratio" else 0.0  # start and end of that law
    assert 0.94 * wanted - early < run.summary["path_time_s"] < 1.06 * wanted


def test_bends_are_taken_more_slowly_where_a_limit_is_given():
    settings = {
        "path.glyph": "s",
        "path.width_mm": "10.0",
        "path.height_mm": "15.0",
        "path.speed_mm_s": "1.0",
        "path.lateral_mm_s2": "0.08",
        "controller.law": "force_pursuit",  # it does not stand still to turn
    }
    mission = load_steering_mission("r_small", None, settings)
    assert mission.path.speed is not None
    run = fly(mission, 4, settings=settings, opener=open_reduced)
    assert run.summary["path_time_s"] == pytest.approx(mission.path.speed.duration, rel=0.06)
    follow = [c for c in run.cycles if c.command.phase == "follow" and c.tracked is not None]
    times = np.array([c.shot.end for c in follow])
    progress = np.array([c.command.progress for c in follow])
    parts = np.linspace(0.0, mission.path.length, 13)[2:-1]  # it turns first, and is late then
    seen = np.diff(np.interp(parts, np.maximum.accumulate(progress), times))
    asked = np.diff(np.interp(parts, mission.path.speed.arc, mission.path.speed.times))
    assert asked.max() > 1.5 * asked.min()
    assert np.corrcoef(seen, asked)[0, 1] > 0.85
