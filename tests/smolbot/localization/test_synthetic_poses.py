"""Poses of a world without signals are checked as a localizer checks those of signals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smolbot.errors import InputError
from smolbot.localization.cold_start import SearchVolume
from smolbot.localization.localizer import Localizer
from smolbot.localization.synthetic import SyntheticFit, SyntheticLocalizer, SyntheticRecording

ROOM = SearchVolume((-0.02, -0.02, 0.045), (0.02, 0.02, 0.07), spacing=5e-3)
NOTHING = np.zeros((10, 0))


def simulate_fix(fitted):
    return SyntheticRecording(NOTHING, 50e3, 0.02, time=1.0, fit=fitted)


@pytest.fixture
def seen(array, along_device, pose_at, hear):
    """``seen(share)``: what a localizer makes of a swing of this share of the stops, without and with signals."""
    localizer, rests = (
        Localizer(array, along_device, None, "paper", ROOM),
        SyntheticLocalizer(array, along_device, ROOM),
    )
    truth = pose_at((3.0, -2.0, 60.0), 30.0)
    loud, swing = localizer.locate_swing(hear(array, along_device, truth), truth)

    def locate_both(share, **other):
        recording = hear(array, along_device, truth, amplitude=share * along_device.theta_max)
        pose, _ = localizer.locate_swing(recording, truth)
        amplitude = share * along_device.theta_max
        fitted = SyntheticFit(loud.position, loud.orientation, amplitude, swing.covariance, loud.r_squared)
        return pose, rests.locate_swing(simulate_fix(replace(fitted, **other)), truth)[0]

    return locate_both


@pytest.mark.parametrize("share", [0.8, 0.2, 0.1, 0.06, 0.05, 0.03, 0.01])
def test_a_swing_too_weak_to_trust_in_a_signal_is_too_weak_in_a_simulated_fix(seen, share):
    recording, simulated = seen(share)
    assert recording.trusted == simulated.trusted == (share > 0.055)


@pytest.mark.parametrize(
    "worse",
    [
        {"position": np.array([0.0, 0.0, 0.1])},
        {"position": np.array([-0.05, 0.0, 0.06])},
        {"r_squared": 0.6},
        {"covariance": np.diag([1e-4] * 3 + [1.0, 1e-4, 1e-4, 1e-4])},
        {"covariance": np.diag([0.02**2, 1e-8, 1e-8] + [1e-4] * 4)},
    ],
    ids=["above", "aside", "unexplained", "turned anyhow", "somewhere"],
)
def test_a_simulated_fix_that_explains_little_or_lies_outside_is_not_trusted(seen, worse):
    assert seen(0.8)[1].trusted
    assert not seen(0.8, **worse)[1].trusted


def test_where_nothing_swung_there_is_no_simulated_fix(array, along_device):
    nobody = SyntheticLocalizer(array, along_device, ROOM)
    for fitted in (None, SyntheticFit(np.zeros(3), np.array([1.0, 0, 0, 0]), 0.0, np.full((7, 7), np.inf), 0.0)):
        with pytest.raises(InputError, match="holds no pose"):
            nobody.locate_swing(simulate_fix(fitted))
