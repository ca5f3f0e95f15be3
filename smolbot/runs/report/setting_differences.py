"""Differences between runs: every setting of their files, gains with their defaults, seeds and versions."""

from __future__ import annotations

import json
import tomllib
from hashlib import sha256
from typing import Any

from smolbot.config.plugins import load_plugin
from smolbot.errors import PluginError
from smolbot.motion.controller import complete_gains
from smolbot.runs.recording.run_files import MISSION, RIG, ROBOT
from smolbot.runs.report.recorded_flight import RecordedFlight

Flat = dict[str, str]


def collect_settings(flight: RecordedFlight) -> Flat:
    """Collect all settings of a run.

    Parameters
    ----------
    flight : RecordedFlight

    Returns
    -------
    dict of str to str
        Values as text, by dotted name; for a file that is named, its content.
    """
    found: Flat = {}
    for name, prefix in ((MISSION, "mission"), (RIG, "rig"), (ROBOT, "robot")):
        found |= flatten(tomllib.loads(flight.record.begin.files[name].decode()), prefix)
    if flight.steered is not None:
        found |= {f"mission.controller.gains.{k}": json.dumps(v) for k, v in _collect_gains(flight).items()}
    for reference in ("mission.rig", "mission.robot"):  # these files are compared by content, not by path
        found.pop(reference, None)
    files = flight.record.files
    for setting, name in files.names.items():
        key = setting if setting.startswith("rig.") else f"mission.{setting}"
        found[key] = f"contents {sha256(files.contents[name]).hexdigest()[:8]}"
    where = flight.record.provenance
    found |= {key: str(where.get(key)) for key in ("seed", "smolbot", "commit", "python")}
    return found | flatten(where.get("packages", {}), "package")


def find_changes(flights: list[RecordedFlight]) -> list[tuple[str, list[str | None]]]:
    """Find the settings that differ between runs.

    Parameters
    ----------
    flights : list of RecordedFlight

    Returns
    -------
    list of tuple
        Name, and the value of each run; None for a run without it.
    """
    settings = [collect_settings(flight) for flight in flights]
    names = dict.fromkeys(name for one in settings for name in one)
    rows = [(name, [one.get(name) for one in settings]) for name in names]
    return [(name, values) for name, values in rows if len(set(values)) > 1]


def flatten(data: dict[str, Any], prefix: str = "") -> Flat:
    """Flatten a nested dictionary to dotted names.

    Parameters
    ----------
    data : dict
    prefix : str, optional
        Put before all names.

    Returns
    -------
    dict of str to str
        Values as JSON.

    Examples
    --------
    >>> flatten({"a": {"b": 1.5}, "c": [{"d": "x"}]}, "rig")
    {'rig.a.b': '1.5', 'rig.c.0.d': '"x"'}
    """
    found: Flat = {}
    for key, value in data.items():
        name = f"{prefix}.{key}" if prefix else key
        if isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
            value = {str(i): item for i, item in enumerate(value)}
        if isinstance(value, dict):
            found |= flatten(value, name)
        else:
            found[name] = json.dumps(value, ensure_ascii=False, default=str)
    return found


def _collect_gains(flight: RecordedFlight) -> dict[str, float]:
    """Return the gains as flown; without defaults if the law is not installed here."""
    assert flight.steered is not None
    given = dict(flight.steered.gains)
    try:
        return complete_gains(load_plugin("controllers", flight.steered.law).gains, given, flight.steered.law)
    except PluginError:
        return given
