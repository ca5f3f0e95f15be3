"""The swing of a cantilever in a high-speed clip (Fig. S2): position and angle of the magnet by frame.

Assumptions: the camera looks along the axis of oscillation and does not move; the magnet is the largest bright
object; the file's own frame rate is that of playback, unless another is given.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from smolbot.core.arrays import FloatArray, IntArray
from smolbot.errors import InputError
from smolbot.runs.optics.video import Video

MIN_CONTRAST = 25.0  # grey levels that magnet and background must be apart
MIN_AREA = 30  # pixels of a magnet
MIN_SWING_RMS = 0.15  # pixels, rms: what moves less does not swing
MAX_RADIUS_ERROR = 0.03  # relative: how well the radius of the arc must be known for angles to come from it


@dataclass(frozen=True, eq=False)
class ObservedSwing:
    """Motion of a magnet, frame by frame; frames that do not show it are left out.

    Attributes
    ----------
    frames : ndarray of int, shape (n,)
    times : ndarray, shape (n,), in s
    centers : ndarray, shape (n, 2), in pixels
        To the right and up, from the rotation centre if that is found, else from the mean.
    arc : ndarray, shape (n,), in rad
        Angle of the magnet's centre about the rotation centre, from its mean; nan if none is found.
    turn : ndarray, shape (n,), in rad
        Rotation of the magnet itself, from its mean; nan if it has no corners to determine it from.
    radius, radius_sigma : float, in pixels
        Distance from rotation centre to magnet (l0), and its standard deviation.
    total : int
        Number of frames of the clip.
    """

    frames: IntArray
    times: FloatArray
    centers: FloatArray
    arc: FloatArray
    turn: FloatArray
    radius: float
    radius_sigma: float
    total: int

    @property
    def by_arc(self) -> bool:
        """Whether the angles come from the arc of the magnet's centre, and not from the magnet's own rotation."""
        return bool(np.all(np.isfinite(self.arc)))

    @property
    def angles(self) -> FloatArray:
        """Deflection (n,), in rad, from its mean."""
        return self.arc if self.by_arc else self.turn


def follow_swing(clip: Video) -> ObservedSwing:
    """Find a bright magnet in every frame, the arc on which it swings, and its angles.

    Parameters
    ----------
    clip : Video

    Returns
    -------
    ObservedSwing

    Raises
    ------
    InputError
        If there is no bright object, or it does not swing.
    """
    frames, rows = [], []
    for number, frame in enumerate(clip):
        found = _find_magnet(frame)
        if found is not None:
            frames.append(number)
            rows.append(found)
    if len(rows) < 20:
        raise InputError(
            f"{clip.path}: a bright magnet is seen in {len(rows)} of {clip.frames} frames; it must be "
            f"{MIN_CONTRAST:.0f} grey levels "
            f"brighter than what is around it, and cover {MIN_AREA} pixels or more."
        )
    table = np.array(rows)
    centers, second, fourth = table[:, :2], table[:, 2] + 1j * table[:, 3], table[:, 4] + 1j * table[:, 5]
    moved = centers - centers.mean(axis=0)
    if float(np.sqrt(np.mean(np.sum(moved**2, axis=1)))) < MIN_SWING_RMS:
        raise InputError(f"{clip.path}: the bright magnet does not move; nothing swings in this clip.")
    turn = _compute_rotation(second, fourth)
    pivot, radius, sigma = _fit_circle(centers)
    arc = np.full(len(centers), math.nan)
    if sigma < MAX_RADIUS_ERROR * radius:
        away = centers - pivot
        rest = away.mean(axis=0)
        # angles grow counterclockwise as seen, like the magnet's own turn
        cross, dot = rest[0] * away[:, 1] - rest[1] * away[:, 0], away @ rest
        arc = np.arctan2(cross, dot)
        arc -= arc.mean()
    elif not np.all(np.isfinite(turn)):
        raise InputError(
            f"{clip.path}: the swing is too small to show its arc (radius {radius:.0f} ± {sigma:.0f} pixels), and "
            "the magnet has "
            "no corners that tell how it is turned. Come nearer with the camera."
        )
    return ObservedSwing(
        np.array(frames), np.array(frames) / clip.fps,
        centers - (pivot if sigma < MAX_RADIUS_ERROR * radius else centers.mean(axis=0)),
        arc, turn, radius, sigma, clip.frames,
    )  # fmt: skip


def _find_magnet(frame: Any) -> tuple[float, ...] | None:
    """Find centre (right, up) in pixels, and moments of order two and four, of the largest bright object."""
    import cv2

    grey = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
    _, mask = cv2.threshold(cv2.GaussianBlur(grey, (0, 0), 1.0), 0, 1, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    if count < 2:
        return None
    best = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    if stats[best, cv2.CC_STAT_AREA] < MIN_AREA:
        return None
    left, top, width, height = (int(v) for v in stats[best, :4])
    a, b = max(left - 3, 0), max(top - 3, 0)
    window = slice(b, top + height + 3), slice(a, left + width + 3)
    patch = grey[window].astype(np.float64)
    own = labels[window] == best
    bright, dark = float(np.median(patch[own])), float(np.median(grey[labels == 0]))
    if bright - dark < MIN_CONTRAST:
        return None
    # how much of a pixel is magnet: 0 to 1 about halfway, so that neither noise within nor light without counts
    cover = np.clip((patch - dark) / (bright - dark) * 2.0 - 0.5, 0.0, 1.0)
    cover[~cv2.dilate(own.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)] = 0.0
    rows, columns = np.mgrid[: patch.shape[0], : patch.shape[1]].astype(np.float64)
    total = float(cover.sum())
    u, v = float((cover * columns).sum()) / total, float((cover * rows).sum()) / total
    point = (columns - u) - 1j * (rows - v)
    size = float((cover * np.abs(point) ** 2).sum())
    second = complex((cover * point**2).sum()) / size
    fourth = complex((cover * point**4).sum()) / float((cover * np.abs(point) ** 4).sum())
    return u + a, -(v + b), second.real, second.imag, fourth.real, fourth.imag


def _compute_rotation(second: Any, fourth: Any) -> FloatArray:
    """Compute the rotation (n,) of a magnet in rad from its mean, by its longer axis or else its corners."""
    for moments, folds, least in ((second, 2, 0.1), (fourth, 4, 0.03)):
        if abs(moments.mean()) > least:
            turn = np.unwrap(np.angle(moments)) / folds
            return np.asarray(turn - turn.mean())
    return np.full(len(second), math.nan)


def _fit_circle(points: FloatArray) -> tuple[FloatArray, float, float]:
    """Fit a circle to points (n, 2) in pixels; return centre (2,), radius and the radius' standard deviation."""
    from scipy.optimize import least_squares

    middle = points.mean(axis=0)
    local = points - middle
    a = np.column_stack([2.0 * local, np.ones(len(local))])
    x, y, c = np.linalg.lstsq(a, np.sum(local**2, axis=1), rcond=None)[0]
    start = [x, y, math.sqrt(max(c + x * x + y * y, 1.0))]
    found = least_squares(lambda p: np.hypot(local[:, 0] - p[0], local[:, 1] - p[1]) - p[2], start, loss="soft_l1")
    residuals = np.hypot(local[:, 0] - found.x[0], local[:, 1] - found.x[1]) - found.x[2]
    information = found.jac.T @ found.jac
    if np.linalg.cond(information) > 1e14:
        return middle, math.inf, math.inf
    covariance = float(np.mean(residuals**2)) * np.linalg.inv(information)
    return middle + found.x[:2], float(found.x[2]), math.sqrt(float(covariance[2, 2]))
