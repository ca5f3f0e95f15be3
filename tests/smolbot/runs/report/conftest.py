"""One recorded flight for all tests of reports."""

from __future__ import annotations

import pytest

from smolbot.config.mission import load_steering_mission
from smolbot.flight.session import fly
from smolbot.runs.folder import RunFolder
from smolbot.runs.recording import message_queue
from smolbot.runs.report.recorded_flight import RecordedFlight

SHORT = {"path.points_mm": "[[-1.5, 0.0], [1.5, 0.0]]", "start.offset_mm": "[-0.5, 0.3]", "localization.quiet_s": "2.0",
         "localization.learn_ring_down": "true"}  # fmt: skip


@pytest.fixture(scope="session")
def mission():
    return load_steering_mission("line", settings=SHORT)


@pytest.fixture(scope="session")
def folder(mission, tmp_path_factory):
    path = tmp_path_factory.mktemp("reported") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(message_queue, "FLUSH_INTERVAL", 0.02)  # so that wherever the record is cut, something is in it
        fly(mission, 3, folder=RunFolder(path), settings=SHORT)
    return path


@pytest.fixture(scope="session")
def flight(folder, mission):
    return RecordedFlight.read(folder, mission)
