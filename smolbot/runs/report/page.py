"""The page ``report.html``: how a run went, and why."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from smolbot.config.observation import Observation
from smolbot.errors import InputError, report_write_errors
from smolbot.runs.report import machine_figures as machinery
from smolbot.runs.report import position_figures as whereabouts
from smolbot.runs.report import signal_figures as signals
from smolbot.runs.report.background_spectrum import (
    BackgroundSpectrum,
    estimate_background_spectrum,
    find_background_recordings,
)
from smolbot.runs.report.coil_load import compute_coil_load
from smolbot.runs.report.error_budget_section import build_budget_section
from smolbot.runs.report.figures_of_merit import build_figures_table, build_verdict_table, format_number
from smolbot.runs.report.optical_section import build_optical_sections
from smolbot.runs.report.page_elements import ELEMENTS, Section, render_page
from smolbot.runs.report.provenance_section import build_events_section, build_provenance_section
from smolbot.runs.report.recorded_flight import NO_SIGNALS, RecordedFlight
from smolbot.runs.report.residuals import fit_windows
from smolbot.runs.report.svg import apply_page_style, to_svg
from smolbot.runs.summary import format_label

REPORT = "report.html"
"""File of a run folder."""


def save_report(flight: RecordedFlight, out: Path | None = None) -> Path:
    """Write the report of a flight.

    Parameters
    ----------
    flight : RecordedFlight
    out : Path, optional
        File to write; default: ``report.html`` in the run folder.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If the page cannot be written.
    """
    path = flight.record.folder / REPORT if out is None else out
    content = build_report(flight)
    with report_write_errors(path, "the report"):
        path.write_text(content, encoding="utf-8")
    return path


def build_report(flight: RecordedFlight) -> str:
    """Build the page of a flight.

    Parameters
    ----------
    flight : RecordedFlight

    Returns
    -------
    str
        HTML.
    """
    with apply_page_style():
        sections = [
            _build_verdict_section(flight),
            *_build_position_sections(flight),
            *build_optical_sections(flight),
            build_budget_section(flight),
            _build_coils_section(flight),
            _build_cycle_section(flight),
            *_build_signal_sections(flight),
            build_events_section(flight),
            build_provenance_section(flight),
        ]
    summary = flight.summary
    verdict = summary["verdict"]
    heading = ELEMENTS.heading(flight.mission.name, verdict)
    lead = [*map(ELEMENTS.paragraph, _build_lead(flight)), ELEMENTS.tiles(choose_key_figures(summary))]
    return render_page(f"{flight.title}: {verdict}", heading, lead, sections, warning=_describe_warning(flight))


def _describe_warning(flight: RecordedFlight) -> str:
    record = flight.record
    if not record.whole:
        return (
            f"This record is cut short: it ends after {flight.run.duration:.1f} s, before the end of the run. "
            "All figures are of what was recorded until then."
        )
    if record.recovered is not None and not record.recovered.ended:
        return (
            "This record was recovered: the process was ended before it recorded the end of the run. All figures are "
            f"of the {flight.run.duration:.1f} s that had been written by then."
        )
    if record.dropped:
        return f"The recorder dropped {record.dropped} messages: cycles are missing from this report."
    return ""


def _build_lead(flight: RecordedFlight) -> list[str]:
    s, mission = flight.summary, flight.mission
    description = mission.base.description
    setup = f"{mission.robot.name} on {mission.rig.name}{format_label(s)}, seed {flight.seed}"
    ended = f"{s['status']}: {s['stop_reason']}" if s["stop_reason"] else s["status"]
    return [
        *([description] if description else []),
        f"{setup}. {ended[0].upper()}{ended[1:]}.",
    ]


def choose_key_figures(summary: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Choose the most important figures of merit.

    Parameters
    ----------
    summary : dict

    Returns
    -------
    list of tuple of str
        Value, unit and name; at most eight.
    """
    shown = (
        ("tracking_error_mm", "mean", "mm", "mean tracking error"),
        ("tracking_error_mm", "p95", "mm", "95 % of the path within"),
        ("sigma_mm", "distance", "mm", "scatter in space"),
        ("localization_error_mm", "mean", "mm", "mean localization error"),
        ("orientation_error_deg", "mean", "°", "mean orientation error"),
        ("axis_error_deg", "mean", "°", "mean axis error"),
        ("pose_rate_hz", "", "Hz", "trusted poses"),
        ("turns", "", "", "turns of the magnet"),
        ("pauses", "", "", "pauses"),
        ("loop_rate_hz", "", "Hz", "loop rate"),
        ("r_squared_median", "", "", "median R²"),
        ("duration_s", "", "s", "duration"),
        ("cycles", "", "", "cycles"),
    )
    found = []
    for key, part, unit, name in shown:
        value = summary.get(key)
        value = value.get(part) if part and isinstance(value, dict) else value
        if value is not None and not isinstance(value, dict):
            found.append((f"{value:.4f}" if key == "r_squared_median" else format_number(value), unit, name))
    return found[:8]


def _build_verdict_section(flight: RecordedFlight) -> Section:
    section = Section("verdict", "Verdict")
    section.add(build_verdict_table(flight.mission, flight.summary))
    for reason in flight.summary["verdict_reasons"]:
        section.add_missing_note(reason)
    return section.add(ELEMENTS.folded("All figures of this run", build_figures_table(flight.summary)))


def _build_position_sections(flight: RecordedFlight) -> list[Section]:
    """Build the sections on position and error, which depend on the kind of run."""
    place = Section("path", "Path")
    sigmas = f"{whereabouts.SIGMAS:g} standard deviations"
    if isinstance(flight.mission, Observation):
        place.title = "Track"
        place.add_figure(
            to_svg(whereabouts.draw_track_figure(flight, flight.mission), "track", "Track of the device"),
            "Measurements about their mean, with the ellipse of one standard deviation."
            if flight.mission.sections.observe.measurements is not None
            else "The container from above and from the front; arrows are the tip's axis as localized. Right: the "
            "dotted square, enlarged, where the error of the tracked pose was largest; ellipses are "
            f"{sigmas} of its horizontal covariance.",
        )
        if flight.mission.sections.observe.measurements is not None:
            return [place]
        error = Section("errors", "Localization over time")
        return [
            place,
            error.add_figure(
                to_svg(
                    whereabouts.draw_observation_figure(flight, flight.mission), "watched", "Errors and rate over time"
                ),
                "Each dot is a trusted pose against the truth at its time. Below: trusted poses in every second.",
            ),
        ]
    arrows = " Arrows: propulsion axis, true and tracked, at every pause." if flight.is_helical else ""
    place.add_figure(
        to_svg(whereabouts.draw_path_figure(flight), "path", "Path planned, true and localized"),
        f"Grey: planned. Dark: true path of the robot. Orange ellipses: {sigmas} of the tracked pose's horizontal "
        "covariance; 1.1 % of normal errors would lie outside. Right: the dotted square, enlarged, where the robot was "
        f"farthest from its path.{arrows}",
    )
    error = Section("errors", "Errors over time and along the path")
    error.add_figure(
        to_svg(whereabouts.draw_errors_figure(flight), "errors", "Tracking and localization error"),
        "Tracking error is the true robot's horizontal distance to the path as a curve, from the path's start on. "
        "Localization error is pose minus truth in three dimensions; where it alone is large, it lies along the path "
        "or in height.",
    )
    sections = [place, error]
    if flight.is_helical:
        helix = Section("helix", "Screwing")
        s = flight.summary
        helix.add_figure(
            to_svg(whereabouts.draw_helix_figure(flight), "helix", "Distance, axis error and turns along the path"),
            "Distance to the path, with rings at the pauses; the angle between localized and true propulsion axis; "
            "turns of the magnet before each pause, in another colour where it turned slower after a step-out.",
        )
        helix.add_paragraph(f"{format_number(s['turns'])} turns, {s['pauses']} pauses, {s['step_outs']} step-outs.")
        sections.append(helix)
    return sections


def _build_coils_section(flight: RecordedFlight) -> Section:
    section = Section("coils", "Currents, duty and heat")
    return section.add_figure(
        to_svg(
            machinery.draw_coils_figure(flight, compute_coil_load(flight)), "coils", "Currents, duty and heat over time"
        ),
        "Each with the limit that would have ended the run. Temperature is computed from commanded currents, as the "
        "safety supervisor does in flight: one thermal node for each coil.",
    )


def _build_cycle_section(flight: RecordedFlight) -> Section:
    section = Section("cycle", "One cycle")
    return section.add_figure(
        to_svg(machinery.draw_cycle_figure(flight), "cycle", "Timeline of a typical cycle"),
        "Windows of a typical shot, to scale, then the compute time: bar for the median, line to the 99th "
        "percentile, dotted box for the budget (turnaround_ms).",
    )


def _build_signal_sections(flight: RecordedFlight) -> list[Section]:
    """Build the sections on signals and noise."""
    fit, noise = Section("fit", "Signal and fit"), Section("noise", "Noise and mains")
    windows = list(fit_windows(flight))
    spectrum: BackgroundSpectrum | None = None
    background = find_background_recordings(flight)
    try:
        spectrum = estimate_background_spectrum(background)
    except InputError as error:
        noise.add_missing_note(f"No noise model can be estimated from the background recordings: {error}")
    lines = np.zeros(0) if spectrum is None else spectrum.line_frequencies
    if windows:
        fit.add_figure(
            to_svg(
                signals.draw_fit_figure(flight, windows, lines), "fit", "R², a window, and the spectrum of residuals"
            ),
            "R² is from the record. The rest is computed again: the raw samples minus the forward model at each "
            "recorded pose, with the sensors and device parameters assumed then. Where the orange line lies on the "
            "broad one, the residuals are noise alone; where it lies above, the model is incomplete. A constant, and "
            "the slope or decay that was fitted in each channel, are subtracted from all of them, so the lowest "
            "frequencies fall.",
        )
    else:
        fit.add_missing_note(NO_SIGNALS)
    if spectrum is not None:
        noise.add_figure(
            to_svg(signals.draw_noise_figure(spectrum), "noise", "Spectral density of the noise of every channel"),
            f"Recorded in {spectrum.seconds:.0f} s before the first cycle. Dotted: identified spectral lines. The "
            "dashed floor is the median between lines, from 20 Hz to 200 Hz.",
        )
        noise.add(ELEMENTS.table(*_format_lines(spectrum), numbers=True))
    elif not background and not windows:
        noise.add_missing_note(NO_SIGNALS)
    elif not background:
        noise.add_missing_note(
            "Nothing was recorded before the first cycle (quiet_s, or an estimator without a noise model)."
        )
    return [fit, noise]


def _format_lines(noise: BackgroundSpectrum) -> tuple[list[list[str]], list[str]]:
    """Return rows and header of the table of mains lines and noise floors."""
    channels = range(noise.lines.shape[1])
    rows = [
        [f"{f:.3f} Hz", f"{1e9 * np.sqrt(np.mean(row**2)):.2f}", *(f"{1e9 * v:.2f}" for v in row)]
        for f, row in zip(noise.line_frequencies, noise.lines, strict=True)
    ]
    floor = noise.floor
    rows.append(["floor, pT/√Hz", f"{1e12 * np.sqrt(np.mean(floor**2)):.1f}", *(f"{1e12 * v:.1f}" for v in floor)])
    return rows, ["line: peak in nT", "all", *(f"channel {i}" for i in channels)]
