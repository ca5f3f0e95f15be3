"""The share of drawn worlds in which a mission would end.

A rollout in the controller's own model does not know that the liquid may be more viscous than the file says, or a coil
weaker. A mission that ends there a second before its limit may fail in most flights. So it is flown in worlds that
are drawn about the model, as far as the rig file says that they may differ from it (``[tank.mismatch]``).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smolbot.config.mismatch import MismatchSampler
from smolbot.config.mission import Mission
from smolbot.core.arrays import FloatArray
from smolbot.core.results import Readable
from smolbot.flight.preview.model_world import Perturbation
from smolbot.flight.preview.rollout import Outcome, Rollout, RolloutParts

WORLDS = 20
"""Number of worlds that are drawn, where the first ones leave a doubt."""

ENOUGH_WORLDS = 10
"""Number of worlds after which it is done if more have failed than a go allows."""

FIRST_WORLDS = 6
"""Number of worlds that suffice where each ends with room to spare: at a true share of 0.7, one time in nine."""

ROOM_TO_SPARE = 0.8
"""Share of the time limit, of the verdict's errors and of a coil's rise to its highest temperature within which a world
ends with room to spare."""

MIN_SHARE = 0.95
"""Share of the worlds that must end for a go: of twenty flights, a lab may have to repeat one."""

SEED = 20
"""Of the worlds: the same mission is told the same share each time."""

START_SCATTER, START_CLIP = 0.5e-3, 2.0
"""Standard deviation, in m, of where a hand puts the robot down, and the deviations to which it is clipped."""

FIELD_EXPONENT = 4.0
"""Power of the distance to a coil with which its gradient falls off: so much a misplaced coil's pull differs."""


@dataclass(frozen=True, repr=False)
class DrawnWorlds(Readable):
    """Flights of a mission in drawn worlds, simulated on the controller's model.

    Attributes
    ----------
    flown : int
        Number of worlds.
    ended : int
        Number of those in which the path's end was reached in time, with errors that the mission's verdict allows.
    durations, path_times : ndarray, shape (flown,), in s
        With the learning phase, and from the path's start on; nan where the path's end was not reached.
    energies : ndarray, shape (flown,), in J
        Heat in the actuation coils; nan likewise.
    tracking_errors, localization_errors : ndarray, shape (flown,), in m
        Mean distance of the robot from the path, and of a pose from the robot.
    failed : tuple of int
        Numbers of the worlds that fail.
    late : bool
        Whether the time limit ended any of them.
    reasons : tuple of str
        Why the others failed, the most frequent kind first, one for each of them.
    """

    flown: int
    ended: int
    durations: FloatArray
    path_times: FloatArray
    energies: FloatArray
    tracking_errors: FloatArray
    localization_errors: FloatArray
    failed: tuple[int, ...]
    late: bool
    reasons: tuple[str, ...]

    @property
    def share(self) -> float:
        """Share of the worlds in which the mission ends in time."""
        return self.ended / self.flown

    @property
    def suffices(self) -> bool:
        """Whether the share is enough for a go."""
        return self.share >= MIN_SHARE

    def __str__(self) -> str:
        return f"{self.ended} of {self.flown} in time"

    def describe_failures(self) -> str:
        """Describe how many worlds fail, and why the most frequent kind does.

        Returns
        -------
        str
            A sentence that begins in lower case, for the reasons of a no-go.
        """
        return (
            f"it would end in time in {self.ended} of {self.flown} drawn worlds, and {MIN_SHARE:.0%} are asked; "
            f"in most of the others {self.reasons[0]}"
        )


@dataclass(frozen=True)
class _Flown:
    """One world: what happened, and whether it ended, and with room to spare."""

    outcome: Outcome
    tracking_error: float
    localization_error: float
    reason: str
    easily: bool


def fly_drawn_worlds(parts: RolloutParts) -> DrawnWorlds:
    """Fly a mission in worlds that are drawn about the controller's model, until its share is known well enough.

    Parameters
    ----------
    parts : RolloutParts
        Of the mission.

    Returns
    -------
    DrawnWorlds
    """
    flown: list[_Flown] = []
    failed: list[str] = []
    for number in range(WORLDS):
        flown.append(_fly_one(parts, number))
        failed += [flown[-1].reason] if flown[-1].reason else []
        hopeless = len(failed) > round((1.0 - MIN_SHARE) * WORLDS)
        certain = len(flown) == FIRST_WORLDS and all(world.easily for world in flown)
        if certain or (hopeless and len(flown) >= ENOUGH_WORLDS):
            break
    return _summarize(flown, failed)


def fly_chosen_worlds(parts: RolloutParts, numbers: Sequence[int]) -> DrawnWorlds:
    """Fly a mission in given worlds, until one fails.

    Parameters
    ----------
    parts : RolloutParts
        Of the mission.
    numbers : sequence of int
        Numbers of the worlds.

    Returns
    -------
    DrawnWorlds
        Without those after the first that fails.
    """
    flown: list[_Flown] = []
    for number in numbers:
        flown.append(_fly_one(parts, number))
        if flown[-1].reason:
            break
    return _summarize(flown, [world.reason for world in flown if world.reason])


def _collect(flown: Sequence[_Flown], name: str) -> FloatArray:
    """Collect one figure of every world; nan where the path's end was not reached."""
    return np.array([np.nan if world.outcome.reason else getattr(world.outcome, name) for world in flown])


def draw_perturbation(mission: Mission, number: int) -> Perturbation:
    """Draw how a world differs from what the mission's files say.

    Parameters
    ----------
    mission : Mission
    number : int
        Of the world: the same number is the same world.

    Returns
    -------
    Perturbation
    """
    section, coils = mission.rig.mismatch, mission.rig.sections.coils
    rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence([SEED, number])))
    spreads = MismatchSampler(rng, section.scale)
    one = spreads.sample_factor
    away = np.array([np.linalg.norm(mission.path.points.mean(axis=0) - np.array(coil.center)) for coil in coils])
    gains = spreads.sample_factors(section.coil_gain, len(coils))
    nearer = spreads.sample_offsets(section.coil_place, len(coils))
    return Perturbation(
        drag=one(section.drag) * one(section.drag_anisotropy),
        rotational_drag=one(section.rotation_drag) * one(section.drag_anisotropy),
        moment=one(section.moment),
        coil_gains=gains * (1.0 + FIELD_EXPONENT * nearer / away) if len(coils) else None,
        start_offset=START_SCATTER * np.clip(rng.standard_normal(2), -START_CLIP, START_CLIP),
        heading=float(rng.uniform(-np.pi, np.pi)),
        pose_bias=section.scale * rng.standard_normal(6),
    )


def _fly_one(parts: RolloutParts, number: int) -> _Flown:
    """Fly one world, and hold its errors against the verdict's limits."""
    mission = parts.mission
    outcome = Rollout(parts, draw_perturbation(mission, number), seed=number).fly()
    on_path = outcome.trail[outcome.first_on_path :]
    tracking = float(np.mean(mission.path.project(on_path)[1])) if len(on_path) else math.nan
    localization = float(np.mean(outcome.pose_errors)) if len(outcome.pose_errors) else math.nan
    verdict, limit = mission.sections.verdict, mission.sections.stop.max_duration_s
    reason = outcome.reason
    easily = outcome.duration - outcome.learned_at <= ROOM_TO_SPARE * limit and _stays_cool(mission, outcome)
    for name, error, most in (
        ("tracking", 1e3 * tracking, verdict.mean_tracking_mm),
        ("localization", 1e3 * localization, verdict.mean_localization_mm),
    ):
        if most is not None and error > most:
            reason = reason or f"its mean {name} error would be {error:.2f} mm, above mean_{name}_mm = {most:g}."
        easily = easily and (most is None or error <= ROOM_TO_SPARE * most)
    return _Flown(outcome, tracking, localization, reason, easily and not reason)


def _stays_cool(mission: Mission, outcome: Outcome) -> bool:
    """Return whether every coil whose heat is known stays well below its highest temperature."""
    ambient = mission.rig.sections.safety.ambient_c
    coils = zip(mission.rig.thermal, outcome.peaks, strict=True)
    return all(coil is None or peak - ambient <= ROOM_TO_SPARE * (coil.limit - ambient) for coil, peak in coils)


def _summarize(flown: Sequence[_Flown], failed: Sequence[str]) -> DrawnWorlds:
    return DrawnWorlds(
        flown=len(flown),
        ended=len(flown) - len(failed),
        durations=_collect(flown, "duration"),
        path_times=_collect(flown, "path_time"),
        energies=_collect(flown, "energy"),
        tracking_errors=np.array([world.tracking_error for world in flown]),
        localization_errors=np.array([world.localization_error for world in flown]),
        failed=tuple(number for number, world in enumerate(flown) if world.reason),
        late=any(world.outcome.late for world in flown),
        reasons=_sort_by_kind(failed),
    )


def _sort_by_kind(reasons: Sequence[str]) -> tuple[str, ...]:
    """Sort reasons by how often their first words occur, the most frequent first."""
    kinds = Counter(_kind(reason) for reason in reasons)
    return tuple(sorted(reasons, key=lambda reason: -kinds[_kind(reason)]))


def _kind(reason: str) -> str:
    return " ".join(reason.split()[:4])
