"""Figures over arc length draw each position on the strand on which the robot was."""

from __future__ import annotations

import numpy as np
import pytest

from smolbot.paths.arc_lengths import assign_arc_lengths
from smolbot.paths.curve import Curve

TURN = np.linspace(0.0, 2.0 * np.pi, 401)
SHAPES = {
    "figure eight": np.column_stack([8.0 * np.sin(TURN), 5.0 * np.sin(2.0 * TURN)]),
    "circle": 7.0 * np.column_stack([np.cos(TURN), np.sin(TURN)]),
    "circle twice": 7.0 * np.column_stack([np.cos(2.0 * TURN), np.sin(2.0 * TURN)]),
    "there and back": np.column_stack([10.0 - np.abs(np.linspace(-10.0, 10.0, 401)), np.zeros(401)]),
}
NOISE_MM, BOUND_MM = (
    0.15,
    1.0,
)
"""Of positions, and of arc lengths: some times the noise. A wrong strand is off by far more."""


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("share", [0.5, 1.0])
def test_positions_lie_on_the_strand_that_was_flown(shape: str, share: float) -> None:
    path = Curve(1e-3 * np.column_stack([SHAPES[shape], np.zeros(401)]))
    arc = np.linspace(0.0, share * path.length, 500)
    flown = path.at(arc) + 1e-3 * NOISE_MM * np.random.default_rng(1).normal(size=(500, 3))
    error = 1e3 * np.abs(assign_arc_lengths(path, flown) - arc)
    # at the end of a way back, and only there, the two strands are one place
    assert np.quantile(error, 0.98) < BOUND_MM


def test_a_part_that_was_left_out_moves_no_other_position() -> None:
    path = Curve(1e-3 * np.column_stack([SHAPES["figure eight"], np.zeros(401)]))
    arc = np.concatenate([np.linspace(0.0, 0.3, 150), np.linspace(0.7, 1.0, 150)]) * path.length
    assert np.abs(assign_arc_lengths(path, path.at(arc)) - arc).max() < 1e-3 * BOUND_MM


def test_no_position_has_no_arc_length() -> None:
    assert len(assign_arc_lengths(Curve(np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]])), np.zeros((0, 3)))) == 0
