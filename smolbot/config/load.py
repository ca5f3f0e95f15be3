"""Read a mission of either kind: one that steers a robot along a path, or one that only localizes a device."""

from __future__ import annotations

from smolbot.config import mission as missionfile
from smolbot.config.mission import Mission
from smolbot.config.mission_base import open_document
from smolbot.config.observation import Observation, is_observation, load_observation

AnyMission = Mission | Observation


def load_mission(name: str, rig: str | None = None, settings: dict[str, str] | None = None) -> AnyMission:
    """Read a shipped mission by name, or a user's by path, with the rig and robot that it names.

    A file with a section ``[observe]`` is an `Observation`; every other is a `Mission`.

    Parameters
    ----------
    name : str
        A shipped mission, or the path of a file.
    rig : str, optional
        A rig to use instead of the mission's own.
    settings : dict, optional
        ``{"cycle.half_periods": "6"}``: settings that override the mission file; keys that begin with
        ``rig.`` override the rig file.

    Returns
    -------
    Mission or Observation

    Raises
    ------
    ConfigError
        With a line for every fault of the files, before anything moves.

    Examples
    --------
    >>> import smolbot
    >>> smolbot.load_mission("line", settings={"controller.tolerance_mm": "0.5"}).tolerance
    0.0005
    """
    settings = settings or {}
    if is_observation(open_document(name, settings)):
        return load_observation(name, rig, settings)
    return missionfile.load_steering_mission(name, rig, settings)
