"""A mission that is killed leaves a record that can be recovered, and that lies in nothing."""

from __future__ import annotations

import pytest

from sim.kills import PHASES, kill_all

SHORT = {"path.points_mm": "[[-1.0, 0.0], [0.5, 0.0]]", "start.offset_mm": "[-0.5, 0.3]", "localization.quiet_s": "1.0"}


def test_what_was_flushed_before_a_kill_is_there_and_true(tmp_path):
    outcomes = list(kill_all(3, 3, "line", SHORT, tmp_path))
    assert [o.faults for o in outcomes] == [[]] * 3
    assert max(o.recovered for o in outcomes) > 0
    assert max(o.messages for o in outcomes) >= max(o.flushed for o in outcomes) > 0


@pytest.mark.slow
def test_of_fifty_killed_missions_each_is_recovered_and_misses_half_a_second_at_most(tmp_path):
    outcomes = list(kill_all(50, 1, "r_small", {}, tmp_path))
    assert [o for o in outcomes if o.faults or o.late] == []
    assert {o.phase for o in outcomes} == set(PHASES)
    assert sum(o.torn for o in outcomes) > 20
    assert all(o.cycles == 0 for o in outcomes if not o.messages)
