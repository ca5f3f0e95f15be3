"""Faults by name: the grammar that tank and twin share, and what each fault does to the tank's recordings."""

from __future__ import annotations

import numpy as np
import pytest

from sim.tank.faults import GOOD, ONCE, FaultSchedule
from sim.tank.rig import TankRig
from sim.tank.settings import TankSettings
from sim.tank.tank_faults import TANK_FAULTS, describe_fault, parse_tank_faults
from sim.twin.faults import FAULTS, FaultInjector, parse_fault
from smolbot.config.load import load_mission
from smolbot.config.rig import load_rig
from smolbot.config.robot import load_robot
from smolbot.core.shots import Actuate, Excite, Listen, RingDown, Shot
from smolbot.errors import ConfigError, InputError

FREQUENCY = 103.5
LOOK = Shot((Excite((8.0, 8.0), FREQUENCY, 5), RingDown(0.02), Listen(2, FREQUENCY)))


def open_tank(*faults: str) -> TankRig:
    settings = TankSettings(faults=list(faults))
    return TankRig(load_rig("tank"), load_robot("gradient"), settings, np.zeros(2), seed=1)


def listen(*faults: str) -> np.ndarray:
    with open_tank(*faults) as rig:
        recording = rig.play(LOOK)
    assert recording is not None
    return recording.field


@pytest.fixture(scope="module")
def healthy() -> np.ndarray:
    return listen()


def test_a_fault_is_read_with_channel_values_moment_and_duration() -> None:
    (fault,) = parse_tank_faults(["sensor_hum.7=200nT,103.5@listening#30:2.5"])
    assert (fault.name, fault.channel, fault.values) == ("sensor_hum", "7", (200.0, 103.5))
    assert (fault.phase, fault.shot, fault.duration) == ("listening", 30, 2.5)
    once, good, unsaid = parse_tank_faults(["drag=0.5:once", "coil_dead.+x@3s:good", "windows_lost"])
    assert (once.duration, good.duration, unsaid.duration) == (ONCE, GOOD, None)
    assert good.channel == "+x"


@pytest.mark.parametrize(
    "text",
    [
        "sensor_gane.3=0.5", "sensor_gain.3", "sensor_gain.3=half", "sensor_gain.3=0.5,2", "sensor_gain.3=0.5@noon",
        "sensor_gain.3=0.5@30s:0", "sensor_gain.3=0.5@listening#0", "sensor_offset=5A", "drag.x=0.5", "drag=-1",
        "drag=0", "drag=nan", "windows_lost=2",
    ],
)  # fmt: skip
def test_a_fault_that_cannot_be_read_says_what_can(text: str) -> None:
    with pytest.raises(InputError, match="--fault .*: "):
        parse_tank_faults([text])
    with pytest.raises(ConfigError, match=r"tank\.faults"):
        load_mission("line", settings={"rig.tank.faults": f'["{text}"]'})


@pytest.mark.parametrize("text", ["sensor_dead.10", "coil_dead.left", "excitation_lost.z", "sensors_swapped.1=10"])
def test_a_channel_that_the_rig_does_not_have_is_refused_with_those_that_it_has(text: str) -> None:
    with pytest.raises(InputError, match="it has "):
        open_tank(text)


@pytest.mark.parametrize("text", ["sensors_swapped.3=3", "sensors_swapped=0"])
def test_a_sensor_cannot_be_swapped_with_itself(text: str) -> None:
    with pytest.raises(InputError, match="cannot be swapped with itself"):
        open_tank(text)


def test_every_fault_of_tank_and_twin_has_a_sentence() -> None:
    assert all(len(describe_fault(name)[1].split()) > 3 for name in TANK_FAULTS)
    assert all(len(sentence.split()) > 2 for sentence in FAULTS.values())


def test_a_fault_begins_and_ends_at_its_time() -> None:
    schedule = FaultSchedule(parse_tank_faults(["windows_lost@2s:3", "drag=0.5@listening#2", "viscosity=2"]))
    assert schedule.is_active(2, 0.0)
    schedule.begin_shot(LOOK, 10.0)
    assert [schedule.is_active(0, t) for t in (11.9, 12.0, 14.9, 15.0)] == [False, True, True, False]
    assert not schedule.is_active(1, 1e6)  # its shot has not come
    schedule.begin_shot(LOOK, 20.0)
    start = next(at for at, window in LOOK.timed() if isinstance(window, Listen))
    assert schedule.find_span(1) == (20.0 + start, GOOD)


def test_a_fault_of_the_twin_that_lasts_seconds_ends_after_them() -> None:
    now = [0.0]
    faults = FaultInjector(lambda _: None, lambda: now[0])
    faults.add(parse_fault("sensor_dead@now:2"))
    now[0] = 1.9
    assert faults.is_active("sensor_dead")
    assert faults.take("sensor_dead")  # not used up by being noticed
    now[0] = 2.1
    assert not faults.is_active("sensor_dead")


def test_a_fault_that_has_not_begun_changes_no_sample(healthy: np.ndarray) -> None:
    faults = [f"{text}@1000s" for text in ("sensor_gain.3=0.5", "excitation_lost", "viscosity=0.5", "moment=0.5")]
    np.testing.assert_array_equal(listen(*faults), healthy)


def test_a_sensor_fault_changes_its_own_channel_only(healthy: np.ndarray) -> None:
    for text in (
        "sensor_gain.3=0.5", "sensor_dead.3", "sensor_stuck_bit.3=3", "sensor_offset.3=500", "sensor_drift.3=500",
        "sensor_hum.3=500", "sensor_noise.3=50", "sensor_spikes.3=500,2000", "sensors_saturated.3",
    ):  # fmt: skip
        changed = np.flatnonzero(np.any(listen(text) != healthy, axis=1))
        assert changed.tolist() == [3], text


def test_half_the_gain_halves_the_reading_about_its_constant(healthy: np.ndarray) -> None:
    half = listen("sensor_gain.3=0.5")[3]
    step = 20e-6 / 2**16  # of the converter
    np.testing.assert_allclose(half - half.mean(), 0.5 * (healthy[3] - healthy[3].mean()), atol=1.1 * step)


def test_swapped_sensors_exchange_their_readings(healthy: np.ndarray) -> None:
    swapped = listen("sensors_swapped.2=3")
    np.testing.assert_array_equal(swapped[[2, 3]], healthy[[3, 2]])


def test_a_frozen_sensor_keeps_its_last_value() -> None:
    with open_tank("sensor_frozen.2@listening#2") as rig:
        first, second = rig.play(LOOK), rig.play(LOOK)
    assert first is not None
    assert second is not None
    assert np.all(second.field[2] == first.field[2, -1])


def test_a_clipped_sensor_is_cut_on_one_side_and_does_not_say_so() -> None:
    with open_tank("sensor_offset.1=9000", "sensor_clipped.1=9000") as rig:
        recording = rig.play(LOOK)
    assert recording is not None
    assert recording.field[1].max() <= 9e-6
    assert not recording.saturated.any()


def test_saturated_sensors_say_so() -> None:
    with open_tank("sensors_saturated") as rig:
        recording = rig.play(LOOK)
    assert recording is not None
    assert recording.saturated.all()


def test_a_lost_window_gives_no_recording_and_the_next_one_does() -> None:
    with open_tank("windows_lost@listening#2:0.05") as rig:
        assert [rig.play(LOOK) is None for _ in range(3)] == [False, True, False]


def test_without_excitation_the_device_does_not_swing() -> None:
    def compute_swing(*faults: str) -> float:
        with open_tank(*faults) as rig:
            rig.play(LOOK)
            return float(np.ptp(rig._tank._trace[: rig._tank._used, 0]))

    assert compute_swing("excitation_lost") < 0.01 * compute_swing()
    assert compute_swing("excitation_gain.x=0.1", "excitation_gain.y=0.1") < 0.5 * compute_swing()


@pytest.mark.parametrize(("fault", "factor"), [("drag=0.5", 2.0), ("viscosity=2", 0.5), ("rotation_drag=1.5", 1.0)])
def test_speed_under_a_steady_pull_is_inverse_to_drag(fault: str, factor: float) -> None:
    def compute_path(*faults: str) -> float:
        with open_tank(*faults) as rig:
            assert rig.witness is not None
            for _ in range(10):  # the magnet turns into the field first
                rig.play(Shot((Actuate((8.0, 0.0, 0.0, 0.0), 0.05),)))
            before = rig.witness.truth(rig.now()).position
            rig.play(Shot((Actuate((8.0, 0.0, 0.0, 0.0), 0.05),)))
            return float(np.linalg.norm(rig.witness.truth(rig.now()).position - before))

    # another place by then, so another force; the factor on the speed stays clear
    assert compute_path(fault) / compute_path() == pytest.approx(factor, rel=0.35)


def test_a_liquid_that_begins_to_flow_takes_the_robot_along() -> None:
    with open_tank("flow=0.8,90@1s:2") as rig:
        assert rig.witness is not None
        rig.play(LOOK)
        began = rig.now()
        for _ in range(8):
            rig.play(Shot((RingDown(0.5),)))
        way = [rig.witness.truth(began + t).position for t in (0.9, 1.2, 2.2, 3.2, 3.6)]
    still, flowed, stopped = way[1] - way[0], way[2] - way[1], way[4] - way[3]
    assert flowed[1] == pytest.approx(0.8e-3, rel=0.1)
    assert np.linalg.norm(still) < 0.3 * np.linalg.norm(flowed)
    assert np.linalg.norm(stopped) < 0.1 * np.linalg.norm(flowed)


def test_a_dead_coil_carries_no_current() -> None:
    with open_tank("coil_dead.-x@2s") as rig:
        assert rig._tank._plant_faults.compute_current_factors(0.0).tolist() == [1, 1, 1, 1, 1, 1]
        rig.play(LOOK)
        assert rig._tank._plant_faults.compute_current_factors(3.0).tolist() == [1, 0, 1, 1, 1, 1]


def test_faults_are_ground_truth_of_the_record() -> None:
    with open_tank("drag=0.5", "sensor_gain.3=0.5@30s") as rig:
        assert rig.provenance()["faults"] == ["drag=0.5", "sensor_gain.3=0.5@30s"]
