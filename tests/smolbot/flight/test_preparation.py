"""What is learned before the first cycle is used no further than the rig allows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smolbot.core.sensing import SensorArray
from smolbot.core.shots import RingDown
from smolbot.flight.device_belief import DeviceBelief
from smolbot.flight.preparation import (
    MAX_TAIL_LEFT,
    TAIL_ERROR,
    Preparation,
    PreparationSettings,
    lengthen_ring_down,
)
from smolbot.flight.scheduler import Scheduler
from smolbot.localization.cold_start import SearchVolume
from smolbot.localization.noise.excitation_transients import SEPARABLE_AFTER
from smolbot.localization.synthetic import SyntheticLocalizer
from smolbot.motion.controller import Command, Cycle


class Unseen:
    """A tracker that knows of nothing."""

    pose, misses, confirmed = None, 0, False


@pytest.mark.parametrize("time_constants", [(1e-4, 3e-4), (3e-4, 1e-4), (1e-3, 2e-3)])
def test_however_quick_the_coils_no_shot_listens_before_the_rig_lets_it(line, along_device, time_constants):
    """Coils that are silent after 4 ms gain nothing where amplifiers need 5 ms; slow ones take their time."""
    limits = replace(line.rig.limits, min_ring_down=5e-3)
    belief = DeviceBelief(along_device)
    scheduler = Scheduler(Cycle(), limits, belief, lambda _: 1e-4 * np.eye(3)[:2], lambda: 0.0)
    array = SensorArray(np.zeros((3, 3)), np.eye(3))
    localizer = SyntheticLocalizer(
        array, along_device, SearchVolume((-1, -1, -1), (1, 1, 1), spacing=1.0), time_constants
    )
    events = []
    first = Preparation(
        localizer, scheduler, PreparationSettings(0.0, 50e3, learn_ring_down=True), lambda shot: None, lambda: 0.0,
        lambda time, what, detail: events.append((what, detail["ring_down_ms"])),
    )  # fmt: skip
    first.learn()
    shot = scheduler.next(Command(None), Unseen())
    assert limits.faults(shot) == []
    waits = next(window.duration for window in shot.windows if isinstance(window, RingDown))
    assert waits == pytest.approx(max(5e-3, SEPARABLE_AFTER * max(time_constants)))
    assert events == [("ring-down learned", pytest.approx(1e3 * waits))]


def test_listening_waits_for_strong_pulling_currents_but_no_longer_than_the_mission():
    cycle, longest, slow, quick = Cycle(3, 12e-3, 2, 10.0), 20e-3, (3e-3, 1e-4), (2e-3, 1e-4)
    waits = [
        lengthen_ring_down(cycle, longest, 150.0, most, [slow, quick]).ring_down for most in (1.0, 8.0, 42.0, 90.0)
    ]
    assert waits == sorted(waits)
    assert (waits[0], waits[-1]) == (cycle.ring_down, longest)
    left = TAIL_ERROR * 42.0 * slow[1] * np.exp(-(3 / 150.0 + waits[2]) / slow[0])
    assert left == pytest.approx(MAX_TAIL_LEFT)


def test_a_cycle_that_waits_long_enough_is_left_as_it_is():
    cycle = Cycle(3, 12e-3, 2, 10.0)
    assert lengthen_ring_down(cycle, 20e-3, 103.5, 8.0, [(3e-3, 2e-4)]) is cycle
    assert lengthen_ring_down(cycle, 20e-3, 103.5, 8.0, []) is cycle
