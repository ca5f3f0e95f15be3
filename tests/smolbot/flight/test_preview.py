"""Missions on paper: one for each reason not to fly, and what is said of those that go."""

from __future__ import annotations

import functools
import re

import numpy as np
import pytest

from smolbot.config.mission import load_steering_mission
from smolbot.core.shots import RingDown, Shot
from smolbot.errors import ConfigError
from smolbot.flight.assembly import make_safety
from smolbot.flight.preview.gradient import preview
from smolbot.flight.preview.model_world import ModelWorld, Perturbation
from smolbot.flight.preview.rollout import RolloutParts, expect_cycle
from smolbot.flight.safety.heat_store import HeatMemory
from smolbot.flight.session import run
from tests.conftest import mission_of

UNFIT = {
    "path_outside_tank": r"path_outside_tank\.toml:6: path: \(21\.0, 0\.0\) mm lies outside the tank; .* to \(",
    "start_outside_tank": r"start_outside_tank\.toml:13: start: \(-21\.0, 0\.0\) mm lies outside the tank; .* to \(",
    "path_outside_table": r"path_outside_table\.toml:6: path: \(9\.0, 0\.0, 60\.0\) mm lies outside the field table, "
    r"which covers x -7 to 7, y -7 to 7, z 57 to 63 mm",
    "tolerance_under_error": r"tolerance_under_error\.toml:11: controller\.tolerance_mm: 0\.1 mm lies under the "
    r"localization error .* 0\.\d+ mm",
    "cycle_breaks_limit": r"cycle_breaks_limit\.toml:13: cycle: Excite must last at most 200 ms; got 386\.5 ms",
}
NO_GO = {
    "law_breaks_limit": r"current_ratio would break a limit near .*Actuate must last at most 100 ms; got 1\d\d\.\d ms",
    "stalls": r"would stall near \(.*\) mm, .* of 8\d\.\d mm .*does not point where it should",
    "stalls_larger": r"would stall near \(.*\) mm, .* of 100\.\d mm .*does not point where it should",
    "too_slow": r"would not end within max_duration_s = 5 s: \d\.\d of 8\.0 mm",
    "leaves_table": r"would leave the field table near \(-2\d\.\d, ",
}


def test_every_mission_that_must_not_fly_has_its_reason_here(missions):
    assert {p.stem for p in missions.glob("*.toml")} == {*UNFIT, *NO_GO, "narrow_table"}


@pytest.mark.parametrize("name", UNFIT)
def test_a_mission_that_does_not_fit_is_refused_for_exactly_its_reason(missions, name):
    with pytest.raises(ConfigError) as error:
        load_steering_mission(str(missions / f"{name}.toml"))
    faults = str(error.value).splitlines()
    assert len(faults) == 1
    assert re.search(UNFIT[name], faults[0])


@pytest.mark.parametrize("name", NO_GO)
def test_a_mission_that_would_not_end_is_a_no_go_for_exactly_its_reason(missions, name):
    seen = preview(load_steering_mission(str(missions / f"{name}.toml")), seek_remedy=False)
    assert not seen.go
    assert len(seen.reasons) == 1
    assert re.search(NO_GO[name], seen.reasons[0])
    assert np.isnan(seen.duration)
    assert np.isfinite(seen.rate_limit)


@functools.cache
def preview_of(name):
    """The preview of a shipped mission, computed once for all tests that look at it."""
    return preview(mission_of(name))


@pytest.mark.parametrize("name", ["line", "r_path", "r_small"])
def test_a_shipped_mission_is_a_go(name):
    mission = mission_of(name)
    seen = preview_of(name)
    assert seen.go
    assert seen.length == pytest.approx(mission.path.length)
    assert np.linalg.norm(seen.trail[-1][:2] - mission.path.points[-1][:2]) <= mission.tolerance
    assert mission.path.project(seen.trail)[1].max() < 3e-3
    assert seen.force_profile.force.min() > 1e-6
    assert mission.rig.limits.faults(seen.shot) == []
    assert seen.shot.listen is not None


def test_the_timeline_limits_the_rate_and_the_turnaround_lowers_it(line):
    seen = preview_of("line")
    rest = line.cycle.duration(line.robot.device.frequency)
    assert 1 / (0.08 + rest) < seen.rate_limit < 1 / rest
    assert 1 / seen.rate == pytest.approx(1 / seen.rate_limit + line.rig.turnaround)


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"rig.limits.max_current_a": "80"}, r"after \d+ s near .*: Coil '.*' would reach .* °C .*max_temperature_c"),
        ({"rig.safety.max_duty": "0.3"}, r"after \d+ s near .*: Coil '.*' would be driven for .* \(max_duty\)"),
        ({"rig.limits.max_current_a": "2"}, r"would stall .*with 0 to 2 A in each of 4 coils, predictive finds"),
        ({"verdict.mean_localization_mm": "0.2"}, r"would err by 0\.\d\d mm in the mean, more than mean_localization"),
    ],
)  # fmt: skip
def test_heat_duty_weak_coils_and_poor_poses_are_foreseen(settings, reason):
    seen = preview(load_steering_mission("r_path", settings=settings), seek_remedy=False)
    assert len(seen.reasons) == 1
    assert re.search(reason, seen.reasons[0])


def test_coils_that_an_earlier_run_has_left_hot_are_taken_as_hot(cold_coils):
    mission = load_steering_mission("r_path")
    heat = make_safety(mission.rig, mission).heat
    heat.temperatures = [89.0 if coil is not None else 25.0 for coil in heat.coils]
    HeatMemory.from_rig_name(mission.rig.name).keep(heat, now=True)
    assert "max_temperature_c" in preview(mission, seek_remedy=False).reasons[0]


def test_the_cycle_is_the_one_that_a_flight_learns():
    learned, fixed = load_steering_mission("r_path"), load_steering_mission("line")
    assert expect_cycle(learned).ring_down == pytest.approx(12e-3)  # twelve time constants of 1 ms
    assert expect_cycle(fixed) == fixed.cycle


def test_a_liquid_that_flows_carries_a_robot_that_nothing_pulls():
    mission = load_steering_mission("line", settings={"rig.medium.flow_mm_s": "0.5"})
    parts = RolloutParts.prepare(mission)
    worlds = [ModelWorld(mission, parts.setup, parts.errors, Perturbation(), seed) for seed in range(4)]
    for world in worlds:
        start = world.position
        world.play(Shot((RingDown(2.0),)), 0.0)
        assert np.linalg.norm(world.position - start) == pytest.approx(1e-3)
    assert len({round(float(np.arctan2(*world.flow)), 3) for world in worlds}) == 4


@pytest.mark.slow
@pytest.mark.parametrize("name", ["line", "r_path", "r_small"])
def test_figures_told_are_those_flown(name):
    flown = [run(name, seed=seed).summary for seed in range(1, 9)]
    told = preview_of(name)

    def mean(*keys):
        return np.mean([functools.reduce(dict.__getitem__, keys, summary) for summary in flown])

    assert told.duration == pytest.approx(mean("duration_s"), rel=0.1)
    assert told.coil_energy == pytest.approx(mean("coil_energy_j"), rel=0.15)
    assert told.rate == pytest.approx(mean("loop_rate_hz"), rel=0.02)
    assert told.mean_localization_error == pytest.approx(mean("localization_error_mm", "mean") * 1e-3, rel=0.35)
