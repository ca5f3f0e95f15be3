"""Poses against the optical track from ``smolbot track``: a reference that also exists on a bench."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.errors import SmolbotError
from smolbot.runs.optics.optical_track import OpticalTrack, read_optical_track
from smolbot.runs.pictures.style import LOCATED, PLANNED, TRUE, draw_dots
from smolbot.runs.report.page_elements import ELEMENTS, Section
from smolbot.runs.report.recorded_flight import RecordedFlight
from smolbot.runs.report.svg import make_wide_figure, to_svg
from smolbot.runs.run import get_trusted_poses
from smolbot.runs.summary import compute_statistics

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FOLDER, TRACK = "optical", "track.csv"
"""Path of a track in a run folder; its times are on the run's clock."""


@dataclass(frozen=True)
class OpticalComparison:
    """Poses of a run with the optical track at the same times.

    Attributes
    ----------
    track : OpticalTrack
    times : ndarray, shape (n,), in s
        On the run's clock.
    located, optical : ndarray, shape (n, 3), in m
        Positions in the world frame.
    heading_errors : ndarray, shape (n,), in rad
        Located minus optical azimuth of body z, within half a turn.
    """

    track: OpticalTrack
    times: FloatArray
    located: FloatArray
    optical: FloatArray
    heading_errors: FloatArray

    @property
    def distances(self) -> FloatArray:
        """Horizontal distance (n,) between pose and optical position, in m."""
        found: FloatArray = np.linalg.norm((self.located - self.optical)[:, :2], axis=1)
        return found


def compare_with_track(flight: RecordedFlight) -> OpticalComparison | None:
    """Compare the trusted poses of a flight with its optical track.

    Parameters
    ----------
    flight : RecordedFlight

    Returns
    -------
    Seen or None
        None without a track.

    Raises
    ------
    InputError
        If the track cannot be read.
    """
    path = flight.record.folder / FOLDER / TRACK
    if not path.is_file():
        return None
    track = read_optical_track(path)
    poses = get_trusted_poses(flight.run.cycles)
    times = np.array([pose.time for pose in poses])
    places, headings, known = track.interpolate(times)
    ahead = np.array([pose.body_axis("z") for pose in poses]).reshape(-1, 3)
    heading_errors = np.angle(np.exp(1j * (np.arctan2(ahead[:, 1], ahead[:, 0]) - headings)))
    located = np.array([pose.position for pose in poses]).reshape(-1, 3)
    return OpticalComparison(track, times[known], located[known], places[known], heading_errors[known])


def build_optical_sections(flight: RecordedFlight) -> list[Section]:
    """Build the section on the optical track.

    Parameters
    ----------
    flight : RecordedFlight

    Returns
    -------
    list of Section
        Empty for a run without a track.
    """
    section = Section("optical", "Optical reference")
    try:
        pair = compare_with_track(flight)
    except SmolbotError as error:
        return [section.add_missing_note(f"The optical track of this run cannot be used: {error}")]
    if pair is None:
        return []
    if not len(pair.times):
        return [section.add_missing_note("No pose of this run is between two frames of its optical track.")]
    section.add_figure(
        to_svg(draw_optical_figure(flight, pair), "optical", "Poses against the optical track"),
        "Left: optical and localized positions of the robot. Right: horizontal distance of each trusted pose to the "
        "optical position at the same time, and the difference of their headings.",
    )
    return [
        section.add(
            ELEMENTS.table(format_optical_rows(flight, pair), ("", "mean", "std", "rms", "95 %", "max"), numbers=True)
        )
    ]


def format_optical_rows(flight: RecordedFlight, pair: OpticalComparison) -> list[list[str]]:
    """Format the errors against the camera: of poses, of headings, and of the robot to its path.

    Parameters
    ----------
    flight : RecordedFlight
    pair : OpticalComparison

    Returns
    -------
    list of list of str
        A table row for each.
    """
    rows = [
        ("pose to camera, mm", 1e3 * pair.distances),
        ("heading to camera, °", np.degrees(np.abs(pair.heading_errors))),
    ]
    following = flight.trace.following
    if flight.steered is not None and following:
        since = pair.track.times >= following[0].cycle.shot.end
        if since.any():
            off = flight.steered.path.project(pair.track.positions[since])[1]
            rows.append(("robot in the video to the path, mm", 1e3 * off))
    names = ("mean", "std", "rms", "p95", "max")
    return [[name, *(f"{value:.3f}" for value in compute_statistics(values, *names).values())] for name, values in rows]


def draw_optical_figure(flight: RecordedFlight, pair: OpticalComparison) -> Figure:
    """Draw track and poses from above, and their differences in position and heading over time.

    Parameters
    ----------
    flight : RecordedFlight
    pair : OpticalComparison

    Returns
    -------
    Figure
    """
    figure = make_wide_figure(4.6)
    panels: Any = figure.subplot_mosaic([["above", "apart"], ["above", "turned"]], width_ratios=[1.0, 1.2])
    above, apart, turned = panels["above"], panels["apart"], panels["turned"]
    if flight.steered is not None:
        above.plot(*(1e3 * flight.steered.path.points[:, :2].T), color=PLANNED, lw=7, alpha=0.7, label="planned")
    above.plot(*(1e3 * pair.track.positions[:, :2].T), color=TRUE, lw=1.4, label="seen")
    draw_dots(
        above, 1e3 * pair.located[:, 0], 1e3 * pair.located[:, 1], 2.6, LOCATED, alpha=0.6, label="each pose", zorder=3
    )
    above.set_aspect("equal", adjustable="datalim")
    above.set_xlabel("x in mm")
    above.set_ylabel("y in mm")
    above.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncol=3)
    draw_dots(apart, pair.times, 1e3 * pair.distances, 2.4, LOCATED, alpha=0.7)
    apart.axhline(1e3 * float(pair.distances.mean()), color=TRUE, lw=1)
    apart.set_title("Pose to camera, horizontally, in mm; line: mean")
    apart.set_ylim(bottom=0.0)
    draw_dots(turned, pair.times, np.degrees(pair.heading_errors), 2.4, LOCATED, alpha=0.7)
    turned.axhline(0.0, color=TRUE, lw=1)
    turned.set_title("Heading: localized minus optical, in degrees")
    turned.set_xlabel("time in s")
    for axes in (above, apart, turned):
        axes.grid()
    return figure
