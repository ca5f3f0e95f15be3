"""One recorded flight for all tests of reports."""

from __future__ import annotations

import pytest

from smolbot.config.mission import load_mission
from smolbot.flight.session import fly
from smolbot.runs.folder import RunFolder
from smolbot.runs.recording import pump
from smolbot.runs.report.flight import Flight

SHORT = {"path.points_mm": "[[-1.5, 0.0], [1.5, 0.0]]", "start.offset_mm": "[-0.5, 0.3]", "localization.quiet_s": "2.0",
         "localization.learn_ring_down": "true"}  # fmt: skip


@pytest.fixture(scope="session")
def mission():
    return load_mission("line", settings=SHORT)


@pytest.fixture(scope="session")
def folder(mission, tmp_path_factory):
    path = tmp_path_factory.mktemp("reported") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pump, "FLUSH_EVERY", 0.02)  # so that wherever the record is cut, something is in it
        fly(mission, 3, folder=RunFolder(path), settings=SHORT)
    return path


@pytest.fixture(scope="session")
def flight(folder, mission):
    return Flight.read(folder, mission)
