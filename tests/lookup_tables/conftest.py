"""Coils and tables small enough to be built in a few milliseconds."""

from __future__ import annotations

import numpy as np
import pytest

from lookup_tables import FieldTable, RoundCoil, build, mesh_axis

DIRECTIONS = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0)}


@pytest.fixture(scope="session")
def coils() -> list[RoundCoil]:
    """Four air coils around the origin, 84 mm between opposing faces."""
    return [
        RoundCoil(name, 0.052 * np.array(axis), np.array(axis), 0.015, 0.035, 0.020, 200)
        for name, axis in DIRECTIONS.items()
    ]


@pytest.fixture(scope="session")
def axes() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return mesh_axis(-0.008, 0.012, 0.001), mesh_axis(-0.010, 0.010, 0.001), mesh_axis(-0.003, 0.003, 0.001)


@pytest.fixture(scope="session")
def table(coils, axes) -> FieldTable:
    return build(coils, *axes)


@pytest.fixture(scope="session")
def points(table) -> np.ndarray:
    """Random points between the nodes."""
    return np.random.default_rng(1).uniform(*table.bounds, (300, 3))
