"""A console with its page in this process, a run to look at, and a browser where there is one."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from sim.measure.browser import Browser, find_missing
from smolbot.config.load import load_mission
from smolbot.flight.session import fly
from smolbot.runs.folder import RunFolder
from smolbot.ui.console.open_console import OpenConsole


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one short recorded run, ``line``."""
    folder = tmp_path_factory.mktemp("runs")
    mission = load_mission("line", None, {"stop.max_duration_s": "4", "localization.quiet_s": "1"})
    fly(mission, 3, folder=RunFolder(folder / "line"))
    return folder


@pytest.fixture(scope="session")
def free_port() -> Callable[[], int]:
    """A port that is free now."""

    def find() -> int:
        with socket.create_server(("127.0.0.1", 0)) as server:
            port: int = server.getsockname()[1]
            return port

    return find


@pytest.fixture(scope="module")
def opened(runs: Path, free_port: Callable[[], int], tmp_path_factory: pytest.TempPathFactory) -> Iterator[OpenConsole]:
    """A console that is open for the tests of one module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("session")))
        said: list[str] = []
        console = OpenConsole(port=free_port(), runs=runs, log=said.append)
        yield console
        console.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Headless Chromium."""
    lack = find_missing()
    if lack and os.environ.get("SMOLBOT_NO_SKIPS") == "1":
        pytest.fail(lack)
    if lack:
        pytest.skip(lack)
    with Browser(900, 560) as found:
        yield found
