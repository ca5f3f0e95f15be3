"""Console and mission as they are used, each a process of its own: the end of one is the end of the other's flight."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from smolbot.ui.link.consoles import ENVIRONMENT, read_console

pytestmark = pytest.mark.slow

SLOW = ("--set", "path.speed_mm_s=0.05", "--set", "stop.max_duration_s=100000", "--set", "localization.quiet_s=1",
        "--force", "preview")  # fmt: skip
"""A letter that takes a quarter of an hour of the tank's time: it is stopped long before."""


class Session:
    """Commands of one user, who has nothing else running."""

    def __init__(self, folder: Path, port: int) -> None:
        self.folder, self.port = folder, port
        (folder / "session").mkdir()
        self.environment = os.environ | {"XDG_RUNTIME_DIR": str(folder / "session")}
        self.environment.pop(ENVIRONMENT, None)

    def begin(self, *arguments: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", "smolbot", *arguments], cwd=self.folder, env=self.environment, text=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip

    def flying(self, name: str) -> subprocess.Popen[str]:
        """A mission that has begun to cycle."""
        run = self.begin("run", "r_path", "--live", "--no-report", "--out", name, *SLOW)
        table = self.folder / name / "cycles.csv"
        while run.poll() is None and not (table.is_file() and table.read_text().count("\n") > 5):
            time.sleep(0.05)
        assert run.poll() is None, run.stderr.read()  # type: ignore[union-attr]
        return run

    def ended(self, run: subprocess.Popen[str], name: str) -> str:
        """Why it stopped; its exit code was that of a stop, and its folder is whole."""
        run.communicate(timeout=60)
        assert run.returncode == 3
        summary = json.loads((self.folder / name / "summary.json").read_text(encoding="utf-8"))
        return str(summary["stop_reason"])


@pytest.fixture
def session(tmp_path: Path) -> Session:
    import socket

    with socket.create_server(("127.0.0.1", 0)) as server:
        return Session(tmp_path, server.getsockname()[1])


@pytest.fixture
def console(session: Session) -> Iterator[subprocess.Popen[str]]:
    process = session.begin("console", "--port", str(session.port), "--json")
    assert process.stdout is not None
    assert process.stdout.readline().startswith("{")
    yield process
    process.terminate()
    process.communicate(timeout=60)


def test_smolbot_stop_needs_no_browser(session: Session, console: subprocess.Popen[str]) -> None:
    run = session.flying("a")
    stop = session.begin("stop", "--json")
    told, _ = stop.communicate(timeout=60)
    assert stop.returncode == 0
    assert [one["stopped"] for one in json.loads(told)["stopped"]] == [True]
    assert session.ended(run, "a") == "stopped by the operator (console)"


def test_a_killed_console_stops_its_mission(session: Session, console: subprocess.Popen[str]) -> None:
    run = session.flying("a")
    console.send_signal(signal.SIGKILL)
    assert session.ended(run, "a").startswith("the console is gone")


@pytest.mark.skipif(os.name != "posix", reason="no SIGSTOP there")
def test_a_console_that_hangs_stops_its_mission(session: Session, console: subprocess.Popen[str]) -> None:
    run = session.flying("a")
    console.send_signal(signal.SIGSTOP)
    try:
        assert session.ended(run, "a") == "the console is gone: no sign of life for 2 s"
    finally:
        console.send_signal(signal.SIGCONT)


def test_a_mission_opens_a_console_for_itself_which_ends_after_it(session: Session) -> None:
    run = session.flying("a")
    written = list((session.folder / "session" / "smolbot").glob("console-*.json"))
    assert len(written) == 1
    known = read_console(written[0])
    assert known is not None
    stop = session.begin("stop")
    stop.communicate(timeout=60)
    assert session.ended(run, "a") == "stopped by the operator (console)"
    end = time.monotonic() + 60
    while written[0].exists() and time.monotonic() < end:
        time.sleep(0.1)
    assert not written[0].exists()


def test_without_a_console_stop_says_so(session: Session) -> None:
    stop = session.begin("stop")
    _, said = stop.communicate(timeout=60)
    assert stop.returncode == 2
    assert "No console of this user runs" in said
