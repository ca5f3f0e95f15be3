"""The page ``comparison.html`` that compares several runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.errors import report_write_errors
from smolbot.paths.arc_lengths import assign_arc_lengths
from smolbot.runs.pictures.style import COILS, PLANNED, draw_dots, draw_empty_note, escape_name
from smolbot.runs.report.comparison import Comparison, compute_series
from smolbot.runs.report.figures_of_merit import append_unit, format_number, get_unit
from smolbot.runs.report.intervals import METHOD, Estimate
from smolbot.runs.report.page_elements import ELEMENTS, Section, render_page
from smolbot.runs.report.recorded_flight import RecordedFlight
from smolbot.runs.report.svg import apply_page_style, make_wide_figure, to_svg
from smolbot.runs.summary import compute_tracking_distance
from smolbot.runs.trace import pair_with_truth

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLORS = (COILS[0], COILS[2], COILS[5], COILS[3], COILS[4], COILS[1])

_N_AVERAGES = 40  # stretches of a path over which an error is averaged


def write_comparison(found: Comparison, path: Path) -> Path:
    """Write the page of a comparison.

    Parameters
    ----------
    found : Comparison
    path : Path
        File to write.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    content = build_comparison_page(found)
    with report_write_errors(path, "the comparison"):
        path.write_text(content, encoding="utf-8")
    return path


def build_comparison_page(found: Comparison) -> str:
    """Build the page of a comparison.

    Parameters
    ----------
    found : Comparison

    Returns
    -------
    str
        HTML.
    """
    with apply_page_style():
        sections = [
            _build_figures_section(found),
            _build_settings_section(found),
            _build_paths_section(found),
            _build_errors_section(found),
            _build_runs_section(found),
        ]
    title = " and ".join(found.labels) if len(found.labels) == 2 else f"{len(found.labels)} runs compared"
    robot = found.flights[0].mission.robot
    lead = f"Robot {robot.name} ({robot.kind}). Changes and differences are against the first run."
    return render_page(title, title, [ELEMENTS.paragraph(line) for line in (lead, *found.notes)], sections)


def _build_figures_section(found: Comparison) -> Section:
    section = Section("figures", "Figures side by side")
    shown = [f for f in found.figures if f.key.endswith("_mm.mean") and any(e and e.low is not None for e in f.values)]
    if shown:
        section.add_figure(
            to_svg(_draw_intervals(found, shown), "intervals", "Mean errors with intervals"),
            "Each run's mean error with its 95 % interval. Where intervals of two runs are far apart, the runs differ; "
            "the table gives the difference.",
        )
    header = ["figure", *found.labels]
    for label in found.labels[1:]:
        header.append(f"{label} minus {found.labels[0]}")
    rows = []
    for figure in found.figures:
        unit = get_unit(figure.key)
        own, over = figure.values, figure.differences_to_first[1:]
        rows.append(
            [
                figure.name,
                *(format_estimate(e, unit) for e in own),
                *(format_estimate(e, unit, signed=True) for e in over),
            ]
        )
    section.add(ELEMENTS.table(rows, header, wide=True))
    return section.add_paragraph(METHOD + " A star marks a difference whose interval does not contain zero.")


def _build_settings_section(found: Comparison) -> Section:
    section = Section("settings", "What was changed")
    if not found.settings:
        return section.add_missing_note("Nothing: mission, rig, robot, gains, seed and versions are the same.")
    rows = [[name, *("-" if v is None else v for v in values)] for name, values in found.settings]
    return section.add(ELEMENTS.table(rows, ["setting", *found.labels], wide=True))


def _build_paths_section(found: Comparison) -> Section:
    section = Section("paths", "Paths")
    return section.add_figure(
        to_svg(_draw_paths(found), "paths", "Paths of all runs"),
        "From above: grey is what was planned, coloured the true path of each robot; without "
        "ground truth, the tracked one.",
    )


def _build_errors_section(found: Comparison) -> Section:
    section = Section("errors", "Errors")
    along = found.flights[0].steered is not None
    return section.add_figure(
        to_svg(_draw_errors(found), "errors", "Errors of all runs"),
        (
            f"Dots: each value; lines: mean over every {100 / _N_AVERAGES:g} % of the path. "
            if along
            else "Each pose over the time of its run. "
        )
        + "Right: cumulative distribution of the values; a curve further to the left is better.",
    )


def _build_runs_section(found: Comparison) -> Section:
    section = Section("runs", "Runs")
    for flight, label in zip(found.flights, found.labels, strict=True):
        s = flight.summary
        words = f"{flight.title}, {s['status']}: {s['stop_reason']}. {flight.record.path}"
        section.add(ELEMENTS.run_line(label, s["verdict"], words))
    return section


def format_estimate(estimate: Estimate | None, unit: str, *, signed: bool = False) -> str:
    """Format an estimate with its interval and unit.

    Parameters
    ----------
    estimate : Estimate, or None
    unit : str
    signed : bool
        A difference: its sign is shown, and a star marks an interval without zero.

    Returns
    -------
    str
    """
    if estimate is None:
        return "-"
    plus = "+" if signed and estimate.value > 0 else ""
    shown = f"{plus}{format_number(estimate.value)}"
    if estimate.low is None or estimate.high is None:
        return append_unit(shown, unit)
    star = " *" if signed and estimate.low * estimate.high > 0 else ""
    return append_unit(f"{shown} ({format_number(estimate.low)} to {format_number(estimate.high)})", unit) + star


def _draw_intervals(found: Comparison, shown: list[Any]) -> Figure:
    n = len(found.labels)
    figure = make_wide_figure(0.7 + 0.42 * n)
    panels: Any = figure.subplots(1, len(shown), squeeze=False, sharey=True)
    for axes, one in zip(panels[0], shown, strict=True):
        for row, estimate in enumerate(one.values):
            if estimate is None:
                continue
            color = COLORS[row % len(COLORS)]
            axes.plot([estimate.low, estimate.high], [row, row], color=color, lw=3, alpha=0.5, solid_capstyle="butt")
            axes.plot(estimate.value, row, "o", color=color, ms=7)
        axes.set_yticks(range(n), [escape_name(label) for label in found.labels])
        axes.set_ylim(n - 0.5, -0.5)
        axes.set_xlim(left=0.0)
        axes.set_title(f"{one.name.capitalize()}, in {get_unit(one.key)}")
        axes.grid(axis="x")
    return figure


def _draw_paths(found: Comparison) -> Figure:
    figure = make_wide_figure(6.4)
    axes = figure.subplots()
    for index, (flight, label) in enumerate(zip(found.flights, found.labels, strict=True)):
        if flight.steered is not None:
            planned = 1e3 * flight.steered.path.points
            axes.plot(planned[:, 0], planned[:, 1], color=PLANNED, lw=8, solid_capstyle="round", zorder=1,
                      alpha=0.6, label="planned" if index == 0 else None)  # fmt: skip
        places = flight.trace.true_positions()
        if not len(places):
            tracked = [c.tracked for c in flight.run.cycles if c.tracked is not None]
            places = np.array([p.position for p in tracked]).reshape(-1, 3)
        color = COLORS[index % len(COLORS)]
        axes.plot(1e3 * places[:, 0], 1e3 * places[:, 1], color=color, lw=1.5, label=escape_name(label), zorder=3)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.05)
    axes.set_xlabel("x in mm")
    axes.set_ylabel("y in mm")
    axes.grid()
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _draw_errors(found: Comparison) -> Figure:
    steered = found.flights[0].steered is not None
    kinds = (["tracking"] if steered else []) + ["localization"]
    figure = make_wide_figure(3.0 * len(kinds))
    rows: Any = figure.subplots(len(kinds), 2, width_ratios=[2.2, 1.0], squeeze=False)
    names = {"tracking": "Tracking error, in mm", "localization": "Localization error of each trusted pose, in mm"}
    for (course, share), kind in zip(rows, kinds, strict=True):
        course.set_title(names[kind])
        share.set_title("Share of values within")
        any_known = False
        for index, (flight, label) in enumerate(zip(found.flights, found.labels, strict=True)):
            place, value = _compute_error_curve(flight, kind)
            if not len(value):
                continue
            any_known = True
            _draw_error_curve(course, place, value, COLORS[index % len(COLORS)], label, averaged=steered)
            order = np.sort(compute_series(flight).get(kind, value))
            share.plot(order, np.arange(1, len(order) + 1) / len(order), color=COLORS[index % len(COLORS)], lw=1.5)
        if not any_known:
            draw_empty_note(course, "no ground truth on this rig")
            draw_empty_note(share, "no ground truth on this rig")
        course.set_ylim(bottom=0.0)
        share.set_xlim(left=0.0)
        share.set_ylim(0.0, 1.02)
        course.grid(axis="y")
        share.grid()
    rows[-1, 0].set_xlabel("along the path, in mm" if steered else "time in s")
    rows[-1, 1].set_xlabel("error in mm")
    rows[0, 0].legend(loc="upper right", ncol=3)
    return figure


def _compute_error_curve(flight: RecordedFlight, kind: str) -> tuple[FloatArray, FloatArray]:
    """Return arc lengths in mm (or times in s, without a path) and errors in mm."""
    mission, moments = flight.steered, flight.trace.moments
    if kind == "tracking" and mission is not None:
        places = np.vstack([np.zeros((0, 3)), *(m.positions for m in flight.trace.following)])
        if not len(places):
            return np.zeros(0), np.zeros(0)
        arc = 1e3 * assign_arc_lengths(mission.path, places)
        return arc, 1e3 * compute_tracking_distance(mission, flight.trace.following)
    if mission is not None:
        moments = flight.trace.following
    pairs = pair_with_truth(moments)
    value = 1e3 * np.array([np.linalg.norm(p.position - t.position) for p, t in pairs])
    if mission is None or not pairs:
        return np.array([p.time for p, _ in pairs]), value
    return 1e3 * assign_arc_lengths(mission.path, np.array([t.position for _, t in pairs])), value


def _draw_error_curve(
    axes: Axes, place: FloatArray, value: FloatArray, color: str, label: str, *, averaged: bool
) -> None:
    draw_dots(axes, place, value, 1.8, color, alpha=0.35 if averaged else 0.7)
    edges = np.linspace(place.min(), place.max() + 1e-9, _N_AVERAGES + 1)
    which = np.digitize(place, edges) - 1
    known = [i for i in range(_N_AVERAGES) if np.any(which == i)]
    means = [float(value[which == i].mean()) for i in known]
    axes.plot(0.5 * (edges[:-1] + edges[1:])[known], means, color=color, lw=1.8, label=escape_name(label))
