"""Find when a video began on a run's clock, from the movement that both show.

Camera and rig have no common clock. Both displacements are compared over all time shifts; the best shift is that of
the greatest likelihood, refined below the frame interval. Poses and camera may differ by a constant offset,
`OFFSET_SIGMA`: for a robot that moves straight at constant speed, a time shift and an offset look the same, and only
the assumed size of that offset separates them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import BoolArray, FloatArray
from smolbot.errors import InputError
from smolbot.runs.optics.optical_track import OpticalTrack
from smolbot.runs.optics.run_poses import RunPoses

MIN_POSES = 8  # poses within the video
MIN_MOVEMENT = 0.5e-3  # m, rms: with less movement in common nothing can be aligned
MIN_CORRELATION = 0.9  # correlation of the two displacements below which they are taken to be of two different flights
OFFSET_SIGMA = 0.3e-3  # m, one standard deviation per axis: between all poses and the camera together
SEARCH_STEP = 0.02  # s: step of the search


@dataclass(frozen=True)
class Alignment:
    """Time shift between a video and a run.

    Attributes
    ----------
    offset : float, in s
        To be added to the video's times.
    sigma : float, in s
        Standard deviation of `offset`; 0 where it was given.
    poses : int
        Number of poses within the video.
    correlation : float
        Of the two displacements.
    given : bool
        Whether the offset was given by the user.
    """

    offset: float
    sigma: float
    poses: int
    correlation: float
    given: bool = False


def align(track: OpticalTrack, poses: RunPoses, offset: float | None = None) -> Alignment:
    """Find when the video began, or use a given offset.

    Parameters
    ----------
    track : OpticalTrack
        On the video's clock.
    poses : RunPoses
    offset : float, in s, optional
        Time of the video's first frame on the run's clock.

    Returns
    -------
    Alignment

    Raises
    ------
    InputError
        If video and run do not overlap, nothing moved in both, or they do not show the same movement.
    """
    spans = (
        f"the run's poses are from {poses.times[0]:.2f} to {poses.times[-1]:.2f} s, the robot is seen for "
        f"{track.times[-1] - track.times[0]:.2f} s of video"
    )
    if offset is not None:
        _, known = _pair(track, poses, offset)
        if not known.any():
            at = f"{track.times[0] + offset:.2f} to {track.times[-1] + offset:.2f} s"
            raise InputError(f"Video and run do not overlap in time: {spans}, with --offset-s {offset:g} from {at}.")
        correlation, _ = _compare_displacements(track, poses, offset)
        return Alignment(offset, 0.0, int(known.sum()), correlation, given=True)
    low, high = poses.times[0] - track.times[-1], poses.times[-1] - track.times[0]
    offsets = np.arange(low, high + SEARCH_STEP, SEARCH_STEP)
    ratios = np.array([_compare_displacements(track, poses, value)[1] for value in offsets])
    if not np.any(np.isfinite(ratios)):
        raise InputError(
            f"Video and run cannot be aligned: at no shift do {MIN_POSES} poses or more lie within the video while "
            "the robot "
            f"moves by {1e3 * MIN_MOVEMENT:g} mm or more; {spans}. Say with --offset-s when the video began."
        )
    best = int(np.nanargmax(np.where(np.isfinite(ratios), ratios, -np.inf)))
    refined = _refine(track, poses, float(offsets[best]))
    correlation, _ = _compare_displacements(track, poses, refined)
    if correlation < MIN_CORRELATION:
        raise InputError(
            "Video and run do not show the same movement: at best, with the video from "
            f"{track.times[0] + refined:.2f} s on, "
            f"their displacements correlate by {correlation:.2f}; {spans}. Is it the right run, and are x and y "
            "the rig's?"
        )
    _, known = _pair(track, poses, refined)
    return Alignment(refined, _compute_sigma(track, poses, refined), int(known.sum()), correlation)


def _pair(track: OpticalTrack, run: RunPoses, offset: float) -> tuple[FloatArray, BoolArray]:
    places, _, known = track.interpolate(run.times - offset)
    return places, known


def _compare_displacements(track: OpticalTrack, run: RunPoses, offset: float) -> tuple[float, float]:
    """Compute the correlation of the displacements, and the log-likelihood ratio of "the same" to "unrelated"."""
    places, known = _pair(track, run, offset)
    n = int(np.count_nonzero(known))
    if n < MIN_POSES:
        return 0.0, -math.inf
    a, b = places[known, :2], run.positions[known, :2]
    apart = float(np.sum((a.mean(axis=0) - b.mean(axis=0)) ** 2)) / OFFSET_SIGMA**2
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    moved = float(np.sum(a * a)), float(np.sum(b * b))
    if min(moved) < n * MIN_MOVEMENT**2:
        return 0.0, -math.inf
    correlation = float(np.sum(a * b)) / math.sqrt(moved[0] * moved[1])
    mismatch = float(np.sum((a - b) ** 2)) / (moved[0] + moved[1])
    return correlation, -n * math.log(max(mismatch, 1e-12)) - 0.5 * apart


def _refine(track: OpticalTrack, run: RunPoses, offset: float) -> float:
    """Find the maximum of parabolas through the likelihoods around a shift."""
    places, known = _pair(track, run, offset)
    scatter = _compute_scatter((places - run.positions)[known, :2])

    def cost(value: float) -> float:
        difference = track.interpolate(run.times[known] - value)[0][:, :2] - run.positions[known, :2]
        mean = difference.mean(axis=0)
        return float(np.sum((difference - mean) ** 2)) / scatter + float(np.sum(mean**2)) / OFFSET_SIGMA**2

    step = 2.0 * SEARCH_STEP
    for _ in range(6):
        low, middle, high = cost(offset - step), cost(offset), cost(offset + step)
        bend = low - 2.0 * middle + high
        if bend <= 0:
            break
        offset += min(max(0.5 * step * (low - high) / bend, -step), step)
        step = max(0.5 * step, 0.01)
    return offset


def _compute_sigma(track: OpticalTrack, run: RunPoses, offset: float) -> float:
    """Compute the standard deviation of the shift in s, from pose scatter and a constant camera offset."""
    places, known = _pair(track, run, offset)
    ahead, _, _ = track.interpolate(run.times - offset + 0.05)
    behind, _, _ = track.interpolate(run.times - offset - 0.05)
    speed = ((ahead - behind) / 0.1)[known, :2]
    scatter = _compute_scatter((places - run.positions)[known, :2])
    mean = speed.mean(axis=0)
    information = float(np.sum((speed - mean) ** 2)) / scatter
    information += float(np.sum(mean**2)) / (OFFSET_SIGMA**2 + scatter / len(speed))
    return 1.0 / math.sqrt(max(information, 1e-12))


def _compute_scatter(residuals: FloatArray) -> float:
    """Compute the variance per axis about the mean, in m²."""
    return max(float(np.mean((residuals - residuals.mean(axis=0)) ** 2)), 1e-12)
