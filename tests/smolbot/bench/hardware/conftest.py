"""A simulated board with the real firmware, where the tools for it are installed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from sim.measure.firmware_figures import Wire
from sim.twin.firmware import find_missing_tools
from sim.twin.simulated_uno import SimulatedUno
from smolbot.bench.hardware.stage import MagnetStage
from smolbot.bench.hardware.wiring import StageSection


@pytest.fixture(scope="session")
def tools() -> None:
    """Skip, or fail where nothing may be skipped, without compiler and simulator."""
    lack = find_missing_tools()
    if lack is not None and os.environ.get("SMOLBOT_NO_SKIPS") == "1":
        pytest.fail(f"nothing may be skipped, but {lack}")
    if lack is not None:
        pytest.skip(lack)


@pytest.fixture
def uno(tools: None, tmp_path: Path) -> Iterator[SimulatedUno]:
    board = SimulatedUno()
    try:
        board.start(tmp_path / "stage")
        yield board
    finally:
        board.close()


@pytest.fixture
def wire(uno: SimulatedUno, tmp_path: Path) -> Iterator[Wire]:
    opened = Wire(tmp_path / "stage")
    yield opened
    opened.close()


@pytest.fixture
def section(tmp_path: Path) -> StageSection:
    return StageSection(port=str(tmp_path / "stage"))


@pytest.fixture
def stage(uno: SimulatedUno, section: StageSection) -> Iterator[MagnetStage]:
    """The driver, open on a board with the magnet away."""
    uno.set_switches(near=False, away=True)
    driver = MagnetStage(section)
    try:
        driver.open()
        yield driver
    finally:
        driver.close()
