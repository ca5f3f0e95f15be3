"""The panel in which recorded runs are opened and browsed."""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smolbot.errors import SmolbotError
from smolbot.runs.recording.reader import stream_messages
from smolbot.runs.recording.recorder import RECORD
from smolbot.ui.console.flight_state import FlightState
from smolbot.ui.console.preview_process import panel

if TYPE_CHECKING:
    from viser import ViserServer

NO_RUN = "–"
MAX_RUNS = 100
"""Largest number of runs in the list, the newest first."""


def list_runs(folder: Path) -> list[str]:
    """List the run folders that have a record, the newest first.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    list of str
        Names of at most `MAX_RUNS` folders.
    """
    found = [path.parent for path in folder.glob(f"*/{RECORD}")]
    return [path.name for path in sorted(found, key=lambda path: path.stat().st_mtime, reverse=True)[:MAX_RUNS]]


def describe_run(folder: Path) -> str:
    """Describe a run in one line, from its summary.

    Parameters
    ----------
    folder : Path
        Run folder.

    Returns
    -------
    str
    """
    try:
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return "it has no summary: it flies, or was ended from outside"
    tracking = summary.get("tracking_error_mm")
    words = [f"{summary['status']}: {summary['stop_reason']}", f"verdict {summary['verdict']}"]
    visited = summary.get("visited_share")
    words += [f"{100.0 * visited:.0f} % of the path visited"] if visited is not None else []
    words += [f"true robot to path {tracking['mean']:.2f} mm on average"] if tracking else []
    return "; ".join(words)


def read_flight(path: Path) -> FlightState:
    """Read a recorded run, message by message.

    Parameters
    ----------
    path : Path
        Run folder, or its record.

    Returns
    -------
    FlightState

    Raises
    ------
    InputError
        If there is no record, or none that can be read.
    """
    flight = FlightState(path.name)
    for topic, data in stream_messages(path):
        flight.add_message(topic, data)
    return flight


class RunsPanel:
    """Panel in the current GUI container.

    Parameters
    ----------
    server : viser.ViserServer
    folder : Path
        Folder of the runs.
    show : callable
        Called with the run that is shown from now on; None for the live one.

    Attributes
    ----------
    flight : FlightState or None
        The recorded run that is shown.
    """

    def __init__(self, server: ViserServer, folder: Path, show: Callable[[FlightState | None], None]) -> None:
        self._folder, self._show = folder, show
        self.flight: FlightState | None = None
        self._lock = threading.Lock()
        self._since = 0.0
        self._from = 0.0
        gui: Any = server.gui
        self.choice = gui.add_dropdown("Run", [NO_RUN, *list_runs(folder)], initial_value=NO_RUN)
        refresh = gui.add_button("Look for new runs")
        self.at = gui.add_slider("Time, s", 0.0, 1.0, 0.1, 0.0, disabled=True)
        self.speed = gui.add_dropdown("Speed", ("1", "2", "5", "10"), initial_value="5")
        self.playing = gui.add_checkbox("Play", False)
        back = gui.add_button("Back to the live mission")
        self.remark = gui.add_html("")
        self.choice.on_update(lambda _: self.open(self.choice.value))
        refresh.on_click(lambda _: self.refresh())
        self.playing.on_update(lambda _: self._start_playing())
        back.on_click(lambda _: self.leave())

    def refresh(self) -> None:
        """Add runs that are new to the list."""
        kept = self.choice.value
        self.choice.options = (NO_RUN, *list_runs(self._folder))
        self.choice.value = kept if kept in self.choice.options else NO_RUN

    def leave(self) -> None:
        """Return to the live mission."""
        self.playing.value = False
        if self.choice.value != NO_RUN:
            self.choice.value = NO_RUN
        self.open(NO_RUN)

    def open(self, name: str) -> None:
        """Read a run, and show its end.

        Parameters
        ----------
        name : str
            Name of its folder; `NO_RUN` for the live mission.
        """
        with self._lock:
            if name == NO_RUN:
                self.flight = None
                self.at.disabled = True
                self.remark.content = ""
                self._show(None)
                return
            self.remark.content = panel("note", "reading …")
            try:
                flight = read_flight(self._folder / name)
            except (SmolbotError, OSError) as error:
                self.remark.content = panel("verdict", False, str(error).splitlines())
                return
            self.playing.value = False
            self.at.max = math.ceil(10.0 * max(flight.latest, 0.2)) / 10.0
            self.at.value = self.at.max
            self.at.disabled = False
            self.remark.content = panel("note", describe_run(self._folder / name))
            self.flight = flight
            self._show(flight)

    def _start_playing(self) -> None:
        self._from = 0.0 if self.at.value >= self.at.max else self.at.value
        self._since = time.monotonic()

    def get_time(self) -> float | None:
        """Return the time to show; it advances while the run plays.

        Returns
        -------
        float or None, in s
            On the clock of the recorded run; None for the live one.
        """
        if self.flight is None:
            return None
        if self.playing.value:
            at = self._from + float(self.speed.value) * (time.monotonic() - self._since)
            self.at.value = round(min(at, self.at.max), 1)
            if at >= self.at.max:
                self.playing.value = False
        value: float = self.at.value
        return value
