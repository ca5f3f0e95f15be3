"""Pursuit with the true force: it pulls where the path goes, keeps its limits, finishes where the field law stalls."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.current_ratio import compute_aligned_force
from controllers.force_pursuit import ForcePursuit
from smolbot.config.mission import load_steering_mission
from smolbot.config.plugins import load_plugin
from smolbot.core.pose import Pose
from smolbot.core.rotations import quaternion_from_axes
from smolbot.core.shots import Shot
from smolbot.errors import InputError
from smolbot.flight.preview.gradient import preview
from smolbot.paths.curve import Curve
from tests.conftest import setup_of

known = partial(setup_of, "line")
UP, Z = np.array([0.0, 0.0, 1.0]), 0.06
LARGE = {"path.width_mm": "16.0", "path.height_mm": "24.0", "controller.law": "force_pursuit"}


def pose(x_mm, y_mm, heading_deg=0.0):
    h = np.radians(heading_deg)
    q = quaternion_from_axes(np.array([np.cos(h), np.sin(h), 0.0]), UP, "zy")
    return Pose(0.0, np.array([x_mm * 1e-3, y_mm * 1e-3, Z]), q, np.eye(6) * 1e-8)


def straight(start, end):
    return Curve(np.array([[*start, 60.0], [*end, 60.0]]) * 1e-3)


def test_it_is_installed_under_its_name():
    assert load_plugin("controllers", "force_pursuit") is ForcePursuit


@settings(max_examples=40)
@given(st.floats(0, 12), st.floats(-180, 180), st.floats(-180, 180), st.floats(0.5, 8.0), st.floats(-180, 180))
def test_the_true_force_points_to_the_goal_and_no_limit_is_broken(radius, around, toward, distance, heading):
    here = radius * np.array([np.cos(np.radians(around)), np.sin(np.radians(around))])
    way = np.array([np.cos(np.radians(toward)), np.sin(np.radians(toward))])
    law = ForcePursuit(known(), {})
    law.reset(straight(here + distance * way, here + (distance + 3) * way), pose(*here))
    command = law.command(pose(*here, heading))
    assert command.phase == "approach"
    assert known().limits.faults(Shot((command.window,))) == []
    force = compute_aligned_force(
        known().table, np.array(command.window.currents), pose(*here).position, known().robot.moment
    )[:2]
    assert np.degrees(np.arccos(np.clip(force @ way / np.linalg.norm(force), -1, 1))) < 3.2
    assert np.linalg.norm(force) < 121e-6


def test_near_its_goal_it_pulls_no_harder_than_brings_it_there():
    law = ForcePursuit(known(), {"t_min_ms": 60.0, "handover_mm": 0.05})
    law.reset(straight((0, 0), (0.5, 0)), pose(0, 0))
    law.command(pose(0.0, 0.0))
    command = law.command(pose(0.35, 0.0))
    force = compute_aligned_force(
        known().table, np.array(command.window.currents), pose(0.35, 0).position, known().robot.moment
    )
    assert np.linalg.norm(force) * 0.06 / known().robot.drag == pytest.approx(0.15e-3, rel=0.02)
    assert not command.saturated


def test_a_force_that_the_coils_cannot_give_is_reduced_and_reported():
    weak = replace(known(), limits=replace(known().limits, max_current=4.0))
    law = ForcePursuit(weak, {"force_un": 300.0})
    law.reset(straight((5, 0), (8, 0)), pose(0, 0))
    command = law.command(pose(0, 0))
    assert command.saturated
    assert command.note
    assert max(command.window.currents) <= 4.0


def test_where_no_currents_pull_head_first_it_says_so_and_tail_first_goes_on():
    outside, inside = pose(14.5, 14.5, 45.0), (14.0, 14.0)
    head, either = ForcePursuit(known(), {}), ForcePursuit(known(), {"tail_first": 1.0})
    for law in (head, either):
        law.reset(straight((16.0, 16.0), inside), outside)
    refused, pulled = head.command(outside), either.command(outside)
    assert refused.window is None
    assert refused.saturated
    assert "No currents pull" in refused.note
    assert pulled.window is not None


def test_it_would_finish_the_letter_on_which_the_paper_s_law_stalls():
    expected = preview(load_steering_mission("r_small", settings=LARGE))
    assert expected.go
    assert load_steering_mission("r_small", settings=LARGE).path.project(expected.trail[25:])[1].max() < 1.0e-3
    stalled = preview(load_steering_mission("r_small", settings={**LARGE, "controller.law": "current_ratio"}))
    assert not stalled.go
    assert expected.force_profile.force.min() > 20e-6
    assert np.degrees(expected.force_profile.direction_error.max()) < 3.2


def test_the_end_is_handed_over_within_the_tolerance():
    law = ForcePursuit(known(), {"handover_mm": 0.3})
    law.reset(straight((-2, 0), (2, 0)), pose(-2, 0))
    for x in np.arange(-2, 1.69, 0.1):
        assert not law.command(pose(x, 0.05)).done
    last = law.command(pose(1.75, 0.05))
    assert last.done
    assert last.window is None
    assert last.progress == pytest.approx(4e-3)


def test_gains_that_contradict_each_other_are_refused():
    with pytest.raises(InputError, match="t_min_ms must not exceed t_max_ms"):
        ForcePursuit(known(), {"t_min_ms": 90.0, "t_max_ms": 50.0})
    with pytest.raises(InputError, match="call reset first"):
        ForcePursuit(known(), {}).command(pose(0, 0))
