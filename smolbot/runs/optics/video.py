"""Read a video, and report clearly what is wrong with one."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from smolbot.errors import InputError, MissingFileError, PluginError

Image = Any
"""An 8-bit colour picture, shape (height, width, 3), blue first; its first pixel's middle is (0, 0)."""

N_BACKGROUND_FRAMES = 25
"""Frames, evenly spread, of which the median is the background."""

MAX_FPS = 1e6  # frames per second: a file that states more has no valid frame rate
MAX_MISSING_FRAMES = 2  # frames that a container may promise and not hold


class Video:
    """A video file of which every frame can be read.

    Parameters
    ----------
    path : Path
    fps : float, optional, in 1/s
        Frames per second as recorded; default: as the file states. The file of a high-speed clip states the
        playback rate.

    Attributes
    ----------
    size : tuple of int
        Width and height in pixels.
    fps : float
    frames : int
        Number of readable frames.
    background : Image
        Median of frames spread over the video.

    Raises
    ------
    MissingFileError
        If there is no such file.
    InputError
        If it is no video, is truncated, or has no frame rate.
    """

    def __init__(self, path: Path, fps: float | None = None) -> None:
        if not path.is_file():
            raise MissingFileError(f"{path}: no such file.", name=str(path))
        if fps is not None and not 0 < fps < MAX_FPS:
            raise InputError(f"--fps must be a positive number of frames per second; got {fps:g}.")
        self.path = path
        self._cv2 = _import_opencv()
        capture = self._open()
        stated_fps = float(capture.get(self._cv2.CAP_PROP_FPS))
        promised = capture.get(self._cv2.CAP_PROP_FRAME_COUNT)
        self.size = (
            int(capture.get(self._cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(self._cv2.CAP_PROP_FRAME_HEIGHT))
        )  # fmt: skip
        if fps is None and not (math.isfinite(stated_fps) and 0 < stated_fps < MAX_FPS):
            raise InputError(
                f"{path}: states a frame rate of {stated_fps:g} per second; say with --fps what it was recorded at."
            )
        self.fps = stated_fps if fps is None else fps
        self.frames, looks = self._read_through(capture, int(promised) if promised > 0 else None)
        self.background: Image = _compute_median(looks)

    def __iter__(self) -> Iterator[Image]:
        """Iterate over all frames, in order."""
        capture = self._open()
        for _ in range(self.frames):
            good, frame = capture.read()
            if not good:
                break
            yield frame
        capture.release()

    def _open(self) -> Any:
        level = self._cv2.utils.logging.getLogLevel()
        self._cv2.utils.logging.setLogLevel(self._cv2.utils.logging.LOG_LEVEL_SILENT)
        try:
            capture = self._cv2.VideoCapture(str(self.path), self._cv2.CAP_FFMPEG)
        finally:
            self._cv2.utils.logging.setLogLevel(level)
        if not capture.isOpened():
            raise InputError(
                f"{self.path}: cannot be opened as a video; it is none that OpenCV reads (.mp4, .avi, .mov, .mkv, …), "
                "or its end is missing."
            )
        return capture

    def _read_through(self, capture: Any, promised: int | None) -> tuple[int, list[Image]]:
        """Decode every frame once; return their number, and some that are evenly spread."""
        step = max((promised or N_BACKGROUND_FRAMES * N_BACKGROUND_FRAMES) // N_BACKGROUND_FRAMES, 1)
        looks: list[Image] = []
        count = 0
        while capture.grab():
            if count % step == step // 2:
                good, frame = capture.retrieve()
                if good:
                    looks.append(frame)
            count += 1
            if len(looks) >= 2 * N_BACKGROUND_FRAMES:  # the container did not say how long it is
                looks, step = looks[::2], 2 * step
        capture.release()
        if promised is not None and count < promised - max(MAX_MISSING_FRAMES, promised // 200):
            raise InputError(
                f"{self.path}: truncated: its header states {promised} frames, {count} can be read. "
                "Copy it again, or have a video tool repair it."
            )
        if count < 2 or not looks:
            raise InputError(f"{self.path}: holds {count} frame{'s' * (count != 1)}; a video is needed.")
        return count, looks


def _compute_median(looks: list[Image]) -> Image:
    stack = np.stack(looks)
    stack.partition(len(stack) // 2, axis=0)
    return stack[len(stack) // 2].copy()


def read_picture(path: Path, size: tuple[int, int]) -> Image:
    """Read a picture of the empty scene, of the same size as the video.

    Parameters
    ----------
    path : Path
    size : tuple of int
        Width and height of the video in pixels.

    Returns
    -------
    Image

    Raises
    ------
    InputError
        If it cannot be read or has another size.
    MissingFileError
        If there is no such file.
    """
    cv2 = _import_opencv()
    if not path.is_file():
        raise MissingFileError(f"{path}: no such file.", name=str(path))
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise InputError(f"{path}: cannot be read as a picture.")
    if picture.shape[1::-1] != size:
        raise InputError(
            f"{path}: has {picture.shape[1]} x {picture.shape[0]} pixels; the video has {size[0]} x {size[1]}."
        )
    return picture


def _import_opencv() -> Any:
    try:
        import cv2
    except ImportError as error:
        raise PluginError(f"Videos need OpenCV: pip install 'smolbot[track]' ({error}).", name="cv2") from error
    return cv2
