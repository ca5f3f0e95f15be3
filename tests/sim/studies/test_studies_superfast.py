"""Superfast: the stage's motion, when sigma passes a limit, and a short study from one drive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim.studies import superfast as study
from sim.studies.study import Options


def test_stage_steps_as_described():
    times = np.linspace(0.0, study.SECONDS, 24_001)
    places, turns = study.make_stepping_track(times)
    speed = np.abs(np.diff(places[:, 0])) / np.diff(times)
    assert speed.max() == pytest.approx(study.TOP_SPEED, rel=1e-3)
    assert places[0, 0] == pytest.approx(-0.025)
    assert places[-1, 0] == pytest.approx(0.025)
    rests = places[1:, 0][speed < 1e-9]
    np.testing.assert_allclose(np.unique(np.round(rests, 6)), np.linspace(-0.025, 0.025, 11), atol=1e-9)
    assert np.ptp(places[:, 1:], axis=0).max() == 0.0
    assert np.ptp(turns, axis=0).max() == 0.0


def test_time_at_which_sigma_passes_a_limit():
    times = np.array([0.5, 1.5, 2.5])
    assert study.find_crossing(times, np.array([0.1, 10.0, 20.0])) == pytest.approx(1.0)
    assert study.find_crossing(times, np.array([0.1, 0.2, 0.3])) is None
    assert study.find_crossing(times, np.array([2.0, 3.0, 4.0])) == 0.5


def test_sigma_is_taken_about_each_benchs_own_mean():
    rng = np.random.default_rng(0)
    n = 4000
    part = {
        "time_s": np.tile(np.linspace(0.0, 0.399, n // 2), 2), "bench": np.repeat([0, 1], n // 2),
        "half_periods": np.full(n, 4),
        **{f"error_{a}_mm": 0.2 * rng.standard_normal(n) + np.repeat([-1.0, 1.0], n // 2) for a in "xyz"},
    }  # fmt: skip
    case = study.summarize_rest(part)
    np.testing.assert_allclose(case["sigma_mm"], 0.2, rtol=0.1)
    np.testing.assert_allclose(case["rms_mm"], np.hypot(1.0, 0.2), rtol=0.05)


def test_outliers_are_the_papers():
    part = {key: np.zeros(4) for key in ("error_x_mm", "error_z_mm", "speed_mm_s", "time_s", "trusted")}
    case = study.summarize_motion({**part, "x_mm": np.array([-1.1, -0.9, 59.0, 61.0])})
    assert (case["n"], case["outliers"]) == (4, 2)


def test_study_follows_a_stepping_device(tmp_path):
    options = Options("superfast", seed=5, poses=1, mismatch=0.0, estimators=("whitened",))
    chunks = [
        replace(c, arguments={**c.arguments, "seconds": min(c["seconds"], 0.5)}) for c in study.make_chunks(options)
    ]
    outcome = study.conclude(options, [c.work(c) for c in chunks])
    cases = {(c["kind"], c["damping"], c["estimator"], c["half_periods"]): c for c in outcome.figures["cases"]}
    rests, steps = cases["rest", "exponential", "whitened", 4], cases["steps", "exponential", "whitened", 4]
    assert rests["under_limit_s"] is None
    assert np.max(rests["sigma_mm"]) < 0.5
    assert steps["outliers"] == 0
    assert steps["rest_rms_mm"] < 0.3
    assert steps["move_rms_mm"] < 1.5
    tracked = cases["rest", "exponential", "tracked", 4]
    assert np.max(tracked["rms_mm"]) < np.max(rests["rms_mm"])
    study.draw(outcome, tmp_path / "superfast.png")
    assert (tmp_path / "superfast.png").stat().st_size > 10_000
