"""A mission that is killed leaves a record that can be recovered, and that lies in nothing."""

from __future__ import annotations

import pytest

from sim.measure.kills import PHASES, Victim, check_recovery, kill_all

SHORT = {"path.points_mm": "[[-2.5, 0.0], [2.5, 0.0]]", "start.offset_mm": "[-0.5, 0.3]", "localization.quiet_s": "1.0"}


@pytest.mark.parametrize(("phase", "delay"), [("learn", 0.1), ("fly", 0.6), ("end", 0.05)])
def test_what_was_flushed_before_a_kill_is_there_and_true(tmp_path, phase, delay):
    victim = Victim(tmp_path / "victim", "line", 3, SHORT)
    outcome = check_recovery(victim, phase, victim.kill(phase, delay))
    assert outcome.faults == []
    assert outcome.messages >= outcome.flushed > 0
    assert (outcome.recovered > 0) == (phase != "learn")


@pytest.mark.slow
def test_of_fifty_killed_missions_each_is_recovered_and_lacks_half_a_second_at_most(tmp_path):
    outcomes = list(kill_all(50, 1, "r_small", {}, tmp_path))
    assert [o for o in outcomes if o.faults or o.late] == []
    assert {o.phase for o in outcomes} == set(PHASES)
    assert sum(o.torn for o in outcomes) > 20
    assert all(o.cycles == 0 for o in outcomes if not o.messages)
