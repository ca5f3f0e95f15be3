"""The assumed device has one owner: estimator and resonance filter use a learned value at once, shots later."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np

from smolbot import Device, load_mission
from smolbot.flight.assembly import make_loop
from smolbot.flight.device_belief import DeviceBelief
from smolbot.flight.session import open_rig
from smolbot.motion.robot import compute_magnet_inertia

DEVICE = Device(0.89e-3, np.array([0.0, 0.0, 1.0]), 1.5e-3, 0.31, 103.5, 31.7, "exponential")


def test_a_learned_magnet_is_scheduled_with_the_next_retune_and_changes_no_inertia():
    belief = DeviceBelief(DEVICE)
    belief.learn_magnet(0.9e-3, 1.6e-3)
    assert (belief.device.moment, belief.device.l0) == (0.9e-3, 1.6e-3)
    assert belief.scheduled is DEVICE
    belief.retune(103.9, 30.0)
    assert belief.scheduled is belief.device
    assert (belief.device.moment, belief.device.frequency, belief.device.damping) == (0.9e-3, 103.9, 30.0)
    assert belief.inertia == compute_magnet_inertia(DEVICE.moment, DEVICE.l0)


def test_in_a_flight_all_parts_have_the_same_belief_and_shots_are_made_for_the_last_retune():
    """Sensors, and with them the moment, are learned before and after a retune of a frequency that was 0.4 Hz off."""
    mission = load_mission("line", settings={"localization.quiet_s": "2.0", "stop.max_duration_s": "15"})
    mission.robot.calibrated = replace(mission.robot.device, frequency=103.9)
    with closing(open_rig(load_mission("line"), 3)) as rig, make_loop(rig, mission) as loop:
        belief = loop.scheduler.belief
        while not loop.done:
            scheduled, n_events = belief.scheduled, len(loop.events)
            record = loop.step()
            assert record.shot.listen.frequency == scheduled.frequency
            assert loop.resonance.belief is belief
            assert loop.localizer.device is belief.device
            retuned = any(event.what == "device retuned" for event in loop.events[n_events:])
            assert belief.scheduled is (belief.device if retuned else scheduled)
    happened = [event.what for event in loop.events if event.what in ("array learned", "device retuned")]
    assert happened[0] == happened[-1] == "array learned"
    assert "device retuned" in happened
    assert belief.inertia == compute_magnet_inertia(mission.robot.device.moment, mission.robot.device.l0)
