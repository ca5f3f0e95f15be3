"""Who may open the page, and what anybody else is told."""

from __future__ import annotations

import http.client
import os
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from smolbot.errors import InputError
from smolbot.ui.console.drawing_panel import format_mission
from smolbot.ui.console.open_console import OpenConsole
from smolbot.ui.console.page_access import PageAccess, check_port_free

HERE = {"Host": "127.0.0.1:8420"}
TOKEN = "a-token"


def test_a_page_that_others_can_reach_needs_a_token() -> None:
    with pytest.raises(InputError, match="needs a token"):
        PageAccess("0.0.0.0", 8420)


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        (HERE, None),
        ({"Host": "localhost:8420"}, None),
        (HERE | {"Origin": "http://127.0.0.1:8420"}, None),
        (HERE | {"Origin": "http://evil.example"}, 403),  # another site's page in the operator's browser
        ({"Host": "evil.example:8420"}, 403),  # a name that was made to point here
        ({}, 403),
    ],
)
def test_on_loopback_only_pages_of_this_machine_are_answered(headers: dict[str, str], status: int | None) -> None:
    refused = PageAccess("127.0.0.1", 8420).check_request("/", headers)
    assert (refused.status if refused else None) == status


def test_the_token_is_asked_for_once_and_then_kept_by_the_browser() -> None:
    door, headers = PageAccess("0.0.0.0", 8420, TOKEN), {"Host": "lab.example:8420"}
    for path in ("/", "/?token=wrong", "/?token=", "/bar", "/?Token=a-token"):
        refused = door.check_request(path, headers)
        assert refused is not None
        assert refused.status == 401
    shown = door.check_request(f"/?token={TOKEN}", headers)
    assert shown is not None
    assert shown.status == 303
    assert "HttpOnly; SameSite=Strict" in shown.cookie
    assert door.check_request("/", headers | {"Cookie": shown.cookie.partition(";")[0]}) is None
    wrong = door.check_request("/", headers | {"Cookie": f"{door.cookie}=other"})
    assert wrong is not None
    assert wrong.status == 401


def test_orders_need_the_key_of_a_page_that_was_let_in() -> None:
    door = PageAccess("127.0.0.1", 8420)
    assert door.is_order_allowed(f"/stop?key={door.key}")
    for path in ("/stop", "/stop?key=", "/stop?key=guess", "/stop?key=é"):
        assert not door.is_order_allowed(path)


def test_a_busy_port_is_one_clear_error() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server, pytest.raises(InputError, match="Name another port"):
        check_port_free("127.0.0.1", server.getsockname()[1])


def _ask(console: OpenConsole, path: str, **headers: str) -> tuple[int, str]:
    connection = http.client.HTTPConnection("127.0.0.1", console.access.port, timeout=20.0)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    return answer.status, answer.read().decode(errors="replace")


def test_strangers_stop_nothing(opened: OpenConsole) -> None:
    assert _ask(opened, "/stop?key=guess") == (403, "Only a page of this console may stop a mission.\n")
    status, words = _ask(opened, f"/stop?key={opened.access.key}", Origin="http://evil.example")
    assert (status, words) == (403, "A page of http://evil.example may not use this console.\n")
    assert opened.page.bar.stop_times == []
    assert _ask(opened, f"/stop?key={opened.access.key}")[0] == 200
    assert len(opened.page.bar.stop_times) == 1


@pytest.mark.parametrize(
    "words",
    [
        b"\x16\x03\x01\x02\x00\x01\x00",
        b"GET / HTTP/9.9\r\n\r\n",
        b"POST / HTTP/1.1\r\nHost: x\r\n\r\n",
        b"GET " + b"a" * 70000,
    ],
    ids=["tls", "version", "method", "endless line"],
)
def test_what_is_no_request_is_answered_or_closed_and_the_page_lives_on(words: bytes, opened: OpenConsole) -> None:
    with socket.create_connection(("127.0.0.1", opened.access.port), 20.0) as sock:
        try:
            sock.sendall(words)
            sock.shutdown(socket.SHUT_WR)
            answer = sock.recv(4096)
        except ConnectionError:
            answer = b""
    assert answer == b"" or answer.startswith(b"HTTP/1.1 4")
    assert _ask(opened, "/")[0] == 200


def test_a_huge_or_senseless_message_closes_only_the_page_that_sent_it(opened: OpenConsole) -> None:
    import viser
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    address = f"ws://127.0.0.1:{opened.access.port}"
    for path, message in (
        ("/", b"\xc1" * 100),
        ("/", b"x" * 2_000_000),
        (f"/bar?key={opened.access.key}", "x" * 2_000_000),
    ):
        subprotocols = [f"viser-v{viser.__version__}"] if path == "/" else None
        page = connect(address + path, subprotocols=subprotocols, max_size=None)  # type: ignore[arg-type]
        with page, pytest.raises(ConnectionClosed):
            page.send(message)
            while True:
                page.recv(timeout=20.0)
    with connect(f"{address}/bar?key={opened.access.key}") as bar:
        assert '"state"' in str(bar.recv(timeout=20.0))
    with (
        connect(f"{address}/bar?key=guess") as bar,
        pytest.raises(ConnectionClosed, match="only a page of this console"),
    ):
        bar.recv(timeout=20.0)


def test_no_page_opens_a_public_address(opened: OpenConsole) -> None:
    opened.page.server.request_share_url()
    assert opened.page.server._share_tunnel is None


def _command(*arguments: str, session: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "smolbot", "console", *arguments],
        capture_output=True, text=True, timeout=120, env=os.environ | {"XDG_RUNTIME_DIR": session}, check=False,
    )  # fmt: skip


def test_a_second_console_is_told_of_the_first(opened: OpenConsole, free_port: Callable[[], int]) -> None:
    done = _command("--runs", opened.console.runs, "--port", str(free_port()), session=os.environ["XDG_RUNTIME_DIR"])
    assert done.returncode == 2
    assert f"A console runs already (process {os.getpid()})" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_console_on_a_busy_port_ends_with_one_message(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        done = _command("--port", str(server.getsockname()[1]), session=str(tmp_path))
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "Name another port" in done.stderr


def test_a_drawing_becomes_a_mission_that_loads(tmp_path: Path) -> None:
    from smolbot.config.load import load_mission
    from smolbot.config.mission import Mission

    points = [(-8.0, -8.0), (0.0, 6.5), (8.0, -8.0)]
    path = tmp_path / "drawn.toml"
    path.write_text(format_mission(load_mission("r_path"), points, 0.0, "my letter"), encoding="utf-8")
    drawn = load_mission(str(path))
    assert isinstance(drawn, Mission)
    assert drawn.name == "my_letter"
    assert np.allclose(1e3 * drawn.path.points[:, :2], points)
    with pytest.raises(InputError, match="only looks"):
        format_mission(load_mission("endoscope"), points, 0.0, "x")
