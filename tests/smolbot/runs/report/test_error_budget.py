"""The parts of a tracking error add up to it, and each is what it says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smolbot.core.shots import Actuate
from smolbot.motion.gradient import advance
from smolbot.runs.report.error_budget import PARTS, BudgetStep, compute_budget, find_steps
from smolbot.runs.report.error_budget_section import compute_pose_budget


@pytest.fixture(scope="module")
def budget(flight):
    return compute_budget(flight.steered, find_steps(flight))


def test_the_parts_of_every_step_add_up_to_its_error(budget):
    assert len(budget.error) > 10
    np.testing.assert_allclose(sum(budget.parts.values()), budget.error, rtol=0, atol=1e-15)
    assert sum(budget.shares.values()) == pytest.approx(1.0)


def test_the_error_of_a_step_is_the_true_distance_to_the_path(budget, flight):
    """The path of this flight is the x axis, from -1.5 mm to 1.5 mm; y is the error, positive to the left."""
    ends = {m.truth.time: m.truth.position for m in flight.trace.moments if m.truth is not None}
    places = np.array([ends[time] for time in budget.time])
    inside = np.abs(places[:, 0]) < 1.5e-3
    assert inside.sum() > 10
    np.testing.assert_allclose(budget.error[inside], places[inside, 1], atol=1e-15)


def test_parts_match_an_independent_decomposition(budget, flight):
    """On a straight path along x each part is a difference of y: taken here from the moments themselves."""
    moments = {m.truth.time: i for i, m in enumerate(flight.trace.moments) if m.truth is not None}
    setup = flight.steered.setup()
    checked = 0
    for row, time in enumerate(budget.time):
        index = moments[time]
        after, before = flight.trace.moments[index], flight.trace.moments[index - 1]
        if abs(after.truth.position[0]) > 1.5e-3:
            continue
        tracked, window = before.cycle.tracked, after.cycle.shot.windows[0]
        assert budget.parts["localization"][row] == pytest.approx(
            before.truth.position[1] - tracked.position[1], abs=1e-15
        )
        assert budget.parts["lag"][row] == pytest.approx(
            before.truth_at_end.position[1] - before.truth.position[1], abs=1e-15
        )
        moved = np.zeros(2)
        if isinstance(window, Actuate):
            field = setup.table.field(tracked.position[None])[:, 0]
            gradient = setup.table.gradient(tracked.position[None])[:, 0]
            ahead = tracked.rotation @ setup.device.moment_in_body
            heading = np.arctan2(ahead[1], ahead[0])
            moved, _ = advance(setup.robot, field, gradient, np.array(window.currents), heading, window.duration)
        truly = after.truth.position[1] - before.truth_at_end.position[1]
        assert budget.parts["mismatch"][row] == pytest.approx(truly - moved[1], abs=1e-9)
        meant = tracked.position[1] + moved[1]
        part, other = ("saturation", "aim") if before.cycle.command.saturated else ("aim", "saturation")
        assert budget.parts[part][row] == pytest.approx(meant, abs=1e-9)
        assert budget.parts[other][row] == 0.0
        checked += 1
    assert checked > 10


@pytest.mark.parametrize("part", [name for name in PARTS if name != "aim"])
def test_one_cause_alone_is_found_as_that_cause(flight, part):
    """Steps in which only one thing goes wrong, by 0.2 mm to the left."""
    off, on = np.array([0.0, 2e-4]), np.array([0.3e-3, 0.0])
    start, zero = np.array([-0.5e-3, 0.0]), np.zeros(2)
    wrong = {name: off if name == part else zero for name in PARTS}
    true = start
    tracked = true - wrong["localization"]
    acting = true + wrong["lag"]
    expected = tracked + on - (tracked - start) + wrong["saturation"]
    reached = acting + (expected - tracked) + wrong["mismatch"]
    if part == "localization":  # the law sends the robot on as if it were where it is thought to be
        expected = tracked + on + off
        reached = acting + on + off
    found = compute_budget(
        flight.steered, [BudgetStep(tracked, true, acting, expected, reached, part == "saturation", 1.0)]
    )
    assert found.error[0] == pytest.approx(2e-4)
    assert found.shares[part] == pytest.approx(1.0)


def test_a_missing_cycle_is_no_step(flight):
    """Where the recorder dropped a cycle, nobody knows what was commanded in between."""
    whole = find_steps(flight)
    record = flight.record
    moments, numbers = list(record.moments), list(record.number_of_cycle)
    gone = len(moments) // 2
    del moments[gone], numbers[gone]
    broken = replace(record, moments=moments, number_of_cycle=numbers)
    left = find_steps(replace(flight, record=broken, trace=broken.trace()))
    assert len(left) == len(whole) - 2
    assert {step.time for step in left} < {step.time for step in whole}


def test_no_step_no_budget(flight):
    assert compute_budget(flight.steered, []) is None


def test_errors_of_poses_split_into_bias_noise_and_rest():
    """Poses with a bias of (0.3, 0, 0.4) mm and noise of 0.1 mm per axis, foretold as that."""
    rng = np.random.default_rng(1)

    class Pose:
        def __init__(self, position, covariance=None):
            self.position, self.covariance = position, covariance

    noise, bias = 1e-4, np.array([3e-4, 0.0, 4e-4])
    pairs = [
        (Pose(bias + noise * rng.standard_normal(3), noise**2 * np.eye(6)), Pose(np.zeros(3))) for _ in range(20_000)
    ]
    found = compute_pose_budget(pairs)
    assert found["bias"] == pytest.approx(25e-8, rel=0.02)
    assert found["predicted"] == pytest.approx(3e-8)
    assert abs(found["rest"]) < 0.05 * found["predicted"]
    assert found["bias"] + found["predicted"] + found["rest"] == pytest.approx(found["total"])
