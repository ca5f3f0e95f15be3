"""The page in a real browser: what is pressed reaches the mission, what the mission says is shown."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest

from sim.measure.browser import Browser
from smolbot.flight.safety.stop_latch import Latch
from smolbot.runs.recording.reader import stream_messages
from smolbot.ui.console.open_console import OpenConsole
from smolbot.ui.link.feed import CONSOLE_REASON, Feed
from smolbot.ui.link.join import join_console


@dataclass
class Mission:
    """Stands where the loop does."""

    latch: Latch = field(default_factory=Latch)
    halted: threading.Event = field(default_factory=threading.Event)
    held: threading.Event = field(default_factory=threading.Event)
    resumed: threading.Event = field(default_factory=threading.Event)

    def __post_init__(self) -> None:
        self.latch.bind(self.halted.set)

    def hold(self) -> None:
        self.held.set()

    def resume(self) -> None:
        self.resumed.set()


@pytest.fixture(scope="module")
def page(opened: OpenConsole, browser: Browser) -> Browser:
    browser.open(opened.access.address)
    return browser


@pytest.fixture
def mission() -> Mission:
    return Mission()


@pytest.fixture
def flying(opened: OpenConsole, page: Browser, mission: Mission) -> Iterator[Feed]:
    """A mission that has joined, and has said all of the recorded run but its end."""
    feed = join_console(opened.console, {"mission": "line on tank"}, mission.latch, mission)
    for number, (topic, data) in enumerate(stream_messages(f"{opened.console.runs}/line")):
        if topic not in ("/run/end", "/windows"):
            feed.put(topic, number, data)
    page.wait_for_text("state", ("FLYING", "APPROACHING"))
    yield feed
    feed.end()


def test_a_page_without_a_mission_says_so(page: Browser) -> None:
    assert page.read_text("state") == "IDLE"
    assert not page.read_errors()


def test_stop_pressed_in_a_browser_stops_the_mission(flying: Feed, page: Browser, mission: Mission) -> None:
    page.press_stop()
    assert mission.halted.wait(20.0)
    assert (mission.latch.reason, mission.latch.ending) == (CONSOLE_REASON, "stopped")


def test_escape_stops_too(flying: Feed, page: Browser, mission: Mission) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    ActionChains(page.driver).send_keys(Keys.ESCAPE).perform()
    assert mission.halted.wait(20.0)


def test_stop_reaches_the_mission_from_a_page_that_is_gone_at_once(
    opened: OpenConsole, flying: Feed, page: Browser, mission: Mission
) -> None:
    page.watch_clicks(then_leave=True)
    page.press_stop()
    assert mission.halted.wait(20.0)
    assert page.driver.current_url == "about:blank"
    page.open(opened.access.address)


def test_a_page_that_is_closed_stops_nothing(
    opened: OpenConsole, flying: Feed, page: Browser, mission: Mission
) -> None:
    page.driver.get("about:blank")
    page.open(opened.access.address)
    assert page.read_text("state") in ("FLYING", "APPROACHING")
    assert not mission.latch.tripped


def test_pause_and_resume(flying: Feed, page: Browser, mission: Mission) -> None:
    from smolbot.runs.recording.messages import encode_event
    from smolbot.runs.run import Event

    page.driver.find_element("id", "pause").click()
    assert mission.held.wait(20.0)
    flying.put("/events", 0, encode_event(Event(99.0, "paused")).SerializeToString())  # as the loop says it
    page.wait_for_text("state", ("PAUSED",))
    assert page.wait_for_text("pause", ("Resume",))
    page.driver.find_element("id", "pause").click()
    assert mission.resumed.wait(20.0)
    flying.put("/events", 0, encode_event(Event(99.1, "resumed")).SerializeToString())
    page.wait_for_text("state", ("FLYING", "APPROACHING"))


def test_a_mission_whose_process_is_gone_is_shown_as_failed(opened: OpenConsole, flying: Feed, page: Browser) -> None:
    flying._sock.close()  # as the system does to a process that was killed
    page.wait_for_text("state", ("FAILED",))
    assert "its process is gone" in page.read_text("note")


def test_a_recorded_run_is_looked_through(opened: OpenConsole, page: Browser) -> None:
    runs = opened.page.runs
    runs.refresh()
    runs.open("line")
    try:
        assert runs.flight is not None
        page.wait_for_text("state", ("▶ TIMEOUT",))
        last = page.read_text("time")
        runs.at.value = round(0.5 * runs.flight.latest, 1)
        page.wait_for_text("time", (f"{runs.at.value:.1f}",))
        assert page.read_text("time") != last
        assert page.read_text("state") != "▶ TIMEOUT"
        assert page.read_text("mission").endswith("recorded")
    finally:
        runs.leave()


def test_clicks_on_the_liquid_draw_a_path(opened: OpenConsole, page: Browser) -> None:
    drawing = opened.page.drawing
    opened.page.starting.choose()
    drawing._set_active(True)
    drawn: list[Any] = []
    try:
        canvas = max(page.driver.find_elements("tag name", "canvas"), key=lambda c: c.size["width"] * c.size["height"])
        from selenium.webdriver.common.action_chains import ActionChains

        for x, y in ((-60, 40), (0, -40), (60, 40)):
            count = len(drawing.points)
            for _ in range(50):  # the page may still load what makes it listen
                ActionChains(page.driver).move_to_element_with_offset(canvas, x, y).click().perform()
                page.read_text("state")
                if len(drawing.points) > count:
                    break
            drawn.append(drawing.points[-1])
        assert len({point for point in drawn}) == 3
        assert drawn[0][0] < drawn[1][0] < drawn[2][0]  # to the right is +x
        assert drawn[0][1] < drawn[1][1] > drawn[2][1]  # up is +y
        assert all(abs(value) < 30.0 for point in drawn for value in point)
        path = drawing.write()
        assert "points_mm" in path.read_text(encoding="utf-8")
    finally:
        drawing._take_back("Clear")
        drawing._set_active(False)


def test_a_page_without_the_token_shows_why(opened: OpenConsole, page: Browser) -> None:
    page.driver.get(f"http://127.0.0.1:{opened.access.port}/stop")
    assert "Only a page of this console may stop a mission." in page.driver.page_source
    page.open(opened.access.address)
