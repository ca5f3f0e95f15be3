"""The mission file of an observation: a device that something else moves or holds is only localized."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from smolbot.config.document import Document, Fault, FileModel
from smolbot.config.mission_base import MissionBase, MissionBaseFile, load_parts, open_document
from smolbot.config.plugins import load_world
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.config.units import Positive
from smolbot.errors import report_plugin_errors
from smolbot.motion.external_motion import ExternalMotion

STEERING_SECTIONS = ("path", "start", "controller")
"""Sections of a mission that steers; none of them goes with [observe]."""

_MOTION_KEYS = ("speed_mm_s", "turn_deg_s", "change_s")


class ObserveSection(FileModel):
    """Either how long a moving device is tracked, or how many independent measurements a resting one gets."""

    duration_s: Positive | None = None
    measurements: Annotated[int, Field(ge=2)] | None = None
    speed_mm_s: Positive | None = None
    turn_deg_s: Positive | None = None
    change_s: Positive | None = None

    @model_validator(mode="after")
    def _check_one_kind(self) -> ObserveSection:
        if (self.duration_s is None) == (self.measurements is None):
            raise ValueError("give one of duration_s, to track a device, or measurements, of one that rests.")
        given = [key for key in _MOTION_KEYS if getattr(self, key) is not None]
        if self.measurements is not None and given:
            raise ValueError(f"independent measurements know of no motion; leave {', '.join(given)} away.")
        if given and len(given) < len(_MOTION_KEYS):
            missing = [key for key in _MOTION_KEYS if key not in given]
            raise ValueError(f"a moving device needs {', '.join(_MOTION_KEYS)}; missing: {', '.join(missing)}.")
        return self


class ObservationVerdict(FileModel):
    """Limits that a finished observation must keep to pass.

    The error is checked only where the ground truth is known.
    """

    mean_localization_mm: Positive | None = None
    min_rate_hz: Positive | None = None
    max_sigma_mm: Positive | None = None


class ObservationFile(MissionBaseFile):
    """All keys and sections of the mission file of an observation."""

    observe: ObserveSection
    verdict: ObservationVerdict = ObservationVerdict()


class Observation(MissionBase):
    """A mission that only localizes: nothing here knows where the device is, or where it will go; it has no path.

    Parameters
    ----------
    document : Document
        The mission file, resolved.
    sections : ObservationFile
    rig : RigConfig
    robot : RobotConfig

    Examples
    --------
    >>> import smolbot
    >>> mission = smolbot.load_mission("brain_marker")
    >>> mission.sections.observe.measurements, mission.motion
    (10, None)
    """

    path: None = None

    def __init__(self, document: Document, sections: ObservationFile, rig: RigConfig, robot: RobotConfig) -> None:
        super().__init__(document, sections, rig, robot)
        self.sections = sections

    @property
    def motion(self) -> ExternalMotion | None:
        """Assumed motion of the device; None if it rests."""
        section = self.sections.observe
        if section.speed_mm_s is None or section.turn_deg_s is None or section.change_s is None:
            return None
        return ExternalMotion(1e-3 * section.speed_mm_s, float(np.radians(section.turn_deg_s)), section.change_s)

    @property
    def start(self) -> tuple[float, float]:
        """Middle (x, y) of the container in m, in the world frame; the device has no start position of its own."""
        x, y = self.rig.container.center.tolist()
        return x, y


def is_observation(document: Document) -> bool:
    """Return whether a mission file is that of an observation.

    Parameters
    ----------
    document : Document

    Returns
    -------
    bool
    """
    return "observe" in document.data


def load_observation(name: str, rig: str | None = None, settings: dict[str, str] | None = None) -> Observation:
    """Read an observation with the rig and device that it names.

    Parameters
    ----------
    name : str
        Name of a shipped mission, or the path of a user's own.
    rig : str, optional
        A rig to use instead of the mission's own.
    settings : dict, optional
        Values that replace those of the mission file; keys that begin with ``rig.`` replace those of the rig file.

    Returns
    -------
    Observation

    Raises
    ------
    ConfigError
        With a line for every fault of the files, before anything moves.
    """
    settings = settings or {}
    document = open_document(name, settings)
    both = [section for section in STEERING_SECTIONS if section in document.data]
    if both and is_observation(document):
        message = f"[observe] only looks, and [{both[0]}] steers: a mission has one or the other."
        raise document.error([Fault((both[0],), message)])
    sections, rig_config, robot_config = load_parts(document, ObservationFile, rig, settings)
    unfit = _find_faults(rig_config, robot_config)
    if unfit:
        raise document.error(unfit)
    observation = Observation(document, sections, rig_config, robot_config)
    from smolbot.config.feasibility import find_listening_faults

    unfit = find_listening_faults(observation)
    if unfit:
        raise document.error(unfit)
    return observation


def _find_faults(rig: RigConfig, robot: RobotConfig) -> list[Fault]:
    """Find faults of device and world together."""
    if robot.kind != "device":
        message = f"'{robot.name}' is of kind '{robot.kind}', which swims; [observe] needs a bare device."
        return [Fault(("robot",), message)]
    world = load_world(rig.world, rig.document)
    with report_plugin_errors("World", world, "unfit"):
        reason: str | None = world.unfit(rig, robot)
    return [] if reason is None else [Fault(("rig",), reason)]
