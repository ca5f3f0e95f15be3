"""A short animation of a run: path, robot, localized pose and currents over time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.config.observation import Observation
from smolbot.core.arrays import FloatArray
from smolbot.core.shots import Actuate, Excite, MoveMagnet, Rotate, Window
from smolbot.errors import InputError, report_write_errors
from smolbot.runs.pictures.style import LOCATED, PLANNED, TRUE, escape_name
from smolbot.runs.report.interpolated_track import InterpolatedTrack, collect_true_way
from smolbot.runs.report.recorded_flight import RecordedFlight
from smolbot.runs.report.svg import FAINT, GRID, INK, apply_page_style
from smolbot.runs.trace import get_located_poses

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SUFFIXES = (".gif", ".mp4")

SIZE = (6.4, 4.8)
"""In inches, at `DPI`."""

DPI = 90
SHADES = 6
"""Number of shades of each colour in a GIF, from white: few colours make a small file."""

HEADING_LENGTH = 0.07
"""Length of the line along the robot's heading, as a share of the picture's width."""

_REST = 1.0  # s for which the last picture stays


@dataclass(frozen=True)
class Animation:
    """A written animation.

    Attributes
    ----------
    seconds : float, in s
        Length.
    fps : int, in 1/s
        Pictures per second.
    speed : float
        How many times faster than the run.
    size : int, in bytes
    """

    seconds: float
    fps: int
    speed: float
    size: int

    def as_dict(self) -> dict[str, float]:
        """Convert to a dictionary for JSON output.

        Returns
        -------
        dict of str to float
        """
        return {"seconds": self.seconds, "fps": self.fps, "times_real_time": self.speed, "bytes": self.size}


def make_animation(run: str | Path, path: Path, seconds: float = 10.0, fps: int = 12) -> Animation:
    """Write an animation of a recorded run.

    Parameters
    ----------
    run : str or Path
        Run folder, or its record.
    path : Path
        ``.gif``, or ``.mp4`` where ffmpeg is installed.
    seconds : float, in s
        Length; the run is sped up accordingly.
    fps : int, in 1/s
        Pictures per second.

    Returns
    -------
    Animation

    Raises
    ------
    InputError
        For another kind of file, an ``.mp4`` without ffmpeg, a run without cycles, or a file that cannot be
        written.
    """
    _check(path)
    flight = RecordedFlight.read(run)
    if not flight.trace.moments:
        raise InputError(f"{flight.record.path}: holds no complete cycle; there is nothing to show.")
    count = max(round(seconds * fps), 2)
    begin, end = _find_span(flight)
    speed = (end - begin) / ((count - 1) / fps)
    with apply_page_style():
        scene = AnimationScene(flight, speed)
        times = np.linspace(begin, end, count)
        with report_write_errors(path, "the animation"):
            if path.suffix.lower() == ".gif":
                _write_gif(path, scene.draw_pictures(times), fps)
            else:
                _write_mp4(path, scene, times, fps)
    return Animation(count / fps, fps, speed, path.stat().st_size)


def _check(path: Path) -> None:
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: an animation is one of {', '.join(SUFFIXES)}; got '{path.suffix}'.")
    if path.suffix.lower() == ".mp4":
        from matplotlib.animation import FFMpegWriter

        if not FFMpegWriter.isAvailable():
            raise InputError(f"{path}: an .mp4 needs ffmpeg, which is not on this machine; name a .gif instead.")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}.")


def _find_span(flight: RecordedFlight) -> tuple[float, float]:
    """Return the times of the first pose and of the end of the last shot, in s."""
    moments = flight.trace.moments
    first = next((m.cycle.tracked.time for m in moments if m.cycle.tracked is not None), moments[0].cycle.shot.start)
    return first, max(m.cycle.shot.end for m in moments)


class AnimationScene:
    """The content of the animation, redrawn for each time.

    Parameters
    ----------
    flight : RecordedFlight
    speed : float
        How many times faster than the run, for the label.
    """

    def __init__(self, flight: RecordedFlight, speed: float) -> None:
        from matplotlib.figure import Figure

        self.figure: Figure = Figure(figsize=SIZE, dpi=DPI, facecolor="white")
        self._flight = flight
        self._speed = speed
        device = flight.mission.robot.device
        ahead = np.array([0.0, 0.0, 1.0]) if flight.is_helical else device.moment_in_body
        moments = flight.trace.moments
        truths = [p for m in moments for p in (m.truth, m.truth_at_end) if p is not None]
        self._true = InterpolatedTrack.from_poses(list({p.time: p for p in truths}.values()), ahead).with_positions(
            *collect_true_way(moments)
        )
        self._heard = InterpolatedTrack.from_poses(get_located_poses(moments), ahead)
        self._trail = self._true if len(self._true.times) else self._heard
        self._axes, self._bars = self._lay_out()
        self._names, self._limit, self._windows = _choose_bars(flight)
        self._draw_still()

    def draw_pictures(self, times: FloatArray) -> Iterator[Any]:
        """Draw a picture at each time.

        Parameters
        ----------
        times : ndarray, shape (n,), in s
            On the rig's clock.

        Yields
        ------
        PIL.Image.Image
        """
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from PIL import Image

        canvas = FigureCanvasAgg(self.figure)
        for time in times:
            self.show(float(time))
            canvas.draw()  # type: ignore[no-untyped-call]
            picture = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
            yield Image.fromarray(picture).convert("RGB")

    def show(self, time: float) -> None:
        """Move everything to one time.

        Parameters
        ----------
        time : float, in s
            On the rig's clock.
        """
        place, ahead = self._trail.interpolate(time)
        seen = self._trail.times <= time
        trail = 1e3 * np.vstack([self._trail.positions[seen], place[None, :]])
        self._way.set_data(trail[:, 0], trail[:, 1])
        self._robot.set_data([1e3 * place[0]], [1e3 * place[1]])
        length = max(float(np.hypot(*ahead)), 1e-9)
        low, high = self._axes.get_xlim()
        tip = 1e3 * place[:2] + HEADING_LENGTH * (high - low) * ahead / length
        self._heading.set_data([1e3 * place[0], tip[0]], [1e3 * place[1], tip[1]])
        past = self._heard.times <= time
        latest = 1e3 * self._heard.positions[past]
        self._poses.set_data(latest[-60:, 0], latest[-60:, 1])
        if len(latest):
            self._located.set_data([latest[-1, 0]], [latest[-1, 1]])
        for bar, value in zip(self._drawn, self._compute_values(time), strict=True):
            bar.set_height(value)
        self._clock.set_text(f"{time:.1f} s")
        self._said.set_text(self._describe(time))

    def _lay_out(self) -> tuple[Axes, Axes]:
        axes = self.figure.add_axes((0.1, 0.1, 0.66, 0.76))
        bars = self.figure.add_axes((0.83, 0.1, 0.15, 0.5))
        self.figure.text(0.1, 0.94, self._flight.title, fontsize=11, fontweight="bold")
        times = f"{self._speed:.1f} times real time" if self._speed < 100 else f"{self._speed:.0f} times real time"
        self.figure.text(0.98, 0.945, times, fontsize=9, color=FAINT, ha="right")
        self._clock = self.figure.text(0.83, 0.8, "", fontsize=15, fontweight="bold")
        self._said = self.figure.text(0.83, 0.745, "", fontsize=8.5, color=INK, va="top")
        return axes, bars

    def _draw_still(self) -> None:
        axes, bars, flight = self._axes, self._bars, self._flight
        if flight.steered is not None:
            planned = 1e3 * flight.steered.path.points
            axes.plot(*planned[:, :2].T, color=PLANNED, lw=7, solid_capstyle="round", alpha=0.7, label="planned")
        name = "true" if len(self._true.times) else "localized way"
        (self._way,) = axes.plot([], [], color=TRUE, lw=1.5, label=name)
        (self._poses,) = axes.plot([], [], ".", color=LOCATED, ms=3, alpha=0.5)
        (self._located,) = axes.plot([], [], "o", color=LOCATED, ms=7, mfc="none", mew=1.8, label="localized")
        (self._heading,) = axes.plot([], [], color=TRUE, lw=2.4, solid_capstyle="round", zorder=5)
        (self._robot,) = axes.plot([], [], "o", color=TRUE, ms=8, zorder=6)
        _set_limits(axes, *_compute_limits(flight, self._trail, self._heard))
        axes.set_xlabel("x in mm")
        axes.set_ylabel("y in mm")
        axes.grid()
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 0.995), ncol=3, fontsize=8.5)
        self._drawn = bars.bar(range(len(self._names)), [0.0] * len(self._names), color=TRUE, width=0.7)
        bars.set_xticks(range(len(self._names)), [escape_name(n) for n in self._names], fontsize=8.5)
        low = 0.0 if flight.mission.rig.limits.unipolar or not flight.mission.rig.coil_names else -self._limit
        bars.set_ylim(low, self._limit)
        bars.set_title("turns so far" if flight.is_helical else "current, A", fontsize=9)
        bars.tick_params(labelsize=8)

    def _compute_values(self, time: float) -> list[float]:
        """Return the heights of the bars: of the shot played at that time, or the last before."""
        values = [0.0] * len(self._names)
        for start, window in self._windows:
            if start > time:
                break
            if isinstance(window, Actuate):
                values = list(window.currents)
            elif isinstance(window, Excite):
                values = [abs(c) for c in window.currents]
            elif isinstance(window, Rotate):
                values[0] += window.turns * min(1.0, (time - start) / window.duration)
        return values

    def _describe(self, time: float) -> str:
        """Return the mode of the shot, or what the magnet does."""
        now = next((m.cycle.shot for m in reversed(self._flight.trace.moments) if m.cycle.shot.start <= time), None)
        if now is None:
            return ""
        for at, window in now.timed():
            inside = now.start + at <= time <= now.start + at + window.duration
            if inside and isinstance(window, Rotate | MoveMagnet):
                return "magnet turns" if isinstance(window, Rotate) else f"magnet moves {window.to}"
        return now.mode


def _choose_bars(flight: RecordedFlight) -> tuple[tuple[str, ...], float, list[tuple[float, Window]]]:
    """Return names and limit of the bars, and the windows that give their heights."""
    limits, names = flight.mission.rig.limits, flight.mission.rig.coil_names
    kind: type = Actuate
    top = limits.max_current
    if flight.is_helical:
        kind, names, top = Rotate, ("magnet",), 1.0
    elif not names or flight.steered is None:
        kind, names, top = Excite, ("x", "y"), limits.max_excitation_current
    windows = [
        (m.cycle.shot.start + at, window)
        for m in flight.trace.moments
        for at, window in m.cycle.shot.timed()
        if isinstance(window, kind)
    ]
    if flight.is_helical:
        top = max(sum(w.turns for _, w in windows if isinstance(w, Rotate)), 1.0)
    return names, top, windows


def _set_limits(axes: Axes, low: FloatArray, high: FloatArray) -> None:
    """Set the limits of the axes to show all from `low` (x, y) to `high`, with equal scales."""
    box = axes.get_position()
    shape = np.array([box.width * SIZE[0], box.height * SIZE[1]])
    scale = float(np.max((high - low) / shape)) * 1.1
    middle = 0.5 * (low + high)
    (x0, y0), (x1, y1) = middle - 0.5 * scale * shape, middle + 0.5 * scale * shape
    axes.set_xlim(x0, x1)
    axes.set_ylim(y0, y1)


def _compute_limits(
    flight: RecordedFlight, trail: InterpolatedTrack, located: InterpolatedTrack
) -> tuple[FloatArray, FloatArray]:
    """Compute the corners of what to show in mm: the track, and the container of an observed device."""
    shown = [1e3 * trail.positions[:, :2], 1e3 * located.positions[:, :2]]
    if flight.steered is not None:
        shown.append(1e3 * flight.steered.path.points[:, :2])
    if isinstance(flight.mission, Observation) and flight.mission.sections.observe.measurements is None:
        box = flight.mission.rig.container
        shown.append(1e3 * np.array([box.low[:2], box.high[:2]]))
    places = np.vstack(shown)
    low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
    half = np.maximum(0.5 * (high - low), 0.5)
    return 0.5 * (low + high) - half, 0.5 * (low + high) + half


def _write_gif(path: Path, pictures: Iterator[Any], fps: int) -> None:
    """Write a GIF with one palette for all pictures, so that only moving parts are stored."""
    from PIL import Image

    palette = Image.new("P", (1, 1))
    palette.putpalette(_make_palette())
    flat = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    each = round(1000.0 / fps)
    lasting = [each] * (len(flat) - 1) + [round(1000.0 * _REST)]
    flat[0].save(path, save_all=True, append_images=flat[1:], duration=lasting, loop=0, optimize=True, disposal=1)


def _make_palette() -> list[int]:
    """Return white and shades of every colour of the scene, as bytes of red, green and blue."""
    from matplotlib.colors import to_rgb

    shades = np.linspace(0.0, 1.0, SHADES + 1)[1:, None]
    colors = np.array([to_rgb(color) for color in (INK, FAINT, PLANNED, TRUE, LOCATED)])
    mixed = 1.0 - shades[None] * (1.0 - colors[:, None])
    rows = np.vstack([np.ones(3), to_rgb(GRID), mixed.reshape(-1, 3)])
    return [int(value) for value in np.round(255.0 * rows).ravel()]


def _write_mp4(path: Path, scene: AnimationScene, times: FloatArray, fps: int) -> None:
    from matplotlib.animation import FFMpegWriter

    writer = FFMpegWriter(fps=fps, codec="libx264", extra_args=["-pix_fmt", "yuv420p"])
    with writer.saving(scene.figure, str(path), DPI):
        for time in times:
            scene.show(float(time))
            writer.grab_frame()
