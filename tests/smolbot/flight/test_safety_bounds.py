"""Where each rule of the safety begins, on both sides of its bound, and its summary."""

from __future__ import annotations

import json
from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from smolbot.core.coil_heat import CoilHeat, ThermalCoil, advance_temperature
from smolbot.core.limits import Limits
from smolbot.core.pose import Pose
from smolbot.core.sensing import Recording
from smolbot.core.shots import Actuate, Excite, Listen, MoveMagnet, Rest, RingDown, Rotate, Shot
from smolbot.errors import SafetyError
from smolbot.flight.safety.duty_cycle import DutyCycle
from smolbot.flight.safety.heat_store import HeatMemory
from smolbot.flight.safety.sensor_monitor import SensorMonitor
from smolbot.flight.safety.supervisor import Safety, SafetyRules, make_limits_only_safety

LIMITS = Limits(("+x", "-x"), max_current=8.0, max_rotation_frequency=1.0)
NAMES = ("+x", "-x", "excitation x", "excitation y")
LISTEN = Listen(2, 128.0)  # 1/128 s, which a float holds exactly
REACH = ((-0.082, -0.071, 0.055), (0.072, 0.083, 0.096))


def a_safety(rules=None, coils=(None,) * 4, sensors=3, patience=2, memory=None):
    return Safety(
        LIMITS,
        rules or SafetyRules(),
        DutyCycle(NAMES, 8.0),
        CoilHeat(coils, 25.0),
        SensorMonitor(sensors, patience),
        heat_memory=memory,
    )


def pulling(start=0.0, current=8.0, duration=0.125, mode="track"):
    return Shot((Actuate((current, 0.0), duration), RingDown(0.03125), LISTEN), mode, start)


def a_pose(place=(0.0, 0.0, 0.05), sigma=(1e-4, 1e-4, 1e-4)):
    return Pose(0.0, np.array(place), np.array([1.0, 0, 0, 0]), np.diag([*np.square(sigma), 1e-4, 1e-4, 1e-4]))


def make_recording(clock, dead=()):
    field = 1e-9 * np.random.default_rng(0).standard_normal((3, 500))
    field[list(dead)] = 3e-9
    return Recording(field, 64e3, 0.02, clock=clock)


def refusal(safety, shot, now=0.0, pose=None):
    """Why a shot is refused; empty if it is not."""
    try:
        safety.check_shot(shot, now, pose if pose is not None else a_pose())
    except SafetyError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", [0, 1])
def test_a_robot_counts_as_outside_where_three_standard_deviations_still_lie_outside(axis, side):
    sigma, outward = (2.1e-2, 2.2e-2, 2.3e-2), (-1.0, 1.0)[side]
    found = {}
    for deviations in (2.9, 3.2):
        place = [0.0, 0.0, 0.08]
        place[axis] = REACH[side][axis] + outward * deviations * sigma[axis]
        found[deviations] = refusal(a_safety(SafetyRules(allowed_box=REACH)), pulling(), pose=a_pose(place, sigma))
    assert found[2.9] == ""
    low, high = 1e3 * REACH[0][axis], 1e3 * REACH[1][axis]
    at = (low, high)[side] + outward * 3.2e3 * sigma[axis]
    assert found[3.2] == (
        f"Out of reach: the robot's {'xyz'[axis]} is {at:.1f} ± {3e3 * sigma[axis]:.1f} mm; it may be from "
        f"{low:.1f} to {high:.1f} mm (container and reach_margin_mm). Nothing was played."
    )


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_pose_is_as_uncertain_as_its_worst_axis(axis):
    for sigma, unsure in ((0.0625, False), (0.079, True)):  # the bound itself is allowed
        sigmas = [1e-4] * 3
        sigmas[axis] = sigma
        why = refusal(a_safety(SafetyRules(max_sigma=0.0625, uncertain_shots=1)), pulling(), pose=a_pose(sigma=sigmas))
        assert (why != "") == unsure
    assert why == (
        "Uncertain pose: its standard deviation was above 62.5 mm (max_sigma_mm) in 1 shots in a row that drive the "
        "robot; now 79.0 mm. Nothing was played."
    )


def test_looking_for_a_robot_and_learning_coils_need_no_pose():
    safety = a_safety(SafetyRules(max_sigma=1e-6, uncertain_shots=1))
    for shot in (
        Shot((Excite((1.0, 0.0), 128.0, 2), RingDown(0.02), LISTEN), "search"),
        Shot((LISTEN,), "hold"),
        pulling(mode="quiet"),
    ):
        safety.check_shot(shot, 0.0, None)
        safety.check_shot(shot, 1.0, a_pose())
    with pytest.raises(SafetyError, match=r"Lost pose: .* before it was ever located. Nothing was played."):
        safety.check_shot(pulling(), 2.0, None)
    turning = a_safety()
    with pytest.raises(SafetyError, match="Lost pose"):
        turning.check_shot(Shot((MoveMagnet("near", 5.0), Rotate((1, 0, 0), 0.5, 2.0))), 0.0, None)


def test_a_robot_that_is_only_looked_at_may_not_be_outside_either():
    looking = Shot((Excite((1.0, 0.0), 128.0, 2), RingDown(0.02), LISTEN))
    assert "robot's x is 140.0" in refusal(
        a_safety(SafetyRules(allowed_box=REACH)), looking, pose=a_pose((0.14, 0, 0.08))
    )


@pytest.mark.parametrize(("late", "words"), [(0.0, ""), (2.0**-20, r"was 0.50 s old on arrival (max_age_ms = 500)")])
def test_a_recording_ages_from_its_end_and_is_of_use_up_to_the_longest_age(late, words):
    safety, shot = a_safety(SafetyRules(max_age=0.5, stale_shots=1)), pulling(start=16.0)
    listens = shot.start + 0.125 + 0.03125
    came = listens + LISTEN.duration + 0.5 + late
    if not words:
        assert safety.check_recording(shot, make_recording(listens), came) is not None
        return
    with pytest.raises(SafetyError) as stopped:
        safety.check_recording(shot, make_recording(listens), came)
    assert str(stopped.value) == (
        f"Stale data: 1 listening windows in a row were lost (stale_shots = 1); of the last one, the recording {words}."
    )


@pytest.mark.parametrize(("duration", "most"), [(0.015625, 0.05), (0.5, 0.26953125)])
def test_a_shot_may_begin_half_of_itself_early_and_by_some_hundredths_of_a_second_in_any_case(duration, most):
    for early, fine in ((0.98 * most, True), (1.02 * most, False)):
        safety = a_safety(SafetyRules(stale_shots=2))
        shot = Shot((Actuate((0.0, 0.0), duration), RingDown(0.03125 - 0.015625 * (duration < 0.1)), LISTEN), start=4.0)
        assert shot.duration == pytest.approx(2.0 * most if duration > 0.1 else 0.0390625)
        listens = shot.start + shot.duration - LISTEN.duration
        got = safety.check_recording(shot, make_recording(listens - early), shot.end)
        assert (got is not None) == fine
    with pytest.raises(SafetyError, match=f"the recording began {early:.3f} s before it was requested"):
        safety.check_recording(shot, make_recording(listens - early), shot.end)


def test_a_lost_window_is_reported_with_its_shot():
    safety = a_safety(SafetyRules(stale_shots=2))
    safety.check_recording(pulling(1.0), None, 1.2)
    with pytest.raises(
        SafetyError, match=r"2 listening windows in a row were lost \(stale_shots = 2\); .* at 2.500 s "
    ):
        safety.check_recording(pulling(2.5), None, 2.7)


def test_a_duty_cycle_up_to_the_limit_is_allowed_and_one_above_is_reported_with_both():
    safety = a_safety(SafetyRules(max_duty=0.75))
    for i in range(48):  # an eighth of a second each, of 8 s
        safety.check_shot(pulling(0.125 * i), 0.125 * i, a_pose())
    assert safety.duty.peaks == [0.75, 0.0, 0.0, 0.0]
    assert refusal(safety, pulling(6.0, duration=0.0625), 6.0) == (
        "Coil '+x' would be driven for 76 % of 8 s; at most 75 % (max_duty). Nothing was played."
    )


def test_excitation_coils_have_a_share_and_a_temperature_of_their_own():
    coils = (None, None, ThermalCoil("excitation x", 2.0, 10.0, 5.0, limit=300.0), None)
    safety, burst = a_safety(coils=coils), Excite((4.0, 0.0), 128.0, 32)
    safety.check_shot(Shot((burst, RingDown(0.25), LISTEN)), 1.0, a_pose())
    assert safety.duty.peaks == [0.0, 0.0, 0.25 / 8.0, 0.0]
    hot = advance_temperature(coils[2], 25.0, 8.0, 0.25, 25.0)
    assert hot > 25.3
    assert safety.summarize() == {
        "duty_peak": dict(zip(NAMES, safety.duty.peaks)),
        "coil_temperature_begin_c": {"excitation x": 25.0},
        "coil_temperature_peak_c": {"excitation x": pytest.approx(hot)},
        "coil_temperature_limit_c": {"excitation x": 300.0},
    }


def test_coils_heat_while_driven_and_cool_in_every_pause_within_and_between_shots():
    coil = ThermalCoil("+x", 1.0, 20.0, 8.0, limit=1e3)
    safety, expected, clock = a_safety(coils=(coil, None, None, None)), 25.0, 0.0
    for start in (2.0, 4.0, 40.0):
        shot = Shot((Rest(0.25), Actuate((8.0, 0.0), 0.125), RingDown(0.125), LISTEN), start=start)
        safety.check_shot(shot, start, a_pose())
        for idle, driven in ((start - clock + 0.25, 0.125), (0.125 + LISTEN.duration, 0.0)):
            expected = advance_temperature(coil, expected, 0.0, idle, 25.0)
            expected = advance_temperature(coil, expected, 64.0, driven, 25.0) if driven else expected
        clock = shot.end
        assert safety.heat.temperatures[0] == pytest.approx(expected, abs=1e-9)


def test_a_pull_that_would_heat_a_coil_too_much_is_refused_with_both_temperatures():
    coil = ThermalCoil("-x", 1.0, 0.5, 8.0, limit=40.0)
    safety = a_safety(coils=(None, coil, None, None))
    shot = Shot((Actuate((0.0, 8.0), 0.2), Rest(30.0)))
    reached = advance_temperature(coil, 25.0, 64.0, 0.2, 25.0)
    assert refusal(safety, shot) == (
        f"Coil '-x' would reach {reached:.1f} °C by the end of the next shot; at most 40 °C (max_temperature_c). "
        "Nothing was played."
    )


@pytest.mark.parametrize("ended", [False, True])
def test_what_coils_are_left_at_is_noted_as_soon_as_a_run_is_over(tmp_path, ended):
    coil = ThermalCoil("+x", 1.0, 20.0, 8.0, limit=1e3)
    memory = HeatMemory(tmp_path / "heat.json", clock=lambda: 1e6)  # no time goes by: only the first note is due
    safety = a_safety(coils=(coil, None, None, None), memory=memory)
    safety.check_shot(pulling(0.0), 0.0, a_pose())
    safety.check_shot(pulling(0.5), 0.5, a_pose())
    if ended:
        safety.end()
    noted = json.loads((tmp_path / "heat.json").read_text())["temperatures_c"]["+x"]
    assert (noted == safety.heat.temperatures[0]) == ended
    assert 25.0 < noted <= safety.heat.temperatures[0]
    again = a_safety(coils=(coil, None, None, None), memory=HeatMemory(tmp_path / "heat.json", clock=lambda: 1e6))
    assert again.summarize()["coil_temperature_begin_c"] == {"+x": pytest.approx(noted)}


def test_once_over_nothing_is_played_and_the_first_reason_is_kept():
    safety = a_safety()
    safety.end()
    assert refusal(safety, Shot((LISTEN,), "hold")) == "This run is over; nothing was played. Begin a new one."
    tripped = a_safety()
    first = refusal(tripped, Shot((Actuate((9.0, 0.0), 0.3), LISTEN)))
    assert first.count("must") == 2
    assert first.endswith("Nothing was played.")
    tripped.end()
    assert refusal(tripped, Shot((LISTEN,), "hold")) == first


def test_several_sensors_are_named_together_and_a_noise_shot_without_a_drive_counts():
    safety, quiet = a_safety(patience=2), Shot((LISTEN,), "quiet")
    safety.check_recording(quiet, make_recording(0.0, dead=(0, 2)), 0.0)
    with pytest.raises(SafetyError) as stopped:
        safety.check_recording(quiet, make_recording(0.0, dead=(0, 2)), 0.0)
    assert str(stopped.value) == (
        "Sensors 0, 2 (counted from 0) were constant (dead, or a broken wire) in 2 listening windows in a row "
        "(sensor_shots = 2)."
    )
    for probe in (pulling(mode="quiet"), Shot((Excite((1.0, 0.0), 128.0, 2), RingDown(0.02), LISTEN), "quiet")):
        listening = a_safety(patience=1)
        clock = sum(window.duration for window in probe.windows[:-1])
        assert listening.check_recording(probe, make_recording(clock, dead=(0,)), 0.2) is not None


def test_without_rules_only_a_rigs_limits_end_a_run():
    safety, far = make_limits_only_safety(LIMITS, 3), a_pose((9.0, 9.0, 9.0), (1.0, 1.0, 1.0))
    for i in range(100):
        shot = pulling(0.125 * i)
        safety.check_shot(shot, 0.125 * i, far)
        assert safety.duty.peaks[0] == min(0.125 * (i + 1), 1.0)  # of a second
        silent = make_recording(shot.end - LISTEN.duration, dead=(0, 1, 2))
        assert safety.check_recording(shot, silent, shot.end + 1e6) is silent
    assert set(safety.summarize()["duty_peak"]) == {"+x", "-x", "excitation x", "excitation y"}
    assert safety.summarize()["coil_temperature_peak_c"] == {}
    safety.check_shot(Shot((Excite((10.0, -10.0), 128.0, 64), RingDown(0.02), LISTEN)), 30.0, far)
    assert "9.00 A" in refusal(safety, pulling(40.0, current=9.0), 40.0)


def test_by_default_a_third_lost_window_or_a_fifth_uncertain_pose_in_a_row_ends_a_run():
    safety = a_safety()
    assert [safety.check_recording(pulling(i), None, i + 0.5) for i in range(2)] == [None, None]
    with pytest.raises(SafetyError, match="3 listening windows in a row"):
        safety.check_recording(pulling(2.0), None, 2.5)
    unsure, uncertain = a_safety(SafetyRules(max_sigma=1e-3)), a_pose(sigma=(2e-3, 1e-4, 1e-4))
    assert [refusal(unsure, pulling(i), i, uncertain)[:14] for i in range(5)] == ["", "", "", "", "Uncertain pose"]


def test_what_ends_a_run_cannot_be_changed_while_it_runs():
    with pytest.raises(FrozenInstanceError):
        SafetyRules().max_duty = 1.0
