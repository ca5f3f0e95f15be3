"""The files that a run starts from, with all files that they name; stored as used, read again as a mission."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from smolbot.config.load import AnyMission, load_mission
from smolbot.errors import InputError

MISSION, RIG, ROBOT = "mission.toml", "rig.toml", "robot.toml"


@dataclass(frozen=True)
class RunFiles:
    """Contents of the files of a run folder, and the settings by which the mission finds them.

    Attributes
    ----------
    contents : dict of str to bytes
        ``mission.toml``, ``rig.toml``, ``robot.toml``, and the files that these name: a drawing, a table,
        calibrated sensors.
    names : dict of str to str
        ``{"rig.sensors.calibrated": "sensors.toml"}``: file by the setting that names it.
    """

    contents: dict[str, bytes]
    names: dict[str, str]

    @classmethod
    def of(cls, mission: AnyMission) -> RunFiles:
        """Read the files of a loaded mission.

        Parameters
        ----------
        mission : Mission or Observation

        Returns
        -------
        RunFiles
        """
        documents = {MISSION: mission.document, RIG: mission.rig.document, ROBOT: mission.robot.document}
        contents = {name: document.text.encode() for name, document in documents.items()}
        names = {}
        for key, stem, path in _list_named_files(mission):
            name = stem + path.suffix
            names[key] = name
            contents[name] = path.read_bytes()
        return cls(contents, names)

    def load(self, folder: Path, settings: dict[str, str] | None = None) -> AnyMission:
        """Load the mission from these files.

        Parameters
        ----------
        folder : Path
            Where they were written.
        settings : dict of str to str, optional
            Values that replace those of the files.

        Returns
        -------
        Mission or Observation

        Raises
        ------
        InputError
            If a file is missing from the folder.
        """
        missing = sorted(name for name in self.contents if not (folder / name).is_file())
        if missing:
            raise InputError(f"{folder}: {', '.join(missing)} is missing from this run folder.")
        named = {key: str((folder / name).absolute()) for key, name in self.names.items()}
        laid = {"robot": ROBOT, **named, **(settings or {})}
        return load_mission(str(folder / MISSION), str(folder / RIG), laid)


def _list_named_files(mission: AnyMission) -> Iterator[tuple[str, str, Path]]:
    """Yield setting, stem of the copy, and path, of every file that the mission's files name."""
    sensors = mission.rig.sensors_file
    if sensors is not None:
        yield "rig.sensors.calibrated", "sensors", sensors
    table = mission.rig.sections.table
    if table is not None and table.file is not None:
        yield "rig.table.file", "table", mission.rig.document.folder(("table", "file")) / table.file
    drawing = mission.document.data.get("path", {}).get("file")
    if drawing is not None:
        yield "path.file", "path", mission.document.folder(("path", "file")) / drawing
