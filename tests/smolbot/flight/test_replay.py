"""Replay: the same settings give the same poses, bit for bit; others what they would have given."""

from __future__ import annotations

import datetime
import json
import os
import subprocess
import sys
from dataclasses import replace

import pytest

from smolbot.config.device import DeviceConfig, write_device
from smolbot.config.load import load_mission
from smolbot.config.plugins import load_world
from smolbot.errors import ConfigError, InputError
from smolbot.flight.replay import compute_figures, compute_pose_differences, replay
from smolbot.flight.session import fly
from smolbot.runs.folder import RunFolder
from smolbot.runs.recording.reader import read_run

SHORT = {"path.points_mm": "[[-1.0, 0.0], [1.5, 0.0]]", "start.offset_mm": "[-0.5, 0.3]", "localization.quiet_s": "2.0"}
DECAY = {"localization.learn_ring_down": "true"}


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A short flight that learns all that can be learned, and its folder."""
    folder = tmp_path_factory.mktemp("replay") / "run"
    settings = {**SHORT, **DECAY}
    return fly(load_mission("line", None, settings), 3, folder=RunFolder(folder), settings=settings), folder


class Missing:
    """A rig that loses some of its windows."""

    def __init__(self, rig, lost):
        self._rig = rig
        self._lost = lost
        self._played = 0

    def __getattr__(self, name):
        return getattr(self._rig, name)

    def play(self, shot):
        self._played += 1
        recording = self._rig.play(shot)
        return None if self._played in self._lost else recording


def test_the_same_settings_give_the_same_poses_bit_for_bit(flown):
    run, folder = flown
    again = replay(folder)
    assert again.first_difference() is None
    assert len(again.cycles) == len(run.cycles) > 20
    for mine, theirs in zip(run.cycles, again.cycles, strict=True):
        assert mine.pose.position.tobytes() == theirs.pose.position.tobytes()
        assert mine.tracked.covariance.tobytes() == theirs.tracked.covariance.tobytes()
    assert compute_pose_differences(again)["distance_mm"]["max"] == 0.0


def test_what_was_learned_in_flight_is_learned_again(flown):
    run, folder = flown
    learned = {event.what for event in run.events}
    assert {"noise learned", "ring-down learned", "coil tails learned", "array learned"} <= learned
    recorded = read_run(folder).events
    assert [(e.time, e.what) for e in recorded] == [(e.time, e.what) for e in run.events]
    assert [json.loads(json.dumps(e.detail)) for e in run.events] == [e.detail for e in recorded]


@pytest.mark.parametrize("lost", [{7, 30, 31, 32}, {9, 10, 25}])
def test_a_flight_that_lost_windows_is_replayed_bit_for_bit(tmp_path, lost):
    mission = load_mission("line", None, {**SHORT, **DECAY, "stop.lost_shots": "8"})

    def lossy(mission, seed):
        world = load_world("tank", mission.rig.document)
        return Missing(world.open(mission.rig, mission.robot, mission.start_placement, seed), lost)

    run = fly(mission, 4, folder=RunFolder(tmp_path / "run"), opener=lossy)
    again = replay(tmp_path / "run")
    assert again.first_difference() is None
    assert len(again.cycles) == len(run.cycles) > 5


def test_a_replay_does_not_depend_on_how_many_threads_a_machine_lends(flown):
    """It was flown with one thread, and is replayed with one by the other tests."""
    look = f"from smolbot.flight.replay import replay; print(replay({str(flown[1])!r}).first_difference())"
    done = subprocess.run(
        [sys.executable, "-c", look], env={**os.environ, "OPENBLAS_NUM_THREADS": "2"},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.strip().endswith("None")


def test_a_replay_does_not_know_the_truth(flown):
    record = read_run(flown[1])
    blind = replace(record, moments=[replace(m, truth=None, truth_at_end=None) for m in record.moments])
    assert replay(blind).first_difference() is None


def test_fewer_half_periods_locate_less_well(flown):
    found = compute_figures(replay(flown[1], half_periods=1))
    assert found["replayed"]["sigma_mm_median"] > 1.4 * found["recorded"]["sigma_mm_median"]
    assert found["replayed"]["localization_error_mm"]["mean"] > found["recorded"]["localization_error_mm"]["mean"]


def test_the_papers_estimator_locates_less_well_in_the_same_windows(flown):
    again = replay(flown[1], estimator="paper")
    found = compute_figures(again)
    assert found["replayed"]["windows"] == found["recorded"]["windows"]
    assert found["replayed"]["localization_error_mm"]["mean"] > found["recorded"]["localization_error_mm"]["mean"]
    assert again.first_difference().startswith("cycle 0, pose")


def test_another_device_is_used(flown, tmp_path):
    device = load_mission("line").robot.device
    robot = load_mission("line").robot.name
    slower = replace(device, frequency=0.95 * device.frequency)
    write_device(tmp_path / "mine.toml", DeviceConfig(robot, "tank", datetime.date(2026, 11, 25), slower))
    again = replay(flown[1], device=tmp_path / "mine.toml")
    left = [[1.0 - c.pose.r_squared for c in cycles] for cycles in (again.cycles, flown[0].cycles)]
    assert left[0][0] > 3.0 * left[1][0]  # a device with a lower assumed frequency does not fit the recordings


def test_a_device_file_of_another_robot_is_refused(flown, tmp_path):
    device = load_mission("line").robot.device
    write_device(tmp_path / "other.toml", DeviceConfig("helical", "tank", datetime.date(2026, 11, 25), device))
    with pytest.raises(ConfigError, match="helical"):
        replay(flown[1], device=tmp_path / "other.toml")


@pytest.mark.parametrize("half_periods", [0, 3, -1])
def test_half_periods_that_were_not_recorded_are_refused(flown, half_periods):
    with pytest.raises(InputError, match="must lie within 1 and 2"):
        replay(flown[1], half_periods=half_periods)


def test_a_run_of_the_reduced_plant_has_nothing_to_locate_in(tmp_path):
    from sim.reduced.rig import open_reduced

    fly(load_mission("line", None, SHORT), 1, folder=RunFolder(tmp_path / "run"), opener=open_reduced)
    with pytest.raises(InputError, match="reduced plant make no signals"):
        replay(tmp_path / "run")


MISSIONS = ["line", "r_small", "r_path", "s_path", "s_path_blocked", "endoscope", "brain_marker"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed", "settings"),
    [
        *((name, 1, {}) for name in MISSIONS),
        ("r_path", 2, {"localization.estimator": "paper"}),
        ("r_path", 3, {"cycle.half_periods": "6"}),
        ("r_small", 4, {"controller.law": "current_ratio"}),
    ],
)
def test_ten_missions_are_replayed_bit_for_bit(tmp_path, name, seed, settings):
    fly(load_mission(name, None, settings), seed, folder=RunFolder(tmp_path / "run"))
    again = replay(tmp_path / "run")
    assert again.first_difference() is None
    assert len(again.cycles) == len(again.record.moments) > 9


def test_a_figure_that_is_no_picture_is_refused_before_anything_is_played(flown, tmp_path):
    from smolbot.ui.cli.replay import replay as command

    for out in (tmp_path / "figure", tmp_path / "figure.xls"):
        with pytest.raises(InputError, match=r"one of \.png"):
            command(flown[1], estimator="paper", out=out)
    assert not any(tmp_path.iterdir())


def test_a_record_that_ends_before_the_first_cycle_is_reported(flown, tmp_path):
    record = read_run(flown[1])
    record.moments, record.shot_of_cycle, record.whole = [], [], False
    with pytest.raises(InputError, match="no cycle.*cut short"):
        replay(record)


def test_faults_of_a_recorded_mission_name_the_record(flown):
    record = read_run(flown[1])
    mission = record.mission()
    for document in (mission.document, mission.rig.document, mission.robot.document):
        assert document.path.parent == record.path
    record.begin.files["rig.toml"] += b"nonsense = 1\n"
    with pytest.raises(ConfigError) as caught:
        record.mission()
    assert f"{record.path}/rig.toml:" in str(caught.value)
