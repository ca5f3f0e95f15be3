"""A robot that gets nowhere: told apart from one that is slow, waits or is searched for, and ended with its reason."""

from __future__ import annotations

import numpy as np
import pytest

import smolbot
from sim.reduced.rig import open_reduced
from smolbot.config.load import load_mission
from smolbot.core.shots import Actuate
from smolbot.errors import InputError
from smolbot.flight.session import fly
from smolbot.flight.stall import STALL_TIME, StallMonitor
from smolbot.motion.controller import Command
from smolbot.paths.curve import Curve
from smolbot.paths.speed_profile import SpeedProfile

CYCLE = 0.15
DRIVING = Command(Actuate((1.0,), 0.1))
EIGHT = np.linspace(0.0, 2.0 * np.pi, 400)
PATHS = {
    "line": Curve([[0, 0, 0.06], [0.02, 0, 0.06]]),
    "eight": Curve(np.column_stack([8e-3 * np.sin(EIGHT), 5e-3 * np.sin(2 * EIGHT), np.full(400, 0.06)])),
    "there and back": Curve([[0, 0, 0.06], [0.01, 0, 0.06], [0, 0, 0.06]]),
}
TOO_WEAK = {"controller.law": "force_pursuit", "rig.limits.max_current_a": "1", "localization.quiet_s": "1"}


def watch(path, speed, noise=0.0, seconds=60.0, seed=0, steered=CYCLE, command=DRIVING):
    """Time in s after which a robot that goes along a path at a speed, in m/s, counts as stalled; None if it ends."""
    monitor, rng = StallMonitor(path), np.random.default_rng(seed)
    for k in range(int(seconds / CYCLE)):
        s = speed * k * CYCLE
        if s >= path.length:
            return None
        place = path.at(s) + noise * rng.standard_normal(3)
        if monitor.update(place, command, steered) is not None:
            return (k + 1) * CYCLE
    return None


@pytest.mark.parametrize("name", PATHS)
@pytest.mark.parametrize("noise", [0.0, 0.15e-3])
def test_a_robot_that_stands_still_has_stalled_in_twice_that_time_at_most_however_its_poses_err(name, noise):
    ended = watch(PATHS[name], 0.0, noise)
    assert STALL_TIME <= ended < 2.0 * STALL_TIME


@pytest.mark.parametrize("name", PATHS)
@pytest.mark.parametrize("speed", [0.05e-3, 2e-3])
def test_a_robot_that_goes_on_has_not_stalled_however_slowly_and_wherever_the_path_crosses(name, speed):
    assert watch(PATHS[name], speed, 0.1e-3, seconds=120.0) is None


def test_time_in_which_nothing_steers_does_not_count():
    assert watch(PATHS["line"], 0.0, seconds=300.0, steered=0.0) is None


def test_a_robot_on_its_way_to_the_start_advances_by_coming_nearer():
    path, approach = PATHS["line"], Command(Actuate((1.0,), 0.1), phase="approach")
    monitor = StallMonitor(path)
    for k in range(400):
        assert monitor.update(np.array([-0.01 + 0.1e-3 * k * CYCLE, 0.0, 0.06]), approach, CYCLE) is None
    ended = [monitor.update(np.array([-0.004, 0.0, 0.06]), approach, CYCLE) for _ in range(200)]
    assert ended[-1] is not None


def test_progress_that_only_the_law_tells_is_an_advance_too():
    monitor = StallMonitor(PATHS["line"])
    for k in range(400):
        told = Command(Actuate((1.0,), 0.1), progress=0.05e-3 * k * CYCLE)
        assert monitor.update(np.array([-3e-3, 0.0, 0.06]), told, CYCLE) is None


def test_a_path_that_is_to_be_followed_slowly_gives_more_time():
    steady = SpeedProfile(np.array([0.0, 0.02]), np.array([0.05e-3, 0.05e-3]))
    slow = Curve(PATHS["line"].points, steady)
    assert watch(slow, 0.0, seconds=200.0) > STALL_TIME + 30.0


@pytest.fixture
def no_remedies(monkeypatch):
    """Remedies have tests of their own, and take far longer than what is tested here."""
    monkeypatch.setattr("smolbot.flight.preview.gradient.find_remedy", lambda *_, **__: "")


def test_a_flight_that_gets_nowhere_ends_stuck_with_the_reason_that_the_preview_gives(no_remedies):
    mission = load_mission("line", settings=TOO_WEAK)
    seen = smolbot.preview(mission)
    run = fly(mission, 3, opener=open_reduced)
    assert not seen.go
    assert run.status == "stuck"
    assert run.duration - run.begun < 1.5 * STALL_TIME
    cause = "with 0 to 1 A in each of 4 coils, force_pursuit finds hardly any force along the path there."
    assert "would stall near" in seen.reasons[0]
    assert "stalled near" in run.stop_reason
    assert seen.reasons[0].endswith(cause)
    assert run.stop_reason.endswith(cause)


def test_what_the_preview_calls_no_go_is_not_flown_unless_forced(no_remedies, tmp_path):
    brief = {"stop__max_duration_s": 1.0, "localization__quiet_s": 0.0}
    out = tmp_path / "run"
    for use in (
        lambda **more: smolbot.run("line", seed=1, out=out, report=False, **brief, **more),
        lambda **more: smolbot.simulate("line", [1], plant="reduced", out=out, **brief, **more),
        lambda **more: smolbot.tune("line", trials=2, worlds=1, held_out=1, out=out, **brief, **more),
    ):
        with pytest.raises(InputError, match=r"no-go: it would not end within max_duration_s = 1 s.*--force preview"):
            use()
        assert not out.exists()
        with pytest.raises(InputError, match="force must be one of preview; got 'limits'"):
            use(force="limits")
    assert smolbot.run("line", seed=1, force="preview", **brief).status == "timeout"
    assert smolbot.simulate("line", [1], plant="reduced", force="preview", **brief).flights[0].summary["cycles"] > 1
