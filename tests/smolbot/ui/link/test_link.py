"""The link between a mission and its console: who is let in, what an order does, and what a lost console does."""

from __future__ import annotations

import contextlib
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest

from smolbot.flight.pause import Pause
from smolbot.flight.safety.stop_latch import Latch
from smolbot.ui.link import feed as feeding
from smolbot.ui.link.console_server import MAX_UNAUTHENTICATED, ConsoleServer, MissionConnection, request_stop
from smolbot.ui.link.consoles import Console, list_running, make_secret, read_console, write_console
from smolbot.ui.link.feed import CONSOLE_REASON, Feed
from smolbot.ui.link.frames import MAX_FRAME_SIZE, Kind, LinkError, make_frame, make_message_frame, parse_message
from smolbot.ui.link.handshake import GREETING


@dataclass
class Heard:
    """Stands where the page does."""

    lines: list[MissionConnection] = field(default_factory=list)
    messages: list[tuple[str, int, bytes]] = field(default_factory=list)
    gone: list[str] = field(default_factory=list)
    told: list[str] = field(default_factory=list)
    news: threading.Condition = field(default_factory=threading.Condition)

    def add_mission(self, line: MissionConnection) -> None:
        self._note(self.lines, line)

    def receive_message(self, line: MissionConnection, topic: str, time_ns: int, data: bytes) -> None:
        self._note(self.messages, (topic, time_ns, data))

    def log_stop(self, line: MissionConnection) -> None:
        pass

    def remove_mission(self, line: MissionConnection, why: str) -> None:
        self._note(self.gone, why)

    def tell(self, line: str) -> None:
        self._note(self.told, line)

    def _note(self, where: list[Any], what: Any) -> None:
        with self.news:
            where.append(what)
            self.news.notify_all()

    def wait(self, until: Callable[[], object]) -> None:
        with self.news:
            assert self.news.wait_for(until, 20.0)


@dataclass
class Mission:
    """Stands where the loop does: halts are counted, and waited for."""

    latch: Latch = field(default_factory=Latch)
    pause: Pause = field(default_factory=Pause)
    halted: threading.Event = field(default_factory=threading.Event)

    def __post_init__(self) -> None:
        self.latch.bind(self.halted.set)


@pytest.fixture
def heard() -> Heard:
    return Heard()


@pytest.fixture
def console(heard: Heard, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[ConsoleServer, Console]]:
    """A running console server, and its file entry."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    secret = make_secret()
    server = ConsoleServer(secret, heard, lambda asked: _stop_all(server, asked), heard.tell)
    yield server, Console(1, server.port, secret, "http://127.0.0.1:1/", 1, str(tmp_path))
    server.close()


def _stop_all(server: ConsoleServer, asked: str) -> list[dict[str, Any]]:
    told = []
    for line in server.connections:
        line.send_order(Kind.STOP, asked)
        line.answered.wait(20.0)
        told.append({"mission": line.about["mission"], "stopped": line.stopped is not None})
    return told


@pytest.fixture
def mission() -> Mission:
    return Mission()


@pytest.fixture
def flown(console: tuple[ConsoleServer, Console], mission: Mission, heard: Heard) -> Iterator[Feed]:
    """A mission that has joined."""
    feed = Feed(console[1].connect(), {"mission": "m", "process": 7}, mission.latch, mission.pause)
    feed.begin()
    heard.wait(lambda: heard.lines)
    yield feed
    feed.end()


def test_messages_arrive_whole_and_in_order(flown: Feed, heard: Heard) -> None:
    sent = [("/timing", k, bytes([k]) * k) for k in range(200)]
    for each in sent:
        flown.put(*each)
    heard.wait(lambda: len(heard.messages) == len(sent))
    assert heard.messages == sent
    assert flown.dropped == 0


def test_stop_trips_the_latch_and_halts_in_the_thread_that_receives_it(
    console: tuple[ConsoleServer, Console], flown: Feed, mission: Mission
) -> None:
    with console[1].connect() as sock:
        told = request_stop(sock, "a test", 20.0)
    assert told == [{"mission": "m", "stopped": True}]
    assert mission.halted.is_set()
    assert (mission.latch.reason, mission.latch.ending) == (CONSOLE_REASON, "stopped")


def test_pause_and_resume_reach_the_loop(flown: Feed, mission: Mission, heard: Heard) -> None:
    held = threading.Event()
    mission.pause.hold = held.set  # type: ignore[method-assign]
    heard.lines[0].send_order(Kind.PAUSE)
    assert held.wait(20.0)
    resumed = threading.Event()
    mission.pause.resume = resumed.set  # type: ignore[method-assign]
    heard.lines[0].send_order(Kind.RESUME)
    assert resumed.wait(20.0)
    assert not mission.latch.tripped


@pytest.mark.parametrize("how", ["closed", "good-bye", "garbage"])
def test_a_console_that_goes_stops_the_mission(how: str, flown: Feed, mission: Mission, heard: Heard) -> None:
    sock = heard.lines[0]._sock
    if how == "closed":
        sock.shutdown(socket.SHUT_RDWR)  # what the system does to a process that was killed
    elif how == "good-bye":
        heard.lines[0].send_order(Kind.BYE)
    else:
        sock.sendall(b"\xff" * 64)
    assert mission.halted.wait(20.0)
    assert mission.latch.reason.startswith("the console is gone")
    assert mission.latch.ending == "failed"


def test_a_console_that_says_nothing_any_more_stops_the_mission(
    console: tuple[ConsoleServer, Console], mission: Mission, heard: Heard, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feeding, "SILENCE_TIMEOUT", 0.2)
    feed = Feed(console[1].connect(), {"mission": "m"}, mission.latch, mission.pause)
    feed.begin()
    heard.wait(lambda: heard.lines)  # a page that beats no more: nobody calls server.beat()
    assert mission.halted.wait(20.0)
    assert "no sign of life" in mission.latch.reason
    feed.end()


def test_signs_of_life_are_no_orders_and_a_good_bye_ends_nothing(
    console: tuple[ConsoleServer, Console], flown: Feed, mission: Mission, heard: Heard
) -> None:
    for _ in range(100):
        console[0].send_heartbeats()
    held = threading.Event()
    mission.pause.hold = held.set  # type: ignore[method-assign]
    heard.lines[0].send_order(Kind.PAUSE)
    assert held.wait(20.0)  # all that came before it was heard
    assert not mission.latch.tripped
    flown.end()
    heard.wait(lambda: heard.gone)
    assert heard.gone == [""]  # it said good-bye
    assert not mission.latch.tripped


def test_a_queue_that_is_full_drops_and_counts_and_never_waits(
    mission: Mission, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feeding, "MAX_QUEUED", 10)
    ours, theirs = socket.socketpair()
    feed = Feed(ours, {}, mission.latch, mission.pause)  # not begun: nothing takes from the queue
    for k in range(25):
        feed.put("/timing", k, b"x")
    assert feed.dropped == 15
    feed.end()
    theirs.close()


def _until_closed(sock: socket.socket) -> None:
    with contextlib.suppress(OSError), sock:  # what it sent was not even read
        sock.shutdown(socket.SHUT_WR)
        while sock.recv(4096):
            pass


def _strangers(port: int) -> Iterator[tuple[str, socket.socket]]:
    def knock() -> socket.socket:
        return socket.create_connection(("127.0.0.1", port), 20.0)

    yield "port scan", knock()
    for name, words in (
        ("http", b"GET / HTTP/1.1\r\nHost: x\r\n\r\n" + b"x" * 200),
        ("huge frame", struct.pack("!IB", 2**32 - 1, 2) + b"\0" * 200),
        ("wrong secret", b"\0" * 64),
        ("its own proof back", GREETING + b"\0" * 64),
    ):
        sock = knock()
        sock.sendall(words)
        yield name, sock


def test_strangers_are_shown_the_door_and_the_mission_is_untouched(
    console: tuple[ConsoleServer, Console], flown: Feed, mission: Mission, heard: Heard
) -> None:
    for number, (_, sock) in enumerate(_strangers(console[0].port), 1):
        _until_closed(sock)
        heard.wait(lambda number=number: len(heard.told) >= number)
    assert all(line.startswith("A connection to the link was closed: ") for line in heard.told)
    assert len(heard.told) == 5
    flown.put("/timing", 1, b"still here")
    heard.wait(lambda: heard.messages)
    assert not mission.latch.tripped
    assert len(heard.lines) == 1


def test_one_who_knows_the_secret_and_talks_nonsense_is_told_so(
    console: tuple[ConsoleServer, Console], heard: Heard
) -> None:
    for words in (
        make_frame(Kind.HELLO, b"not json"),
        make_frame(Kind.HELLO, b"[]"),
        struct.pack("!IB", 2**31, 1),
        make_frame(Kind.STOP),
    ):
        with console[1].connect() as sock:
            sock.sendall(words)
            _until_closed(sock)
    heard.wait(lambda: len(heard.told) == 4)
    assert "a frame of 2147483648 bytes; at most" in " ".join(heard.told)
    assert not heard.lines


def test_a_mission_whose_frames_are_too_long_is_cut_off_alone(
    console: tuple[ConsoleServer, Console], flown: Feed, mission: Mission, heard: Heard
) -> None:
    with console[1].connect() as sock:
        sock.sendall(make_frame(Kind.HELLO, b'{"role": "mission"}') + struct.pack("!IB", MAX_FRAME_SIZE + 1, 2))
        heard.wait(lambda: heard.gone)
    assert "at most" in heard.gone[0]
    flown.put("/timing", 1, b"still here")
    heard.wait(lambda: heard.messages)
    assert not mission.latch.tripped


def test_a_crowd_of_strangers_keeps_no_mission_out_for_good(
    console: tuple[ConsoleServer, Console], heard: Heard
) -> None:
    crowd = [socket.create_connection(("127.0.0.1", console[0].port), 20.0) for _ in range(3 * MAX_UNAUTHENTICATED)]
    for sock in crowd:
        sock.close()
    heard.wait(lambda: len(heard.told) >= MAX_UNAUTHENTICATED)
    while True:  # the last strangers' places are given back as their threads end
        try:
            console[1].connect().close()
        except LinkError:
            continue
        break


def test_messages_cut_short_are_no_messages() -> None:
    whole = make_message_frame("/shots", 5, b"data")[5:]
    assert parse_message(whole) == ("/shots", 5, b"data")
    for cut in (0, 5, 9, 12):
        with pytest.raises(LinkError):
            parse_message(whole[:cut])


def test_a_console_is_found_by_its_file_which_nobody_else_may_read(console: tuple[ConsoleServer, Console]) -> None:
    path = write_console(console[1])
    assert path.stat().st_mode & 0o777 == 0o600
    assert read_console(path) == console[1]
    assert list_running() == [console[1]]


def test_the_file_of_a_console_that_ended_is_cleared_away(console: tuple[ConsoleServer, Console]) -> None:
    path = write_console(console[1])
    console[0].close()
    assert list_running() == []
    assert not path.exists()


def test_a_foreign_server_at_the_port_is_not_taken_for_a_console(console: tuple[ConsoleServer, Console]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        there = Console(1, server.getsockname()[1], make_secret(), "", 1, "")
        threading.Thread(target=lambda: server.accept()[0].sendall(b"220 mail.example ESMTP\r\n"), daemon=True).start()
        with pytest.raises(LinkError, match=r"no console answers there|closed"):
            there.connect()


def test_the_secret_is_never_sent(console: tuple[ConsoleServer, Console]) -> None:
    said: list[bytes] = []

    class Overheard(socket.socket):
        def sendall(self, data: Any, *_: Any) -> None:
            said.append(bytes(data))
            super().sendall(data)

    from smolbot.ui.link.handshake import authenticate_to_console

    sock = Overheard()
    sock.connect(("127.0.0.1", console[0].port))
    authenticate_to_console(sock, bytes.fromhex(console[1].secret))
    sock.close()
    assert said
    assert bytes.fromhex(console[1].secret) not in b"".join(said)


def test_a_mission_that_is_watched_loads_no_page() -> None:
    script = "import sys, smolbot.ui.cli.live, smolbot.ui.link.console_server; sys.exit('viser' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], timeout=120, check=False).returncode == 0
