"""The linearised loop: margins of loops with known ones, limits found by flying, gains of a regulator."""

from __future__ import annotations

import math
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from sim.analysis.flight import Model, State, require_loop, simulate_flight
from sim.analysis.linear import average_cycles, fit_feedback, linearize_cycle
from sim.analysis.loop import MOST_LATE, SampledLoop, compute_margins
from sim.analysis.lqr import Weights, design_regulator
from smolbot.config.mission import load_steering_mission
from smolbot.core.pose import Pose
from smolbot.errors import InputError


def integrator(gain: float, kalman: float = 1.0) -> SampledLoop:
    """A robot that moves by -gain of where it is seen to be, once a cycle of 0.1 s."""
    return SampledLoop(
        np.zeros((1, 1)), np.array([[-gain]]), np.array([[kalman]]), np.zeros((1, 0)), period=0.1, wait=0.0
    )


def two(first: SampledLoop, second: SampledLoop) -> SampledLoop:
    """Two loops side by side."""
    diagonal = [np.diag([a[0, 0], b[0, 0]]) for a, b in (
        (first.motion, second.motion), (first.feedback, second.feedback), (first.kalman, second.kalman)
    )]  # fmt: skip
    return SampledLoop(*diagonal, np.zeros((2, 0)), first.period, first.wait)


@pytest.mark.parametrize("gain", [0.1, 0.5, 1.2])
def test_margins_of_an_integrator_are_those_of_the_closed_form(gain):
    # L = K / (z - 1): |L| = 1 at w = 2 asin(K / 2), where its phase is -(pi + w) / 2; its pole is 1 - K
    found = compute_margins(integrator(gain))
    crossing = 2.0 * math.asin(0.5 * gain)
    phase = 0.5 * (math.pi - crossing)
    assert found.gain == pytest.approx(2.0 / gain, rel=1e-4)
    assert found.phase == pytest.approx(phase, rel=1e-4)
    assert found.delay == pytest.approx(phase / crossing, rel=1e-3)
    assert found.radius == pytest.approx(abs(1.0 - gain))
    # |1 + L| / |1 - L| is least at half the sampling rate
    assert found.disc == pytest.approx(2.0 * (2.0 - gain) / (2.0 + gain), rel=1e-4)


@pytest.mark.parametrize("late", [1, 2, 5])
def test_an_integrator_with_late_poses_rings_at_the_known_gain(late):
    limit = 2.0 * math.sin(math.pi / (2.0 * (2 * late + 1)))  # z^d (z - 1) + K has a root at |z| = 1
    assert (
        integrator(0.99 * limit).compute_spectral_radius(late=late)
        < 1.0
        < integrator(1.01 * limit).compute_spectral_radius(late=late)
    )
    assert compute_margins(integrator(0.99 * limit)).late == late
    assert compute_margins(integrator(1.01 * limit)).late == late - 1


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # python-control divides by zero at z = 1
@pytest.mark.parametrize(("gain", "kalman"), [(0.4, 1.0), (0.8, 0.5), (1.1, 0.3)])
def test_margins_agree_with_python_control(gain, kalman):
    import control

    loop = integrator(gain, kalman)
    # by hand: where it is seen to be follows as k z / (z - (1 - k)(1 - K)), the robot as 1 / (z - 1)
    one = control.tf([gain * kalman, 0.0], np.polymul([1.0, -1.0], [1.0, -(1.0 - kalman) * (1.0 - gain)]), loop.period)
    _, phases, _, _, crossings, _ = control.stability_margins(one, returnall=True)
    disc = control.disk_margins(one, np.linspace(1e-3, math.pi / loop.period, 4000))[0]
    found = compute_margins(loop)
    at_nyquist = 2.0 * (1.0 + (1.0 - kalman) * (1.0 - gain)) / (gain * kalman)  # which stability_margins does not see
    assert found.gain == pytest.approx(at_nyquist, rel=1e-3)
    assert math.degrees(found.phase) == pytest.approx(phases[0], rel=1e-3)
    assert found.delay * loop.period == pytest.approx(math.radians(phases[0]) / crossings[0], rel=1e-3)
    assert found.disc == pytest.approx(disc, rel=1e-3)
    response = control.initial_response(loop.to_state_space(), np.arange(30) * loop.period, [1.0, 0.0])
    assert np.allclose(loop.simulate_step(29)[:, 0], np.ravel(response.outputs))


def test_of_two_loops_side_by_side_the_tighter_one_counts():
    slow, quick = integrator(0.3, 0.7), integrator(1.0, 0.6)
    both, alone = compute_margins(two(slow, quick)), [compute_margins(x) for x in (slow, quick)]
    for name in ("gain", "phase", "delay", "late", "disc"):
        assert getattr(both, name) == pytest.approx(min(getattr(m, name) for m in alone), rel=2e-3)


def test_a_loop_that_steers_nothing_has_no_margin_to_lose():
    found = compute_margins(integrator(0.0))
    assert found.stable
    assert found.late == MOST_LATE
    assert math.isinf(found.gain)
    assert math.isinf(found.delay)
    assert math.isinf(found.settling)


def test_a_loop_that_rings_has_none():
    found = compute_margins(integrator(2.1))
    assert not found.stable
    assert (found.gain_db, found.phase, found.delay, found.disc) == (0.0, 0.0, 0.0, 0.0)


def test_the_gain_of_a_law_that_saturates_is_that_of_a_noisy_input():
    # statistical linearisation of a limiter: y = clip(x, -a, a) at x ~ N(0, s^2) has the gain erf(a / (s sqrt 2))
    limit, sigma = 4e-5, np.array([5e-5, 0.02])
    law = SimpleNamespace(command=lambda pose: SimpleNamespace(window=-float(np.clip(pose.position[1], -limit, limit))))
    model = SimpleNamespace(
        copy_controller=lambda law: law, compute_motion=lambda state, window: (np.array([0.0, window]), 0.0)
    )
    pose = Pose(0.0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros((6, 6)))
    state = State(np.zeros(3), 0.0)
    feedback, explained = fit_feedback(model, law, pose, state, np.array([0.0, 1.0]), sigma, 200)
    assert feedback[0, 0] == pytest.approx(-math.erf(limit / (sigma[0] * math.sqrt(2.0))), rel=0.03)
    assert abs(feedback[0, 1] * sigma[1]) < 0.01 * abs(feedback[0, 0] * sigma[0])
    assert 0.5 < explained[0] < 0.97


def test_the_regulator_of_an_integrator_is_that_of_the_scalar_riccati_equation():
    # x' = x + b u: p = q + p - (p b)^2 / (r + p b^2), the motion fed back is -b k x,
    # b k = -p b^2 / (r + p b^2)
    weights = Weights(across=1e-4, heading=0.1, current=0.5)
    per_amp, most = 3e-5, 8.0
    currents = np.array([[per_amp, 0.0], [0.0, 0.02]])
    cycle = SimpleNamespace(motion=np.zeros((2, 2)), currents=currents)
    found = design_regulator(cycle, weights, most)
    for row, (b, unit) in enumerate(((per_amp * most, weights.across), (0.02 * most, weights.heading))):
        q, r = unit**-2, weights.current**-2
        p = 0.5 * (q + math.sqrt(q**2 + 4.0 * q * r / b**2))
        assert found[row, row] == pytest.approx(-p * b**2 / (r + p * b**2), rel=1e-6)
    assert np.allclose(found - np.diag(np.diag(found)), 0.0, atol=1e-12)


@cache
def straight(law: str = "force_pursuit") -> Model:
    """A long straight line through the middle of the tank, under a law that learns nothing in flight."""
    settings = {"controller.law": law, "path.points_mm": "[[-8.0,0.0],[8.0,0.0]]", "start.offset_mm": "[-0.5,0.0]"}
    return Model(load_steering_mission("line", None, settings))


@cache
def cycles():
    model = straight()
    flown = [i for i in simulate_flight(model, model.make_controller()) if i.tracker is not None and not i.command.done]
    return [linearize_cycle(model, i) for i in flown if i.command.phase == "follow"]


def loops(first: int, last: int, step: int = 5) -> list[SampledLoop]:
    return [SampledLoop.from_cycle(average_cycles(cycles(), k, 4)) for k in range(first, last, step)]


def test_the_gain_of_the_tracker_is_the_steady_one_of_an_independent_riccati_equation():
    from scipy.linalg import solve_discrete_are

    from smolbot.core.shots import Shot
    from smolbot.flight.tracking.tracker import DRIFT_NOISE_DENSITY, MODEL_FLOOR, PROCESS_NOISE_DENSITY, Tracker

    model = straight()
    tracker = Tracker(model.setup.robot, model.setup.device, model.setup.table)
    spread = np.array([8e-5, 8e-5, 1e-4, 5e-3, 5e-3, 8e-3])
    state, clock = State(np.array([1e-3, 2e-3, 0.06]), 0.3), 0.0
    heard = None
    for _ in range(500):
        shot = Shot(model.listening, "track", clock)
        clock = shot.end
        before = model.copy_tracker(tracker)
        heard = Pose(shot.end, state.position, state.compute_orientation(), np.diag(spread**2))
        tracker.update(shot, heard)
    from sim.analysis.linear import _differentiate_tracker

    instant = SimpleNamespace(tracker=before, shot=shot, measured=heard)
    found = _differentiate_tracker(model, instant, np.array([0.0, 1.0]), np.array([5e-5, 0.01]))
    t = shot.duration
    f, h = np.array([[1.0, t], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    q = np.diag([PROCESS_NOISE_DENSITY[1] ** 2 * t, DRIFT_NOISE_DENSITY**2 * t])
    r = np.array([[spread[1] ** 2 + MODEL_FLOOR[1] ** 2]])
    p = solve_discrete_are(f.T, h.T, q, r)
    gain = (p @ h.T / (h @ p @ h.T + r)).ravel()
    q_turn, r_turn = PROCESS_NOISE_DENSITY[5] ** 2 * t, spread[5] ** 2 + MODEL_FLOOR[5] ** 2
    p_turn = 0.5 * (q_turn + math.sqrt(q_turn**2 + 4.0 * q_turn * r_turn))
    assert found[[0, 2], 0] == pytest.approx(gain, rel=0.02)
    assert found[1, 1] == pytest.approx(p_turn / (p_turn + r_turn), rel=0.02)


@pytest.mark.parametrize("late", [0, 2])
def test_the_linear_loop_rings_at_its_margin(late):
    loop = loops(30, 31)[0]
    found = next(g for g in np.geomspace(1.0, 30.0, 400) if loop.compute_spectral_radius(g, late) > 1.0 + 1e-6)
    if late == 0:
        assert found == pytest.approx(compute_margins(loop).gain, rel=0.02)
    for factor, grows in ((0.95, False), (1.05, True)):
        state = np.zeros(len(loop.close_loop(late=late)))
        state[0] = 1.0
        sizes = []
        for _ in range(400):
            state = loop.close_loop(factor * found, late) @ state
            sizes.append(abs(state[0]))
        assert bool(max(sizes[-40:]) > max(sizes[:40])) == grows


def deviates(model: Model, gain: float, late: int, kick: float = 5e-5, first: int = 20, last: int = 76) -> float:
    """What is left of a kick, or has become of it, in a flight that hears every deviation `gain` times as large."""
    off: list[float] = []

    def seen(state: State) -> State:
        moved = kick if len(off) == first else 0.0
        x, y, z = state.position
        return State(np.array([x, gain * y + moved, z]), gain * state.heading)

    try:
        for instant in simulate_flight(
            model,
            model.make_controller(),
            delay_cycles=late,
            measure=seen,
            keep=lambda cycle: False,
            max_cycles=last + 5,
        ):
            off.append(abs(float(instant.state.position[1])))
    except InputError:  # it has left the table
        return math.inf
    return max(off[-25:]) / kick


@pytest.mark.parametrize("late", [0, 1, 2])
def test_a_flight_with_the_true_law_and_tracker_rings_where_the_linear_loop_predicts(late):
    # the loop changes along the line: its limit lies between those of the places flown over, a quarter allowed
    def limit(loop: SampledLoop) -> float:
        return next(g for g in np.geomspace(1.0, 40.0, 400) if loop.compute_spectral_radius(g, late) > 1.0 + 1e-6)

    found = [limit(loop) for loop in loops(20, 76)]
    model = straight()
    assert deviates(model, 0.75 * min(found), late) < 0.5
    assert deviates(model, 1.25 * max(found), late) > 1.0


@pytest.mark.parametrize("gain", [3.5, 4.0])
def test_a_flight_tolerates_poses_as_late_as_the_linear_loop_predicts(gain):
    # found at 2 cycles and predicted at 1 to 2: one cycle allowed
    found = [
        next(late for late in range(20) if loop.compute_spectral_radius(gain, late) > 1.0 + 1e-6)
        for loop in loops(20, 76)
    ]
    assert 1 <= min(found) <= max(found) <= 3
    assert deviates(straight(), gain, max(min(found) - 1, 0)) < 0.5
    assert deviates(straight(), gain, max(found) + 1) > 1.0


@pytest.mark.slow
def test_a_robot_hunts_where_the_loop_does_not_hold():
    """Poses err as the loop was probed with; it keeps to the path in the firm half and turns about where it is not."""
    model = Model(load_steering_mission("r_path", None, {"controller.law": "force_pursuit"}))
    flown = [
        i for i in simulate_flight(model, model.make_controller()) if i.command.phase == "follow" and not i.command.done
    ]
    every = [linearize_cycle(model, i) for i in flown]
    found = [compute_margins(SampledLoop.from_cycle(average_cycles(every, k, 4))) for k in range(len(every))]
    loose = np.array([c.arc for c, m in zip(every, found, strict=True) if m.disc < 0.1])
    firm = np.array([c.arc for c, m in zip(every, found, strict=True) if m.disc > 0.6])
    rng = np.random.default_rng(1)

    def seen(state: State) -> State:
        off = np.append(5e-5 * rng.standard_normal(2), 0.0)
        return State(state.position + off, state.heading + math.radians(1.0) * rng.standard_normal())

    noisy = [
        (i.command.progress, i.state.heading)
        for i in simulate_flight(model, model.make_controller(), measure=seen, keep=lambda c: False)
    ]
    arcs, headings = np.array(noisy).T
    turns = np.abs(np.diff(np.unwrap(headings)))

    def turned(places):
        near = np.min(np.abs(arcs[:-1, None] - places[None, :]), axis=1) < 2e-4
        return float(np.median(turns[near]))

    assert turned(loose) > 3.0 * turned(firm)


def test_a_mission_without_a_law_or_with_another_robot_has_no_loop():
    mission = straight().mission
    still = SimpleNamespace(name="marker", sections=SimpleNamespace(controller=None), robot=mission.robot)
    with pytest.raises(InputError, match="only localizes"):
        require_loop(still)
    helix = SimpleNamespace(
        name="s_path", sections=mission.sections, robot=SimpleNamespace(kind="helical", name="helix")
    )
    with pytest.raises(InputError, match="'helix' is of kind 'helical'"):
        require_loop(helix)


def test_probing_leaves_law_and_tracker_as_they_were():
    model = straight("predictive")
    plain = [
        i.command.window for i in simulate_flight(model, model.make_controller(), keep=lambda c: False, max_cycles=12)
    ]
    watched = []
    for instant in simulate_flight(model, model.make_controller(), max_cycles=12):
        if instant.tracker is not None:
            linearize_cycle(model, instant, pairs=2)
        watched.append(instant.command.window)
    assert watched == plain
