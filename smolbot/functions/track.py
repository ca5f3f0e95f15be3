"""``track``: find a robot in a video from above, and compare a run with it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from smolbot.config.robot import RobotConfig, load_robot
from smolbot.core.arrays import FloatArray
from smolbot.core.results import Readable, as_columns, format_json
from smolbot.errors import InputError, report_write_errors
from smolbot.functions.settings import DEFAULT_ROBOT
from smolbot.runs.optics.alignment import Alignment, align
from smolbot.runs.optics.analysis import PathAnalysis, analyse
from smolbot.runs.optics.body_fit import Body
from smolbot.runs.optics.body_tracking import track_body
from smolbot.runs.optics.fiducials import find_view_by_markers, read_fiducials
from smolbot.runs.optics.optical_track import COLUMNS, OpticalTrack, write_optical_track
from smolbot.runs.optics.run_poses import RunPoses, read_run_poses
from smolbot.runs.optics.track_errors import compute_tracking_error
from smolbot.runs.optics.video import Video, read_picture
from smolbot.runs.optics.view import CLICK_SIGMA, View, check_points, find_view

MAX_OFFSET_SIGMA = 0.05  # s: a less certain start of a video is reported; a robot moves 0.1 mm in this time
MIN_PIXELS_PER_MM = 9.0  # films of the tank are tracked well from 10 on; at 8 headings err by 13°, at 6 fits jump
MAX_STILL_SHARE = 0.4  # of the frames: with half of them the median shows the robot, not the scene
MAX_VIEW_SIGMA = 1e-4  # m: a less certain camera is reported


@dataclass(frozen=True, repr=False)
class VideoTrack(Readable):
    """A robot's track in a video, and its comparison with a run.

    Attributes
    ----------
    video : Path
    robot : str
        Its name.
    height : float, in m
        z at which it was searched; `height_from` states the source of that value.
    camera : tuple of str
        How the camera's pose was found.
    view : View
        Mapping of positions to pixels.
    track : OpticalTrack
        Frame by frame, on the run's clock where there is a run.
    figures : mapping of str to object
        As ``track.json`` holds them.
    warnings : tuple of str
        Reasons why the track or the comparison is uncertain.
    alignment : Alignment or None
        When the video began on the run's clock.
    analysis : PathAnalysis or None
        The run's poses against the track.
    """

    video: Path
    robot: str
    height: float
    height_from: str
    camera: tuple[str, ...]
    view: View
    track: OpticalTrack
    figures: Mapping[str, Any]
    warnings: tuple[str, ...] = ()
    alignment: Alignment | None = None
    analysis: PathAnalysis | None = None

    def table(self) -> dict[str, np.ndarray[Any, Any]]:
        """Return the track as columns.

        Returns
        -------
        dict of str to ndarray
            The columns of ``track.csv``, in SI units, a value for each frame that shows the robot.
        """
        t = self.track
        rows = zip(t.frames, t.times, *t.positions.T, t.headings, t.sigmas, t.shares, strict=True)
        return as_columns((dict(zip(COLUMNS, map(float, row), strict=True)) for row in rows), COLUMNS)


def track(
    video: str | Path,
    *,
    fiducials: str | Path | None = None,
    corners: FloatArray | None = None,
    corners_at: FloatArray | None = None,
    corners_height: float | None = None,
    camera_height: float | None = None,
    robot: str | None = None,
    robot_height: float | None = None,
    mark: str = "auto",
    background: str | Path | None = None,
    run: str | Path | None = None,
    offset: float | None = None,
    fps: float | None = None,
    out: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> VideoTrack:
    """Find the robot in a video from above; needs the extra ``track``.

    Parameters
    ----------
    video : path
    fiducials : path, optional
        TOML file of the ArUco markers and their places.
    corners : ndarray, shape (4, 2), in pixels, optional
        Four points of the picture, in place of markers.
    corners_at : ndarray, shape (4, 2), in m, optional
        Their positions (x, y) in the rig's world frame.
    corners_height : float, in m, optional
        Their z; by default the robot's.
    camera_height : float, in m, optional
        z of the lens, for parallax.
    robot : str, optional
        By name or path; by default the run's, or ``gradient``.
    robot_height : float, in m, optional
        Known z of the robot; by default the liquid's surface in the run's rig.
    mark : {"auto", "head", "tail", "none"}
        End with the dark mark; ``auto``: the magnet's end, by the robot file.
    background : path, optional
        Picture of the scene without the robot; by default the video's median.
    run : path, optional
        Folder of the run that was filmed, to compare with.
    offset : float, in s, optional
        When the video began on the run's clock; by default by the best match.
    fps : float, in Hz, optional
        Frames per second as recorded; by default as stated in the file.
    out : path, optional
        Folder for track.csv, track.json and track.png; none is made without it.
    progress : callable, optional
        Called with the number of frames that are done, and of all.

    Returns
    -------
    VideoTrack

    Raises
    ------
    InputError, MissingFileError
        For what cannot be used, or does not show the robot.

    Examples
    --------
    >>> import smolbot
    >>> smolbot.track("clip.avi")
    Traceback (most recent call last):
    smolbot.errors.InputError: The camera's view must be known: ...
    """
    if fiducials is not None and (corners is not None or corners_at is not None):
        raise InputError("Give --fiducials or --corners, not both.")
    if fiducials is None and corners is None:
        raise InputError(
            "The camera's view must be known: --fiducials FILE, or --corners 'u,v u,v u,v u,v' with --corners-mm "
            "'x,y …'."
        )
    if (corners is None) != (corners_at is None):
        raise InputError("--corners and --corners-mm belong together: four points in the picture, and where they are.")
    if offset is not None and run is None:
        raise InputError("--offset-s needs --run: it is when the video began on that run's clock.")
    if corners is not None and corners_at is not None:
        check_points(corners, 1e3 * corners_at)
    poses = None if run is None else read_run_poses(Path(run))
    config = _robot(robot, poses)
    film = Video(Path(video), fps)
    height, height_from = _height(robot_height, poses, fiducials, corners_height)
    if fiducials is not None:
        view, camera = _view_by_markers(film, Path(fiducials), camera_height)
    else:
        places = np.column_stack([corners_at, np.full(4, height if corners_height is None else corners_height)])  # type: ignore[list-item]
        view = find_view(corners, places, film.size, camera_height, pixel_sigma=CLICK_SIGMA)  # type: ignore[arg-type]
        camera = (f"four points, {view.rms:.2f} pixels rms",)
    empty = None if background is None else read_picture(Path(background), film.size)
    result = track_body(film, view, _body(config, mark), height, background=empty, progress=progress)
    figures, warnings = _figures_of(result, film, view, config, height, pictured=empty is not None)
    alignment = analysis = None
    if poses is not None:
        alignment = align(result, poses, offset)
        analysis = analyse(result, poses, alignment, plane_known=robot_height is not None)
        result = result.shift(alignment.offset)
        figures |= {"run": str(run), "offset_s": alignment.offset, "offset_sigma_s": alignment.sigma,
                    "correlation": alignment.correlation} | analysis.compute_figures()  # fmt: skip
        if alignment.sigma > MAX_OFFSET_SIGMA:
            warnings.append("the start time of the video is uncertain: it shows little besides straight motion")
        path = None if poses.mission is None else poses.mission.path
        error = None if path is None else compute_tracking_error(result, path, poses)
        figures |= {} if error is None else {"tracking_error_mm": error}
    found = VideoTrack(
        film.path, config.name, height, height_from, camera, view, result, figures, (*warnings,), alignment, analysis
    )
    if out is not None:
        name = film.path.name if run is None else Path(run).resolve().name
        _leave(found, film, Path(out), name, None if poses is None or poses.mission is None else poses.mission.path)
    return found


def _robot(name: str | None, poses: RunPoses | None) -> RobotConfig:
    if name is None and poses is not None and poses.mission is not None:
        return poses.mission.robot
    return load_robot(name or DEFAULT_ROBOT)


def _body(config: RobotConfig, mark: str) -> Body:
    """Make the housing as a box with the position of its magnet."""
    sides = {"head": 1.0, "tail": -1.0, "none": 0.0, "auto": math.copysign(1.0, config.device.l0 - config.center[2])}
    if mark not in sides:
        raise InputError(f"--mark must be one of {', '.join(sides)}; got '{mark}'.")
    across, up, ahead = config.size
    return Body(0.5 * np.array([ahead, across, up]), np.array([config.center[2], config.center[0]]), sides[mark])


def _height(
    given: float | None, poses: RunPoses | None, fiducials: str | Path | None, corners_height: float | None
) -> tuple[float, str]:
    """Find z of the robot, in m, and the source of that value."""
    if given is not None:
        return given, "as given"
    if poses is not None:
        mission = poses.mission
        if mission is not None and mission.robot.kind == "gradient":
            return mission.rig.surface_z, "the liquid's surface: it floats"
        return float(poses.positions[:, 2].mean()), "mean of the run's poses"
    if fiducials is not None:
        section = read_fiducials(Path(fiducials)).fiducials
        heights = [section.height_mm if m.height_mm is None else m.height_mm for m in section.markers]
        return 1e-3 * max(heights), "that of the highest markers; --robot-z-mm is more exact"
    return corners_height or 0.0, "that of the four points; --robot-z-mm is more exact"


def _view_by_markers(film: Video, fiducials: Path, camera_height: float | None) -> tuple[View, tuple[str, ...]]:
    found = find_view_by_markers(film.background, read_fiducials(fiducials), camera_height)
    total = len(found.detected) + len(found.missing)
    notes = [f"{len(found.detected)} of {total} markers, {found.view.rms:.2f} pixels rms"]
    if found.missing:
        notes.append(f"markers not found: {', '.join(map(str, found.missing))}")
    return found.view, tuple(notes)


def _figures_of(
    track: OpticalTrack, film: Video, view: View, robot: RobotConfig, height: float, *, pictured: bool
) -> tuple[dict[str, Any], list[str]]:
    """Compute the figures of a track, and warnings; `pictured` if there was a picture of the empty scene."""
    fine = 1e-3 * view.compute_scale(np.array([*track.positions[:, :2].mean(axis=0), height]))
    stay = track.compute_max_still_share(0.5 * min(robot.size[0], robot.size[2]))
    figures = {
        "video": str(film.path), "fps": film.fps, "frames": track.total, "seen": len(track.frames),
        "hidden": track.hidden, "robot": robot.name, "robot_z_mm": 1e3 * height,
        "duration_s": track.total / film.fps, "sigma_mm": 1e3 * float(np.median(track.sigmas)),
        "camera_sigma_mm": 1e3 * track.view_sigma, "camera_place_mm": 1e3 * view.position,
        **({"head_unsure": track.head_unsure} if track.head_unsure else {}),
        "pixels_per_mm": fine, "longest_stay": stay,
    }  # fmt: skip
    doubts = {
        "parallax: the camera's position is not known well enough. Put markers at the robot's height, or in two "
        "planes, or give --camera-height-mm": track.view_sigma > MAX_VIEW_SIGMA,
        f"in {track.head_unsure} frames head and tail cannot be distinguished; see --mark": track.head_unsure > 0,
        f"{fine:.1f} pixels per mm: below {MIN_PIXELS_PER_MM:g} an outline is lost at times; come nearer": fine
        < MIN_PIXELS_PER_MM,
        f"the robot covers one place in {100 * stay:.0f} % of the frames, and may be taken for part of the scene. "
        "Film for longer before or after, or give --background": stay > MAX_STILL_SHARE and not pictured,
    }
    return figures, [doubt for doubt, holds in doubts.items() if holds]


def _leave(found: VideoTrack, film: Video, folder: Path, name: str, path: Any) -> None:
    """Write track, figures and picture into `folder`; `path` is the curve that was to be followed, if any."""
    from smolbot.runs.optics.track_picture import draw_track

    line = [f"{len(found.track.frames)} of {found.track.total} frames"]
    if found.analysis is not None:
        e, a = found.figures["position_error_mm"], found.figures["angle_error_deg"]
        line = [
            f"{len(found.analysis.times)} poses", f"position error {e['mean']:.2f} ± {e['std']:.2f} mm",
            f"angle error {a['mean']:.1f} ± {a['std']:.1f}°", *line,
        ]  # fmt: skip
    with report_write_errors(folder, done="made"):
        folder.mkdir(parents=True, exist_ok=True)
    write_optical_track(folder / "track.csv", found.track)
    draw_track(
        found.track, found.view, found.height, film.background, folder / "track.png", title=f"Optical track of {name}",
        line="   ·   ".join(line), analysis=found.analysis, planned=None if path is None else path.points,
    )  # fmt: skip
    figures = {**found.figures, "track": str(folder / "track.csv")}
    (folder / "track.json").write_text(format_json(figures), encoding="utf-8")
