"""The panel in which a mission is chosen, previewed and started."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smolbot.config.library import list_shipped
from smolbot.config.load import AnyMission, load_mission
from smolbot.errors import SmolbotError
from smolbot.flight.session import make_run_folder
from smolbot.ui.console.hub import Hub
from smolbot.ui.console.preview_process import panel, preview

if TYPE_CHECKING:
    from viser import ViserServer

OWN_RIG = "its own"


class StartPanel:
    """Panel in the current GUI container.

    Parameters
    ----------
    server : viser.ViserServer
    hub : Hub
    runs : Path
        Folder of the runs.
    show : callable
        Called with a mission that was chosen, to draw it.
    """

    def __init__(self, server: ViserServer, hub: Hub, runs: Path, show: Callable[[AnyMission], None]) -> None:
        self._hub, self._runs, self._show = hub, runs, show
        gui: Any = server.gui
        self.mission = gui.add_dropdown("Mission", self.list_missions(), initial_value="r_path")
        self.rig = gui.add_dropdown("Rig", [OWN_RIG, *list_shipped("rigs")], initial_value=OWN_RIG)
        self.seed = gui.add_number("Seed", 1, min=0, step=1, hint="Of a simulated world: same seed, same run.")
        self.settings = gui.add_text("Settings", "", hint="key=value pairs, such as controller.tolerance_mm=0.5")
        look = gui.add_button("Preview", color="blue")
        fly = gui.add_button("Start", color="green")
        self.remark = gui.add_html("")
        self.mission.on_update(lambda _: self.choose())
        self.rig.on_update(lambda _: self.choose())
        look.on_click(lambda _: self.preview())
        fly.on_click(lambda _: self.start())

    def list_missions(self) -> list[str]:
        """List the missions: shipped ones by name, then files of the current folder and drawn ones by path.

        Returns
        -------
        list of str
        """
        folders = (Path(), Path("missions"), self._runs / "drawn")
        own = [str(path) for folder in folders for path in folder.glob("*.toml")]
        return [
            *list_shipped("missions"),
            *sorted(path for path in own if "[path]" in _read_text(path) or "[observe]" in _read_text(path)),
        ]

    def make_arguments(self, mission: str | None = None) -> list[str]:
        """Build the arguments of a command from the panel.

        Parameters
        ----------
        mission : str, optional
            The chosen one unless given.

        Returns
        -------
        list of str
        """
        found = [mission or self.mission.value]
        if self.rig.value != OWN_RIG:
            found += ["--rig", self.rig.value]
        for pair in shlex.split(self.settings.value):
            found += ["--set", pair]
        return found

    def load(self, mission: str | None = None) -> AnyMission:
        """Load a mission with the rig and the settings of the panel.

        Parameters
        ----------
        mission : str, optional
            The chosen one unless given.

        Returns
        -------
        Mission or Observation

        Raises
        ------
        SmolbotError
            If it cannot be loaded.
        """
        pairs = dict(pair.partition("=")[::2] for pair in shlex.split(self.settings.value))
        return load_mission(mission or self.mission.value, None if self.rig.value == OWN_RIG else self.rig.value, pairs)

    def choose(self) -> None:
        """Draw the chosen mission, unless one flies."""
        if self._hub.busy:
            return
        try:
            self._show(self.load())
            self.remark.content = ""
        except (SmolbotError, ValueError) as error:
            self.remark.content = panel("verdict", False, str(error).splitlines())

    def preview(self, mission: str | None = None, remark: Any = None) -> bool:
        """Show the preview of a mission.

        Parameters
        ----------
        mission : str, optional
            The chosen one unless given.
        remark : viser.GuiHtmlHandle, optional
            Where to show it; in this panel unless given.

        Returns
        -------
        bool
            True for go.
        """
        remark = self.remark if remark is None else remark
        remark.content = panel("note", "previewing …")
        go, remark.content = preview(self.make_arguments(mission))
        return go

    def start(self, mission: str | None = None, remark: Any = None) -> None:
        """Start a mission in a process of its own.

        Parameters
        ----------
        mission : str, optional
            The chosen one unless given.
        remark : viser.GuiHtmlHandle, optional
            Where to show remarks; in this panel unless given.
        """
        remark = self.remark if remark is None else remark
        try:
            arguments, seed = self.make_arguments(mission), int(self.seed.value)
            out = make_run_folder(self.load(mission), seed, self._runs).path
            self._hub.start([*arguments, "--seed", str(seed), "--out", str(out)], arguments[0])
            remark.content = panel("note", "loading; it moves nothing before it has joined this page")
        except (SmolbotError, ValueError) as error:
            remark.content = panel("verdict", False, str(error).splitlines())


def _read_text(path: str) -> str:
    try:
        return Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return ""
