"""What breaks a limit is not played: the coil is named, and so is the limit."""

from __future__ import annotations

from dataclasses import FrozenInstanceError
from math import cos, sin

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smolbot.core.limits import Limits
from smolbot.core.shots import Actuate, Excite, Listen, MoveMagnet, Rest, RingDown, Rotate, Shot
from smolbot.errors import InterlockError

F = 103.5
LIMITS = Limits(("+x", "-x", "+y", "-y"), 8.0, True, 0.1, 10.0, 0.2, 0.005, 3.0)


@pytest.mark.parametrize(
    ("windows", "words"),
    [
        ((Actuate((9.0, 0, 0, 0), 0.03),), ["'+x'", "0 to 8 A", "9.00 A"]),
        ((Actuate((0, 0, 0, -0.5), 0.03),), ["'-y'", "0 to 8 A", "-0.50 A"]),
        ((Actuate((0, 0, float("nan"), 0), 0.03),), ["'+y'", "nan"]),
        ((Actuate((1.0, 0, 0, 0), 0.11),), ["at most 100 ms", "110.0 ms"]),
        ((Actuate((1.0, 0), 0.03),), ["2 currents", "4 coils", "+x, -x, +y, -y"]),
        ((Excite((0.0, -11.0), F, 5),), ["'y'", "±10 A", "-11.00 A"]),
        ((Excite((float("nan"), 0.0), F, 5),), ["'x'", "nan"]),
        ((Excite((1.0, 0.0), F, 30),), ["at most 200 ms", "289.9 ms"]),
        ((Excite((1.0, 0.0), F, 5), RingDown(0.004), Listen(2, F)), ["after 4.0 ms", "5.0 ms of ring-down"]),
        ((Actuate((1.0, 0, 0, 0), 0.03), Listen(2, F)), ["after 0.0 ms", "ring-down"]),
        ((Listen(700, F),), ["at most 3 s", "3.382 s"]),
        ((Rotate((0, 0, 1), 0.25, 1.0),), ["no rotating magnet"]),
        ((MoveMagnet("away", 1.0),), ["no rotating magnet"]),
    ],
)
def test_a_broken_limit_is_named_and_nothing_is_played(windows, words):
    with pytest.raises(InterlockError) as error:
        LIMITS.check(Shot(windows))
    message = str(error.value)
    assert message.endswith("Nothing was played.")
    for word in words:
        assert word in message


def test_every_broken_limit_is_named_at_once():
    shot = Shot((Actuate((9.0, 0, 0, 12.0), 0.2), Excite((20.0, 0.0), F, 5), Listen(2, F)))
    assert len(LIMITS.faults(shot)) == 5
    with pytest.raises(InterlockError, match=r"'\+x'.*'-y'.*100 ms.*'x'.*ring-down"):
        LIMITS.check(shot)


def test_a_supply_that_reverses_may_pull_both_ways():
    both = Limits(("a",), 8.0, unipolar=False)
    assert both.faults(Shot((Actuate((-8.0,), 0.03),))) == []
    assert both.faults(Shot((Actuate((-8.1,), 0.03),)))


def test_a_magnet_turns_no_faster_than_its_stage():
    stage = Limits((), 0.0, max_rotation_frequency=0.5)
    fast, slow = (Rotate((0, 1, 0), frequency, 3) for frequency in (0.6, 0.5))
    assert stage.faults(Shot((slow, Rest(1.0), MoveMagnet("away", 3.0))), magnet_near=True) == []
    assert "0.5 Hz; got 0.6 Hz" in stage.faults(Shot((fast,)), magnet_near=True)[0]


@given(
    st.lists(st.floats(-20, 20), min_size=4, max_size=4),
    st.floats(1e-3, 0.3),
    st.tuples(st.floats(-20, 20), st.floats(-20, 20)),
    st.floats(1e-3, 0.02),
)
def test_a_shot_passes_exactly_if_every_number_is_within_its_limit(currents, duration, drive, ring_down):
    shot = Shot((Actuate(tuple(currents), duration), Excite(drive, F, 5), RingDown(ring_down), Listen(2, F)))
    fine = (
        all(0 <= c <= 8 for c in currents)
        and duration <= 0.1
        and all(abs(c) <= 10 for c in drive)
        and ring_down >= 0.005
    )
    near = 1e-8
    edge = any(abs(c) < near or abs(c - 8) < near for c in currents) or any(abs(abs(c) - 10) < near for c in drive)
    if not edge and abs(duration - 0.1) > near and abs(ring_down - 0.005) > near:
        assert (LIMITS.faults(shot) == []) == fine


STAGE = Limits((), 8.0, max_rotation_frequency=0.25, max_steering_rate=0.175, min_ring_down=0.005)
NEAR, AWAY = MoveMagnet("near", 10.0), MoveMagnet("away", 10.0)


def about(degrees, frequency=0.25, turns=1.0):
    angle = degrees * 3.141592653589793 / 180.0
    return Rotate((cos(angle), sin(angle), 0.0), frequency, turns)


def test_a_maneuver_within_the_stages_limits_is_played():
    shot = Shot((NEAR, about(10), about(45), about(210), AWAY))  # 210 is 30 the other way round
    assert STAGE.faults(shot) == []


@pytest.mark.parametrize(
    ("windows", "near", "words"),
    [
        ((Listen(2, F),), True, ["Listen", "needs the actuation magnet away", "saturates"]),
        ((Excite((1.0, 0.0), F, 5), RingDown(0.02), Listen(2, F)), True, ["Excite at 0.0 ms", "Listen at 68.3 ms"]),
        ((about(0),), False, ["Rotate needs the actuation magnet near"]),
        ((NEAR, AWAY, about(0)), False, ["Rotate needs the actuation magnet near"]),
        ((NEAR, about(0, 0.3)), False, ["within 0.25 Hz", "0.3 Hz"]),
        ((NEAR, about(0), about(41)), False, ["at most 40.1° within 4 s", "41.0°"]),
        ((NEAR, Rotate((1.0, 0.0, 0.1), 0.25, 1.0)), False, ["horizontal plane"]),
        ((NEAR, Rotate((0.0, 0.0, 0.0), 0.25, 1.0)), False, ["horizontal plane"]),
    ],
)
def test_the_magnet_is_away_while_sensors_listen_and_turns_as_the_stage_can(windows, near, words):
    with pytest.raises(InterlockError) as error:
        STAGE.check(Shot(windows), magnet_near=near)
    for word in words:
        assert word in str(error.value)


ONE = Limits(("a",), 8.0, False, 0.1, 10.0, 0.2, 0.08, 3.0)


@pytest.mark.parametrize("share", [0.999, 1.0, 1.0 + 1e-11, 1.001])
@pytest.mark.parametrize(
    ("shot", "words"),
    [
        (lambda x: (Actuate((8.0 * x,), 0.03),), "Coil 'a' current must lie within -8 to 8 A; got 8.01 A."),
        (lambda x: (Actuate((-8.0 * x,), 0.03),), "Coil 'a' current must lie within -8 to 8 A; got -8.01 A."),
        (lambda x: (Actuate((1.0,), 0.1 * x),), "Actuate must last at most 100 ms; got 100.1 ms."),
        (lambda x: (Excite((10.0 * x, 0.0), F, 5),), "Excitation coil 'x' current must lie within ±10 A; got 10.01 A."),
        (
            lambda x: (Excite((0.0, -10.0 * x), F, 5),),
            "Excitation coil 'y' current must lie within ±10 A; got -10.01 A.",
        ),
        (lambda x: (Excite((1.0, 0.0), 20.0 / (0.2 * x), 20),), "Excite must last at most 200 ms; got 200.2 ms."),
        (
            lambda x: (Rest(1.0), Excite((1.0, 0.0), 100.0, 5), RingDown(0.08 / x), Listen(2, F)),
            "Listening at 1129.9 ms follows a drive after 79.9 ms; the coils need 80.0 ms of ring-down.",
        ),
        (lambda x: (Listen(600, 100.0 / x),), "Listen window must last at most 3 s; got 3.003 s."),
    ],
)
def test_a_limit_may_be_reached_up_to_rounding_and_not_passed(shot, words, share):
    assert ONE.faults(Shot(shot(share))) == ([words] if share == 1.001 else [])


def test_one_way_currents_may_be_zero_up_to_rounding_and_not_less():
    for current, fine in ((0.0, True), (-1e-10, True), (-0.001, False)):
        assert (LIMITS.faults(Shot((Actuate((current, 0.0, 0.0, 0.0), 0.03),))) == []) == fine


def test_waits_between_a_drive_and_listening_add_up_and_only_the_last_drive_counts():
    drive, listen = Actuate((1.0,), 0.03), Listen(2, F)
    assert ONE.faults(Shot((drive, RingDown(0.03), Rest(0.05), listen))) == []
    assert ONE.faults(Shot((drive, RingDown(1.0), drive, RingDown(0.07), listen))) != []
    assert ONE.faults(Shot((Rest(0.001), listen))) == []  # nothing was driven


@pytest.mark.parametrize("share", [0.99, 1.0, 1.01])
def test_a_stage_steers_as_far_as_its_rate_and_a_windows_length_let_it(share):
    """The next axis is reached while the magnet turns about it: 0.175 rad/s for two turns at 0.25 Hz, 8 s."""
    angle = share * 0.175 * 8.0
    for sign in (1.0, -1.0):
        turned = Rotate((3.0 * cos(angle), 3.0 * sign * sin(angle), 0.0), 0.25, 2.0)
        found = STAGE.faults(Shot((NEAR, about(0), turned, about(0, turns=9.0), AWAY)))
        expected_fault = f"The stage steers at most 80.2° within 8 s; got {share * 80.214:.1f}°."
        assert found == ([expected_fault] if share > 1.0 else [])


def test_an_axis_that_is_set_while_the_magnet_is_away_is_there_from_the_start():
    far = about(90, turns=0.1)
    assert STAGE.faults(Shot((NEAR, about(0), AWAY, NEAR, far))) == []
    assert len(STAGE.faults(Shot((NEAR, about(0), far)))) == 1
    assert STAGE.faults(Shot((far,)), magnet_near=True) == []
    assert STAGE.faults(Shot((NEAR, about(0), Rest(1.0), about(20)))) == []


@pytest.mark.parametrize("tilt", [0.9e-6, 2e-6])
@pytest.mark.parametrize("length", [1.0, 50.0])
def test_an_axis_is_level_up_to_rounding(tilt, length):
    level = Rotate((0.6 * length, 0.8 * length, -tilt * length), 0.25, 1.0)
    assert (STAGE.faults(Shot((NEAR, level))) == []) == (tilt < 1e-6)


@pytest.mark.parametrize(("frequency", "fine"), [(0.2501, False), (0.25, True), (0.01, True), (-0.1, False)])
def test_a_magnet_turns_forward_and_no_faster_than_it_may(frequency, fine):
    turned = Rotate((1.0, 0.0, 0.0), frequency, 10.0 * frequency)
    assert (STAGE.faults(Shot((NEAR, turned))) == []) == fine


def test_a_rig_without_a_stage_in_its_file_has_none_and_one_without_a_rate_cannot_steer():
    plain = Limits((), 8.0)
    assert "no rotating magnet" in plain.faults(Shot((about(0),)), magnet_near=True)[0]
    fixed = Limits((), 8.0, max_rotation_frequency=0.25)
    assert "at most 0.0° within 4 s; got 10.0°" in fixed.faults(Shot((NEAR, about(0), about(10))))[0]


def test_by_default_the_magnet_is_away():
    STAGE.check(Shot((Listen(2, F),)))
    with pytest.raises(InterlockError, match="Rotate needs the actuation magnet near"):
        STAGE.check(Shot((about(0),)))


def test_a_limit_cannot_be_raised_by_a_program_that_met_it():
    with pytest.raises(FrozenInstanceError):
        LIMITS.max_current = 9.0
