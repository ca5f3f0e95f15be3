"""A path counts as flown when it was visited in order, whatever the law says of its progress."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest

import smolbot
from controllers.force_pursuit import ForcePursuit
from smolbot.config.mission import load_steering_mission
from smolbot.flight.preview.gradient import preview
from smolbot.paths.curve import Curve
from smolbot.runs.recording.reader import read_run
from smolbot.runs.summary import compute_visits, summarise

ANGLES = np.linspace(0.0, 2.0 * np.pi, 61).tolist()
FIGURE_EIGHT = {
    "path.points_mm": str([[round(5 * math.sin(a), 4), round(3 * math.sin(2 * a), 4)] for a in ANGLES]),
    "path.corner_radius_mm": "0",
    "start.offset_mm": "[0.0, 0.0]",
    "localization.quiet_s": "2",
}


class HalfWay:
    """A law that is content with half of the path."""

    gains: ClassVar = ForcePursuit.gains

    def __init__(self, setup, gains):
        self._law = ForcePursuit(setup, gains)

    def reset(self, path, pose):
        self._law.reset(Curve(path.points[: len(path.points) // 2 + 1]), pose)

    def command(self, pose):
        said = self._law.command(pose)
        return replace(said, progress=2.0 * said.progress)


def eight(law):
    return load_steering_mission("r_path", settings={**FIGURE_EIGHT, "controller.law": law})


@pytest.mark.parametrize("law", ["predictive", "force_pursuit", "current_ratio"])
def test_both_lobes_of_a_figure_eight_begun_at_its_crossing_are_flown(law):
    mission = eight(law)
    shown = preview(mission)
    assert shown.go, shown.reasons
    assert mission.find_visits(shown.trail).share >= 0.99
    assert shown.trail[:, 0].min() < -4e-3
    assert shown.trail[:, 0].max() > 4e-3


def test_a_law_that_leaves_out_half_of_the_path_is_a_no_go_and_does_not_pass(plug_in, tmp_path):
    plug_in("controllers", "half_way", HalfWay)
    mission = eight("half_way")
    shown = preview(mission, seek_remedy=False)
    assert not shown.go
    (reason,) = shown.reasons
    assert "half_way would leave out a part: 5" in reason
    assert "skipped" in reason
    relaxed = load_steering_mission(
        "r_path", settings={**FIGURE_EIGHT, "controller.law": "half_way", "verdict.min_visited_share": "0.5"}
    )
    run = smolbot.run(relaxed, seed=3, out=tmp_path / "run", report=False, force="preview")
    assert run.status == "completed"  # as the law says
    assert run.summary["verdict"] == "passed"  # as was asked for
    assert run.summary["progress_mm"] == pytest.approx(run.summary["path_length_mm"], rel=0.05)
    assert 0.5 <= run.summary["visited_share"] < 0.65
    record = read_run(tmp_path / "run")
    figures = summarise(mission, run, record.trace())
    assert figures["verdict"] == "failed"
    assert any("% of the path visited in order, less than 98 %" in reason for reason in figures["verdict_reasons"])
    blind = [replace(m, truth=None, truth_at_end=None, way=np.zeros((0, 3))) for m in record.moments]
    assert 0.5 <= compute_visits(mission, blind).share < 0.65  # from tracked poses, where nobody knows the truth


def test_the_verdict_may_ask_for_less():
    settings = {**FIGURE_EIGHT, "verdict.min_visited_share": "0.5"}
    mission = load_steering_mission("r_path", settings=settings)
    half = mission.path.at(np.linspace(0.0, 0.5 * mission.path.length, 100))
    assert mission.find_skip_fault(mission.find_visits(half)) is None
    fault = eight("predictive").find_skip_fault(mission.find_visits(half))
    assert "less than 98 %" in fault
    with pytest.raises(smolbot.ConfigError, match="min_visited_share"):
        load_steering_mission("r_path", settings={"verdict.min_visited_share": "1.2"})
