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
