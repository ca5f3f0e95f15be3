"""One short flight that was recorded, for all who read records."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import mcap.writer
import pytest

from smolbot.config.mission import load_steering_mission
from smolbot.flight.session import fly
from smolbot.runs.folder import RunFolder
from smolbot.runs.recording.recorder import McapFile
from smolbot.runs.recording.scan import Scan
from smolbot.runs.run import Run
from smolbot.ui.cli.app import main

SHORT = {"path.points_mm": "[[-1.0, 0.0], [0.5, 0.0]]", "start.offset_mm": "[-0.5, 0.3]", "localization.quiet_s": "1.0"}


def _same_pose(a, b):
    if a is None or b is None:
        return a is b
    return (
        (a.time, a.r_squared, a.flip_margin, a.trusted) == (b.time, b.r_squared, b.flip_margin, b.trusted)
        and a.position.tobytes() == b.position.tobytes()
        and a.orientation.tobytes() == b.orientation.tobytes()
        and a.covariance.tobytes() == b.covariance.tobytes()
    )


def _same_cycle(a, b):
    return (
        (a.shot, a.command, a.compute, a.ended, a.rig) == (b.shot, b.command, b.compute, b.ended, b.rig)
        and _same_pose(a.pose, b.pose)
        and _same_pose(a.tracked, b.tracked)
    )


def _foreign(path, topic, data=b"x", profile=""):
    with path.open("wb") as file:
        writer = mcap.writer.Writer(file)
        writer.start(profile)
        schema = writer.register_schema("s", "protobuf", b"")
        if topic:
            channel = writer.register_channel(topic, "protobuf", schema)
            writer.add_message(channel, 0, data, 0)
        writer.finish()
    return path


@pytest.fixture(scope="session")
def same_cycle():
    """Whether two cycles are the same to the last bit."""
    return _same_cycle


@pytest.fixture(scope="session")
def foreign():
    """``foreign(path, topic, data)``: an MCAP file with one message."""
    return _foreign


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Path]:
    """A flight as it was flown, and its folder."""
    folder = tmp_path_factory.mktemp("recorded") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("smolbot.flight.safety.heat_store.find_heat_file", lambda rig: folder.parent / f"{rig}.json")
        return fly(load_steering_mission("line", settings=SHORT), 3, folder=RunFolder(folder), settings=SHORT), folder


@pytest.fixture(scope="session")
def chunked(recorded: tuple[Run, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The record of that flight, flushed as if it had lasted longer: in many chunks, the same on any machine."""
    path = tmp_path_factory.mktemp("chunked") / "run.mcap"
    file = McapFile(path)
    for number, found in enumerate(Scan(recorded[1] / "run.mcap").read_messages()):
        assert found.topic is not None
        file.append(found.topic, found.time, found.data)
        if number == 0 or number % 20 == 5:
            file.flush()
    file.close()
    return path


@pytest.fixture
def copied(recorded: tuple[Run, Path], chunked: Path, tmp_path: Path) -> Path:
    """A copy of its folder with that record, to be damaged."""
    folder = Path(shutil.copytree(recorded[1], tmp_path / "run"))
    shutil.copyfile(chunked, folder / "run.mcap")
    return folder


@pytest.fixture
def smolbot(monkeypatch, capsys):
    """``code, out, err = smolbot("recover", "RUN")``."""

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["smolbot", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err
        return int(ended.value.code or 0), out, err

    return call
