"""Layouts: the search's arithmetic is the bound's, errors of sensors are what fits of them give, results hold."""

from __future__ import annotations

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from sim.studies import layout as study
from sim.studies.benches import load_rig_once
from sim.studies.layout_search import BLOCK, Layout, LayoutScorer, Search
from sim.studies.layout_value import Mismatch, Poses, Volume, evaluate_layout_value
from sim.studies.study import Options
from smolbot.config.feasibility import make_noise_levels
from smolbot.config.rig import load_rig
from smolbot.core.rotations import matrix_from_quaternion, quaternion_from_rotation_vector
from smolbot.localization.bounds import compute_pose_bound
from smolbot.localization.noise.whitening import make_whitened_model
from smolbot.localization.problem import Problem

RIG = load_rig("tank")
LEVELS = make_noise_levels(RIG)
DEVICES = tuple(study.make_devices().values())
WINDOW = study.make_window(RIG)
POSES = Volume().make_poses(2, 1, 0)


def make_scorer(weight: float, draws: int = 2) -> LayoutScorer:
    return LayoutScorer(DEVICES, LEVELS, WINDOW, POSES, RIG.sensors.bandwidth, Mismatch(), weight, draws)


def start() -> Layout:
    found = study.find_layout(RIG.sensors)
    assert found is not None
    return found


def test_score_of_the_search_is_the_bound():
    layout = start()
    scorer = make_scorer(0.0)
    score = scorer.compute_score(layout, scorer.compute_shares(layout))
    squares = []
    for device in DEVICES:
        for room in range(2):
            noise = LEVELS.sample_room_model(RIG.sensors, room, 2500.0)
            bound = compute_pose_bound(
                RIG.sensors, device, noise, POSES.positions, POSES.rotations, WINDOW, block=BLOCK
            )
            squares.append(bound.position_rms**2)
    assert score == pytest.approx(np.sqrt(np.mean(squares)), rel=0.03)  # two phases instead of four


def test_score_counts_misplaced_sensors_as_the_evaluation_does():
    layout = start()
    with_errors, without = (make_scorer(w, 1) for w in (1.0, 0.0))
    squares = with_errors.compute_score(layout, with_errors.compute_shares(layout)) ** 2
    squares -= without.compute_score(layout, without.compute_shares(layout)) ** 2
    noise = LEVELS.sample_room_model(RIG.sensors, 0)
    expected = np.mean(
        [evaluate_layout_value(RIG.sensors, d, noise, WINDOW, POSES, Mismatch()).systematic_rms ** 2 for d in DEVICES]
    )
    assert np.sqrt(squares) == pytest.approx(np.sqrt(expected), rel=0.1)


def test_sensors_out_of_place_do_to_a_fit_what_was_expected():
    """Noiseless data of sensors moved, turned and scaled at random, fitted by the whitened estimator."""
    sensors, mismatch = RIG.sensors, Mismatch(0.05e-3, 0.00125, np.radians(0.075))
    device = replace(DEVICES[0], amplitude=DEVICES[0].theta_max, amplitude_std=100.0)
    noise = LEVELS.sample_room_model(sensors, 0)
    position, rotation = np.array([0.0, 0.0, 0.07]), matrix_from_quaternion(np.array([0.5, 0.5, -0.5, 0.5]))
    n = WINDOW.count_samples(device.frequency)
    model = make_whitened_model(sensors, device, noise, np.ones(10, dtype=bool).tobytes(), n, WINDOW.sample_rate, 0.02)
    rng, errors = np.random.default_rng(3), []
    for _ in range(150):
        phase = float(rng.uniform(0, np.pi))
        tilts = mismatch.tilt * rng.standard_normal((10, 3))
        axes = [matrix_from_quaternion(quaternion_from_rotation_vector(t)) @ a
                for t, a in zip(tilts, sensors.axes, strict=True)]  # fmt: skip
        gains = 1.0 + mismatch.gain * rng.standard_normal((10, 1))
        moved = model.positions + mismatch.place * rng.standard_normal((10, 3))
        true = replace(model, positions=moved, axes=np.array(axes) * gains)
        size = device.theta_max / np.radians(30.0)
        data = true.compute_response(position, rotation, phase, size)[0]
        errors.append(Problem(model, data).fit(position, rotation, phase, size).position - position)
    expected = evaluate_layout_value(
        sensors, device, noise, WINDOW, Poses(position[None], rotation[None]), mismatch
    ).systematic_rms[0]
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(expected, rel=0.2)


def test_a_search_only_improves_and_keeps_the_rules():
    scorer = make_scorer(0.1, 1)
    search = Search(scorer, scorer.find_best_of_random(10, 2, np.random.default_rng(1)), np.random.default_rng(0))
    scores = [search.score]
    for _ in range(30):
        search.step()
        scores.append(search.score)
        assert search.layout.is_allowed()
    assert np.all(np.diff(scores) <= 0)
    assert scores[-1] < scores[0]
    np.testing.assert_allclose(search.layout.places, np.round(search.layout.places, 3))


@pytest.mark.parametrize(
    ("places", "axes"),
    [([[0, 0], [0.005, 0]], [0, 2]), ([[0, 0], [0.08, 0]], [0, 2]), ([[0, 0], [0.03, 0]], [2, 2])],
    ids=["too close", "outside", "one axis"],
)
def test_layouts_that_break_a_rule_are_not_allowed(places, axes):
    assert not Layout(np.array(places, dtype=float), np.array(axes)).is_allowed()


def test_toml_is_read_back_as_the_same_layout():
    layout = start()
    read = tomllib.loads(study.format_toml(layout))
    found = {(*place[:2], axis) for place, axis in zip(read["positions_mm"], read["axes"], strict=True)}
    assert found == {(*np.round(1e3 * p), "xyz"[a]) for p, a in zip(layout.places, layout.axes, strict=True)}


def test_study_reports_both_layouts_and_draws_them(tmp_path):
    options = Options("layout", seed=3, jobs=1, poses=1)
    chunk = study.make_chunks(options)[0]
    short = replace(chunk, arguments={**chunk.arguments, "patience": 3})
    outcome = study.conclude(options, [short.work(short)])
    layouts = outcome.figures["layouts"]
    assert set(layouts) == {"rig", "found"}
    assert 50 < layouts["rig"]["bound_um"] < 500
    assert 0.5 < layouts["rig"]["correlation"] < 1.0
    assert len(outcome.figures["found"]["axes"]) == len(load_rig_once("tank").sensors)
    study.draw(outcome, tmp_path / "layout.png")
    assert (tmp_path / "layout.png").stat().st_size > 10_000
