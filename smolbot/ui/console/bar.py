"""The bar above the page: the state of the mission in a word, and the buttons that must always work."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from smolbot.ui.console.flight_state import FlightState
from smolbot.ui.link.frames import Kind

UPDATE_INTERVAL = 0.2
"""Seconds between two updates of the bar."""

GREEN, BLUE, AMBER, RED, GREY = "#15803d", "#1d4ed8", "#b45309", "#dc2626", "#5b6675"

_MODES = {
    "quiet": ("LISTENING", BLUE),
    "search": ("SEARCHING", BLUE),
    "lost": ("SIGNAL LOST", AMBER),
    "hold": ("HOLDING", BLUE),
}
_ENDINGS = {"completed": GREEN, "stopped": AMBER}

Order = Callable[[Kind, str], None]


def describe_state(flight: FlightState, time_: float | None = None) -> tuple[str, str]:
    """Return the state of a run in a word, and its colour.

    Parameters
    ----------
    flight : FlightState
    time_ : float, in s, optional
        On the rig's clock; the latest unless given.

    Returns
    -------
    word : str
    colour : str
        As in CSS.
    """
    ended = flight.ending
    if ended is not None and (time_ is None or time_ >= flight.latest):
        return ended.status.upper(), _ENDINGS.get(ended.status, RED)
    text = flight.find_text(time_)
    if text is None:
        return ("LEARNING" if flight.mission is not None else "STARTING"), BLUE
    if flight.is_paused(time_):
        return "PAUSED", AMBER
    if text.mode == "track":
        return ("APPROACHING", BLUE) if text.phase == "approach" else ("FLYING", GREEN)
    if text.mode == "hold" and not flight.steers:
        return "WATCHING", GREEN
    return _MODES.get(text.mode, (text.mode.upper(), BLUE))


def make_bar_state(
    flight: FlightState | None, flying: bool, starting: str, time_: float | None = None, replay: str = ""
) -> dict[str, Any]:
    """Build what the bar shows, for its script.

    Parameters
    ----------
    flight : FlightState or None
    flying : bool
        Whether a mission is connected that can be paused.
    starting : str
        Name of a mission that was started and has not joined yet; empty if there is none.
    time_ : float, in s, optional
        On the rig's clock; the latest unless given.
    replay : str
        Text beside the name of a run that is over.

    Returns
    -------
    dict
    """
    if flight is None:
        word = ("STARTING", BLUE) if starting else ("IDLE", GREY)
        note = f"{starting} loads" if starting else "Choose a mission and start it, or open a run."
        return _fill_bar_state(word, "smolbot console", note, flying=False)
    text = flight.find_text(time_)
    values = flight.cycles.get_values(time_)
    error, progress = (values[-1, 0], values[-1, 2]) if len(values) else (math.nan, math.nan)
    allowed = flight.tolerance
    happened = flight.list_events(time_)
    note = (text.note if text else "it listens, and learns the noise and the coils") or (
        happened[-1][1] if happened else ""
    )
    if flight.ending is not None and (time_ is None or time_ >= flight.latest):
        note = flight.ending.reason
    state = describe_state(flight, time_)
    fine = allowed is None or not error > allowed
    return _fill_bar_state(
        (f"▶ {state[0]}" if replay else state[0], state[1]),
        flight.name + (f", seed {flight.seed}" if flight.seed is not None else "") + replay,
        note,
        flying=flying and flight.ending is None,
        paused=flight.is_paused(),
        error=f"{error:.2f} mm" if math.isfinite(error) else "–",
        tolerance=f"error to path, {allowed:g} allowed" if allowed is not None else "error to path",
        error_colour="#86efac" if fine else "#fca5a5",
        progress=f"{100 * progress:.0f} %" if math.isfinite(progress) else "–",
        time=f"{flight.latest if time_ is None else time_:.1f}",
        truth=len(flight.true) > 0,
    )


def _fill_bar_state(state: tuple[str, str], mission: str, note: str, *, flying: bool, **figures: Any) -> dict[str, Any]:
    shown = {
        "error": "–", "progress": "–", "time": "–", "tolerance": "error to path", "error_colour": "", "paused": False,
        "truth": False,
    }  # fmt: skip
    return {
        **shown,
        **figures,
        "state": state[0],
        "colour": state[1],
        "mission": mission,
        "note": note,
        "flying": flying,
    }


class Bar:
    """Answers requests for the page itself and for its bar, in the event loop of the page's server.

    Parameters
    ----------
    look : callable
        Returns what to show; see `make_bar_state`.
    order : callable
        Passes an order on to every mission, without waiting.
    may_order : callable
        Whether a request's path has the key of an authenticated page.
    key : str
        Key for the page's script.

    Attributes
    ----------
    stop_times : list of float, in s
        Times of the stop orders on the monotonic clock.
    open : int
        Number of open pages.
    """

    def __init__(
        self, look: Callable[[], dict[str, Any]], order: Order, may_order: Callable[[str], bool], key: str
    ) -> None:
        self._look, self._order, self._may_order = look, order, may_order
        self._page = build_page(key)
        self.stop_times: list[float] = []
        self.open = 0

    def answer(self, path: str) -> tuple[int, str, bytes] | None:
        """Answer a plain request; see `page_access.open_viser`.

        Parameters
        ----------
        path : str

        Returns
        -------
        (int, str, bytes) or None
            Status, content type and body; None if the request is not ours.
        """
        place = path.partition("?")[0]
        if place in ("/", "/index.html"):
            return 200, "text/html; charset=utf-8", self._page
        if place != "/stop":
            return None
        if not self._may_order(path):
            return 403, "text/plain", b"Only a page of this console may stop a mission.\n"
        self._execute("stop")
        return 200, "text/plain", b"stopping\n"

    async def serve(self, connection: Any) -> None:
        """Serve the websocket of one page's bar until it closes.

        Parameters
        ----------
        connection : websockets.asyncio.server.ServerConnection
        """
        if not self._may_order(connection.request.path):
            await connection.close(1008, "only a page of this console may use this")
            return
        telling = asyncio.ensure_future(self._send_updates(connection))
        self.open += 1
        try:
            async for word in connection:
                self._execute(word if isinstance(word, str) else "")
        finally:
            self.open -= 1
            telling.cancel()

    def _execute(self, word: str) -> None:
        if word == "stop":
            self.stop_times.append(time.monotonic())
            self._order(Kind.STOP, "page")
        elif word in ("pause", "resume"):
            self._order(Kind.PAUSE if word == "pause" else Kind.RESUME, "page")

    async def _send_updates(self, connection: Any) -> None:
        from websockets.exceptions import ConnectionClosed

        with contextlib.suppress(ConnectionClosed):
            while True:  # again and again, so that a page notices when nobody tells it anything
                await connection.send(json.dumps(self._look()))
                await asyncio.sleep(UPDATE_INTERVAL)


def build_page(key: str) -> bytes:
    """Build the page: that of viser with our bar above it.

    Parameters
    ----------
    key : str
        Key for the page's script.

    Returns
    -------
    bytes
    """
    import viser

    html = (Path(viser.__file__).parent / "client" / "build" / "index.html").read_text(encoding="utf-8")
    ours = (Path(__file__).parent / "bar.html").read_text(encoding="utf-8").replace("@KEY@", key)
    return html.replace("<title>Viser</title>", "").replace("<body>", f"<body>{ours}", 1).encode()
