"""Resonance and damping are followed from what single recordings say."""

import numpy as np
import pytest

from smolbot.core.sensing import Device
from smolbot.flight.tracking.resonance_filter import Resonance

DEVICE = Device(0.89e-3, np.array([0.0, 0.0, 1.0]), 1.5e-3, 0.31, 103.5, 31.7, "exponential")
COVARIANCE = np.diag([0.12**2, 0.5**2])


def follow(resonance: Resonance, truth: np.ndarray, n: int, seed: int = 0) -> int:
    rng = np.random.default_rng(seed)
    changes = 0
    for i in range(n):
        off = truth - [resonance.device.frequency, resonance.device.damping]
        changes += resonance.update(0.11 * i, off + rng.multivariate_normal([0, 0], COVARIANCE), COVARIANCE) is not None
    return changes


@pytest.mark.parametrize("truth", [(103.8, 31.7), (103.2, 31.7), (103.5, 36.0)])
def test_a_device_that_is_off_is_replaced_by_one_that_is_not(truth):
    resonance = Resonance(DEVICE)
    assert follow(resonance, np.array(truth), 150) >= 1
    assert resonance.device.frequency == pytest.approx(truth[0], abs=0.08)
    assert resonance.device.damping == pytest.approx(truth[1], abs=1.0)
    assert DEVICE.frequency == 103.5


@pytest.mark.parametrize("seed", range(5))
def test_a_device_that_is_right_is_left_alone(seed):
    resonance = Resonance(DEVICE)
    assert follow(resonance, np.array([103.5, 31.7]), 300, seed) == 0


def test_an_outlier_and_an_estimate_without_information_are_ignored():
    resonance = Resonance(DEVICE)
    follow(resonance, np.array([103.5, 31.7]), 30)
    before = resonance.off
    assert resonance.update(4.0, np.array([9.0, 0.0]), COVARIANCE) is None
    assert resonance.update(4.1, np.zeros(2), np.full((2, 2), np.inf)) is None
    assert (resonance.off == before).all()


WANDERS = np.array([0.01, 0.15])
"""How a device in a warming liquid changes within the square root of a second, in Hz and 1/s."""

OFF_MODEL = np.array([0.05, 0.5])
"""What sensors a little out of place add to every single estimate, which a fit cannot claim."""


@pytest.mark.parametrize("claimed", [0.02 * np.array([1.0, 10.0]), 0.12 * np.array([1.0, 4.0])], ids=["sharp", "blunt"])
def test_what_it_claims_to_know_is_what_it_knows_of_a_device_that_wanders(claimed):
    """Errors over claimed standard deviations have a mean square of one; three times as much doubt would not do."""
    rng, resonance = np.random.default_rng(7), Resonance(DEVICE)
    truth, squares = np.array([DEVICE.frequency, DEVICE.damping]), []
    for i in range(3000):
        truth = truth + WANDERS * rng.standard_normal(2)
        truth[1] = abs(truth[1])
        believed = np.array([resonance.device.frequency, resonance.device.damping])
        seen = truth - believed + np.hypot(claimed, OFF_MODEL) * rng.standard_normal(2)
        resonance.update(float(i), seen, np.diag(claimed**2))
        left = truth - [resonance.device.frequency, resonance.device.damping] - resonance.off
        squares.append((left / resonance.sigma) ** 2)
    assert np.mean(squares[100:], axis=0) == pytest.approx([1.0, 1.0], rel=0.25)
