"""The figures of merit of a run as tables, with the exact numbers of the summary."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from smolbot.config.load import AnyMission
from smolbot.config.observation import Observation
from smolbot.runs.report.page_elements import ELEMENTS

if TYPE_CHECKING:
    from markupsafe import Markup

NAMES = {
    "tracking_error_mm": "tracking error: true robot to path",
    "localization_error_mm": "localization error of each trusted pose, in space",
    "localization_bias_mm": "its mean along x, y, z",
    "localization_scatter_mm": "its standard deviation along x, y, z",
    "tracked_error_mm": "the same of the tracked pose",
    "orientation_error_deg": "orientation error",
    "axis_error_deg": "propulsion axis of each pose against the true one",
    "axis_error_tracked_deg": "propulsion axis as tracked, at the end of each pause",
    "axis_to_path_deg": "true propulsion axis against the path, at the end of each pause",
    "sigma_mm": "scatter of independent measurements",
    "sigma_deg": "scatter of their orientation",
    "mean_mm": "mean of the measurements",
    "r_squared_median": "R² (median)",
    "loop_rate_hz": "loop rate",
    "timeline_limit_hz": "loop rate that the timeline allows",
    "compute_ms": "compute time per cycle",
    "turnaround_ms": "budget for it",
    "pose_rate_hz": "trusted poses",
    "gaps": "gaps between trusted poses",
    "measurements": "independent measurements",
    "shots_per_measurement": "shots for each",
    "turns": "turns of the magnet",
    "pauses": "pauses to listen",
    "step_outs": "step-outs",
    "coil_energy_j": "heat in the actuation coils",
    "duration_s": "duration",
    "path_time_s": "of it on the path",
    "path_length_mm": "length of the path",
    "progress_mm": "of it passed, as the controller counts",
    "visited_share": "share of it visited in order",
    "cycles": "cycles",
    "flips": "180° orientation flips",
    "poses_untrusted": "measurements rejected",
    "wall_s": "wall time",
    "realtime_factor": "times faster than real time",
}
"""Figures of a summary that a report shows, in order, and what they are."""

_UNITS = {"mm": "mm", "deg": "°", "s": "s", "hz": "Hz", "ms": "ms", "j": "J"}


def build_verdict_table(mission: AnyMission, summary: dict[str, Any]) -> Markup:
    """Build the table of criteria: requested limit, value of the run, and whether it is met.

    Parameters
    ----------
    mission : Mission or Observation
    summary : dict

    Returns
    -------
    str
        HTML.
    """
    ended = summary["status"]
    rows: list[tuple[str, object, str, bool | None]] = [
        ("status at the end", _format_data("status", ended), "completed", ended == "completed")
    ]
    for key, name, limit, is_maximum in _list_criteria(mission):
        value = _get_value(summary, key)
        required = f"at {'most' if is_maximum else 'least'} {limit:g} {get_unit(key)}"
        if value is None:
            rows.append((name, "not known: no ground truth", required, None))
        else:
            rows.append((name, _format_data(key, value), required, value <= limit if is_maximum else value >= limit))
    return ELEMENTS.verdict(rows)


def build_figures_table(summary: dict[str, Any]) -> Markup:
    """Build the table of all figures of merit of a run.

    Parameters
    ----------
    summary : dict

    Returns
    -------
    str
        HTML.
    """
    return ELEMENTS.table(
        [(name, _format_cells(key, summary[key])) for key, name in NAMES.items() if summary.get(key) is not None]
    )


def format_number(value: float) -> str:
    """Format a number with three significant digits.

    Parameters
    ----------
    value : float

    Returns
    -------
    str
    """
    if isinstance(value, bool | str):
        return str(value)
    if isinstance(value, int) or abs(value) >= 1000 or (abs(value) >= 100 and value == round(value)):
        return f"{value:.0f}"
    return f"{value:.3g}" if abs(value) < 100 else f"{value:.1f}"


def get_unit(key: str) -> str:
    """Return the unit in the key of a figure.

    Parameters
    ----------
    key : str

    Returns
    -------
    str
        Empty without a unit.
    """
    return _UNITS.get(key.split(".")[0].rsplit("_", 1)[-1], "")


def append_unit(shown: str, unit: str) -> str:
    """Append the unit to a number.

    Parameters
    ----------
    shown : str
        The number.
    unit : str
        Empty if it has none.

    Returns
    -------
    str

    Examples
    --------
    >>> append_unit("0.48", "mm"), append_unit("1.1", "°"), append_unit("12", "")
    ('0.48 mm', '1.1°', '12')
    """
    return f"{shown}{'' if unit in ('', '°') else ' '}{unit}"


def _format_cells(key: str, value: Any) -> Markup:
    """Format each number of a figure that has several, with its name."""
    if isinstance(value, dict):
        return ELEMENTS.named_figures([(name, _format_data(f"{key}.{name}", inner)) for name, inner in value.items()])
    if isinstance(value, list):
        return ELEMENTS.listed_figures([_format_data(f"{key}.{i}", inner) for i, inner in enumerate(value)])
    return _format_data(key, value)


def _format_data(key: str, value: Any) -> Markup:
    if value is None:
        text = "-"
    else:
        shown = f"{value:.4f}" if key.startswith("r_squared") else format_number(value)
        text = append_unit(shown, get_unit(key))
    return ELEMENTS.figure_of_merit(key, value, text)


def _list_criteria(mission: AnyMission) -> Iterator[tuple[str, str, float, bool]]:
    """Key of the summary, name, limit, and whether the limit is a maximum."""
    asked: list[tuple[str, str, float | None, bool]]
    if isinstance(mission, Observation):
        looked = mission.sections.verdict
        asked = [
            ("localization_error_mm.mean", "mean localization error", looked.mean_localization_mm, True),
            ("pose_rate_hz", "trusted poses a second", looked.min_rate_hz, False),
            ("sigma_mm.distance", "scatter in space", looked.max_sigma_mm, True),
        ]
    else:
        limits = mission.sections.verdict
        asked = [
            ("tracking_error_mm.mean", "mean tracking error", limits.mean_tracking_mm, True),
            ("localization_error_mm.mean", "mean localization error", limits.mean_localization_mm, True),
            ("visited_share", "share of the path visited in order", limits.min_visited_share, False),
        ]
    for key, name, limit, is_maximum in asked:
        if limit is not None:
            yield key, name, limit, is_maximum


def _get_value(summary: dict[str, Any], key: str) -> Any:
    found: Any = summary
    for part in key.split("."):
        found = found.get(part) if isinstance(found, dict) else None
    return found
