"""The page: the scene, the panels, and the thread that updates both."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path
from typing import Any

import numpy as np

from smolbot.config.load import AnyMission, load_mission
from smolbot.ui.console.bar import Bar, make_bar_state
from smolbot.ui.console.drawing_panel import DrawingPanel
from smolbot.ui.console.figures_panel import FiguresPanel
from smolbot.ui.console.flight_state import FlightState
from smolbot.ui.console.hub import Hub
from smolbot.ui.console.page_access import PageAccess, open_viser
from smolbot.ui.console.preview_process import panel
from smolbot.ui.console.runs_panel import RunsPanel
from smolbot.ui.console.scene import TRACKED, TRUE, Scene
from smolbot.ui.console.start_panel import StartPanel
from smolbot.ui.link.feed import HEARTBEAT_INTERVAL

UPDATE_INTERVAL = 0.2
"""Seconds between two updates of the scene."""

FIGURES_INTERVAL = 3
"""Updates of the scene per update of the figures: people read no faster."""

TRACE_OFFSET = np.array([0.0, 0.0, 0.3])
"""Offset, in mm, of the tracked trace above the true one, so that both are visible."""

MAX_POINTS = 3000
"""Largest number of points of a trace; longer ones are thinned."""


class Page:
    """Everything that a browser shows. Opens its port when it is made.

    Parameters
    ----------
    access : PageAccess
    hub : Hub
    runs : Path
        Folder of the runs to browse.
    mission : str
        Mission to draw at first.

    Raises
    ------
    InputError
        If the port is busy.
    """

    def __init__(self, access: PageAccess, hub: Hub, runs: Path, mission: str = "r_path") -> None:
        self.hub = hub
        self.bar = Bar(self.make_bar_state, hub.order, access.is_order_allowed, access.key)
        self.server = open_viser(access, self.bar.answer, {"/bar": self.bar.serve}, hub.log)
        self.scene = Scene(self.server)
        self._over = threading.Event()
        self._drawn_mission: Any = None
        self._shown: tuple[int, float | None] = (-1, None)
        self._lay_out(runs)
        self.draw(load_mission(mission))
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()
        self._beating = asyncio.run_coroutine_threadsafe(self._send_heartbeats(), self.server.get_event_loop())

    def _lay_out(self, runs: Path) -> None:
        gui = self.server.gui
        left = gui.add_panel()
        with left.add_tab("Figures"):
            self.figures = FiguresPanel(self.server)
        left.dock_left()
        left.set_width(340)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Mission"):
            self.starting = StartPanel(self.server, self.hub, runs, self.choose)
        with tabs.add_tab("Draw"):
            self.drawing = DrawingPanel(self.server, self.scene, self.starting, runs / "drawn")
        with tabs.add_tab("Runs"):
            self.runs = RunsPanel(self.server, runs, self._show_run)
        with tabs.add_tab("Log"):
            self.log = gui.add_html("")
        gui.main_panel.dock_right()
        gui.main_panel.set_width(320)

    @property
    def flight(self) -> FlightState | None:
        """The run that is shown: a recorded one, or the one that joined last."""
        return self.runs.flight or self.hub.live

    def make_bar_state(self) -> dict[str, Any]:
        """Build what the bar shows.

        Returns
        -------
        dict
        """
        replayed = self.runs.flight
        at = self.runs.at.value if replayed is not None else None
        shown = make_bar_state(
            self.flight, self.hub.flying and replayed is None, self.hub.busy, at, ", recorded" if replayed else ""
        )
        return {**shown, "drawn": bool(self.drawing.points)}

    def draw(self, mission: AnyMission) -> None:
        """Draw a mission in place of the current one.

        Parameters
        ----------
        mission : Mission or Observation
        """
        self.scene.draw(mission)
        self._drawn_mission = mission
        self.drawing.show()

    def choose(self, mission: AnyMission) -> None:
        """Draw a mission that is not flown yet, and leave the run that was shown.

        Parameters
        ----------
        mission : Mission or Observation
        """
        self.runs.leave()
        if not self.hub.flying:
            self.hub.live = None
        self.draw(mission)

    def _show_run(self, flight: FlightState | None) -> None:
        """Show another run from now on."""
        self._shown = (-1, None)

    def close(self) -> None:
        """End the thread and close the port."""
        self._over.set()
        self._thread.join(2.0)
        self._beating.cancel()
        self.server.stop()

    async def _send_heartbeats(self) -> None:
        """Send heartbeats from the event loop that passes on a STOP: if it hangs, missions stop by themselves."""
        while not self._over.is_set():
            if self.hub.console_server is not None:
                self.hub.console_server.send_heartbeats()
            await asyncio.sleep(HEARTBEAT_INTERVAL)

    def _run(self) -> None:
        turn = 0
        while not self._over.wait(UPDATE_INTERVAL):
            try:
                self._update(turn)
            except Exception as error:  # a page that cannot draw must still be able to stop
                self.hub.log(f"The page cannot draw: {type(error).__name__}: {error}")
            turn += 1

    def _update(self, turn: int) -> None:
        if turn % FIGURES_INTERVAL == 0:
            lines = list(self.hub.log.lines)[-30:]
            content = panel("log", lines[::-1])
            if self.log.content != content:
                self.log.content = content
        flight, at = self.flight, self.runs.get_time()
        if flight is None or flight.mission is None:
            return
        if flight.mission is not self._drawn_mission:
            self.draw(flight.mission)
            self._shown = (-1, None)
        shown = (flight.version, at)
        if shown == self._shown:
            return
        with self.server.atomic():
            self._move_robot(flight, at)
        if turn % FIGURES_INTERVAL == 0:
            self._shown = shown
            self.figures.show(flight, at)

    def _move_robot(self, flight: FlightState, at: float | None) -> None:
        """Move the robot, draw its traces and colour the coils."""
        with flight.lock:
            tracked, true = flight.tracked.get_values(at), flight.true.get_values(at)
            estimated, truth = _thin_points(tracked[:, :3]), _thin_points(true)
            currents = flight.currents.get_values(at)[-1:]
        self.scene.draw_line("believed", estimated + TRACE_OFFSET, TRACKED, 3.5)
        if len(flight.true):
            self.scene.draw_line("true", truth, TRUE, 2.0)
        if len(tracked):
            self.scene.place_robot(tracked[-1, :3], tracked[-1, 3:7])
        else:
            self.scene.place_robot(None, None)
        over = flight.ending is not None and (at is None or at >= flight.latest)
        if flight.mission is not None and len(currents) and flight.coils != ("magnet",):
            allowed = flight.mission.rig.limits.max_current
            self.scene.color_coils(np.zeros(len(flight.coils)) if over else currents[0] / allowed)


def _thin_points(points: Any) -> Any:
    return points[:: max(-(-len(points) // MAX_POINTS), 1)].copy()
