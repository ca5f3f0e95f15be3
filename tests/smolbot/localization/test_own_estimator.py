"""A lab's own estimator is flown by its entry point: `locate` alone is enough; one that learns gets what is learned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import smolbot
from smolbot import Actuate, Localizer, Pose, load_mission
from smolbot.config import plugins
from smolbot.errors import ConfigError, InputError, PluginError
from smolbot.flight.replay import replay
from smolbot.localization.estimator import PoseEstimatorBase
from smolbot.localization.localizer import Paper

SHORT = {"path.points_mm": "[[-1.0, 0.0], [1.5, 0.0]]", "localization.quiet_s": "2.0"}


class Plain(PoseEstimatorBase):
    """Locates with the paper's fit, and knows nothing of oscillations, noise or sensors."""

    def locate(self, recording, prior=None):
        return Localizer(self.sensors, self.device, estimator="paper", volume=self.volume).locate(recording, prior)


class Learning(Plain):
    """The same, with noise as something that it learns."""

    learns = frozenset({"noise"})
    received = ()

    def with_noise(self, noise):
        Learning.received = (*Learning.received, noise)
        return super().with_noise(noise)


class Handed(Localizer):
    """One of ours, under another name."""


def test_an_estimator_that_only_locates_flies_a_mission_to_its_end(plug_in):
    plug_in("estimators", "plain", Plain)
    mission = load_mission("line", settings={**SHORT, "localization.estimator": "plain"})
    run = smolbot.run(mission, seed=3)
    assert run.status == "completed", run.stop_reason
    assert run.summary["verdict"] == "passed"
    assert [event.what for event in run.events] == []
    assert not [c for c in run.cycles if c.shot.mode == "quiet"]
    assert run.begun == 0.0


def test_what_it_locates_is_the_pose_of_the_cycle_bit_for_bit(plug_in):
    plug_in("estimators", "plain", Plain)
    mine, theirs = (
        smolbot.run(
            "line",
            seed=3,
            witness=False,
            path__points_mm=[[-1, 0], [1.5, 0]],
            localization__estimator=name,
            force="preview",
        )
        for name in ("plain", "paper")
    )
    first, other = mine.cycles[0], theirs.cycles[0]  # later ones differ: the tracker weighs the paper's amplitude too
    assert first.shot == other.shot
    assert np.array_equal(first.pose.position, other.pose.position)


def test_an_estimator_that_learns_the_noise_gets_it_once(plug_in):
    plug_in("estimators", "learning", Learning)
    Learning.received = ()
    brief = {"localization.quiet_s": "2.0", "stop.max_duration_s": "1.0", "localization.estimator": "learning"}
    run = smolbot.run(load_mission("line", settings=brief), seed=3, force="preview")
    assert [event.what for event in run.events] == ["noise learned"]
    assert len(Learning.received) == 1
    assert run.begun > 2.0


def test_a_recorded_run_is_replayed_with_a_labs_own_estimator(plug_in, tmp_path):
    plug_in("estimators", "plain", Plain)
    mission = load_mission("line", settings=SHORT)
    run = smolbot.run(mission, seed=3, out=tmp_path / "run", report=False, force="preview")
    again = replay(run.folder, estimator="plain")
    assert again.changed == {"estimator": "plain"}
    assert len(again.cycles) == len(run.cycles)
    assert sum(c.trusted is not None for c in again.cycles) > 0.8 * len(run.cycles)


def test_ours_under_another_name_flies_the_same_flight_bit_for_bit(plug_in):
    plug_in("estimators", "handed", Handed)
    missions = [
        load_mission("line", settings={**SHORT, "localization.estimator": name}) for name in ("whitened", "handed")
    ]
    flights = [smolbot.run(mission, seed=3, witness=False, force="preview") for mission in missions]
    assert [e.what for e in flights[0].events] == [e.what for e in flights[1].events]
    for a, b in zip(flights[0].cycles, flights[1].cycles, strict=True):
        assert a.shot == b.shot
        assert np.array_equal(a.tracked.position, b.tracked.position)


class NotFinite(Plain):
    """Gives poses that are no numbers, or claims no covariance, from the first window on."""

    position, covariance = (np.nan, 0.0, 0.06), 1e-8 * np.eye(6)

    def locate(self, recording, prior=None):
        return Pose(recording.middle, self.position, (1, 0, 0, 0), self.covariance)


class Unsure(NotFinite):
    position, covariance = (0.0, 0.0, 0.06), np.full((6, 6), np.nan)


@pytest.mark.parametrize(
    ("made", "cause"),
    [(NotFinite, "Pose position must be finite"), (Unsure, "the covariance of the pose is not finite")],
)
def test_poses_that_are_not_finite_are_never_trusted_and_the_run_says_so(plug_in, made, cause):
    plug_in("estimators", "odd", made)
    mission = load_mission("line", settings={"localization.estimator": "odd", "stop.lost_shots": "5"})
    run = smolbot.run(mission, seed=3, force="preview")
    assert run.status == "lost"
    assert cause in run.stop_reason
    assert not any(cycle.tracked for cycle in run.cycles)
    assert not any(isinstance(window, Actuate) for cycle in run.cycles for window in cycle.shot.windows)


class Blind:
    learns = frozenset()

    def __init__(self, sensors, device, volume): ...


class Backward(PoseEstimatorBase):
    def locate_swing(self, recording): ...


@pytest.mark.parametrize(
    ("broken", "fault"),
    [
        (Blind, "it has no method locate_swing(recording, prior=None)"),
        (Backward, "locate_swing() lacks the parameter 'prior'"),
    ],
)
def test_an_estimator_that_breaks_its_protocol_is_refused_when_the_mission_is_read(plug_in, broken, fault):
    plug_in("estimators", "bad", broken)
    with pytest.raises(PluginError) as refused:
        load_mission("line", settings={"localization.estimator": "bad"})
    assert fault in str(refused.value)
    assert "Estimator 'bad' (plugged_in_bad:made)" in str(refused.value)


def test_an_estimator_that_is_not_installed_is_a_fault_of_the_file(plug_in):
    with pytest.raises(ConfigError, match=r"localization.estimator.*: no estimator is named 'paler'; installed: paper"):
        load_mission("line", settings={"localization.estimator": "paler"})


def test_the_reduced_plant_refuses_an_estimator_whose_errors_it_does_not_know(plug_in):
    from sim.reduced.rig import open_reduced
    from smolbot.flight.session import fly

    plug_in("estimators", "plain", Plain)
    with pytest.raises(InputError, match="whitened and paper"):
        fly(load_mission("line", settings={"localization.estimator": "plain"}), 1, opener=open_reduced)


@pytest.mark.parametrize(("made", "name"), [(Localizer, "whitened"), (Paper, "paper")])
def test_ours_by_their_entry_points_are_the_public_localizer(made, name, array, along_device):
    assert plugins.load_plugin("estimators", name) is made
    mine, public = made(array, along_device), Localizer(array, along_device, estimator=name)
    assert mine.learns == public.learns == made.learns
    again = mine.with_device(replace(along_device, damping=30.0)).with_transients((1e-3,))
    assert again.device.damping == 30.0
    assert again.transients == (1e-3,)
    assert again.estimator == name
    assert again.noise is mine.noise
