"""The tracker's compiled filter against the textbook's, in plain numpy."""

from __future__ import annotations

import numpy as np
import pytest

from smolbot.flight.tracking.kalman import predict, update


def positive(rng, n, scale=1.0):
    a = rng.normal(size=(n, n))
    return scale * (a @ a.T + 0.1 * np.eye(n))


@pytest.mark.parametrize("m", [6, 7])
def test_a_correction_is_the_textbook_s(m):
    rng = np.random.default_rng(m)
    p, r, innovation = positive(rng, 10), positive(rng, m, 0.3), rng.normal(size=m)
    h = np.eye(10)[:m]
    s = h @ p @ h.T + r
    distance, change, after = update(p, r, innovation)
    assert distance == pytest.approx(innovation @ np.linalg.solve(s, innovation))
    assert change == pytest.approx(p @ h.T @ np.linalg.solve(s, innovation))
    assert after == pytest.approx(np.linalg.inv(np.linalg.inv(p) + h.T @ np.linalg.inv(r) @ h))
    assert np.linalg.eigvalsh(after).min() > 0.0


def test_a_measurement_without_a_valid_covariance_is_infinitely_far():
    distance, change, after = update(np.eye(10), -2.0 * np.eye(6), np.ones(6))
    assert distance == np.inf
    assert np.all(change == 0.0)
    assert np.all(after == np.eye(10))
    assert update(np.eye(10), np.full((6, 6), np.nan), np.ones(6))[0] == np.inf


def test_waiting_spreads_the_place_by_the_drift_and_what_wanders():
    rng = np.random.default_rng(0)
    p, wait, noise = positive(rng, 10), 0.7, rng.uniform(0.1, 0.2, 10)
    step = np.eye(10)
    step[:3, 7:] = wait * np.eye(3)
    assert predict(p, wait, noise) == pytest.approx(step @ p @ step.T + np.diag(noise))
