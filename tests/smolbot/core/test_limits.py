"""What breaks a limit is not played: the coil is named, and so is the limit."""

from __future__ import annotations

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
