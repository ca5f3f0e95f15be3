"""Keys of a file that make others void: those that redefine the path, or the kind of sensors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

PATHS = ("glyph", "points_mm", "file")
"""Keys of ``[path]`` of which a mission gives one."""

SHAPE = (*PATHS, "width_mm", "height_mm", "element")
"""Keys of ``[path]`` that belong to one kind of path."""

SINGLE_AXIS = "single_axis"
"""The kind of sensors of a rig file that names none."""


def void_keys(data: Mapping[str, Any], upper: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Find the keys of a file that are void once something is laid over it.

    Parameters
    ----------
    data : mapping
        Content of the file.
    upper : mapping
        What is laid over it: another file, or settings.

    Returns
    -------
    list of (section, key)

    Examples
    --------
    >>> void_keys({"path": {"glyph": "R", "width_mm": 16.0, "center_mm": [0, 0]}}, {"path": {"file": "mine.svg"}})
    [('path', 'glyph'), ('path', 'width_mm')]
    """
    path, new_path = _section(data, "path"), _section(upper, "path")
    given = [key for key in PATHS if key in new_path]
    void = SHAPE if given and not any(key in path for key in given) else ()
    found = [("path", key) for key in void if key in path and key not in new_path]
    sensors, new_sensors = _section(data, "sensors"), _section(upper, "sensors")
    if "kind" in new_sensors and new_sensors["kind"] != sensors.get("kind", SINGLE_AXIS):
        found += [("sensors", key) for key in sensors if key not in new_sensors]
    return found


def _section(data: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    section = data.get(name)
    return section if isinstance(section, Mapping) else {}
