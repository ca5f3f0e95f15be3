"""What would mend a mission that would not end: a longer limit, another law or gain, or a stronger current."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from smolbot.config.mission import Mission
from smolbot.config.plugins import list_plugins, load_plugin
from smolbot.errors import SmolbotError
from smolbot.flight.preview.drawn_worlds import fly_chosen_worlds
from smolbot.flight.preview.rollout import Rollout, RolloutParts
from smolbot.motion.controller import robot_kinds

TRIED_WORLDS = 4
"""Number of drawn worlds in which a remedy must help, all of them: those that fail without it, if they are known."""

LIMIT_FACTORS = (1.5, 3.0)
"""Factors on the time limit that are tried."""

CURRENT_FACTORS = (1.5, 2.0, 3.0, 5.0)
"""Factors on the highest current that are tried: beyond them it is another bench."""

ROUND_TO = 10.0
"""Step, in s, to which a time limit is rounded up."""

TAIL_FIRST = "tail_first"
"""Gain of a law by which a robot may be pushed tail first."""

Settings = Mapping[str, str | float]


def find_remedy(mission: Mission, *, late: bool, failed: Sequence[int] = ()) -> str:
    """Find a change with which a mission would end in the controller's model, in its own world and in drawn ones.

    Parameters
    ----------
    mission : Mission
        One that would not end, with a robot that is moved by gradient forces.
    late : bool
        Whether the time limit ends it: no longer one helps a robot that stalls.
    failed : sequence of int
        Numbers of the drawn worlds in which it fails, where it ends in its own.

    Returns
    -------
    str
        The change, as settings of a command; empty if none of those that were tried helps.
    """
    worlds = [*failed, *(number for number in range(TRIED_WORLDS) if number not in failed)][:TRIED_WORLDS]
    for settings in _list_changes(mission, late=late):
        found = _try_change(mission, settings, worlds)
        if found:
            return found
    return ""


def _list_changes(mission: Mission, *, late: bool) -> Iterator[Settings]:
    """List changes, those that cost least first."""
    limit, current = mission.sections.stop.max_duration_s, mission.rig.limits.max_current
    law = load_plugin("controllers", mission.law)
    if late:
        yield from ({"stop.max_duration_s": factor * limit} for factor in LIMIT_FACTORS)
    if TAIL_FIRST in law.gains and mission.gains.get(TAIL_FIRST, law.gains[TAIL_FIRST].default) < 1.0:
        yield {f"controller.gains.{TAIL_FIRST}": 1.0}
    for name in list_plugins("controllers"):
        if name != mission.law and mission.robot.kind in robot_kinds(load_plugin("controllers", name)):
            yield {"controller.law": name}
    yield from ({"rig.limits.max_current_a": factor * current} for factor in CURRENT_FACTORS)


def _try_change(mission: Mission, settings: Settings, numbers: Sequence[int]) -> str:
    """Return a change as settings of a command if the mission ends with it; else an empty text."""
    try:
        parts = RolloutParts.prepare(change_mission(mission, settings))
        alone = Rollout(parts).fly()
        if alone.reason:
            return ""
        worlds = fly_chosen_worlds(parts, numbers)
    except SmolbotError:  # such as a law that cannot drive these coils: no remedy
        return ""
    if worlds.ended < worlds.flown:
        return ""
    key, value = next(iter(settings.items()))
    if key == "stop.max_duration_s":
        needed = max(alone.duration, *worlds.durations) - alone.learned_at
        value = ROUND_TO * math.ceil(min(float(value), 1.2 * needed) / ROUND_TO)
    return f"--set {key}={value if isinstance(value, str) else format(value, '.3g')}"


def change_mission(mission: Mission, settings: Settings) -> Mission:
    """Make a mission that differs from another in few settings; its path and field table are the same.

    Parameters
    ----------
    mission : Mission
    settings : mapping
        ``stop.max_duration_s``, ``controller.law``, ``controller.gains.NAME`` or ``rig.limits.max_current_a``.

    Returns
    -------
    Mission
    """
    changed = copy.copy(mission)
    for key, value in settings.items():
        *way, name = key.split(".")
        if way[0] == "rig":
            changed.rig = copy.copy(changed.rig)
            changed.rig.__dict__.pop("limits", None)  # cached
            changed.rig.sections = _update(changed.rig.sections, way[1:], name, value)
        else:
            changed.sections = changed.base = _update(changed.sections, way, name, value)
    return changed


def _update(section: Any, way: list[str], name: str, value: Any) -> Any:
    """Return a copy of a section of a file in which one value differs."""
    if way == ["gains"]:
        return section.model_copy(update={"gains": {**section.gains, name: value}})
    if not way:
        return section.model_copy(update={name: value})
    own = getattr(section, way[0])
    return section.model_copy(update={way[0]: _update(own, way[1:], name, value)})
