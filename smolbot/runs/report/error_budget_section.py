"""The section of a report that shows the causes of the error."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.runs.pictures.style import LOCATED, draw_dots
from smolbot.runs.report.error_budget import PARTS, ErrorBudget, compute_budget, find_steps
from smolbot.runs.report.page_elements import ELEMENTS, Section
from smolbot.runs.report.recorded_flight import NO_TRUTH, RecordedFlight
from smolbot.runs.report.svg import FAINT, INK, make_wide_figure, to_svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLORS = {"localization": LOCATED, "lag": "#7b2d8b", "saturation": "#f2a541", "aim": "#5fa8d3", "mismatch": "#4c956c"}


def build_budget_section(flight: RecordedFlight) -> Section:
    """Build the section: the error budget of a path, or of the poses of an observation.

    Parameters
    ----------
    flight : RecordedFlight

    Returns
    -------
    Section
    """
    section = Section("budget", "Error budget")
    if not flight.knows_truth:
        return section.add_missing_note(NO_TRUTH)
    mission = flight.steered
    if mission is None:
        return _add_pose_budget(section, flight)
    budget = compute_budget(mission, find_steps(flight))
    if budget is None:
        return section.add_missing_note("The path was not reached, so there is no tracking error to split.")
    section.add_figure(
        to_svg(draw_budget(budget), "budget", "Parts of the tracking error, in total and along the path"),
        "Left: root mean square of the tracking error and of each part. Right: error and parts along the path, signed, "
        "positive to the left of the way; where a coloured line follows the black one, that part causes the error.",
    )
    header = ("part", "rms, mm", "mean, mm", "share of mean square", "what it is")
    section.add(ELEMENTS.table(format_rows(budget), header, wide=True))
    for line in describe_budget(budget, flight.summary, helical=flight.is_helical):
        section.add_paragraph(line)
    return section.add(ELEMENTS.formula_of_steps())


def format_rows(budget: ErrorBudget) -> list[tuple[str, str, str, str, str]]:
    """Format a table row for each part and one for the total.

    Parameters
    ----------
    budget : ErrorBudget

    Returns
    -------
    list of tuple of str
    """
    rms, shares = budget.rms, budget.shares
    rows = [
        (name, f"{1e3 * rms[name]:.4f}", _format_signed(values), _format_percent(shares[name]), PARTS[name])
        for name, values in budget.parts.items()
    ]
    total = f"tracking error of {len(budget.error)} steps"
    share = _format_percent(sum(shares.values()))
    return [*rows, ("total", f"{1e3 * budget.total_rms:.4f}", _format_signed(budget.error), share, total)]


def _format_signed(values: FloatArray) -> str:
    return f"{1e3 * float(np.mean(values)):+.4f}"


def _format_percent(share: float) -> str:
    return f"{100.0 * share:.1f} %".replace("-0.0 %", "0.0 %")


def describe_budget(budget: ErrorBudget, summary: dict[str, Any], *, helical: bool = False) -> list[str]:
    """Describe how well the parts explain the total, and how the total compares with the summary.

    Parameters
    ----------
    budget : ErrorBudget
    summary : dict
    helical : bool

    Returns
    -------
    list of str
        Sentences.
    """
    square, alone = budget.total_rms**2, sum(value**2 for value in budget.rms.values())
    left = float(np.max(np.abs(sum(budget.parts.values()) - budget.error)))
    exact = "to rounding, so that nothing is left" if left < 1e-12 else f"to within {1e9 * left:.2g} nm"
    lines = [
        f"In every step the parts add up to the error {exact}. Their "
        f"mean squares alone make {100 * alone / square:.0f} % of the total's; the other "
        f"{100 * (1 - alone / square):+.0f} % is due to correlation between parts "
        f"({'they add' if alone < square else 'they compensate each other'}). A share includes that: it is the "
        "mean product of part and error over the mean square of the error, and may be negative."
    ]
    tracking = summary.get("tracking_error_mm")
    if tracking is not None:
        where = "at the first pose of each pause" if helical else "at poses"
        lines.append(
            f"The budget is computed {where}: {1e3 * budget.total_rms:.3f} mm rms. The tracking error of this run, "
            f"also computed at shot ends{' and between pauses' if helical else ''}, is {tracking['rms']:.3f} mm rms."
        )
    return lines


def draw_budget(budget: ErrorBudget) -> Figure:
    """Draw the rms of each part as bars, and the parts along the path.

    Parameters
    ----------
    budget : ErrorBudget

    Returns
    -------
    Figure
    """
    figure = make_wide_figure(3.5)
    bars, course = figure.subplots(1, 2, width_ratios=[1.0, 1.6])
    names = ["total", *budget.parts]
    values = [1e3 * budget.total_rms, *(1e3 * value for value in budget.rms.values())]
    colors = [INK, *(COLORS[name] for name in budget.parts)]
    bars.barh(range(len(names)), values, color=colors, height=0.62)
    for row, (name, value) in enumerate(zip(names, values, strict=True)):
        share = "" if name == "total" else f", {100 * budget.shares[name]:.0f} %".replace("-0 %", "0 %")
        bars.text(value, row, f"\u2002{value:.3f} mm{share}", va="center", fontsize=9)
    bars.set_yticks(range(len(names)), names)
    bars.invert_yaxis()
    bars.set_xlim(0.0, 1.55 * max(values))
    bars.set_title("Rms in mm, and share of the mean square")
    _draw_parts(course, budget)
    return figure


def _draw_parts(axes: Axes, budget: ErrorBudget) -> None:
    """Draw error and parts along the path; negligible parts are left out."""
    order = np.argsort(budget.arc, kind="stable")
    arc = 1e3 * budget.arc[order]
    axes.axhline(0.0, color=FAINT, lw=0.8)
    for name, values in budget.parts.items():
        if budget.rms[name] < 0.1 * max(budget.rms.values()):
            continue
        shown = 1e3 * values[order]
        if name in ("saturation", "aim"):  # one or the other in each step
            here = shown != 0.0
            draw_dots(axes, arc[here], shown[here], 2.4, COLORS[name], alpha=0.8, label=name)
        else:
            axes.plot(arc, shown, color=COLORS[name], lw=1.0, alpha=0.85, label=name)
    axes.plot(arc, 1e3 * budget.error[order], color=INK, lw=1.5, label="tracking error")
    axes.set_title("Along the path, in mm, positive to the left", pad=16)
    axes.set_xlabel("along the path, in mm")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 0.985), ncol=5, fontsize=8.5, borderaxespad=0.0)
    axes.grid(axis="y")


def _add_pose_budget(section: Section, flight: RecordedFlight) -> Section:
    """Split the localization error of a device that is not steered: bias, predicted variance and rest."""
    found = compute_pose_budget(flight.compared_poses)
    if found is None:
        return section.add_missing_note("No pose could be trusted, so there is no error to split.")
    section.add(
        ELEMENTS.table(_format_pose_rows(found), ("part", "rms, mm", "share of mean square", "what it is"), wide=True)
    )
    return section.add(ELEMENTS.formula_of_poses())


def compute_pose_budget(pairs: list[tuple[Any, Any]]) -> dict[str, float] | None:
    """Split the mean squared position error into bias, predicted variance and rest.

    Parameters
    ----------
    pairs : list of tuple of Pose
        Each pose with its ground truth.

    Returns
    -------
    dict of str to float, in m², or None
        Mean squares: ``total``, ``bias``, ``predicted`` (by the covariances), ``rest``; None without pairs.
    """
    if not pairs:
        return None
    errors = np.array([pose.position - truth.position for pose, truth in pairs])
    total = float(np.mean(np.sum(errors**2, axis=1)))
    bias = float(np.sum(errors.mean(axis=0) ** 2))
    predicted = float(np.mean([np.trace(pose.covariance[:3, :3]) for pose, _ in pairs]))
    return {"total": total, "bias": bias, "predicted": predicted, "rest": total - bias - predicted}


def _format_pose_rows(found: dict[str, float]) -> list[tuple[str, str, str, str]]:
    meanings = {
        "bias": "the same in every pose: misplaced sensors, a model error that is the same everywhere",
        "predicted": "noise, as the covariance of each pose predicts it",
        "rest": "the remainder: misplaced sensors whose effect depends on the position, motion within a window, mains",
        "total": "localization error of each trusted pose, in space",
    }
    rows = []
    for name in ("bias", "predicted", "rest", "total"):
        square = found[name]
        rms = np.sign(square) * np.sqrt(abs(square))
        rows.append((name, f"{1e3 * rms:.3f}", f"{100 * square / found['total']:.0f} %", meanings[name]))
    return rows
