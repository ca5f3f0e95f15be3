"""The decay of a coil's current is learned from a weak pull, and predicted for every other."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from smolbot.config.mission import load_steering_mission
from smolbot.config.plugins import load_world
from smolbot.core.pose import Pose
from smolbot.core.sensing import Recording
from smolbot.core.shots import Actuate, Excite, Listen, RingDown, Shot
from smolbot.errors import InputError
from smolbot.localization.localizer import Localizer
from smolbot.localization.noise.actuation_decay import CoilDecay, CoilDecays, identify_decay
from smolbot.localization.noise.model import NoiseModel

RATE, F = 50_000.0, 103.5
TAUS = np.array([3.1e-3, 2.8e-3])  # s
COUPLING = np.random.default_rng(3).normal(size=(2, 10)) * 1e-4  # T per A, at the sensors
CUTOFF = 1000.0  # Hz, of the sensors


def record(shot, noise=0.0, seed=0):
    """Currents of two RL circuits through first-order sensors, stepped at 5 us, with a constant, mains and noise."""
    step = 5e-6
    n = round(shot.duration / step)
    time = (np.arange(n) + 1) * step
    command = np.zeros((2, n))
    for at, window in shot.timed():
        if isinstance(window, Actuate):
            command[:, (time > at) & (time <= at + window.duration)] = np.array(window.currents)[:, None]
        if isinstance(window, Listen):
            listen = at
    current = np.array([lfilter([1 - np.exp(-step / t)], [1, -np.exp(-step / t)], c) for t, c in zip(TAUS, command)])
    keep = np.exp(-2 * np.pi * CUTOFF * step)
    field = lfilter([1 - keep], [1, -keep], COUPLING.T @ current, axis=1)
    samples = np.arange(int((shot.duration - listen) * RATE))
    field = field[:, np.round((listen + samples / RATE) / step).astype(int) - 1]
    if noise:
        rng = np.random.default_rng(seed)
        field = field + 5e-8 * rng.normal(size=(10, 1)) + 1e-8 * np.cos(2 * np.pi * 50 * samples / RATE + 0.4)
        field = field + 3e-9 * np.exp(-30 * samples / RATE) * np.cos(2 * np.pi * F * samples / RATE + 1.0)
        field = field + noise * rng.normal(size=field.shape)
    return Recording(field, RATE, np.inf)


def faint(coil):
    currents = [0.0, 0.0]
    currents[coil] = 0.2
    return Shot((Actuate(tuple(currents), 15e-3), RingDown(8e-3), Listen(8, F)), "quiet")


def flown(currents, pull=0.03):
    return Shot((Actuate(currents, pull), Excite((2.0, 1.0), F, 3), RingDown(12e-3), Listen(2, F)))


@pytest.fixture(scope="module")
def learned():
    return CoilDecays(tuple(identify_decay(faint(c), [record(faint(c), 4e-10, c)], F) for c in range(2)))


def test_time_constants_are_those_of_the_circuits(learned):
    assert [t.time_constant for t in learned.decays] == pytest.approx(TAUS, rel=1e-3)


@pytest.mark.parametrize(("currents", "pull"), [((8.0, 0.0), 0.03), ((3.0, 6.5), 0.05), ((8.0, 8.0), 0.005)])
def test_the_decay_after_full_pulls_is_predicted_from_weak_ones(learned, currents, pull):
    shot = flown(currents, pull)
    recording = record(shot)
    assert np.abs(recording.field).max() > 3e-10
    assert np.abs(learned.subtract_from(shot, recording).field).max() < 0.02 * np.abs(recording.field).max()


def test_nothing_is_subtracted_where_nothing_pulled(learned):
    for shot in (flown((0.0, 0.0)), Shot((Excite((2.0, 1.0), F, 3), RingDown(12e-3), Listen(2, F)))):
        recording = record(shot, 1e-10)
        assert learned.subtract_from(shot, recording) is recording
    late = Shot((Actuate((8.0, 8.0), 0.03), RingDown(0.1), Listen(2, F)))
    assert learned.subtract_from(late, recording) is recording


def test_a_coil_that_is_not_measured_has_no_decay():
    silent = Recording(1e-10 * np.random.default_rng(0).normal(size=(10, 1900)), RATE, np.inf)
    assert identify_decay(faint(0), [silent], F) is None
    loud = record(faint(0), 1e-10)
    saturated = Recording(loud.field, RATE, np.inf, np.arange(10) == 4)
    assert identify_decay(faint(0), [saturated], F) is None
    shot = flown((8.0, 8.0))
    recording = record(shot)
    assert CoilDecays((None, None)).subtract_from(shot, recording) is recording


def test_one_coil_at_a_time_is_learned():
    for shot in (flown((1.0, 1.0)), Shot((Excite((2.0, 1.0), F, 3), RingDown(12e-3), Listen(2, F)))):
        with pytest.raises(InputError, match="one coil is driven once"):
            identify_decay(shot, [record(shot)], F)


@pytest.fixture(scope="module")
def pulled():
    """In an ideal tank: learned decays, and recordings after opposite coils pulled, which moves a robot little."""
    mission = load_steering_mission("r_path", settings={"rig.tank.mismatch.scale": "0"})
    with load_world("tank", mission.rig.document).open(mission.rig, mission.robot, mission.start, seed=5) as rig:
        quiet = [rig.play(Shot((Listen(200, F),), "quiet")) for _ in range(4)]
        learned = []
        for coil in range(4):
            currents = [0.0] * 4
            currents[coil] = 0.2
            shot = Shot((Actuate(tuple(currents), 15e-3), RingDown(8e-3), Listen(8, F)), "quiet")
            learned.append(identify_decay(shot, [rig.play(shot)], F))
        taken = []
        for i in range(12):
            currents = (8.0, 8.0, 0.0, 0.0) if i % 2 else (0.0, 0.0, 8.0, 8.0)
            shot = Shot((Actuate(currents, 0.03), Excite((8.0, 8.0), F, 3), RingDown(12e-3), Listen(2, F)))
            recording = rig.play(shot)
            taken.append((shot, recording, rig.witness.truth(recording.middle)))
        coils = rig._tank.coils  # books only
    return mission, quiet, CoilDecays(tuple(learned)), taken, coils


def test_the_decays_in_the_tank_are_those_of_its_coils(pulled):
    mission, _, learned, _, coils = pulled
    for coil, one in enumerate(learned.decays):
        tau = coils.circuits[coil, 3]
        lag = 1.0 - 1.0 / (2 * np.pi * mission.rig.sensors.bandwidth * tau)  # what a low pass makes of a decay
        assert one.time_constant == pytest.approx(tau, rel=2e-3)
        assert one.size == pytest.approx(coils.coupling[coil] / lag, rel=0.02, abs=3e-7)  # 3 pT of a full pull


def test_the_pose_of_a_robot_that_was_just_pulled_is_not_biased_by_the_decaying_current(pulled):
    mission, quiet, learned, taken, _ = pulled
    localizer = Localizer(mission.rig.sensors, mission.robot.device, NoiseModel.learn(quiet)).with_transients((1e-3,))
    squares = {"left in": 0.0, "taken off": 0.0}
    for shot, recording, truth in taken:
        prior = Pose(truth.time, truth.position, truth.orientation, np.eye(6))
        for name, as_heard in (("left in", recording), ("taken off", learned.subtract_from(shot, recording))):
            pose, _ = localizer.locate_swing(as_heard, prior)
            off = pose.position - truth.position
            squares[name] += float(off @ np.linalg.solve(pose.covariance[:3, :3], off)) / (3 * len(taken))
    assert squares["taken off"] < 1.6  # 36 squares of a standard normal: one in a hundred is above
    assert squares["left in"] > 1.5 * squares["taken off"]


def test_a_decay_has_its_time_constant():
    shot, one = flown((1.0,)), CoilDecay(3e-3, np.ones(10))
    field = CoilDecays((one,)).compute_field(shot, 483, RATE)
    assert field[:, 150] / field[:, 0] == pytest.approx(np.full(10, np.exp(-1.0)))
