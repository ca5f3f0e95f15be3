"""Precision against damping, from none to very strong, in speed and precision mode (Fig. 2G)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sim.studies.benches import REFERENCE_POSITION, make_characterised_device, make_localizers, open_bench
from sim.studies.columns import join_columns, make_columns, select_rows
from sim.studies.scatter import compute_mean_bound, compute_scatter, locate_repeatedly
from sim.studies.study import Chunk, Columns, Options, Outcome, Study, cut_chunks, make_rng
from smolbot.localization.statistics import compute_r_squared

DAMPINGS = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 31.7, 40.0)
HALF_PERIODS = (2, 20)
GLYCEROL = 31.7
"""Damping of the paper's device in glycerol, in 1/s."""

DEFAULT_POSES, BENCHES = 300, 2
"""Poses of each damping, and benches among which they are divided."""


def run_chunk(chunk: Chunk) -> Columns:
    """Locate with one damping, in both modes.

    Parameters
    ----------
    chunk : Chunk

    Returns
    -------
    Columns
    """
    bench = open_bench(chunk, make_characterised_device(chunk["damping"], "exponential"), chunk["mismatch"])
    found, rng = make_localizers(bench, chunk["estimators"]), make_rng(chunk)
    rows: list[dict[str, Any]] = []
    for n in HALF_PERIODS:
        labels = {"damping_per_s": chunk["damping"], "bound_mm": compute_mean_bound(bench, REFERENCE_POSITION[2], n)}
        rows += locate_repeatedly(bench, found, REFERENCE_POSITION[2], n, chunk["poses"], rng, labels)
    return make_columns(rows)


def make_chunks(options: Options) -> list[Chunk]:
    """Make two benches for each damping.

    Parameters
    ----------
    options : Options

    Returns
    -------
    list of Chunk
    """
    total, scale = options.poses or DEFAULT_POSES, options.mismatch or 0.0
    pieces = [
        (f"eta-{eta:g}-{i}", {"damping": eta, "mismatch": scale, "poses": max(total // BENCHES, 2)})
        for eta in DAMPINGS
        for i in range(BENCHES)
    ]
    return cut_chunks(options, run_chunk, pieces)


def conclude(options: Options, parts: list[Columns]) -> Outcome:
    """Compute the scatter of each damping, and fit straight lines.

    Parameters
    ----------
    options : Options
    parts : list of Columns
        One per chunk, in order.

    Returns
    -------
    Outcome
    """
    columns = join_columns(parts)
    figures: dict[str, Any] = {"mismatch": options.mismatch or 0.0, "cases": [], "trends": []}
    rows: list[tuple[str, str]] = []
    for name in options.estimators:
        for n in HALF_PERIODS:
            sigmas = []
            for eta in DAMPINGS:
                part = select_rows(columns, estimator=name, half_periods=n, damping_per_s=eta)
                case = compute_scatter(part) | {"bound_mm": float(np.sqrt(np.mean(part["bound_mm"] ** 2)))}
                figures["cases"].append({"estimator": name, "half_periods": n, "damping_per_s": eta, **case})
                sigmas.append(case["sigma_xyz_without_flips_mm"])
            slope, start = np.polyfit(DAMPINGS, sigmas, 1)
            r2 = compute_r_squared(sigmas, start + slope * np.array(DAMPINGS))
            trend = {"slope_um_s": 1e3 * float(slope), "intercept_um": 1e3 * float(start), "r_squared": r2}
            figures["trends"].append({"estimator": name, "half_periods": n, **trend})
            each = ", ".join(f"{1e3 * s:.0f}" for s in sigmas)
            untrusted = sum(c["untrusted"] for c in figures["cases"][-len(DAMPINGS) :])
            flipped = sum(c["flipped"] for c in figures["cases"][-len(DAMPINGS) :])
            left_out = (f"; {untrusted} untrusted" if untrusted else "") + (
                f"; without {flipped} flips" if flipped else ""
            )
            rows.append(
                (
                    f"{name}, N = {n}",
                    f"{1e3 * slope:.1f} µm s × damping + {1e3 * start:.0f} µm, R² {r2:.2f}; sigma {each} µm{left_out}",
                )
            )
    rows.append(("damping, 1/s", ", ".join(f"{eta:g}" for eta in DAMPINGS)))
    return Outcome(rows, figures, columns)


def draw(outcome: Outcome, path: Path) -> None:
    """Draw scatter against damping, with trend lines.

    Parameters
    ----------
    outcome : Outcome
    path : Path
        PNG to write.
    """
    from sim.batch.slide import BOUND, COLORS, draw_limit_line, open_slide, set_titles

    cases, trends = outcome.figures["cases"], outcome.figures["trends"]
    names = list(dict.fromkeys(c["estimator"] for c in cases))
    strong = [c for c in cases if c["estimator"] == names[0] and c["damping_per_s"] == GLYCEROL]
    at = {c["half_periods"]: 1e3 * c["sigma_xyz_without_flips_mm"] for c in strong}
    headline = f"In glycerol: {at[2]:.0f} µm at N = 2, {at[20]:.0f} µm at N = 20"
    flips = ", ".join(f"{name} {sum(c['flipped'] for c in cases if c['estimator'] == name)}" for name in names)
    subline = (
        f"{names[0]}; at (0, 0, 80 mm), exponential damping, 20 ms ring-down, {cases[0]['n']} poses each, "
        f"mismatch x {outcome.figures['mismatch']:g}; flips, left out here: {flips}"
    )
    with open_slide(path, headline, subline, 1, 2) as axes:
        for panel, n in zip(axes, HALF_PERIODS, strict=True):
            top = 0.0
            for name in names:
                line = [c for c in cases if c["estimator"] == name and c["half_periods"] == n]
                trend = next(t for t in trends if t["estimator"] == name and t["half_periods"] == n)
                x = np.array([c["damping_per_s"] for c in line])
                if name == names[0]:
                    panel.plot(x, [1e3 * c["bound_mm"] for c in line], color=BOUND, lw=9, solid_capstyle="round",
                               label="bound", zorder=1)  # fmt: skip
                sigmas = [1e3 * c["sigma_xyz_without_flips_mm"] for c in line]
                panel.plot(x, sigmas, "o", color=COLORS[name], ms=7, zorder=3,
                           label=f"{name}: {trend['slope_um_s']:.1f} µm s, R² {trend['r_squared']:.2f}")  # fmt: skip
                panel.plot(x, trend["intercept_um"] + trend["slope_um_s"] * x, "--", color=COLORS[name], lw=1.4)
                top = max(top, 1.5 * float(np.max(sigmas)))
            panel.set_ylim(0, top)
            draw_limit_line(panel, GLYCEROL, "glycerol", vertical=True)
            set_titles(panel, f"N = {n}: standard deviation, mean of x, y and z, in µm", "damping coefficient in 1/s")
            panel.legend(frameon=False, loc="upper left")


STUDY = Study(
    name="damping",
    title="Precision against damping",
    devices=lambda: {"characterised": make_characterised_device(0.0, "exponential")},
    chunks=make_chunks,
    conclude=conclude,
    draw=draw,
    notes={"dampings_per_s": DAMPINGS, "half_periods": HALF_PERIODS, "position_mm": [0, 0, 80]},
)
