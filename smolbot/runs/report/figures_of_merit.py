"""The figures of merit of a run as tables, every number as the summary has it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from smolbot.config.load import AnyMission
from smolbot.config.observation import Observation
from smolbot.runs.report.html import text

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
    "compute_ms": "computing per cycle",
    "turnaround_ms": "time that the rig sets aside for it",
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
    "progress_mm": "of it passed",
    "cycles": "cycles",
    "flips": "poses turned the wrong way round",
    "poses_untrusted": "windows without a pose to trust",
    "wall_s": "wall time",
    "realtime_factor": "times faster than real time",
}
"""Figures of a summary that a report shows, in order, and what they are."""

_UNITS = {"mm": "mm", "deg": "°", "s": "s", "hz": "Hz", "ms": "ms", "j": "J"}


def verdict_table(mission: AnyMission, summary: dict[str, Any]) -> str:
    """What the mission file asks of a run, what it got, and whether that is enough."""
    rows = [_criterion("ended as it should", summary, "status", "completed", summary["status"] == "completed")]
    for key, name, limit, most in _wanted(mission):
        value = _at(summary, key)
        if value is None:
            rows.append(_line(name, "<td>not known: no witness</td>", _told(limit, most, key), "-"))
        else:
            met = value <= limit if most else value >= limit
            rows.append(_criterion(name, summary, key, _told(limit, most, key), met))
    head = "<thead><tr><th>criterion</th><th>this run</th><th>asked for</th><th></th></tr></thead>"
    return f'<table id="verdict-table">{head}<tbody>{"".join(rows)}</tbody></table>'


def figures_table(summary: dict[str, Any]) -> str:
    """Every figure of merit that this run has."""
    rows = []
    for key, name in NAMES.items():
        value = summary.get(key)
        if value is None:
            continue
        rows.append(f"<tr><th>{text(name)}</th><td>{_cells(key, value)}</td></tr>")
    return f'<div class="scroll"><table id="figures-table"><tbody>{"".join(rows)}</tbody></table></div>'


def number(value: float) -> str:
    """A number as people read it: three digits that matter."""
    if isinstance(value, bool | str):
        return str(value)
    if isinstance(value, int) or abs(value) >= 1000 or (abs(value) >= 100 and value == round(value)):
        return f"{value:.0f}"
    return f"{value:.3g}" if abs(value) < 100 else f"{value:.1f}"


def unit_of(key: str) -> str:
    """The unit that a figure's name carries."""
    return _UNITS.get(key.split(".")[0].rsplit("_", 1)[-1], "")


def _cells(key: str, value: Any) -> str:
    if isinstance(value, dict):
        return " &nbsp; ".join(f"{text(name)} {_number(f'{key}.{name}', inner)}" for name, inner in value.items())
    if isinstance(value, list):
        return ", ".join(_number(f"{key}.{i}", inner) for i, inner in enumerate(value))
    return _number(key, value)


def _number(key: str, value: Any) -> str:
    unit = unit_of(key)
    if value is None:
        said = "-"
    else:
        shown = f"{value:.4f}" if key.startswith("r_squared") else number(value)
        said = f"{shown}{'' if unit in ('', '°') else ' '}{unit}"
    return f'<data data-key="{text(key)}" value="{text(value)}">{text(said)}</data>'


def _criterion(name: str, summary: dict[str, Any], key: str, wanted: str, met: bool) -> str:
    mark = f'<span class="badge {"passed" if met else "failed"}">{"yes" if met else "no"}</span>'
    return _line(name, f"<td>{_number(key, _at(summary, key))}</td>", wanted, mark)


def _line(name: str, got: str, wanted: str, mark: str) -> str:
    return f"<tr><th>{text(name)}</th>{got}<td>{text(wanted)}</td><td>{mark}</td></tr>"


def _wanted(mission: AnyMission) -> Iterator[tuple[str, str, float, bool]]:
    """Key of the summary, name, limit, and whether it is the most that is allowed."""
    asked: list[tuple[str, str, float | None, bool]]
    if isinstance(mission, Observation):
        looked = mission.sections.verdict
        asked = [
            ("localization_error_mm.mean", "mean localization error", looked.mean_localization_mm, True),
            ("pose_rate_hz", "trusted poses a second", looked.min_rate_hz, False),
            ("sigma_mm.distance", "scatter in space", looked.max_sigma_mm, True),
        ]
    else:
        wanted = mission.sections.verdict
        asked = [
            ("tracking_error_mm.mean", "mean tracking error", wanted.mean_tracking_mm, True),
            ("localization_error_mm.mean", "mean localization error", wanted.mean_localization_mm, True),
        ]
    for key, name, limit, most in asked:
        if limit is not None:
            yield key, name, limit, most


def _told(limit: float, most: bool, key: str) -> str:
    return f"at {'most' if most else 'least'} {limit:g} {unit_of(key)}"


def _at(summary: dict[str, Any], key: str) -> Any:
    found: Any = summary
    for part in key.split("."):
        found = found.get(part) if isinstance(found, dict) else None
    return found
