"""Output of a study of margins: numbers for ``--json``, the table, the gains file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sim.analysis.loop import UNSTABLE, Margins
from sim.analysis.lqr import Weights
from sim.studies.study import Columns, Outcome
from smolbot.config.mission import Mission


def _summarize(table: Columns, name: str) -> dict[str, Any]:
    """Worst (least), what nineteen of twenty places have at least, median, and place of the worst."""
    values = np.asarray(table[name])
    worst = int(np.argmin(values))
    return {
        "worst": float(values[worst]),
        "p5": float(np.sort(values)[int(0.05 * len(values))]),
        "median": float(np.median(values)),
        "where_mm": float(table["arc_mm"][worst]),
        "at_mm": [float(table["x_mm"][worst]), float(table["y_mm"][worst])],
    }


def find_worst_place(table: Columns) -> int:
    """Find the cycle with the smallest disc margin; if some are unstable, the one with the largest pole.

    Parameters
    ----------
    table : Columns

    Returns
    -------
    int
    """
    disc = np.asarray(table["disc_margin"])
    return int(np.argmin(disc)) if disc.min() > 0.0 else int(np.argmax(table["largest_pole"]))


def find_median_place(table: Columns) -> int:
    """Find the cycle with the median disc margin.

    Parameters
    ----------
    table : Columns

    Returns
    -------
    int
    """
    order = np.argsort(table["disc_margin"])
    return int(order[len(order) // 2])


def collect_figures(
    mission: Mission, weights: Weights, table: Columns, found: Sequence[Margins], gains: Columns
) -> dict[str, Any]:
    """Collect all results as numbers for ``--json``.

    Parameters
    ----------
    mission : Mission
    weights : Weights
    table : Columns
    found : sequence of Margins
    gains : Columns

    Returns
    -------
    dict
    """
    worst = find_worst_place(table)
    steady = np.array([m.stable for m in found])
    settle = np.asarray(table["settle_s"])
    values = dict(zip(gains["_names"].tolist(), gains["_values"].tolist(), strict=True))
    return {
        "mission": mission.name,
        "law": mission.law,
        "places": len(found),
        "path_length_mm": 1e3 * mission.path.length,
        "cycle_ms": float(np.median(table["cycle_ms"])),
        **{name: _summarize(table, name) for name in (
            "gain_margin_db", "gain_reduction_margin_db", "phase_margin_deg", "delay_margin_ms", "delay_margin_cycles",
            "disc_margin",
        )},
        "late_cycles": {"worst": int(np.min(table["late_cycles"])), "median": float(np.median(table["late_cycles"]))},
        "bandwidth_hz": float(np.median(table["bandwidth_hz"])),
        "settle_s": float(np.median(settle)),
        "settle_s_worst": float(np.max(settle)),
        "largest_pole": {
            "worst": float(np.max(table["largest_pole"])), "median": float(np.median(table["largest_pole"])),
        },
        "unstable_places": int(np.sum(~steady)),
        "worst_place": {"arc_mm": float(table["arc_mm"][worst]), "x_mm": float(table["x_mm"][worst]),
                        "y_mm": float(table["y_mm"][worst])},
        "explained": [float(np.median(table["explained_across"])), float(np.median(table["explained_turn"]))],
        "gains": values,
        "gains_now": dict(zip(gains["_names"].tolist(), gains["_start"].tolist(), strict=True)),
        "regulator": {
            "weights": {"across_mm": 1e3 * weights.across, "heading_deg": math.degrees(weights.heading),
                        "current_share": weights.current},
            "distance_now": float(gains["_distance"][0]),
            "distance": float(gains["_distance"][1]),
            "share": float(gains["_share"][0]),
            "flights": int(gains["_flights"][0]),
        },
        "reduced_flights": {
            key: [{"seed": int(r[0]), "tracking_rms_mm": float(r[1]), "duration_s": float(r[2]), "passed": bool(r[3])}
                  for r in np.asarray(gains[f"_flown_{key}"]).reshape(-1, 4)]
            for key in ("before", "after")
        },
    }  # fmt: skip


def format_rows(figures: Mapping[str, Any], table: Columns) -> list[tuple[str, str]]:
    """Format the results as a table.

    Parameters
    ----------
    figures : mapping
    table : Columns

    Returns
    -------
    list of (str, str)
    """
    n, unstable = figures["places"], figures["unstable_places"]
    late, poles = figures["late_cycles"], figures["largest_pole"]
    period = figures["cycle_ms"]
    rows = [
        ("law", f"{figures['law']}, {n} cycles of {period:.0f} ms along {figures['path_length_mm']:.0f} mm"),
        ("gain margin", _format_least(figures["gain_margin_db"], "dB")),
        ("phase margin", _format_least(figures["phase_margin_deg"], "°", 0)),
        ("delay margin", _format_least(figures["delay_margin_ms"], "ms", 0)),
        ("", f"poses may be {max(late['worst'], 0)} cycles late everywhere, {late['median']:.0f} at the median place"),
        ("disc margin", _format_least(figures["disc_margin"], "", 2)),
        ("bandwidth, settling", f"{figures['bandwidth_hz']:.2f} Hz, {figures['settle_s']:.2f} s to 5 % (medians)"),
        ("largest pole", f"{poles['median']:.3f}; worst {poles['worst']:.3f}"),
    ]
    if unstable:
        at = np.asarray(table["arc_mm"])[np.asarray(table["largest_pole"]) > UNSTABLE]
        rows.append(("unstable", f"at {unstable} of {n} places, {at.min():.1f} to {at.max():.1f} mm"))
    across, turn = figures["explained"]
    rows.append(("linear", f"{across:.0%} of the cross-track motion and {turn:.0%} of the turn are linear (medians)"))
    regulator = figures["regulator"]
    now, then = regulator["distance_now"], regulator["distance"]
    rows.append(("regulator", f"relative distance of the law's feedback {now:.2f}, with the nearest gains {then:.2f}"))
    if regulator["share"] < 1.0:
        rows.append(("", f"the gains below are {regulator['share']:.0%} of the way: farther, fewer flights pass"))
    if not figures["gains"]:
        rows.append(("", "no gains of this law are nearer at this pace"))
    rows += [(name, f"{figures['gains_now'][name]:.4g} → {value:.4g}") for name, value in figures["gains"].items()]
    for key, name in (("before", "reduced plant, now"), ("after", "reduced plant, with them")):
        flown = figures["reduced_flights"][key]
        if flown:
            rms = [f["tracking_rms_mm"] for f in flown]
            time = [f["duration_s"] for f in flown]
            passed = sum(f["passed"] for f in flown)
            rows.append((name, f"{passed} of {len(flown)} passed, rms {np.mean(rms):.3f} mm, {np.mean(time):.1f} s"))
    return rows


def _format_least(summary: Mapping[str, Any], unit: str, digits: int = 1) -> str:
    gap = "" if unit in ("", "°") else " "
    x, y = summary["at_mm"]

    def shown(value: float) -> str:
        return f"{value:.{digits}f}{gap}{unit}" if math.isfinite(value) else "unlimited"

    return (
        f"median {shown(summary['median'])}; at least {shown(summary['p5'])} at 95 % of places; minimum "
        f"{shown(summary['worst'])}, {summary['where_mm']:.1f} mm along, at ({x:.1f}, {y:.1f}) mm"
    )


def format_files(outcome: Outcome) -> dict[str, str]:
    """Format the gains file, which a mission or ``--set @gains.toml`` takes.

    Parameters
    ----------
    outcome : Outcome

    Returns
    -------
    dict of str to str
        Text by file name.
    """
    from sim.tuning.report import format_gains

    figures = outcome.figures
    if not figures["gains"]:
        return {}
    weights = figures["regulator"]["weights"]
    return {
        "gains.toml": format_gains(
            [
                f"Gains of {figures['law']} for {figures['mission']} whose feedback comes closest to a linear",
                f"quadratic regulator: {weights['across_mm']:g} mm, {weights['heading_deg']:.0f} degrees and "
                f"{weights['current_share']:g} of the full current have equal cost.",
                "A starting point for smolbot tune, not a result of one.",
            ],
            figures["gains"],
        )
    }
