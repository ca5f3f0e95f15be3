"""Preview of an observation: a typical cycle, the cycle rate, and the expected accuracy of its poses."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from smolbot.config.feasibility import compute_expected_covariances
from smolbot.config.observation import Observation
from smolbot.core.arrays import FloatArray
from smolbot.core.results import Readable
from smolbot.core.rotations import quaternion_from_axes
from smolbot.core.shots import Shot

MEAN_SEARCH_SHOTS = 2.0
"""Mean number of shots of a search until the signal suffices."""

POINTS_PER_AXIS = 3


@dataclass(frozen=True, repr=False)
class ObservationPreview(Readable):
    """Prediction for an observation before it is carried out.

    Attributes
    ----------
    shot : Shot
        A typical cycle.
    rate_limit : float, in Hz
        Cycle rate of the timeline alone.
    rate : float, in Hz
        Cycle rate with the turnaround time included.
    duration : float, in s
        Expected, with the recording of background noise and the search.
    cycles : int
        Number of cycles.
    noise_error : ndarray, shape (n,), in m
        Root mean square 3D error of one pose due to noise alone, on a grid over the container with varied headings.
    reasons : list of str
        Why not to begin; empty means go.
    """

    shot: Shot
    rate_limit: float
    rate: float
    duration: float
    cycles: int
    noise_error: FloatArray
    reasons: list[str] = field(default_factory=list)

    @property
    def go(self) -> bool:
        """True if there is no reason not to begin."""
        return not self.reasons


def preview_observation(mission: Observation) -> ObservationPreview:
    """Time an observation, and compute the expected error of its poses due to noise.

    Parameters
    ----------
    mission : Observation

    Returns
    -------
    ObservationPreview
    """
    shot = Shot(mission.cycle.windows(mission.robot.device.frequency))
    cycle_time = shot.duration + mission.rig.turnaround
    section, quiet = mission.sections.observe, mission.sections.localization.background_noise_duration
    if section.measurements is not None:
        cycles = round(section.measurements * (1.0 + MEAN_SEARCH_SHOTS))
    else:
        cycles = round(MEAN_SEARCH_SHOTS + (section.duration_s or 0.0) / cycle_time)
    rate, duration = 1.0 / cycle_time, quiet + cycles * cycle_time
    min_rate, limit = mission.sections.verdict.min_rate_hz, mission.sections.stop.max_duration_s
    reasons = []
    if min_rate is not None and rate < min_rate:
        reasons.append(f"{rate:.2f} cycles a second fit, fewer than min_rate_hz = {min_rate:g}.")
    if duration - quiet > limit:
        reasons.append(f"it would not end within max_duration_s = {limit:g} s.")
    return ObservationPreview(
        shot, 1.0 / shot.duration, rate, duration, cycles, _compute_noise_errors(mission), reasons
    )


def _compute_noise_errors(mission: Observation) -> FloatArray:
    box = mission.rig.container
    inset = np.array([*(0.1 * box.size), 0.0])
    lines = np.linspace(box.low + inset, box.high - inset, POINTS_PER_AXIS).T
    points = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    up = np.array([0.0, 0.0, 1.0])
    turns = 2.0 * np.pi * np.arange(len(points)) * 0.381966  # evenly spread, and no two neighbours alike
    headings = [quaternion_from_axes(np.array([np.cos(a), np.sin(a), 0.0]), up, "zx") for a in turns]
    covariances = compute_expected_covariances(mission, points, headings)
    return np.asarray(np.sqrt(np.trace(covariances[:, :3, :3], axis1=1, axis2=2)))
