"""What ``smolbot track`` tells of an optical track: figures, warnings, a run's errors against it, and its files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.errors import writing
from smolbot.runs.optics.alignment import align
from smolbot.runs.optics.analysis import PathAnalysis, analyse
from smolbot.runs.optics.opticaltrack import OpticalTrack, write_optical_track
from smolbot.runs.optics.trackfigures import tracking_error
from smolbot.ui.cli.show import echo_json, json_text, table

if TYPE_CHECKING:
    from smolbot.config.robot import RobotConfig
    from smolbot.core.arrays import FloatArray
    from smolbot.runs.optics.runposes import RunPoses
    from smolbot.runs.optics.video import Video
    from smolbot.runs.optics.view import View

VAGUE = 0.05  # s: more than this unsure of when the video began is told: a tenth of a millimetre of a robot's way
COARSE = (
    9.0  # pixels per mm: the tank's films are tracked well from 10 on; at 8 headings err by 13 degrees, at 6 fits jump
)
STAYS = 0.4  # share of the frames: with half of them the median shows the robot, not the scene
DOUBT = 1e-4  # m: more than this unsure of the camera is told


class TrackReport:
    """Collects rows to print and figures to keep, in the order in which they are told.

    Parameters
    ----------
    height : float, in m
        z of the robot; `seen_from` says where it is known from.
    camera : list of str
        How the camera's place was found.
    """

    def __init__(
        self, track: OpticalTrack, film: Video, robot: RobotConfig, view: View, height: float,
        *, seen_from: str, camera: list[str],
    ) -> None:  # fmt: skip
        self.track, self.film, self.robot, self.view, self.height = track, film, robot, view, height
        self.figures: dict[str, Any] = {}
        self.rows: list[tuple[str, str]] = []
        self._known_from, self._camera = seen_from, camera
        self._analysis: PathAnalysis | None = None
        self._planned: FloatArray | None = None
        self._line = [f"{len(track.frames)} of {track.total} frames"]

    def tell_track(self, *, pictured: bool) -> None:
        """The track itself, and what makes it doubtful; `pictured` if there was a picture of the empty scene."""
        film, view, found = self.film, self.view, self.track
        self.figures |= {
            "video": str(film.path), "fps": film.fps, "frames": found.total, "seen": len(found.frames),
            "hidden": found.hidden, "robot": self.robot.name, "robot_z_mm": 1e3 * self.height,
            "duration_s": found.total / film.fps, "sigma_mm": 1e3 * float(np.median(found.sigmas)),
            "camera_sigma_mm": 1e3 * found.view_sigma, "camera_place_mm": 1e3 * view.place,
        }  # fmt: skip
        seen = f"robot seen in {len(found.frames)}, hidden in {found.hidden}"
        sigma, camera_sigma = self.figures["sigma_mm"], self.figures["camera_sigma_mm"]
        self.rows += [
            ("frames", f"{found.total} at {film.fps:g} per second; {seen}"),
            ("camera", "; ".join(self._camera) + f"; at {', '.join(f'{1e3 * v:.0f}' for v in view.place)} mm"),
            ("robot", f"{self.robot.name}, at z = {1e3 * self.height:.2f} mm ({self._known_from})"),
            ("sure to", f"{sigma:.3f} mm by its outline, {camera_sigma:.3f} mm by the camera's place"),
        ]
        self._tell_doubts(found, pictured)

    def _tell_doubts(self, found: OpticalTrack, pictured: bool) -> None:
        if found.view_sigma > DOUBT:
            unsure = "parallax: where the camera is, is not known well enough"
            self._warn(f"{unsure}. Put markers at the robot's height, or in two planes, or say --camera-height-mm")
        if found.head_unsure:
            self.figures["head_unsure"] = found.head_unsure
            self._warn(f"in {found.head_unsure} frames nothing tells head from tail; see --mark")
        fine = 1e-3 * self.view.scale(np.array([*found.positions[:, :2].mean(axis=0), self.height]))
        self.figures["pixels_per_mm"] = fine
        if fine < COARSE:
            self._warn(f"{fine:.1f} pixels per mm: below {COARSE:g} an outline is lost at times; come nearer")
        stay = found.stay(0.5 * min(self.robot.size[0], self.robot.size[2]))
        self.figures["longest_stay"] = stay
        if stay > STAYS and not pictured:
            covered = (
                f"the robot covers one place in {100 * stay:.0f} % of the frames, and may be taken for part of the"
            )
            self._warn(f"{covered} scene. Film for longer before or after, or give --background")

    def _warn(self, what: str) -> None:
        self.rows.append(("warning", what))

    def compare(self, poses: RunPoses, run: Path, offset_s: float | None, *, known: bool) -> None:
        """The run's errors against the track, which moves to the run's clock; `known` if the robot's height is."""
        alignment = align(self.track, poses, offset_s)
        self._analysis = analysis = analyse(self.track, poses, alignment, plane_known=known)
        self.track = self.track.shifted(alignment.offset)
        figures = self.figures
        figures |= {"run": str(run), "offset_s": alignment.offset, "offset_sigma_s": alignment.sigma,
                    "correlation": alignment.correlation} | analysis.figures()  # fmt: skip
        self.rows += _compared(figures, alignment.given)
        if alignment.sigma > VAGUE:
            self._warn("when the video began is not sure: it shows too little but straight movement")
        path = None if poses.mission is None else poses.mission.path
        error = None if path is None else tracking_error(self.track, path, poses)
        if error is not None:
            figures["tracking_error_mm"] = error
            self.rows.append(("tracking error", f"{_plain(error)} mm, of the robot as seen to the path"))
        self._planned = None if path is None else path.points
        e, a = figures["position_error_mm"], figures["angle_error_deg"]
        self._line = [
            f"{len(analysis.times)} poses",
            f"position error {e['mean']:.2f} ± {e['std']:.2f} mm",
            f"angle error {a['mean']:.1f} ± {a['std']:.1f}°",
            *self._line,
        ]

    def leave(self, folder: Path, run: Path | None, json: bool) -> None:
        """Write track and figures into `folder`, and print."""
        from smolbot.runs.optics.picture import draw_track

        film = self.film
        with writing(folder, done="made"):
            folder.mkdir(parents=True, exist_ok=True)
        write_optical_track(folder / "track.csv", self.track)
        what = film.path.name if run is None else run.resolve().name
        draw_track(self.track, self.view, self.height, film.background, folder / "track.png",
                   title=f"Optical track of {what}", line="   ·   ".join(self._line), analysis=self._analysis,
                   planned=self._planned)  # fmt: skip
        self.figures["track"] = str(folder / "track.csv")
        (folder / "track.json").write_text(json_text(self.figures), encoding="utf-8")
        self.rows.append(("written", f"{folder}: track.csv, track.json, track.png"))
        table(f"{film.path.name}", self.rows, err=json)
        if json:
            echo_json(self.figures)


def _compared(figures: dict[str, Any], given: bool) -> list[tuple[str, str]]:
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
