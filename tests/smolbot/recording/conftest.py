"""One short flight that was recorded, for all who read records."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from smolbot.flown import Run
from smolbot.flying import fly
from smolbot.missionfile import load_mission
from smolbot.records.folder import RunFolder

SHORT = {"path.points_mm": "[[-1.0, 0.0], [0.5, 0.0]]", "start.offset_mm": "[-0.5, 0.3]", "localization.quiet_s": "1.0"}


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Path]:
    """A flight as it was flown, and its folder."""
    folder = tmp_path_factory.mktemp("recorded") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("smolbot.heatmemory.kept_at", lambda rig: folder.parent / f"{rig}.json")
        return fly(load_mission("line", settings=SHORT), 3, folder=RunFolder(folder), settings=SHORT), folder


@pytest.fixture
def copied(recorded: tuple[Run, Path], tmp_path: Path) -> Path:
    """A copy of its folder, to be damaged."""
    return Path(shutil.copytree(recorded[1], tmp_path / "run"))
