"""The plant of the twin is the tank: the same commands, sampled, move it and are heard in the same way."""

from __future__ import annotations

import json
import math
import time

import numpy as np
import pytest

from sim.tank.settings import TankSettings
from sim.tank.tank import Tank
from sim.twin.truth_server import TruthServer
from sim.twin.twin_plant import TwinPlant
from smolbot.bench.hardware.remote_witness import RemoteWitness
from smolbot.config.document import validate
from smolbot.config.rig import load_rig
from smolbot.config.robot import load_robot
from smolbot.core.shots import Actuate, Excite, Listen, RingDown, Shot
from smolbot.errors import InputError, RigError

SHOT = Shot((Actuate((8.0, 0.0, 3.0, 0.0), 0.03), Excite((6.0, -4.0), 100.0, 5), RingDown(0.02), Listen(4, 100.0)))


def settings(rig):
    return validate(TankSettings, rig.sections.tank, ("tank",))[0]


def make(kind, rig_name="tank", robot="gradient", seed=5, ideal=False):
    rig = load_rig(rig_name)
    return kind(rig, load_robot(robot), settings(rig), np.zeros(2), seed, ideal=ideal)


def sampled(plant, shot, constants):
    """The commands of a shot at every sample's middle; the amplifier makes up for the coils' lag, as in the tank."""
    n = round(shot.duration * plant.rate)
    currents = np.zeros((len(plant.loads), n))
    middle = (np.arange(n) + 0.5) / plant.rate
    for at, window in shot.timed():
        first, end = round(at * plant.rate), round((at + window.duration) * plant.rate)
        if isinstance(window, Actuate):
            currents[:4, first:end] = np.array(window.currents)[:, None]
        elif isinstance(window, Excite):
            omega = 2 * math.pi * window.frequency
            gains = np.sqrt(1 + (omega * constants[4:]) ** 2)
            wave = np.sin(omega * (middle[first:end] - at))
            currents[4:, first:end] = (np.array(window.currents) * gains)[:, None] * wave
    return currents


@pytest.fixture(scope="module")
def both():
    tank, plant = make(Tank), make(TwinPlant)
    tank.advance(SHOT.windows)
    constants = tank.coils.circuits[:6, 3]
    currents = sampled(plant, SHOT, constants)
    for piece in np.array_split(currents, 17, axis=1):
        plant.advance(piece)
    return tank, plant


def test_sampled_commands_move_the_tank_as_windows_do(both):
    tank, plant = both
    assert plant.played == round(SHOT.duration * plant.rate)
    for at in np.linspace(0.0, SHOT.duration, 9):
        one, other = tank.history.interpolate_pose(at), plant.history.interpolate_pose(at)
        assert np.linalg.norm(one[:3] - other[:3]) < 2e-7  # pieces end steps elsewhere; a pull moves it by 1e-4
        assert abs(abs(one[3:] @ other[3:]) - 1) < 1e-6


def test_sampled_commands_give_the_signal_of_windows(both):
    tank, plant = both
    clock, n = SHOT.duration - 0.02, 1000
    heard, _ = tank.measure(clock, n)
    volts = plant.read_volts(plant.played - n, n)
    signal = heard - heard.mean(axis=1, keepdims=True)
    field = volts * 1e-6
    field -= field.mean(axis=1, keepdims=True)
    assert np.ptp(signal) > 5e-8
    # both have drawn the same noise: what differs is where the steps of motion end
    assert np.abs(field - signal).max() < 0.01 * np.ptp(signal)


def test_pieces_of_a_recording_fit_together():
    one, other = make(TwinPlant, seed=3), make(TwinPlant, seed=3)
    for plant in (one, other):
        plant.advance(np.zeros((6, 3000)))
        plant.begin_acquisition()
    whole = one.read_volts(1000, 2000)
    parts = np.hstack([other.read_volts(1000, 500), other.read_volts(1500, 700), other.read_volts(2200, 800)])
    # mains and constants are the same; each sensor's own noise is of the size of some steps of the converter
    assert np.abs(whole.mean(axis=1) - parts.mean(axis=1)).max() < 5e-4
    steps = np.abs(np.diff(parts, axis=1))
    assert steps[:, [499, 1199]].max() <= 1.5 * steps.max()
    assert np.abs(whole - parts).max() < 5e-3
    assert np.ptp(whole) > 0.02


def test_volts_are_whole_steps_of_the_converter():
    plant = make(TwinPlant)
    plant.advance(np.zeros((6, 500)))
    plant.begin_acquisition()
    step = 20.0 / 2**16
    readings = plant.read_volts(0, 500) / step
    assert np.abs(readings - np.round(readings)).max() < 1e-6


def test_each_recording_has_constants_of_its_own():
    plant = make(TwinPlant)
    plant.advance(np.zeros((6, 2000)))
    means = []
    for first in (0, 1000):
        plant.begin_acquisition()
        means.append(plant.read_volts(first, 1000).mean(axis=1))
    assert np.abs(means[0] - means[1]).max() > 0.02


def test_what_was_not_played_cannot_be_read():
    plant = make(TwinPlant)
    plant.advance(np.zeros((6, 100)))
    with pytest.raises(InputError, match="keeps samples 0 to 100"):
        plant.read_volts(50, 100)


def test_commands_that_no_card_can_give_change_nothing():
    plant = make(TwinPlant)
    for bad, message in ((np.zeros((5, 10)), "must have shape"), (np.full((6, 10), np.nan), "finite")):
        with pytest.raises(InputError, match=message):
            plant.advance(bad)
    assert plant.played == 0


def test_the_plant_forgets_what_is_long_past():
    plant = make(TwinPlant)
    for _ in range(30):
        plant.advance(np.zeros((6, 50_000)))
    assert len(plant.history.find_rows_since(0.0)[0]) < 15_000
    with pytest.raises(InputError):
        plant.read_volts(0, 10)
    plant.read_volts(plant.played - 1000, 1000)


def test_a_magnet_that_turns_near_a_helix_screws_it_forward():
    plant = make(TwinPlant, "gel", "helical")
    plant.set_magnet(0.0, 0.0, near=False)
    plant.advance(np.zeros((2, 5000)))
    start = plant.history.interpolate_pose(plant.time)
    heading = math.atan2(*(_axis(start)[1::-1]))
    span = 250
    for k in range(400):  # two seconds, half a turn
        plant.set_magnet(math.pi * k / 400, heading, near=True)
        plant.advance(np.zeros((2, span)))
    end = plant.history.interpolate_pose(plant.time)
    moved = end[:3] - start[:3]
    assert abs(moved @ _axis(start)) > 1e-4
    assert abs(moved @ _axis(start)) > 0.7 * np.linalg.norm(moved)


def test_a_magnet_that_is_near_saturates_the_sensors_then_and_only_then():
    plant = make(TwinPlant, "gel", "helical")
    for near in (False, True, None):
        plant.set_magnet(0.0, 0.0, near=near)
        plant.advance(np.zeros((2, 1000)))
    plant.begin_acquisition()
    before, during, after = (plant.read_volts(first, 900) for first in (50, 1050, 2050))
    top = 20.0 / 2**16 * (2**15 - 1)
    assert np.all((during >= top) | (during == -10.0))
    assert 0 < np.count_nonzero(during[:, 0] < 0) < 10  # a dipole points up here and down there
    assert np.abs(before).max() < 1.0
    assert np.abs(after).max() < 1.0


def test_currents_obey_their_commands_while_the_magnet_is_near():
    plant = make(TwinPlant, "gel", "helical")
    plant.advance(np.full((2, 2500), 2.0))
    assert plant.coils.circuits[:2, 0] == pytest.approx(2.0, rel=1e-9)
    plant.set_magnet(0.0, 0.0, near=True)
    plant.advance(np.zeros((2, 250)))
    assert plant.coils.circuits[:2, 0] == pytest.approx(2.0 * np.exp(-5e-3 / plant.coils.circuits[:2, 3]), rel=1e-9)


def test_a_robot_outside_the_container_is_an_error_that_says_where_and_when():
    plant = make(TwinPlant)
    plant.advance(np.zeros((6, 250)))
    plant.carrier.bodies.set_pose(np.array([0.0, 0.0, 0.4]), np.array([1.0, 0.0, 0.0, 0.0]))
    with pytest.raises(RigError, match=r"left the container, to .* 399\.\d+\] mm, at 0\.010 s"):
        plant.advance(np.zeros((6, 250)))


def test_sampled_mismatches_can_be_written_as_json():
    drawn = make(TwinPlant, "gel", "helical").list_mismatches()
    assert json.loads(json.dumps(drawn)).keys() == {"truth", "carrier"}


def _axis(pose):
    w, x, y, z = pose[3:]
    return np.array([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)])


def rows(count, start):
    out = np.zeros((count, 8))
    out[:, 0] = start + 1e-3 * np.arange(count)
    out[:, 1] = 1e-3 * np.arange(count)
    out[:, 4] = 1.0
    return out


def test_truth_arrives_at_another_process_unchanged():
    server = TruthServer("127.0.0.1", 0, {"seed": 4, "truth": np.zeros(2)})
    epoch = time.monotonic()
    witness = RemoteWitness(f"127.0.0.1:{server.port}", epoch)
    try:
        assert witness.provenance()["seed"] == 4
        json.dumps(witness.provenance())
        server.publish(rows(100, epoch))
        pose = witness.truth(0.0405)
        assert pose.position[0] == pytest.approx(0.0405, abs=1e-9)
        assert pose.time == 0.0405
        with pytest.raises(InputError, match="known from"):
            witness.truth(-1.0)
        server.close()
        with pytest.raises(RigError, match="no longer serves"):
            witness.truth(100.0)
    finally:
        witness.close()
        server.close()


def test_a_witness_without_a_twin_is_an_error():
    server = TruthServer("127.0.0.1", 0, {})
    server.close()
    with pytest.raises(RigError, match="no twin serves ground truth"):
        RemoteWitness(f"127.0.0.1:{server.port}", 0.0)
