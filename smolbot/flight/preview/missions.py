"""The preview of a mission of any kind, and the refusal to fly one that it calls no-go."""

from __future__ import annotations

from typing import Literal, get_args

from smolbot.config.load import AnyMission
from smolbot.config.observation import Observation
from smolbot.errors import InputError, suggest_name
from smolbot.flight.preview.gradient import Preview, preview
from smolbot.flight.preview.helix import HelixPreview, preview_helix
from smolbot.flight.preview.observation import ObservationPreview, preview_observation

AnyPreview = Preview | HelixPreview | ObservationPreview
"""What a preview returns: one kind for each kind of mission; all have ``go``, ``reasons``, ``duration``."""

Force = Literal["preview"]
"""What a flight may be forced against: a preview that says no-go."""


def preview_mission(mission: AnyMission) -> AnyPreview:
    """Preview a mission of any kind.

    Parameters
    ----------
    mission : Mission or Observation

    Returns
    -------
    Preview, HelixPreview or ObservationPreview
    """
    if isinstance(mission, Observation):
        return preview_observation(mission)
    return preview_helix(mission) if mission.robot.kind == "helical" else preview(mission)


def require_go(mission: AnyMission, force: str | None = None) -> None:
    """Refuse a mission that its preview calls no-go.

    Parameters
    ----------
    mission : Mission or Observation
    force : {"preview"}, optional
        Fly it all the same, without a preview.

    Raises
    ------
    InputError
        With every reason of the preview; or for another word to force.
    """
    if force is not None:
        if force not in (known := get_args(Force)):
            raise InputError(
                f"force must be one of {', '.join(known)}; got {force!r}.{suggest_name(str(force), known)}"
            )
        return
    found = preview_mission(mission)
    if not found.go:
        remedy = f"In the model it ends with {found.remedy}. " if isinstance(found, Preview) and found.remedy else ""
        raise InputError(
            f"preview of {mission.name} on {mission.rig.name}: no-go: {' '.join(found.reasons)} {remedy}"
            "Nothing was flown. To fly it all the same: --force preview, or force='preview' from Python."
        )
