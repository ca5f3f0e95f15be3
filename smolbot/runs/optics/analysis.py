"""The paper's path analysis (Fig. S9): the error of every pose of a run against the optical path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError
from smolbot.runs.optics.alignment import Alignment
from smolbot.runs.optics.optical_track import OpticalTrack
from smolbot.runs.optics.run_poses import RunPoses


@dataclass(frozen=True, eq=False)
class PathAnalysis:
    """Errors of the poses that lie within the video.

    Attributes
    ----------
    times : ndarray, shape (n,), in s
        Of the poses, on the run's clock.
    poses, optical : ndarray, shape (n, 3), in m
        Located and optical position at the same times, in the world frame.
    angles, optical_angles : ndarray, shape (n,), in rad
        Azimuth of body z, located and optical; the first unwrapped to lie near the second.
    to_path : ndarray, shape (n,), in m
        Horizontal distance from each pose to the optical path.
    plane_known : bool
        Whether the height of `optical` is known, and not only assumed.
    tracked : ndarray, shape (n, 3), in m
        The tracker's position at the same times; nan where there was none.
    """

    times: FloatArray
    poses: FloatArray
    optical: FloatArray
    angles: FloatArray
    optical_angles: FloatArray
    to_path: FloatArray
    plane_known: bool
    tracked: FloatArray

    @property
    def position_errors(self) -> FloatArray:
        """Horizontal distance (n,) between pose and optical position at the same time, in m."""
        return np.asarray(np.linalg.norm((self.poses - self.optical)[:, :2], axis=1))

    @property
    def angle_errors(self) -> FloatArray:
        """Located minus optical azimuth (n,) in rad, within half a turn."""
        return np.asarray(np.angle(np.exp(1j * (self.angles - self.optical_angles))))

    @property
    def depth_errors(self) -> FloatArray:
        """Height of the poses minus its mean (n,) in m, as in the paper."""
        return np.asarray(self.poses[:, 2] - self.poses[:, 2].mean())

    def compute_figures(self) -> dict[str, Any]:
        """Compute the figures of merit.

        ``position_error_mm`` is the paper's: mean and standard deviation of the horizontal distance.
        ``z_error_from_mean_mm`` is also the paper's: the distance from the mean height.

        Returns
        -------
        dict
            Units are in the keys.
        """
        off = 1e3 * (self.poses - self.optical)
        known = np.all(np.isfinite(self.tracked), axis=1)
        out: dict[str, Any] = {
            "poses": len(self.times),
            "position_error_mm": _summarise(1e3 * self.position_errors),
            "to_optical_path_mm": _summarise(1e3 * self.to_path),
            "x_error_mm": _summarise_signed(off[:, 0]),
            "y_error_mm": _summarise_signed(off[:, 1]),
            "z_error_from_mean_mm": _summarise(1e3 * np.abs(self.depth_errors)),
            "angle_error_deg": _summarise(np.degrees(np.abs(self.angle_errors))),
            "angle_bias_deg": float(np.degrees(np.mean(self.angle_errors))),
        }
        if self.plane_known:
            out["z_error_mm"] = _summarise_signed(off[:, 2])
        if known.any():
            tracked = np.linalg.norm((self.tracked - self.optical)[known, :2], axis=1)
            out["tracked_position_error_mm"] = _summarise(1e3 * tracked)
        return out


def analyse(track: OpticalTrack, run: RunPoses, alignment: Alignment, *, plane_known: bool) -> PathAnalysis:
    """Compare the poses of a run with the optical track at the same times.

    Poses for which a neighbouring frame hides the robot are left out.

    Parameters
    ----------
    track : OpticalTrack
        On the video's clock.
    run : RunPoses
    alignment : Alignment
    plane_known : bool
        Whether the height of the track is known, and not only assumed.

    Returns
    -------
    PathAnalysis

    Raises
    ------
    InputError
        If no pose is left.
    """
    shifted = track.shift(alignment.offset)
    places, headings, known = shifted.interpolate(run.times)
    if not known.any():
        raise InputError("No pose of the run lies between two frames that show the robot.")
    poses = run.positions[known]
    headings_of_run = run.headings[known]
    near = headings[known] + np.angle(np.exp(1j * (headings_of_run - headings[known])))
    return PathAnalysis(
        run.times[known], poses, places[known], near, headings[known], _compute_path_distance(poses, shifted.positions),
        plane_known, run.tracked[known],
    )  # fmt: skip


def _compute_path_distance(points: FloatArray, path: FloatArray) -> FloatArray:
    """Compute the horizontal distance (n,) of points to a polyline."""
    a, b = path[:-1, :2], path[1:, :2]
    along = b - a
    squares = np.maximum(np.sum(along**2, axis=1), 1e-18)
    out = np.empty(len(points))
    for i, point in enumerate(points[:, :2]):
        t = np.clip(np.sum((point - a) * along, axis=1) / squares, 0.0, 1.0)
        out[i] = np.sqrt(np.min(np.sum((a + t[:, None] * along - point) ** 2, axis=1)))
    return out


def _summarise(values: FloatArray) -> dict[str, float]:
    return {
        "mean": float(np.mean(values)), "std": float(np.std(values)), "rms": float(np.sqrt(np.mean(values**2))),
        "p95": float(np.percentile(values, 95)), "max": float(np.max(values)),
    }  # fmt: skip


def _summarise_signed(values: FloatArray) -> dict[str, float]:
    return {"mean": float(np.mean(values)), "std": float(np.std(values)), "max": float(np.max(np.abs(values)))}
