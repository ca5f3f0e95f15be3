"""``smolbot track``: what a camera saw, for comparison with a run or with a clip of the cantilever."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smolbot.errors import InputError
from smolbot.ui.cli.options import JsonOption

if TYPE_CHECKING:
    from smolbot.config.robot import RobotConfig
    from smolbot.core.arrays import FloatArray
    from smolbot.runs.optics.opticaltrack import OpticalTrack
    from smolbot.runs.optics.outline import Body
    from smolbot.runs.optics.runposes import RunPoses
    from smolbot.runs.optics.video import Video
    from smolbot.runs.optics.view import View


def track(
    video: Annotated[
        Path, typer.Argument(help="Video from above; with --deflection a high-speed clip.", metavar="VIDEO")
    ],
    fiducials: Annotated[
        Path | None, typer.Option(help="TOML file of the ArUco markers and their places; see the documentation.")
    ] = None,
    corners: Annotated[
        str | None, typer.Option(help="In place of markers: pixels of four points, 'u,v u,v u,v u,v'.")
    ] = None,
    corners_mm: Annotated[
        str | None, typer.Option(help="Their places in the rig's world frame, 'x,y x,y x,y x,y'.")
    ] = None,
    corners_z_mm: Annotated[float | None, typer.Option(help="Their height; default: the robot's.")] = None,
    camera_height_mm: Annotated[float | None, typer.Option(help="z of the lens, by ruler; for parallax.")] = None,
    robot: Annotated[
        str | None, typer.Option("--robot", help="Robot, by name or path; default: the run's, or gradient.")
    ] = None,
    robot_z_mm: Annotated[
        float | None, typer.Option(help="Known height of the robot; default: the liquid's surface in the run's rig.")
    ] = None,
    mark: Annotated[
        str,
        typer.Option(help="Where the dark mark is: head, tail or none; auto: the magnet, as the robot file has it."),
    ] = "auto",
    background: Annotated[
        Path | None, typer.Option(help="Picture of the scene without the robot; default: the video's median.")
    ] = None,
    run: Annotated[
        Path | None, typer.Option("--run", help="Folder of the run that was filmed, to compare with.")
    ] = None,
    offset_s: Annotated[
        float | None, typer.Option(help="When the video began on the run's clock; default: by the best match.")
    ] = None,
    fps: Annotated[float | None, typer.Option(help="Frames per second as recorded; default: as the file says.")] = None,
    deflection: Annotated[
        bool, typer.Option("--deflection", help="Measure the swing of a bright cantilever in a high-speed clip.")
    ] = False,
    from_s: Annotated[float | None, typer.Option(help="With --deflection: the free swing begins here.")] = None,
    to_s: Annotated[float | None, typer.Option(help="With --deflection: and ends here.")] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for table and figure; default: RUN/optical, or VIDEO_track.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Find the robot in a video from above: a track in mm, and a run's errors against it.

    The robot is what differs from the scene that stands still and has the robot's outline; its head is told from its
    tail by its magnet. Markers (--fiducials) or four points (--corners, --corners-mm) say where pixels are. The video
    is aligned with the run by the best match of their displacements. Leaves track.csv, track.json and track.png; a
    track in RUN/optical is the run's optical reference.

    Frames that do not show the robot are counted and left out.
    """
    from smolbot.runs.optics.video import Video

    if (from_s is not None or to_s is not None) and not deflection:
        raise InputError("--from-s and --to-s are for --deflection.")
    folder = out or (run / "optical" if run is not None else Path(f"{video.stem}_track"))
    if deflection:
        if run is not None or fiducials is not None or corners is not None:
            raise InputError("--deflection measures angles in a clip: --run, --fiducials and --corners are not for it.")
        from smolbot.ui.cli.track_swing import measure_swing

        measure_swing(Video(video, fps), fps is not None, from_s, to_s, folder, json)
        return
    _check_points(fiducials, corners, corners_mm)
    if offset_s is not None and run is None:
        raise InputError("--offset-s needs --run: it is when the video began on that run's clock.")
    points = None if corners is None else (_pairs(corners, "--corners"), _pairs(corners_mm or "", "--corners-mm"))
    if points is not None:
        from smolbot.runs.optics.view import check_points

        check_points(*points)
    poses = None
    if run is not None:
        from smolbot.runs.optics.runposes import read_run_poses

        poses = read_run_poses(run)
    config = _robot(robot, poses)
    film = Video(video, fps)
    height, told = _height(robot_z_mm, poses, fiducials, corners_z_mm)
    view, notes = _view(film, fiducials, points, corners_z_mm, camera_height_mm, height)
    body = _body(config, mark)
    found = _follow(film, view, body, height, background, json)
    from smolbot.ui.cli.track_report import TrackReport

    report = TrackReport(found, film, config, view, height, seen_from=told, camera=notes)
    report.tell_track(pictured=background is not None)
    if poses is not None and run is not None:
        report.compare(poses, run, offset_s, known=robot_z_mm is not None)
    report.leave(folder, run, json)


def _check_points(fiducials: Path | None, corners: str | None, corners_mm: str | None) -> None:
    if fiducials is not None and (corners or corners_mm):
        raise InputError("Give --fiducials or --corners, not both.")
    if fiducials is None and corners is None:
        raise InputError(
            "Where pixels are must be known: --fiducials FILE, or --corners 'u,v u,v u,v u,v' with --corners-mm "
            "'x,y …'."
        )
    if (corners is None) != (corners_mm is None):
        raise InputError("--corners and --corners-mm belong together: four points in the picture, and where they are.")


def _pairs(text: str, option: str) -> FloatArray:
    import numpy as np

    parts = text.split()
    try:
        values = [[float(v) for v in part.split(",")] for part in parts]
    except ValueError:
        values = []
    if len(values) != 4 or any(len(v) != 2 for v in values) or not all(math.isfinite(x) for v in values for x in v):
        raise InputError(f"{option} needs four points, such as '102,88 1180,95 1171,870 96,862'; got '{text}'.")
    return np.array(values)


def _robot(name: str | None, poses: RunPoses | None) -> RobotConfig:
    from smolbot.config.robot import load_robot

    if name is None and poses is not None and poses.mission is not None:
        return poses.mission.robot
    return load_robot(name or "gradient")


def _body(config: RobotConfig, mark: str) -> Body:
    """The housing as a box, and where its magnet lies."""
    import numpy as np

    from smolbot.runs.optics.outline import Body

    sides = {"head": 1.0, "tail": -1.0, "none": 0.0, "auto": math.copysign(1.0, config.device.l0 - config.center[2])}
    if mark not in sides:
        raise InputError(f"--mark must be one of {', '.join(sides)}; got '{mark}'.")
    across, up, ahead = config.size
    return Body(0.5 * np.array([ahead, across, up]), np.array([config.center[2], config.center[0]]), sides[mark])


def _height(
    robot_z_mm: float | None, poses: RunPoses | None, fiducials: Path | None, corners_z_mm: float | None
) -> tuple[float, str]:
    """z of the robot, in m, and where it is known from."""
    if robot_z_mm is not None:
        return 1e-3 * robot_z_mm, "as given"
    if poses is not None:
        mission = poses.mission
        if mission is not None and mission.robot.kind == "gradient":
            return mission.rig.surface_z, "the liquid's surface: it floats"
        return float(poses.positions[:, 2].mean()), "mean of the run's poses"
    if fiducials is not None:
        from smolbot.runs.optics.fiducials import read_fiducials

        section = read_fiducials(fiducials).fiducials
        heights = [section.height_mm if m.height_mm is None else m.height_mm for m in section.markers]
        return 1e-3 * max(heights), "that of the highest markers; --robot-z-mm says better"
    return 1e-3 * (corners_z_mm or 0.0), "that of the four points; --robot-z-mm says better"


def _view(
    film: Video, fiducials: Path | None, points: Any, corners_z_mm: float | None, camera_height_mm: float | None,
    height: float,
) -> tuple[View, list[str]]:  # fmt: skip
    import numpy as np

    camera = None if camera_height_mm is None else 1e-3 * camera_height_mm
    notes: list[str] = []
    if fiducials is not None:
        from smolbot.runs.optics.fiducials import read_fiducials, view_by_markers

        found = view_by_markers(film.background, read_fiducials(fiducials), camera)
        view = found.view
        notes.append(f"{len(found.seen)} of {len(found.seen) + len(found.missing)} markers, {view.rms:.2f} pixels rms")
        if found.missing:
            notes.append(f"markers not seen: {', '.join(map(str, found.missing))}")
    else:
        from smolbot.runs.optics.view import CLICK, find_view

        z = height if corners_z_mm is None else 1e-3 * corners_z_mm
        places = np.column_stack([1e-3 * points[1], np.full(4, z)])
        view = find_view(points[0], places, film.size, camera, sharp=CLICK)
        notes.append(f"four points, {view.rms:.2f} pixels rms")
    return view, notes


def _follow(film: Video, view: View, body: Body, height: float, background: Path | None, json: bool) -> OpticalTrack:
    from smolbot.runs.optics.tracking import track_body
    from smolbot.runs.optics.video import read_picture
    from smolbot.ui.cli.show import bar

    empty = None if background is None else read_picture(background, film.size)
    with bar("frames", total=film.frames, quiet=json) as tell:
        return track_body(film, view, body, height, background=empty, progress=lambda done, _: tell(completed=done))
