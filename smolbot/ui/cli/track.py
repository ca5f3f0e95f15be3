"""``smolbot track``: tracks a robot in a camera's video, or the swing of a cantilever in a high-speed clip."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smolbot.errors import InputError
from smolbot.ui.cli.options import JsonOption

if TYPE_CHECKING:
    from smolbot.core.arrays import FloatArray
    from smolbot.functions.track import VideoTrack


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

    The robot is what differs from the static scene and has the robot's outline; its magnet distinguishes head and
    tail. Markers (--fiducials) or four points (--corners, --corners-mm) relate pixels to positions. The video is
    aligned with the run by the best match of their displacements. Leaves track.csv, track.json and track.png; a
    track in RUN/optical is the run's optical reference.

    Frames that do not show the robot are counted and left out.
    """
    if (from_s is not None or to_s is not None) and not deflection:
        raise InputError("--from-s and --to-s are for --deflection.")
    folder = out or (run / "optical" if run is not None else Path(f"{video.stem}_track"))
    if deflection:
        if run is not None or fiducials is not None or corners is not None:
            raise InputError("--deflection measures angles in a clip: --run, --fiducials and --corners are not for it.")
        from smolbot.runs.optics.video import Video
        from smolbot.ui.cli.track_swing import measure_swing

        measure_swing(Video(video, fps), fps is not None, from_s, to_s, folder, json)
        return
    from smolbot.functions.track import track as follow
    from smolbot.ui.cli.show import echo_json, print_table, show_bar

    if (corners is None) != (corners_mm is None):
        raise InputError("--corners and --corners-mm belong together: four points in the picture, and where they are.")
    with show_bar("frames", total=None, quiet=json) as report:
        found = follow(
            video, fiducials=fiducials, corners=_parse_points(corners, "--corners"),
            corners_at=_si(_parse_points(corners_mm, "--corners-mm")), corners_height=_si(corners_z_mm),
            camera_height=_si(camera_height_mm), robot=robot, robot_height=_si(robot_z_mm), mark=mark,
            background=background, run=run, offset=offset_s, fps=fps, out=folder,
            progress=lambda done, total: report(completed=done, total=total),
        )  # fmt: skip
    print_table(found.video.name, [*_rows(found), ("written", f"{folder}: track.csv, track.json, track.png")], err=json)
    if json:
        echo_json({**found.figures, "track": str(folder / "track.csv")})


def _rows(found: VideoTrack) -> list[tuple[str, str]]:
    """Format the track, its warnings, and a run's errors against it."""
    f, t = found.figures, found.track
    place = ", ".join(f"{1e3 * v:.0f}" for v in found.view.position)
    rows = [
        (
            "frames",
            f"{t.total} at {f['fps']:g} per second; robot seen in {len(t.frames)}, hidden in {t.hidden}",
        ),
        ("camera", f"{'; '.join(found.camera)}; at {place} mm"),
        ("robot", f"{found.robot}, at z = {1e3 * found.height:.2f} mm ({found.height_from})"),
        ("sure to", f"{f['sigma_mm']:.3f} mm by its outline, {f['camera_sigma_mm']:.3f} mm by the camera's place"),
    ]
    if found.alignment is not None:
        rows += _compared(f, found.alignment.given)
    if "tracking_error_mm" in f:
        rows.append(("tracking error", f"{_plain(f['tracking_error_mm'])} mm, of the robot as seen to the path"))
    return rows + [("warning", warning) for warning in found.warnings]


def _si(value: Any) -> Any:
    """Millimetres in m; None stays."""
    return None if value is None else 1e-3 * value


def _parse_points(text: str | None, option: str) -> FloatArray | None:
    import numpy as np

    if text is None:
        return None
    parts = text.split()
    try:
        values = [[float(v) for v in part.split(",")] for part in parts]
    except ValueError:
        values = []
    if len(values) != 4 or any(len(v) != 2 for v in values) or not all(math.isfinite(x) for v in values for x in v):
        raise InputError(f"{option} needs four points, such as '102,88 1180,95 1171,870 96,862'; got '{text}'.")
    return np.array(values)


def _compared(figures: Mapping[str, Any], given: bool) -> list[tuple[str, str]]:
    how = "as given" if given else f"± {1e3 * figures['offset_sigma_s']:.0f} ms, by the best match"
    z = figures["z_error_from_mean_mm"]
    height = f"from the mean {z['mean']:.2f} ± {z['std']:.2f} mm"
    if "z_error_mm" in figures:
        known = figures["z_error_mm"]
        height += f"; from the known height {known['mean']:+.2f} ± {known['std']:.2f} mm"
    sides = [f"{figures[k]['mean']:+.2f} ± {figures[k]['std']:.2f}" for k in ("x_error_mm", "y_error_mm")]
    return [
        (
            "video began",
            f"{figures['offset_s']:.3f} s on the run's clock ({how}); correlation {figures['correlation']:.4f}",
        ),
        ("position error", f"{_plain(figures['position_error_mm'])} mm (x and y), of {figures['poses']} poses"),
        ("to optical path", f"{_plain(figures['to_optical_path_mm'])} mm"),
        ("error in x, y", ", ".join(sides) + " mm"),
        ("error in z", height),
        ("angle error", f"{_plain(figures['angle_error_deg'])}°, mean of signs {figures['angle_bias_deg']:+.2f}°"),
        *([("as tracked", f"{_plain(figures['tracked_position_error_mm'])} mm")]
          if "tracked_position_error_mm" in figures else []),
    ]  # fmt: skip


def _plain(f: dict[str, float]) -> str:
    return f"{f['mean']:.2f} ± {f.get('std', math.nan):.2f}, p95 {f['p95']:.2f}, worst {f['max']:.2f}"
