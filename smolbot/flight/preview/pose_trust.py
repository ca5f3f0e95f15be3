"""Whether the poses along a path would be trusted."""

from __future__ import annotations

import math

import numpy as np

from smolbot.config.mission import Mission
from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import matrix_from_quaternion
from smolbot.flight.preview.model_world import PoseErrors
from smolbot.localization.localizer import MAX_ROLL, MAX_SIGMA, MIN_AMPLITUDE


def find_pose_faults(mission: Mission, errors: PoseErrors) -> list[str]:
    """Find why a flight would not get the poses that it needs.

    A pose whose expected covariance exceeds what the localizer trusts is never acted on.

    Parameters
    ----------
    mission : Mission
    errors : PoseErrors
        Along its path.

    Returns
    -------
    list of str
        Reasons not to fly; empty if there is none.
    """
    device = mission.robot.device
    deviations = np.sqrt(np.einsum("nii->ni", errors.expected.noise))
    placed = deviations[:, :3].max(axis=1)
    turned = np.array(
        [
            _compute_turn_share(noise[3:6, 3:6], matrix_from_quaternion(orientation) @ device.moment_in_body)
            for noise, orientation in zip(errors.expected.noise, errors.orientations, strict=True)
        ]
    )
    quiet = errors.amplitudes <= MIN_AMPLITUDE * device.theta_max
    doubtful = np.maximum(placed / MAX_SIGMA[0], turned)
    worst = int(np.argmax(np.where(quiet, np.inf, doubtful)))
    if quiet[worst] or doubtful[worst] >= 1.0:
        x, y = errors.points[worst] * 1e3
        swing, stops = math.degrees(errors.amplitudes[worst]), math.degrees(device.theta_max)
        return [
            f"no pose would be trusted near ({x:.1f}, {y:.1f}) mm: the excitation brings the device to {swing:.2g}° of "
            f"{stops:.3g}°, and one pose errs by {placed[worst] * 1e3:.2g} mm and "
            f"{math.degrees(deviations[worst, 3:6].max()):.2g}° (rms of the worst axes)."
        ]
    return []


def _compute_turn_share(turn: FloatArray, moment: FloatArray) -> float:
    """Compute the uncertainty of an orientation as a share of what is trusted: across the moment, and about it."""
    across = np.eye(3) - np.outer(moment, moment)
    left = across @ turn @ across
    aside, about = float(np.max(np.diag(left))), float(moment @ turn @ moment)
    return max(math.sqrt(max(aside, 0.0)) / MAX_SIGMA[1], math.sqrt(max(about, 0.0)) / MAX_ROLL)
