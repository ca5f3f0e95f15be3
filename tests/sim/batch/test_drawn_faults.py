"""Whatever fails in flight: no exception comes out of it, and no pose that is wrong is trusted."""

from __future__ import annotations

import pytest

from sim.tank.tank_faults import TANK_FAULTS, find_channels, parse_tank_faults
from smolbot.config.rig import load_rig
from tests.sim.batch.drawn_faults import draw_faults, fly_with_faults


def test_drawn_faults_are_known_and_differ() -> None:
    drawn = [fault for seed in range(200) for fault in parse_tank_faults(draw_faults(seed))]
    rig = load_rig("tank")
    for fault in drawn:
        find_channels(fault, rig)
    names = {fault.name for fault in drawn}
    assert len(names) > 0.7 * len(TANK_FAULTS)
    assert draw_faults(3) == draw_faults(3) != draw_faults(4)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100))
def test_a_flight_with_drawn_faults_raises_nothing_and_trusts_no_wrong_pose(seed: int) -> None:
    flight = fly_with_faults(seed, draw_faults(seed))
    assert not flight.bad, str(flight)
    assert flight.reason
