"""Resonance and damping are followed from what single recordings say."""

from dataclasses import replace

import numpy as np
import pytest

from smolbot.core.sensing import Device
from smolbot.flight.device_belief import DeviceBelief
from smolbot.flight.tracking.resonance_filter import (
    MEASUREMENT_FLOOR,
    PROCESS_NOISE_DENSITY,
    START_STD,
    ResonanceFilter,
)
from smolbot.localization.problem import DeviceChange

DEVICE = Device(0.89e-3, np.array([0.0, 0.0, 1.0]), 1.5e-3, 0.31, 103.5, 31.7, "exponential")
COVARIANCE = np.diag([0.12**2, 0.5**2])


def follow(resonance: ResonanceFilter, truth: np.ndarray, n: int, seed: int = 0) -> int:
    rng = np.random.default_rng(seed)
    changes = 0
    for i in range(n):
        off = truth - [resonance.belief.device.frequency, resonance.belief.device.damping]
        changes += resonance.update(0.11 * i, off + rng.multivariate_normal([0, 0], COVARIANCE), COVARIANCE) is not None
    return changes


@pytest.mark.parametrize("truth", [(103.8, 31.7), (103.2, 31.7), (103.5, 36.0)])
def test_a_device_that_is_off_is_replaced_by_one_that_is_not(truth):
    resonance = ResonanceFilter(DeviceBelief(DEVICE))
    assert follow(resonance, np.array(truth), 150) >= 1
    assert resonance.belief.device.frequency == pytest.approx(truth[0], abs=0.08)
    assert resonance.belief.device.damping == pytest.approx(truth[1], abs=1.0)
    assert DEVICE.frequency == 103.5


@pytest.mark.parametrize("seed", range(5))
def test_a_device_that_is_right_is_left_alone(seed):
    resonance = ResonanceFilter(DeviceBelief(DEVICE))
    assert follow(resonance, np.array([103.5, 31.7]), 300, seed) == 0


def test_an_outlier_and_an_estimate_without_information_are_ignored():
    resonance = ResonanceFilter(DeviceBelief(DEVICE))
    follow(resonance, np.array([103.5, 31.7]), 30)
    before = resonance.deviation
    assert resonance.update(4.0, np.array([9.0, 0.0]), COVARIANCE) is None
    assert resonance.update(4.1, np.zeros(2), np.full((2, 2), np.inf)) is None
    assert (resonance.deviation == before).all()


WANDERS = np.array([0.01, 0.15])
"""How a device in a warming liquid changes within the square root of a second, in Hz and 1/s."""

OFF_MODEL = np.array([0.05, 0.5])
"""What sensors a little out of place add to every single estimate, which a fit cannot claim."""


@pytest.mark.parametrize("claimed", [0.02 * np.array([1.0, 10.0]), 0.12 * np.array([1.0, 4.0])], ids=["sharp", "blunt"])
def test_what_it_claims_to_know_is_what_it_knows_of_a_device_that_wanders(claimed):
    """Errors over claimed standard deviations have a mean square of one; three times as much doubt would not do."""
    rng, resonance = np.random.default_rng(7), ResonanceFilter(DeviceBelief(DEVICE))
    truth, squares = np.array([DEVICE.frequency, DEVICE.damping]), []
    for i in range(3000):
        truth = truth + WANDERS * rng.standard_normal(2)
        truth[1] = abs(truth[1])
        assumed = np.array([resonance.belief.device.frequency, resonance.belief.device.damping])
        seen = truth - assumed + np.hypot(claimed, OFF_MODEL) * rng.standard_normal(2)
        resonance.update(float(i), seen, np.diag(claimed**2))
        left = truth - [resonance.belief.device.frequency, resonance.belief.device.damping] - resonance.deviation
        squares.append((left / resonance.sigma) ** 2)
    assert np.mean(squares[100:], axis=0) == pytest.approx([1.0, 1.0], rel=0.25)


def textbook(seen, claims, times):
    """The estimate of a device that is not retuned: information adds up, and is lost over time."""
    off, covariance = np.zeros(2), np.diag(START_STD**2)
    for i, (value, claim) in enumerate(zip(seen, claims)):
        wait = max(times[i] - times[i - 1], 0.0) if i else 0.0
        covariance = covariance + np.diag(PROCESS_NOISE_DENSITY**2 * wait)
        measured = np.linalg.inv(claim + np.diag(MEASUREMENT_FLOOR**2))
        after = np.linalg.inv(np.linalg.inv(covariance) + measured)
        off, covariance = off + after @ measured @ (value - off), after
    return off, np.sqrt(np.diag(covariance))


def test_the_track_is_that_of_a_textbook_filter():
    rng, resonance = np.random.default_rng(2), ResonanceFilter(DeviceBelief(DEVICE))
    assert resonance.sigma == pytest.approx(START_STD)
    times = np.cumsum(rng.choice([0.0, 0.11, 2.0], 25))
    times[12] = times[11] - 1.0  # a recording that comes out of turn is none the surer for it
    mixing = np.array([[1.0, 0.4], [-0.3, 1.0]])
    claims = [np.diag([0.3, 2.0]) @ mixing @ mixing.T @ np.diag([0.3, 2.0]) * s for s in rng.uniform(0.5, 2.0, 25)]
    seen = [rng.multivariate_normal([0, 0], claim) for claim in claims]
    for i in range(25):
        assert resonance.update(times[i], seen[i], claims[i]) is None
        off, sigma = textbook(seen[: i + 1], claims[: i + 1], times)
        assert resonance.deviation == pytest.approx(off)
        assert resonance.sigma == pytest.approx(sigma)


SURELY = np.diag([1e-3, 1e-2]) ** 2


@pytest.mark.parametrize(
    ("damping", "frequency_off", "damping_off", "replaced"),
    [
        (31.7, 0.075, 0.0, False),  # a swing that is still in step after ten periods
        (31.7, 0.085, 0.0, True),
        (31.7, -0.085, 0.0, True),
        (31.7, 0.0, 1.8, False),  # six hundredths
        (31.7, 0.0, -2.0, True),
        (31.7, 0.085, -2.0, True),
        (0.3, 0.0, 0.055, False),  # of what hardly damps, six hundredths of a reciprocal second
        (0.3, 0.0, 0.065, True),
    ],
)
def test_a_device_is_made_anew_where_that_is_worth_its_while(damping, frequency_off, damping_off, replaced):
    resonance = ResonanceFilter(DeviceBelief(replace(DEVICE, damping=damping)))
    seen, rounds = np.array([frequency_off, damping_off]), range(2000)
    found = next((new for _ in rounds if (new := resonance.update(0.0, seen, SURELY)) is not None), None)
    assert (found is not None) == replaced
    assert resonance.belief.device.frequency == (found or DEVICE).frequency
    if found is not None:
        gained = np.array([found.frequency - DEVICE.frequency, found.damping - damping])
        assert gained == pytest.approx(seen, rel=0.05)
        assert (found.moment, found.l0, found.theta_max) == (DEVICE.moment, DEVICE.l0, DEVICE.theta_max)


def test_a_new_device_begins_with_no_difference_and_a_damping_is_not_negative():
    resonance = ResonanceFilter(DeviceBelief(replace(DEVICE, damping=0.5)))
    while (device := resonance.update(0.0, np.array([0.0, -2.0]), np.diag([0.1, 0.3]) ** 2)) is None:
        assert resonance.deviation[1] < 0.0
    assert device.damping == 0.0
    assert resonance.deviation.tolist() == [0.0, 0.0]


@pytest.mark.parametrize("entry", [0, 1])
@pytest.mark.parametrize(("deviations", "taken"), [(4.95, True), (5.05, False)])
def test_an_estimate_is_an_outlier_beyond_five_standard_deviations(entry, deviations, taken):
    resonance, claim = ResonanceFilter(DeviceBelief(DEVICE)), np.diag([0.4, 4.0]) ** 2
    sigma = np.sqrt(np.diag(claim) + START_STD**2 + MEASUREMENT_FLOOR**2)
    resonance.update(0.0, deviations * sigma * np.eye(2)[entry], claim)
    assert (resonance.deviation[entry] > 0.0) == taken


@pytest.mark.parametrize("off", [np.array([-3.5, 0.0]), np.array([0.0, 18.0])])
def test_a_mains_line_or_another_liquid_does_not_retune_the_device(off):
    resonance = ResonanceFilter(DeviceBelief(DEVICE))
    assert resonance.update(0.0, off, np.diag([0.05, 0.5]) ** 2) is None
    assert resonance.deviation.tolist() == [0.0, 0.0]
    assert ResonanceFilter(DeviceBelief(DEVICE)).update(0.0, 0.4 * off, np.diag([0.05, 0.5]) ** 2) is not None


@pytest.mark.parametrize("entry", [0, 1])
@pytest.mark.parametrize(("deviations", "replaced"), [(3.9, False), (4.1, True)])
def test_a_change_has_to_stand_out_by_four_standard_deviations(entry, deviations, replaced):
    """The estimate is chosen so that the deviation after it is so many of its standard deviations from zero."""
    resonance, claim = ResonanceFilter(DeviceBelief(DEVICE)), np.diag([0.1, 1.0]) ** 2
    measured = np.diag(claim) + MEASUREMENT_FLOOR**2
    gain = START_STD**2 / (START_STD**2 + measured)
    sigma = np.sqrt((1.0 - gain) * START_STD**2)
    device = resonance.update(0.0, (deviations * sigma / gain) * np.eye(2)[entry], claim)
    assert (device is not None) == replaced


FREEDOM = 70
"""Degrees of freedom of a recording's residuals."""


def make_change(truth, device, *, unexplained: float = 0.0, held: bool = False) -> DeviceChange:
    """Make the change that a noiseless recording of a true device suggests."""
    offset = np.array(truth) - [device.frequency, device.damping]
    covariance = np.diag([0.3**2, 1.0**2])
    after = FREEDOM + unexplained
    return DeviceChange(offset, covariance, after + float(offset @ np.linalg.solve(covariance, offset)), after, held)


@pytest.mark.parametrize("truth", [(103.5, 19.0), (103.5, 51.0), (101.0, 31.7)])
def test_a_device_that_changes_is_doubted_and_learned_in_a_few_recordings(truth):
    resonance = ResonanceFilter(DeviceBelief(DEVICE))
    follow(resonance, np.array([103.5, 31.7]), 100)
    assert "does not swing as assumed" in resonance.check(make_change(truth, resonance.belief.device), FREEDOM)
    assert resonance.belief.device is DEVICE  # one recording may be disturbed
    reasons = [resonance.check(make_change(truth, resonance.belief.device), FREEDOM) for _ in range(6)]
    assert reasons[0]
    assert not reasons[-1]
    assert not resonance.relearning
    assert resonance.belief.device.frequency == pytest.approx(truth[0], abs=0.1)
    assert resonance.belief.device.damping == pytest.approx(truth[1], abs=1.0)


def test_a_device_that_swings_beyond_its_stops_is_doubted():
    resonance = ResonanceFilter(DeviceBelief(DEVICE))
    follow(resonance, np.array([103.5, 31.7]), 100)
    change = replace(make_change((103.5, 28.5), DEVICE), before=4.0 * FREEDOM)
    assert resonance.check(change, FREEDOM) == ""
    assert resonance.check(replace(change, held=True), FREEDOM)


def test_residuals_that_no_change_of_the_device_explains_do_not_change_it():
    resonance = ResonanceFilter(DeviceBelief(DEVICE))
    follow(resonance, np.array([103.5, 31.7]), 100)
    for _ in range(5):
        assert resonance.check(make_change((103.5, 19.0), DEVICE, unexplained=10.0 * FREEDOM), FREEDOM) == ""
    assert resonance.belief.device is DEVICE


def test_a_device_that_does_not_change_is_not_doubted():
    resonance = ResonanceFilter(DeviceBelief(DEVICE))
    follow(resonance, np.array([103.5, 31.7]), 100)
    assert all(resonance.check(make_change((103.6, 33.0), DEVICE), FREEDOM) == "" for _ in range(20))
