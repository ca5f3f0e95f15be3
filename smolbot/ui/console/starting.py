"""The panel from which a mission is chosen, previewed and started."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smolbot.config.library import shipped
from smolbot.config.load import AnyMission, load_mission
from smolbot.errors import SmolbotError
from smolbot.flight.session import new_folder
from smolbot.ui.console.hub import Hub
from smolbot.ui.console.previewing import panel, preview

if TYPE_CHECKING:
    from viser import ViserServer

OWN = "its own"


class Starting:
    """Made in the container that is open; `show` is told of a mission that was chosen, to draw it."""

    def __init__(self, server: ViserServer, hub: Hub, runs: Path, show: Callable[[AnyMission], None]) -> None:
        self._hub, self._runs, self._show = hub, runs, show
        gui: Any = server.gui
        self.mission = gui.add_dropdown("Mission", self.missions(), initial_value="r_path")
        self.rig = gui.add_dropdown("Rig", [OWN, *shipped("rigs")], initial_value=OWN)
        self.seed = gui.add_number("Seed", 1, min=0, step=1, hint="Of a simulated world: same seed, same run.")
        self.settings = gui.add_text("Settings", "", hint="key=value pairs, such as controller.tolerance_mm=0.5")
        look = gui.add_button("Preview", color="blue")
        fly = gui.add_button("Start", color="green")
        self.said = gui.add_html("")
        self.mission.on_update(lambda _: self.choose())
        self.rig.on_update(lambda _: self.choose())
        look.on_click(lambda _: self.preview())
        fly.on_click(lambda _: self.start())

    def missions(self) -> list[str]:
        """Shipped ones by name, then those of the folder in which the console was started, and what was drawn."""
        folders = (Path(), Path("missions"), self._runs / "drawn")
        own = [str(path) for folder in folders for path in folder.glob("*.toml")]
        return [
            *shipped("missions"),
            *sorted(path for path in own if "[path]" in _text(path) or "[observe]" in _text(path)),
        ]

    def arguments(self, mission: str | None = None) -> list[str]:
        """Of the command, as the panel stands."""
        found = [mission or self.mission.value]
        if self.rig.value != OWN:
            found += ["--rig", self.rig.value]
        for pair in shlex.split(self.settings.value):
            found += ["--set", pair]
        return found

    def loaded(self, mission: str | None = None) -> AnyMission:
        """The mission as the panel stands.

        Raises
        ------
        SmolbotError
        """
        pairs = dict(pair.partition("=")[::2] for pair in shlex.split(self.settings.value))
        return load_mission(mission or self.mission.value, None if self.rig.value == OWN else self.rig.value, pairs)

    def choose(self) -> None:
        """Draw what was chosen, unless a mission flies."""
        if self._hub.busy:
            return
        try:
            self._show(self.loaded())
            self.said.content = ""
        except (SmolbotError, ValueError) as error:
            self.said.content = panel("verdict", False, str(error).splitlines())

    def preview(self, mission: str | None = None, said: Any = None) -> bool:
        """Say go or no-go."""
        said = self.said if said is None else said
        said.content = panel("note", "previewing …")
        go, said.content = preview(self.arguments(mission))
        return go

    def start(self, mission: str | None = None, said: Any = None) -> None:
        """Start it, in a process of its own."""
        said = self.said if said is None else said
        try:
            arguments, seed = self.arguments(mission), int(self.seed.value)
            out = new_folder(self.loaded(mission), seed, self._runs).path
            self._hub.start([*arguments, "--seed", str(seed), "--out", str(out)], arguments[0])
            said.content = panel("note", "loading; it moves nothing before it has joined this page")
        except (SmolbotError, ValueError) as error:
            said.content = panel("verdict", False, str(error).splitlines())


def _text(path: str) -> str:
    try:
        return Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return ""
