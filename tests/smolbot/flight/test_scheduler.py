"""The next shot: what is driven when, how a lost signal is looked for, and how still a robot is held."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smolbot.core.drive import compute_amplitude_after_burst
from smolbot.core.limits import Limits
from smolbot.core.pose import Pose
from smolbot.core.rotations import quaternion_from_axes
from smolbot.core.sensing import Device
from smolbot.core.shots import Actuate, Listen
from smolbot.flight.device_belief import DeviceBelief
from smolbot.flight.scheduler import SEARCH_DIRECTIONS, Scheduler, compute_actuation_time
from smolbot.motion.controller import Command, Cycle
from smolbot.motion.robot import compute_magnet_inertia

LIMITS = Limits(("+x", "-x", "+y", "-y"), 8.0, True, 0.1, 10.0, 0.2, 0.005, 3.0)
CYCLE = Cycle(5, 0.020, 2, 10.0)
DEVICE = Device(0.89e-3, np.array([0.0, 0.0, 1.0]), 1.5e-3, np.radians(17.8), 103.5, 31.7)
PULL = Command(Actuate((6.0, 0.0, 2.0, 0.0), 0.03))
UP = np.array([0.0, 0.0, 1.0])


@dataclass
class Belief:
    pose: Pose | None
    misses: int = 0
    confirmed: bool = True

    def pose_at(self, time: float) -> Pose:
        return self.pose


def scheduler(per_ampere=1e-4, **options):
    return Scheduler(
        CYCLE, LIMITS, DeviceBelief(DEVICE), lambda _: per_ampere * np.eye(3)[:2], lambda: 1.5, **options,
    )  # fmt: skip


def facing(degrees: float) -> Pose:
    ahead = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0.0])
    return Pose(0.0, np.array([0, 0, 0.06]), quaternion_from_axes(ahead, UP, "zy"), np.eye(6) * 1e-8)


@given(
    st.integers(0, 8),
    st.booleans(),
    st.booleans(),
    st.booleans(),
    st.floats(-180, 180),
    st.booleans(),
    st.integers(1, 30),
)
def test_no_coil_is_driven_while_listening(misses, confirmed, paused, known, heading, pulls, rounds):
    plan = scheduler()
    plan.paused = paused
    belief = Belief(facing(heading) if known else None, misses, confirmed)
    for _ in range(rounds):
        shot = plan.next(PULL if pulls else Command(None), belief)
        assert isinstance(shot.windows[-1], Listen)
        assert LIMITS.faults(shot) == []  # an undriven ring-down lies before listening
        assert shot.excite is not None
        assert shot.start == 1.5
        acts = any(isinstance(w, Actuate) for w in shot.windows)
        assert acts == (shot.mode == "track" and pulls)


def test_without_a_pose_it_searches_and_does_not_pull():
    shot = scheduler().next(PULL, Belief(None, confirmed=False))
    assert shot.mode == "search"


def test_a_paused_or_unconfirmed_robot_is_measured_but_not_pulled():
    plan = scheduler()
    assert plan.next(PULL, Belief(facing(0))).mode == "track"
    assert plan.next(PULL, Belief(facing(0), confirmed=False)).mode == "hold"
    plan.paused = True
    shot = plan.next(PULL, Belief(facing(0)))
    assert shot.mode == "hold"
    assert shot.listen is not None
    plan.paused = False
    assert plan.next(PULL, Belief(facing(0))).mode == "track"


@pytest.mark.parametrize("patience", [1, 3])
def test_after_too_many_misses_it_is_lost_and_stops_pulling(patience):
    plan = scheduler(patience=patience)
    modes = [plan.next(PULL, Belief(facing(0), misses)).mode for misses in range(patience + 2)]
    assert modes == ["track"] * patience + ["lost"] * 2


def test_a_search_tries_every_direction_and_then_for_longer():
    plan = scheduler()
    bursts = [plan.next(PULL, Belief(None, confirmed=False)).excite for _ in range(3 * len(SEARCH_DIRECTIONS))]
    n = len(SEARCH_DIRECTIONS)
    for start in (0, n, 2 * n):
        directions = np.array([b.currents for b in bursts[start : start + n]])
        angles = np.sort(np.arctan2(directions[:, 1], directions[:, 0]) % np.pi)
        assert np.diff(angles) == pytest.approx(np.full(n - 1, np.pi / 4), abs=0.02)  # every 45 degrees
    lengths = [b.cycles for b in bursts]
    assert lengths[0] == CYCLE.excite_cycles
    assert lengths[0] == lengths[n - 1] < lengths[n] == lengths[2 * n - 1] < lengths[2 * n]
    assert all(b.duration <= LIMITS.max_excitation for b in bursts)


def test_a_lost_robot_is_looked_for_along_its_last_orientation_too():
    plan = scheduler()
    bursts = [plan.next(PULL, Belief(facing(90), misses=5)).excite for _ in range(2 * (len(SEARCH_DIRECTIONS) + 1))]
    known = scheduler().next(PULL, Belief(facing(90))).excite
    at = [i for i, b in enumerate(bursts) if b.currents == pytest.approx(known.currents, abs=1e-9)]
    assert at
    tried = {tuple(np.sign(np.round(b.currents, 3)).astype(int)) for b in bursts}
    assert {(1, 0), (0, 1), (1, 1), (1, -1)} <= tried


def test_a_found_signal_ends_the_search():
    plan = scheduler()
    for _ in range(6):
        plan.next(PULL, Belief(None, confirmed=False))
    assert plan.next(PULL, Belief(facing(0))).excite.cycles == CYCLE.excite_cycles
    again = plan.next(PULL, Belief(None, confirmed=False))
    assert again.excite.currents == pytest.approx(10.0 * np.array(SEARCH_DIRECTIONS[0]))


@given(st.floats(-180, 180))
def test_the_mix_drives_along_y_x_m_and_wastes_nothing_across_it(heading):
    pose = facing(heading)
    moment = pose.rotation @ DEVICE.moment_in_body
    useful = np.cross(pose.rotation[:, 1], moment)[:2]
    currents = np.array(scheduler().next(PULL, Belief(pose)).excite.currents)
    assert currents @ [useful[1], -useful[0]] == pytest.approx(0.0, abs=1e-9)
    assert currents @ useful > 0


@pytest.mark.parametrize("per_ampere", [1e-5, 5e-5, 1e-4, 1e-3])
def test_a_burst_brings_the_device_to_its_stops_and_no_further(per_ampere):
    burst = scheduler(per_ampere).next(PULL, Belief(facing(30))).excite
    field = per_ampere * np.linalg.norm(burst.currents)
    amplitude = compute_amplitude_after_burst(
        field, DEVICE, compute_magnet_inertia(DEVICE.moment, DEVICE.l0), burst.cycles
    )
    strongest = np.max(np.abs(burst.currents)) == pytest.approx(CYCLE.excite_current)
    assert strongest or amplitude == pytest.approx(DEVICE.theta_max, rel=1e-6)
    assert amplitude <= DEVICE.theta_max * (1 + 1e-9) or np.max(np.abs(burst.currents)) < 0.021 * 10


@pytest.mark.parametrize("damping_model", ["linear", "exponential"])
def test_the_swing_grows_as_its_equation_of_motion_predicts(damping_model):
    """theta'' + 2 eta theta' + w² theta = (m B / I) sin(w t), integrated sample by sample."""
    from scipy.integrate import solve_ivp

    eta = 31.7 if damping_model == "exponential" else 0.0
    device = Device(0.89e-3, np.array([0.0, 0, 1]), 1.5e-3, 0.3, 103.5, eta, damping_model)
    inertia, field, cycles, w = compute_magnet_inertia(device.moment, device.l0), 1e-4, 5, 2 * np.pi * 103.5

    def swing(t, y):
        return [y[1], device.moment * field / inertia * np.sin(w * t) - 2 * eta * y[1] - w**2 * y[0]]

    end = cycles / 103.5
    flown = solve_ivp(swing, (0, end), [0, 0], rtol=1e-9, atol=1e-12, dense_output=True)
    last = flown.sol(np.linspace(end - 0.5 / 103.5, end, 400))[0]
    assert compute_amplitude_after_burst(field, device, inertia, cycles) == pytest.approx(np.abs(last).max(), rel=0.05)


def test_sharp_turns_stretch_the_actuation_in_proportion():
    t_min, t_max, sharp = 0.03, 0.08, np.radians(30)
    turns = np.radians([0, 29.9, 31, 90, 180])
    times = [compute_actuation_time(t, t_min, t_max, sharp) for t in turns]
    assert times[:2] == [t_min, t_min]
    assert times[2:] == pytest.approx(t_min + (t_max - t_min) * turns[2:] / np.pi)
    assert [compute_actuation_time(-t, t_min, t_max, sharp) for t in turns] == times
