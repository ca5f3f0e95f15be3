"""``preview``: predict a mission of either kind without a rig."""

from __future__ import annotations

from typing import Any

from smolbot.config.load import AnyMission, load_mission
from smolbot.config.mission_base import MissionBase
from smolbot.errors import InputError
from smolbot.flight.preview.missions import AnyPreview, preview_mission
from smolbot.functions.settings import merge_settings


def preview(mission: str | AnyMission, rig: str | None = None, **overrides: Any) -> AnyPreview:
    """Compute a mission's timing and simulate it once on the controller's own model; opens no rig.

    Parameters
    ----------
    mission : str, Mission or Observation
        Shipped name, path of a mission file, or a loaded mission.
    rig : str, optional
        A rig to use instead of the mission's own.
    **overrides
        Settings that override the mission file, with ``__`` for the dot: ``controller__tolerance_mm=0.5``.

    Returns
    -------
    Preview, HelixPreview or ObservationPreview
        For a robot that coils pull, one that a rotating magnet drives, or a device that is only observed.

    Raises
    ------
    ConfigError, InputError
        For every fault of the files.

    Examples
    --------
    >>> import smolbot
    >>> predicted = smolbot.preview("line")
    >>> predicted.go, round(predicted.duration)
    (True, 26)
    """
    loaded = load_mission(mission, rig, merge_settings(None, overrides)) if isinstance(mission, str) else mission
    if not isinstance(loaded, MissionBase):
        raise InputError(f"mission must be a name or path as text, or a loaded mission; got {mission!r}.")
    return preview_mission(loaded)
