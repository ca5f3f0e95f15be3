"""Follow one body through a video by its outline against the median frame; frames that hide it are left out."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError
from smolbot.runs.optics.body_fit import Body, OutlineFit, compute_color_distance, compute_mark_position, fit_outline
from smolbot.runs.optics.optical_track import OpticalTrack
from smolbot.runs.optics.video import Video
from smolbot.runs.optics.view import View

MIN_OUTLINE_SHARE = 0.7
"""Share of the outline that must be detected; with less, the body counts as hidden in that frame."""

SEARCH_MARGIN = 3e-3  # m around the last place that are looked at first
MAX_CANDIDATES = 4  # blobs that are tried where the body is not near its last place
AREA_RANGE = (0.25, 3.0)  # of the expected area that a blob may have
MIN_NOISE_RATIO = 6.0  # times the noise: a pixel that differs
MIN_DIFFERENCE = 6.0  # grey levels, likewise
MIN_COLOR_DISTANCE = 2.0  # standard deviations of noise and uneven light, likewise
MIN_MARK_OFFSET = 0.05  # of half lengths: a mark less far from the middle tells head from tail no more
CLEAR_MARK_OFFSET = 0.25  # of half lengths: a mark so far on the other side tells by itself
MAX_HEADING_GAP = 0.25  # s: over longer ones heading is not continued


@dataclass(frozen=True)
class _Detection:
    frame: int
    fit: OutlineFit
    mark: float


def track_body(
    video: Video, view: View, body: Body, height: float, *, background: Any = None,
    progress: Callable[[int, int], None] | None = None,
) -> OpticalTrack:  # fmt: skip
    """Find a body in every frame of a video that shows it.

    Assumptions: the camera does not move, nor does anything but the body and its shadow; the body is level, its
    middle at z = `height`; it covers no pixel in half of the frames or more (or `background` shows the scene
    without it).

    Parameters
    ----------
    video : Video
    view : View
        From pixels to world positions.
    body : Body
    height : float, in m
    background : Image, optional
        The empty scene; default: the video's median.
    progress : callable, optional
        Called with the number of frames done and of all frames.

    Returns
    -------
    OpticalTrack
        On the video's clock.

    Raises
    ------
    InputError
        If the body is in no frame.
    """
    empty = (video.background if background is None else background).astype(np.float32)
    detections: list[_Detection] = []
    largest = 0.0
    last: _Detection | None = None
    finder = _Finder(empty, view, body, height)
    for number, frame in enumerate(video):
        fit = None
        if last is not None and number - last.frame <= MAX_HEADING_GAP * video.fps:
            fit = finder.find_near(frame, last.fit)
        if fit is None:
            fit, area = finder.find_anywhere(frame)
            largest = max(largest, area)
        if fit is not None:
            last = _Detection(number, fit, finder.measure_mark(frame, fit))
            detections.append(last)
        if progress is not None and number % 25 == 0:
            progress(number, video.frames)
    if not detections:
        wanted = 4e6 * body.half[0] * body.half[1]
        what = (
            f"the largest thing that differs from the background covers {1e6 * largest:.1f} mm²"
            if largest > 0
            else "nothing differs from the background; a robot that never moves needs --background, a picture without"
        )
        raise InputError(
            f"{video.path}: the robot is never seen in {video.frames} frames: looked for a body of "
            f"{2e3 * body.half[0]:.1f} x {2e3 * body.half[1]:.1f} mm ({wanted:.1f} mm²) at z = {1e3 * height:.1f} "
            f"mm; {what}."
        )
    return _build_track(detections, video, view, body, height)


class _Finder:
    """Search for the body in one frame."""

    def __init__(self, empty: FloatArray, view: View, body: Body, height: float) -> None:
        self._empty, self._view, self._body, self._height = empty, view, body, height
        self._level = float(np.median(empty[::8, ::8]))

    def find_near(self, frame: Any, fit: OutlineFit) -> OutlineFit | None:
        """Fit the body near its last position; None if it is not there."""
        place = np.array([[fit.x, fit.y, self._height]])
        pixel = self._view.project(place)[0]
        reach = (float(np.linalg.norm(self._body.half[:2])) + SEARCH_MARGIN) * self._view.compute_scale(place[0])
        patch, offset, light = self._cut_patch(frame, pixel, reach)
        if patch is None:
            return None
        found = fit_outline(patch, offset, self._view, self._body, (fit.x, fit.y, fit.heading), self._height, light)
        return found if found is not None and found.share >= MIN_OUTLINE_SHARE else None

    def find_anywhere(self, frame: Any) -> tuple[OutlineFit | None, float]:
        """Search the whole frame; return the fit or None, and the area in m² of the largest object that differs."""
        import cv2

        empty = self._compute_gain(frame) * self._empty
        smooth = cv2.GaussianBlur(frame.astype(np.float32) - empty, (0, 0), 1.5)
        largest = 0.0
        # by what no shadow does first; a body without a colour of its own is only darker or brighter
        for clear in (
            compute_color_distance(smooth, empty),
            np.abs(smooth).max(axis=2) * (MIN_COLOR_DISTANCE / MIN_DIFFERENCE),
        ):
            best, area = self._find_among_blobs(frame, clear.astype(np.float32))
            largest = max(largest, area)
            if best is not None:
                break
        return best, largest

    def _find_among_blobs(self, frame: Any, smooth: Any) -> tuple[OutlineFit | None, float]:
        """Search for the body among the blobs in which `smooth` (rows, columns) is large."""
        import cv2

        noise = 1.4826 * float(np.median(smooth[::4, ::4]))
        mask = (smooth > max(MIN_NOISE_RATIO * noise, MIN_COLOR_DISTANCE)).astype(np.uint8)
        count, labels, stats, middles = cv2.connectedComponentsWithStats(mask)
        largest, tried, expected = 0.0, [], {}
        for i in range(1, count):
            place = self._view.project_to_plane(middles[i][None], self._height)[0]
            scale = self._view.compute_scale(np.array([*place, self._height]))
            area = stats[i, cv2.CC_STAT_AREA] / scale**2
            largest = max(largest, area)
            own = 4.0 * self._body.half[0] * self._body.half[1]
            share, expected[i] = area / own, own * scale**2
            if AREA_RANGE[0] < share < AREA_RANGE[1]:
                tried.append((abs(math.log(share)), i))
        best: OutlineFit | None = None
        for _, i in sorted(tried)[:MAX_CANDIDATES]:
            fit = self._fit_blob(frame, labels == i, smooth, expected[i])
            if fit is not None and (best is None or fit.share * fit.sharpness > best.share * best.sharpness):
                best = fit
        return best, largest

    def measure_mark(self, frame: Any, fit: OutlineFit) -> float:
        """Compute how far ahead of the middle the dark mark lies, in half lengths."""
        import cv2

        place = np.array([[fit.x, fit.y, self._height]])
        u0, v0, u1, v1 = self._clip_window(self._view.project(place)[0], 3e-3 * self._view.compute_scale(place[0]))
        grey = cv2.cvtColor(frame[v0:v1, u0:u1], cv2.COLOR_BGR2GRAY).astype(np.float64)
        return compute_mark_position(grey, (u0, v0), self._view, self._body, fit, self._height)

    def _fit_blob(self, frame: Any, blob: Any, smooth: Any, area: float) -> OutlineFit | None:
        """Return the best of the fits that start with the body along, across and diagonal to the blob."""
        rows, columns = np.nonzero(_cut_to_clearest(blob, smooth, area))
        middle = np.array([columns.mean(), rows.mean()])
        spread = np.cov(np.stack([columns, rows]))
        axis = np.linalg.eigh(spread)[1][:, 1]
        ends = self._view.project_to_plane(middle + np.array([axis, -axis]) * 10.0, self._height)
        heading = math.atan2(*(ends[0] - ends[1])[::-1])
        x, y = (float(v) for v in self._view.project_to_plane(middle[None], self._height)[0])
        reach = (float(np.linalg.norm(self._body.half[:2])) + SEARCH_MARGIN) * self._view.compute_scale(
            np.array([x, y, self._height])
        )
        patch, offset, light = self._cut_patch(frame, middle, reach)
        if patch is None:
            return None
        best: OutlineFit | None = None
        for turn in (0.0, 0.5 * math.pi, 0.25 * math.pi, -0.25 * math.pi):
            fit = fit_outline(patch, offset, self._view, self._body, (x, y, heading + turn), self._height, light)
            if fit is not None and fit.share >= MIN_OUTLINE_SHARE and (best is None or fit.share > best.share):
                best = fit
        return best

    def _compute_gain(self, frame: Any) -> float:
        """Compute the brightness of a frame relative to the empty scene: lamps flicker."""
        return float(np.median(frame[::8, ::8])) / max(self._level, 1.0)

    def _cut_patch(self, frame: Any, pixel: FloatArray, reach: float) -> tuple[Any, tuple[int, int], FloatArray]:
        """Return picture minus background around a pixel, its first pixel, and the background's colour."""
        u0, v0, u1, v1 = self._clip_window(pixel, reach)
        if u1 - u0 < 8 or v1 - v0 < 8:
            return None, (0, 0), np.zeros(3)
        behind = self._compute_gain(frame) * self._empty[v0:v1, u0:u1].astype(np.float64)
        return frame[v0:v1, u0:u1] - behind, (u0, v0), np.median(behind.reshape(-1, 3), axis=0)

    def _clip_window(self, pixel: FloatArray, reach: float) -> tuple[int, int, int, int]:
        height, width = self._empty.shape[:2]
        u, v = (float(p) for p in pixel)
        if not (math.isfinite(u) and math.isfinite(v)):
            return 0, 0, 0, 0
        return (
            max(int(u - reach), 0), max(int(v - reach), 0),
            min(int(u + reach) + 1, width), min(int(v + reach) + 1, height),
        )  # fmt: skip


def _cut_to_clearest(blob: Any, difference: Any, area: float) -> Any:
    """Return the part of a blob that differs most, `area` pixels large; it excludes a touching shadow."""
    values = difference[blob]
    if len(values) <= area:
        return blob
    return blob & (difference >= np.partition(values, len(values) - int(area))[len(values) - int(area)])


def _build_track(detections: list[_Detection], video: Video, view: View, body: Body, height: float) -> OpticalTrack:
    """Build the track; the mark distinguishes head and tail, over all frames between two gaps at once."""
    frames = np.array([s.frame for s in detections])
    middles = np.array([[s.fit.x, s.fit.y] for s in detections])
    raw = np.array([s.fit.heading for s in detections])
    marks = body.mark * np.array([s.mark for s in detections])
    headings = raw.copy()
    breaks = [0, *(np.nonzero(np.diff(frames) > MAX_HEADING_GAP * video.fps)[0] + 1), len(frames)]
    unsure = 0
    for first, last in itertools.pairwise(breaks):
        piece = headings[first:last]
        half_turns = np.round(np.diff(piece) / math.pi)
        signs = np.concatenate([[0.0], np.cumsum(half_turns)]) % 2  # a fit may come out by the other end
        evidence = marks[first:last] * np.where(signs == 1, -1.0, 1.0)
        total = float(np.mean(evidence))
        if abs(total) < MIN_MARK_OFFSET:
            unsure += last - first
        flip = signs + (1.0 if total < 0 else 0.0)
        flip += evidence * (-1.0 if total < 0 else 1.0) < -CLEAR_MARK_OFFSET  # turned by a quarter or more
        headings[first:last] = piece + math.pi * flip
    headings = np.asarray(np.unwrap(headings))
    c, s = np.cos(headings), np.sin(headings)
    ahead, left = body.center
    place = middles - np.column_stack([ahead * c - left * s, ahead * s + left * c])
    middle = view.project(np.array([[*middles.mean(axis=0), height]]))[0]
    return OpticalTrack(
        frames=frames,
        times=frames / video.fps,
        positions=np.column_stack([place, np.full(len(place), height)]),
        headings=headings,
        sigmas=np.array([s.fit.sigma for s in detections]),
        shares=np.array([s.fit.share for s in detections]),
        total=video.frames,
        head_unsure=unsure,
        view_sigma=view.compute_uncertainty(middle, height),
    )
