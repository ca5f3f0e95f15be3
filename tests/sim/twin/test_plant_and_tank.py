"""Where its pieces end with the tank's steps, the plant is the tank to rounding; its noise is that of the tank's."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import welch

from sim.tank.settings import TankSettings
from sim.tank.tank import Tank
from sim.twin.twin_plant import TwinPlant
from smolbot.config.document import validate
from smolbot.config.rig import load_rig
from smolbot.config.robot import load_robot
from smolbot.core.shots import Actuate, Excite, Listen, MoveMagnet, RingDown, Rotate, Shot

SHOT = Shot((Actuate((8.0, 0.0, 3.0, 0.0), 0.03), Excite((6.0, -4.0), 100.0, 5), RingDown(0.02), Listen(4, 100.0)))
PIECE = 250


def make(kind, rig_name="tank", robot="gradient", seed=5, **changes):
    rig = load_rig(rig_name, {key.replace("__", "."): value for key, value in changes.items()})
    settings, _ = validate(TankSettings, rig.sections.tank, ("tank",))
    return kind(rig, load_robot(robot), settings, np.zeros(2), seed)


def commands(plant, shot):
    """Currents (n_loads, n) in the middle of every sample, an excitation larger by what the true coils' lag takes."""
    middle = (np.arange(round(shot.duration * plant.rate)) + 0.5) / plant.rate
    out = np.zeros((len(plant.loads), len(middle)))
    actuation = plant.coils.n_actuation
    for at, window in shot.timed():
        inside = (middle > at) & (middle < at + window.duration)
        if isinstance(window, Actuate):
            out[:actuation, inside] = np.array(window.currents)[:, None]
        elif isinstance(window, Excite):
            omega = 2 * math.pi * window.frequency
            lag = np.hypot(1.0, omega * plant.coils.circuits[actuation : len(out), 3])
            out[actuation:, inside] = np.outer(window.currents * lag, np.sin(omega * (middle[inside] - at)))
    return out


def play(plant, currents):
    for first in range(0, currents.shape[1], PIECE):
        plant.advance(currents[:, first : first + PIECE])


@pytest.fixture(scope="module")
def both():
    tank, plant = make(Tank), make(TwinPlant)
    for _ in range(2):
        tank.advance(SHOT.windows)
        play(plant, commands(plant, SHOT))
    return tank, plant


def clean(plant, clock, n):
    pose_times, poses = plant.history.find_rows_since(clock - 2 * plant.sensors.lead)
    used = slice(0, plant._used)
    return plant.sensors.compute_clean_readings(
        clock, n, plant.device, plant.coils.coupling, plant._trace_times[used], plant._trace[used], pose_times, poses
    )


def test_the_same_commands_give_the_same_motion(both):
    tank, plant = both
    assert plant.time == pytest.approx(tank.time, abs=1e-12)
    for at in np.linspace(0.0, tank.time, 41):
        one, other = tank.history.interpolate_pose(at), plant.history.interpolate_pose(at)
        assert one == pytest.approx(other, rel=0, abs=1e-10)
    moved = tank.history.interpolate_pose(tank.time)[:3] - tank.history.interpolate_pose(0.0)[:3]
    assert np.linalg.norm(moved) > 1e-5


def test_the_same_commands_give_the_same_signal(both):
    tank, plant = both
    n = round(0.02 * plant.rate)
    one, other = clean(tank, tank.time - 0.02, n), clean(plant, plant.time - 0.02, n)
    assert np.ptp(one, axis=1).max() > 5e-8
    assert np.abs(one - other).max() < 1e-13  # a step of the converter is 3e-10 T


def test_pieces_of_a_clean_signal_fit_together_to_less_than_the_converter_resolves(both):
    _, plant = both
    begin, n = plant.time - 0.02, 1000
    parts = [clean(plant, begin + first / plant.rate, 250) for first in range(0, n, 250)]
    assert np.abs(np.hstack(parts) - clean(plant, begin, n)).max() < 1e-11


def test_a_magnet_that_is_measured_turns_the_helix_as_one_that_is_commanded():
    tank, plant = make(Tank, "gel", "helical"), make(TwinPlant, "gel", "helical")
    heading, frequency, turns = 0.3, 0.25, 0.5
    axis = (math.cos(heading), math.sin(heading), 0.0)
    tank.advance((MoveMagnet("near", 0.1),))
    begin = tank.time
    tank.advance((Rotate(axis, frequency, turns),))
    seconds = turns / frequency
    still = np.zeros((2, PIECE))
    plant.set_magnet(0.0, heading, near=True)
    plant.advance(still)
    start = plant.time
    for k in range(round(seconds * plant.rate / PIECE)):
        plant.set_magnet(2 * math.pi * frequency * (k + 1) * PIECE / plant.rate, heading, near=True)
        plant.advance(still)
    for share in (0.25, 0.5, 0.75, 1.0):
        one, other = (
            tank.history.interpolate_pose(begin + share * seconds),
            plant.history.interpolate_pose(start + share * seconds),
        )
        assert np.linalg.norm(one[:3] - other[:3]) < 2e-6
        assert 2 * math.acos(min(abs(one[3:] @ other[3:]), 1.0)) < math.radians(0.3)
    assert np.linalg.norm(one[:3] - tank.history.interpolate_pose(begin)[:3]) > 2e-4


def test_noise_of_many_pieces_has_the_spectrum_of_one_long_recording():
    quiet = {"noise__mains_nt": "0.0", "noise__mains_gradient_nt_per_m": "0.0", "noise__drift_nt_per_s": "0.0"}
    whole, parts = make(Tank, seed=7, **quiet).sensors, make(Tank, seed=8, **quiet).sensors
    n = 100_000
    long = np.zeros((10, n))
    whole.sensor_noise.add(long, 0.0)
    short = np.zeros((10, n))
    for first in range(0, n, PIECE):
        piece = np.zeros((10, PIECE))
        parts.sensor_noise.add(piece, first / 50_000)
        short[:, first : first + PIECE] = piece
    level = whole.sensor_noise.processes[1][0] / parts.sensor_noise.processes[1][0]  # each tank draws its own
    frequency, one = welch(long, 50_000, nperseg=10_000)
    _, other = welch(level * short, 50_000, nperseg=10_000)
    for low, high in ((10, 40), (40, 100), (100, 300), (300, 1000)):
        band = (frequency >= low) & (frequency < high)
        ratio = other[:, band].mean() / one[:, band].mean()
        # at least 10 sensors x 20 spectra x 6 lines, the lowest weighing most: ratios scatter by up to 5 %
        assert ratio == pytest.approx(1.0, abs=0.2)


def test_hours_of_idling_cost_neither_room_nor_accuracy():
    plant = make(TwinPlant)
    late = make(TwinPlant)
    late.played = 5 * 3600 * 50_000  # as if it had idled so long
    late.time = late.played / late.rate
    late._trace_times[: late._used] += late.time
    late.history._times[: late.history._count] += late.time
    currents = commands(plant, SHOT)
    for one in (plant, late):
        play(one, currents)
    n = round(0.02 * plant.rate)
    early, then = clean(plant, plant.time - 0.02, n), clean(late, late.time - 0.02, n)
    assert np.abs(early - then).max() < 1e-3 * np.ptp(early, axis=1).max()
    assert np.abs(late.read_volts(late.played - n, n)).max() < 1.0
