"""Files that a user writes, read strictly: missions, rigs, robots, devices, sensors, samples, tracks.

What a lab's own parts are made of is importable from here; each name loads its own module when first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from smolbot.config.document import Document, Fault, FileModel
    from smolbot.config.plugin_protocols import PathReader, SensorKind, StudyPlugin
    from smolbot.config.world import World

_HOME = {
    "Document": "document",
    "Fault": "document",
    "FileModel": "document",
    "PathReader": "plugin_protocols",
    "SensorKind": "plugin_protocols",
    "StudyPlugin": "plugin_protocols",
    "World": "world",
}

__all__ = ["Document", "Fault", "FileModel", "PathReader", "SensorKind", "StudyPlugin", "World"]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"smolbot.config.{_HOME[name]}"), name)
    raise AttributeError(f"module 'smolbot.config' has no attribute {name!r}")
