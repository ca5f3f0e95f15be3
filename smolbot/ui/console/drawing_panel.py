"""The panel in which a path is drawn by clicks on the liquid's surface, previewed and flown."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.config.alternatives import SHAPE
from smolbot.config.load import AnyMission
from smolbot.config.mission import Mission
from smolbot.config.toml_layers import set_values
from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError, SmolbotError
from smolbot.ui.console.preview_process import panel
from smolbot.ui.console.scene import PLANNED, Scene
from smolbot.ui.console.start_panel import StartPanel

if TYPE_CHECKING:
    from viser import ViserServer

MIN_DISTANCE_MM = 0.1
"""Distance, in mm, below which two clicks count as one."""


def intersect_surface(origin: FloatArray, direction: FloatArray, height: float) -> FloatArray | None:
    """Compute where a ray meets the horizontal plane at a height.

    Parameters
    ----------
    origin : ndarray, shape (3,), in mm
    direction : ndarray, shape (3,)
    height : float, in mm

    Returns
    -------
    ndarray, shape (2,), in mm, or None
        None if it does not meet the plane.

    Examples
    --------
    >>> intersect_surface(np.array([0.0, 0.0, 100.0]), np.array([0.1, 0.0, -1.0]), 60.0).tolist()
    [4.0, 0.0]
    """
    if direction[2] == 0.0 or (height - origin[2]) / direction[2] <= 0.0:
        return None
    met: FloatArray = origin + (height - origin[2]) / direction[2] * direction
    return met[:2]


class DrawingPanel:
    """Panel in the current GUI container; the drawn path replaces that of the chosen mission.

    Parameters
    ----------
    server : viser.ViserServer
    scene : Scene
    starting : StartPanel
        Panel of the chosen mission.
    folder : Path
        Folder for the files of drawn missions.

    Attributes
    ----------
    points : list of (float, float), in mm
        Corners in the world frame.
    """

    def __init__(self, server: ViserServer, scene: Scene, starting: StartPanel, folder: Path) -> None:
        self._server, self._scene, self._starting, self._folder = server, scene, starting, folder
        self.points: list[tuple[float, float]] = []
        self.active = False
        gui = server.gui
        how = "Clicks on the liquid add corners; the first one is where the robot is put down. "
        gui.add_html(panel("note", how + "Rig, law and robot are those of the mission that is chosen."))
        self.toggle = gui.add_checkbox("Draw by clicks", False)
        self.name = gui.add_text("Name", "drawn")
        self.radius = gui.add_number("Corner radius, mm", 1.0, min=0.0, max=20.0, step=0.1)
        undo = gui.add_button_group("", ("Undo", "Clear"))
        look = gui.add_button("Preview the drawing", color="blue")
        fly = gui.add_button("Fly the drawing", color="green")
        self.said = gui.add_html("")
        self.toggle.on_update(lambda _: self._set_active(self.toggle.value))
        undo.on_click(lambda _: self._take_back(undo.value))
        look.on_click(lambda _: self._run_and_report(self.preview))
        fly.on_click(lambda _: self._run_and_report(self.fly))

    def _set_active(self, on: bool) -> None:
        self.active = on
        self._server.scene.remove_click_callback()
        if on:
            self._server.scene.on_click()(self._add_point)

    def _add_point(self, event: Any) -> None:
        met = intersect_surface(np.array(event.ray_origin), np.array(event.ray_direction), self._scene.height)
        if met is None:
            return
        point = (round(float(met[0]), 2), round(float(met[1]), 2))
        if not self.points or np.hypot(point[0] - self.points[-1][0], point[1] - self.points[-1][1]) > MIN_DISTANCE_MM:
            self.points.append(point)
            self.show()

    def _take_back(self, which: str) -> None:
        self.points = self.points[:-1] if which == "Undo" else []
        self.show()

    def show(self) -> None:
        """Show the corners that were clicked so far."""
        points = np.array([(x, y, self._scene.height + 0.6) for x, y in self.points]).reshape(-1, 3)
        self._scene.draw_line("drawn", points, PLANNED, 4.0)
        self._scene.mark("drawn", points, PLANNED)
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        self.said.content = panel("note", f"{len(points)} corners, {steps.sum():.1f} mm") if len(points) else ""

    def write(self) -> Path:
        """Write a mission file with this drawing as its path.

        Returns
        -------
        Path

        Raises
        ------
        InputError
            If there are fewer than two points, or the chosen mission follows no path.
        """
        if len(self.points) < 2:
            raise InputError("Click two points at least: the path's start, and where it goes.")
        mission = self._starting.load()
        text = format_mission(mission, self.points, float(self.radius.value), self.name.value)
        self._folder.mkdir(parents=True, exist_ok=True)
        path = self._folder / f"{_format_stem(self.name.value)}.toml"
        path.write_text(text, encoding="utf-8")
        return path

    def preview(self) -> None:
        """Write the drawing and show its preview."""
        self._starting.preview(str(self.write()), self.said)

    def fly(self) -> None:
        """Write the drawing and fly it, if its preview reports go."""
        path = str(self.write())
        if self._starting.preview(path, self.said):
            self._starting.start(path, self.said)

    def _run_and_report(self, do: Any) -> None:
        try:
            do()
        except (SmolbotError, OSError) as error:
            self.said.content = panel("verdict", False, str(error).splitlines())


def format_mission(mission: AnyMission, points: list[tuple[float, float]], radius: float, name: str) -> str:
    """Format a mission file with the settings of a mission and another path.

    Parameters
    ----------
    mission : Mission or Observation
    points : list of (float, float), in mm
        Corners in the world frame.
    radius : float, in mm
        Corner radius.
    name : str

    Returns
    -------
    str
        TOML.

    Raises
    ------
    InputError
        If the mission follows no path.
    """
    if not isinstance(mission, Mission):
        raise InputError(f"'{mission.name}' only looks; choose a mission that steers a robot, such as r_path.")
    document = mission.document
    values: dict[tuple[str, ...], Any] = {
        ("name",): _format_stem(name),
        ("description",): f"drawn on a console, after {mission.name}",
        ("path", "points_mm"): [list(point) for point in points],
        ("path", "corner_radius_mm"): radius,
    }
    for key in ("rig", "robot"):
        own = document.folder((key,)) / str(document.data[key])
        if own.is_file():
            values[key,] = str(own.absolute())
    void = [("start",), *(("path", key) for key in (*SHAPE, "center_mm"))]
    return set_values(document.text, values, void, begin="")


def _format_stem(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_-]", "_", name).strip("_") or "drawn"
