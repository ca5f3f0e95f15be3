"""Missions on paper: one for each reason not to fly, and what is said of those that go."""

from __future__ import annotations

import re

import numpy as np
import pytest

from smolbot.config.mission import load_steering_mission
from smolbot.errors import ConfigError
from smolbot.flight.preview.gradient import preview
from smolbot.flight.session import run

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
    seen = preview(load_steering_mission(str(missions / f"{name}.toml")))
    assert not seen.go
    assert len(seen.reasons) == 1
    assert re.search(NO_GO[name], seen.reasons[0])
    assert np.isnan(seen.duration)
    assert np.isfinite(seen.rate_limit)


@pytest.mark.parametrize("name", ["line", "r_path", "r_small"])
def test_a_shipped_mission_is_a_go(name):
    mission = load_steering_mission(name)
    seen = preview(mission)
    assert seen.go
    assert seen.length == pytest.approx(mission.path.length)
    assert np.linalg.norm(seen.trail[-1][:2] - mission.path.points[-1][:2]) <= mission.tolerance
    assert mission.path.project(seen.trail)[1].max() < 3e-3
    assert seen.force_profile.force.min() > 1e-6
    assert mission.rig.limits.faults(seen.shot) == []
    assert seen.shot.listen is not None


def test_the_timeline_limits_the_rate_and_the_turnaround_lowers_it(line):
    seen = preview(line)
    rest = line.cycle.duration(line.robot.device.frequency)
    assert 1 / (0.08 + rest) < seen.rate_limit < 1 / rest
    assert 1 / seen.rate == pytest.approx(1 / seen.rate_limit + line.rig.turnaround)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["line", "r_path", "r_small"])
def test_the_expected_duration_is_within_15_percent_of_the_flown_one(name):
    flown = [run(name, seed=seed).duration for seed in range(1, 9)]
    assert np.mean(flown) == pytest.approx(preview(load_steering_mission(name)).duration, rel=0.15)
