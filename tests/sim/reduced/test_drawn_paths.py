"""Drawn paths that cross themselves: what passes was visited, and what preview calls a go is flown whole."""

from __future__ import annotations

import numpy as np
import pytest

from smolbot.paths.polylines import find_crossings
from tests.sim.reduced.drawn_paths import LAWS, SEEDS, draw_path, fly_all


@pytest.mark.parametrize("seed", range(8))
def test_a_drawn_path_is_drawn_again_and_crosses_itself(seed):
    path = draw_path(seed)
    assert np.array_equal(path, draw_path(seed))
    assert any(abs(a - b) > 0.1 for a, b in find_crossings(path, path))
    assert np.abs(path).max() <= 9.0


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_no_flight_of_a_drawn_path_passes_that_left_out_a_part(law):
    flown = list(fly_all(SEEDS, (law,)))
    assert [f.seed for f in flown if f.figures["verdict"] == "passed" and f.figures["visited_share"] < 0.98] == []
    completed = [f for f in flown if f.figures["status"] == "completed"]
    assert np.mean([f.figures["visited_share"] for f in completed]) > 0.99
