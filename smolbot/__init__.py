"""smolbot steers a magnetic millirobot along a path and sees it only through magnetism.

The names below are importable from here; each loads its own module when first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_HOME = {
    "Actuate": "shots",
    "Command": "control",
    "Controller": "control",
    "Curve": "paths",
    "Device": "sensing",
    "Excite": "shots",
    "Gain": "control",
    "Limits": "limits",
    "Listen": "shots",
    "Localizer": "localization.localizer",
    "Mission": "missionfile",
    "MoveMagnet": "shots",
    "NoiseModel": "localization.noise",
    "Observation": "observationfile",
    "Pose": "poses",
    "Recording": "sensing",
    "Rest": "shots",
    "Rig": "worlds",
    "RingDown": "shots",
    "Rotate": "shots",
    "Run": "flown",
    "SearchVolume": "localization.cold_start",
    "SensorArray": "sensing",
    "Setup": "control",
    "Shot": "shots",
    "SmolbotError": "errors",
    "Tracker": "tracking",
    "Witness": "worlds",
    "load_mission": "anymission",
    "load_rig": "rigfile",
    "read_run": "recording.reader",
    "replay": "replaying",
    "run": "flying",
}

__all__ = [
    "Actuate",
    "Command",
    "Controller",
    "Curve",
    "Device",
    "Excite",
    "Gain",
    "Limits",
    "Listen",
    "Localizer",
    "Mission",
    "MoveMagnet",
    "NoiseModel",
    "Observation",
    "Pose",
    "Recording",
    "Rest",
    "Rig",
    "RingDown",
    "Rotate",
    "Run",
    "SearchVolume",
    "SensorArray",
    "Setup",
    "Shot",
    "SmolbotError",
    "Tracker",
    "Witness",
    "__version__",
    "load_mission",
    "load_rig",
    "read_run",
    "replay",
    "run",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"smolbot.{_HOME[name]}"), name)
    raise AttributeError(f"module 'smolbot' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__


if TYPE_CHECKING:
    from smolbot.anymission import load_mission
    from smolbot.control import Command, Controller, Gain, Setup
    from smolbot.errors import SmolbotError
    from smolbot.flown import Run
    from smolbot.flying import run
    from smolbot.limits import Limits
    from smolbot.localization.cold_start import SearchVolume
    from smolbot.localization.localizer import Localizer
    from smolbot.localization.noise import NoiseModel
    from smolbot.missionfile import Mission
    from smolbot.observationfile import Observation
    from smolbot.paths import Curve
    from smolbot.poses import Pose
    from smolbot.recording.reader import read_run
    from smolbot.replaying import replay
    from smolbot.rigfile import load_rig
    from smolbot.sensing import Device, Recording, SensorArray
    from smolbot.shots import Actuate, Excite, Listen, MoveMagnet, Rest, RingDown, Rotate, Shot
    from smolbot.tracking import Tracker
    from smolbot.worlds import Rig, Witness
