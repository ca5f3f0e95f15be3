"""smolbot steers a magnetic millirobot along a path and localizes it only from magnetic sensors.

The names below are importable from here; each loads its own module when first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

_HOME = {
    "Actuate": "core.shots",
    "Command": "motion.controller",
    "Controller": "motion.controller",
    "Curve": "paths.curve",
    "Device": "core.sensing",
    "Excite": "core.shots",
    "Gain": "motion.controller",
    "Limits": "core.limits",
    "Listen": "core.shots",
    "Localizer": "localization.localizer",
    "Mission": "config.mission",
    "MoveMagnet": "core.shots",
    "NoiseModel": "localization.noise.model",
    "Observation": "config.observation",
    "Pose": "core.pose",
    "Recording": "core.sensing",
    "Rest": "core.shots",
    "Rig": "core.rig",
    "RingDown": "core.shots",
    "Rotate": "core.shots",
    "Run": "runs.run",
    "SearchVolume": "localization.cold_start",
    "SensorArray": "core.sensing",
    "Setup": "motion.controller",
    "Shot": "core.shots",
    "SmolbotError": "errors",
    "Tracker": "flight.tracking.tracker",
    "Witness": "core.rig",
    "__version__": "core.version",
    "load_mission": "config.load",
    "load_rig": "config.rig",
    "read_run": "runs.recording.reader",
    "replay": "flight.replay",
    "run": "flight.session",
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
    from smolbot.config.load import load_mission
    from smolbot.config.mission import Mission
    from smolbot.config.observation import Observation
    from smolbot.config.rig import load_rig
    from smolbot.core.limits import Limits
    from smolbot.core.pose import Pose
    from smolbot.core.rig import Rig, Witness
    from smolbot.core.sensing import Device, Recording, SensorArray
    from smolbot.core.shots import Actuate, Excite, Listen, MoveMagnet, Rest, RingDown, Rotate, Shot
    from smolbot.core.version import __version__
    from smolbot.errors import SmolbotError
    from smolbot.flight.replay import replay
    from smolbot.flight.session import run
    from smolbot.flight.tracking.tracker import Tracker
    from smolbot.localization.cold_start import SearchVolume
    from smolbot.localization.localizer import Localizer
    from smolbot.localization.noise.model import NoiseModel
    from smolbot.motion.controller import Command, Controller, Gain, Setup
    from smolbot.paths.curve import Curve
    from smolbot.runs.recording.reader import read_run
    from smolbot.runs.run import Run
