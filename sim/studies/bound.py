"""Pose errors against the Cramer-Rao bound and the paper's method, and whether covariances are true."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from sim.studies.benches import (
    FLIP_DEG,
    REFERENCE_POSITION,
    locate_all,
    make_characterised_device,
    make_localizers,
    make_reference_orientation,
    open_bench,
    sample_prior,
)
from sim.studies.columns import (
    compute_rms,
    join_columns,
    make_columns,
    select_rows,
    stack_position_errors,
    stack_rotation_errors,
)
from sim.studies.cramer_rao import compute_bound, compute_position_bound
from sim.studies.study import Chunk, Columns, Options, Outcome, Study, cut_chunks, make_rng, split_evenly

HALF_PERIODS = (1, 2, 6, 20)
POSES_PER_CHUNK, MISMATCH_CHUNKS = 500, 10
"""Poses of one bench without mismatch, and by how much fewer with it: each bench has its own."""

DEFAULT_POSES = 1000
PHASES = {1: 24, 2: 12}
"""Phases of the oscillation, from 0 to pi, at which the bound is computed; it is interpolated for a pose. For long
windows, where the phase hardly matters, 4 are enough."""


def run_chunk(chunk: Chunk) -> Columns:
    """Locate at the reference pose on one bench: errors, and the bound at each recording's phase.

    Parameters
    ----------
    chunk : Chunk

    Returns
    -------
    Columns
    """
    bench = open_bench(chunk, make_characterised_device(), chunk["mismatch"])
    found = make_localizers(bench, chunk["estimators"])
    position, orientation = np.array(REFERENCE_POSITION), make_reference_orientation()
    rng = make_rng(chunk)
    rows: list[dict[str, Any]] = []
    for half_periods in HALF_PERIODS:
        count = PHASES.get(half_periods, 4)
        grid = np.pi * np.arange(count + 1) / count
        bounds = [
            compute_position_bound(compute_bound(bench, position, orientation, half_periods, p)) for p in grid[:-1]
        ]
        for _ in range(chunk["poses"]):
            recording = bench.record(position, orientation, half_periods)
            prior = sample_prior(position, orientation, rng)
            swing = bench.last_oscillation
            least = float(np.interp((swing.phase if swing else 0.0) % np.pi, grid, [*bounds, bounds[0]]))
            kind = {"mismatch": chunk["mismatch"], "half_periods": half_periods, "bound_mm": 1e3 * least}
            rows += [{**kind, **row} for row in locate_all(found, recording, position, orientation, prior)]
    return make_columns(rows)


def make_chunks(options: Options) -> list[Chunk]:
    """Make chunks without and, unless one scale is given, with mismatches: then many newly sampled benches.

    Parameters
    ----------
    options : Options

    Returns
    -------
    list of Chunk
    """
    total = options.poses or DEFAULT_POSES
    scales = (0.0, 1.0) if options.mismatch is None else (options.mismatch,)
    pieces = []
    for scale in scales:
        sizes = split_evenly(total, POSES_PER_CHUNK if scale == 0.0 else max(POSES_PER_CHUNK // MISMATCH_CHUNKS, 1))
        pieces += [(f"x{scale:g}-{i:03d}", {"mismatch": scale, "poses": size}) for i, size in enumerate(sizes)]
    return cut_chunks(options, run_chunk, pieces)


def conclude(options: Options, parts: list[Columns]) -> Outcome:
    """Compute ratios over all poses; untrusted ones are counted, and included.

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
    figures: dict[str, Any] = {"poses": 0, "cases": []}
    rows: list[tuple[str, str]] = []
    for scale in np.unique(columns["mismatch"]):
        rows.append(
            (f"mismatch x {scale:g}", "ideal" if scale == 0.0 else "sensors, device and noise sampled for each bench")
        )
        for name in options.estimators:
            for half_periods in HALF_PERIODS:
                case = summarize_case(select_rows(columns, mismatch=scale, estimator=name, half_periods=half_periods))
                figures["cases"].append({"mismatch": scale, "estimator": name, "half_periods": half_periods, **case})
                rows.append((f"  {name}, N = {half_periods}", _format_case(case)))
        by_name = {n: select_rows(columns, mismatch=scale, estimator=n, half_periods=2) for n in options.estimators}
        if len(by_name) == 2:
            ratio = compute_rms(stack_position_errors(by_name["whitened"])) / compute_rms(
                stack_position_errors(by_name["paper"])
            )
            figures[f"whitened_over_paper_x{scale:g}"] = ratio
            both = [c for c in figures["cases"] if c["mismatch"] == scale and c["half_periods"] == 2]
            plain = both[0]["over_bound_without_flips"] / both[1]["over_bound_without_flips"]
            figures[f"whitened_over_paper_without_flips_x{scale:g}"] = plain
            text = f"{ratio:.3f} (1 / {1 / ratio:.2f}); without flips {plain:.3f} (1 / {1 / plain:.2f})"
            rows.append(("  whitened / paper, N = 2", text))
    figures["poses"] = len(columns["nees"])
    return Outcome(rows, figures, columns)


def summarize_case(columns: Columns) -> dict[str, Any]:
    """Compute the figures of one case.

    Parameters
    ----------
    columns : Columns

    Returns
    -------
    dict
    """
    errors, nees = stack_position_errors(columns), columns["nees"]
    least = compute_rms(columns["bound_mm"])
    right = np.max(np.abs(stack_rotation_errors(columns)), axis=1) <= FLIP_DEG
    return {
        "n": len(nees),
        "untrusted": int(np.sum(columns["trusted"] == 0.0)),
        "flipped": int(np.sum(~right)),
        "rms_mm": compute_rms(errors),
        "rms_by_axis_mm": np.sqrt(np.mean(errors**2, axis=0)).tolist(),
        "mean_by_axis_mm": errors.mean(axis=0).tolist(),
        "rotation_rms_deg": compute_rms(stack_rotation_errors(columns)),
        "bound_mm": least,
        "over_bound": compute_rms(errors) / least,
        "over_bound_std": 1.0 / math.sqrt(6.0 * len(nees)),
        "over_bound_without_flips": compute_rms(errors[right]) / compute_rms(columns["bound_mm"][right]),
        "nees_over_6": float(np.mean(nees)) / 6.0,
        "nees_over_6_without_flips": float(np.mean(nees[right])) / 6.0,
        "nees_over_6_std": math.sqrt(2.0 / 6.0 / len(nees)),
    }


def _format_case(case: dict[str, Any]) -> str:
    left_out = f", {case['untrusted']} untrusted" if case["untrusted"] else ""
    if case["flipped"]:
        left_out += f"; {case['flipped']} flipped, without them {case['over_bound_without_flips']:.3f} times, "
        left_out += f"NEES / 6 {case['nees_over_6_without_flips']:.3f}"
    return (
        f"{1e3 * case['rms_mm']:7.1f} µm, {case['over_bound']:.3f} ± {case['over_bound_std']:.3f} times the bound of "
        f"{1e3 * case['bound_mm']:.1f} µm; NEES / 6 {case['nees_over_6']:.3f}{left_out}"
    )


def draw(outcome: Outcome, path: Path) -> None:
    """Draw errors against N with the bound, and the distribution of NEES.

    Parameters
    ----------
    outcome : Outcome
    path : Path
        PNG to write.
    """
    from sim.batch.slide import BOUND, COLORS, draw_limit_line, label_line, open_slide, set_ticks, set_titles

    cases = outcome.figures["cases"]
    scale = min(case["mismatch"] for case in cases)
    shown = [case for case in cases if case["mismatch"] == scale]
    best = [c for c in shown if c["estimator"] == shown[0]["estimator"]]
    worst = max(c["over_bound_without_flips"] for c in best)
    flips = sum(c["flipped"] for c in best)
    headline = f"{best[0]['estimator']}: within {worst:.2f} times the Cramer-Rao bound"
    label = "ideal: all mismatches off" if scale == 0.0 else f"mismatches x {scale:g}"
    subline = (
        f"device at (0, 0, 80 mm), noise learned from 10 s of background, {best[0]['n']} poses for each N, {label}"
        + (f"; without {flips} flips" if flips else "")
    )
    with open_slide(path, headline, subline, 1, 2, width_ratios=[1.25, 1.0]) as (left, right):
        left.plot([c["half_periods"] for c in best], [1e3 * c["bound_mm"] for c in best], color=BOUND, lw=9,
                  solid_capstyle="round", zorder=1)  # fmt: skip
        label_line(left, 6, 1e3 * best[2]["bound_mm"], "bound", "#7d838e", xytext=(0, -20), ha="center")
        for name in dict.fromkeys(c["estimator"] for c in shown):
            line = [c for c in shown if c["estimator"] == name]
            apart = [1e3 * c["over_bound_without_flips"] * c["bound_mm"] for c in line]
            left.plot([c["half_periods"] for c in line], apart, "o-", color=COLORS[name], lw=2)
            for c in line:
                if c["flipped"]:
                    left.plot(c["half_periods"], 1e3 * c["rms_mm"], "o", color=COLORS[name], mfc="white", mew=1.5)
                    left.annotate(f"with {c['flipped']} flips", (c["half_periods"], 1e3 * c["rms_mm"]), xytext=(8, -3),
                                  textcoords="offset points", fontsize=9, color=COLORS[name])  # fmt: skip
            label_line(left, 6, apart[2], name, COLORS[name], xytext=(4, 14))
        left.set(xscale="log", yscale="log", xlim=(0.9, 24))
        set_ticks(left, [c["half_periods"] for c in best])
        left.set_yticks([20, 50, 100, 200, 500, 1000], ["20", "50", "100", "200", "500", "1000"])
        set_titles(left, "Rms position error per axis, in µm", "half-periods N")
        columns = select_rows(outcome.columns, mismatch=scale, estimator=best[0]["estimator"])
        kept = np.max(np.abs(stack_rotation_errors(columns)), axis=1) <= FLIP_DEG
        mean, top = float(np.mean(columns["nees"][kept])) / 6.0, 24.0
        right.hist(columns["nees"][kept], bins=60, range=(0, top), density=True, color="#5fa8d3")
        x = np.linspace(0, top, 200)
        right.plot(x, x**2 * np.exp(-x / 2) / 16.0, color=COLORS["whitened"], lw=2)
        label_line(right, 7.5, 0.082, "chi-square, 6 degrees\nof freedom: a consistent\ncovariance", COLORS["whitened"])
        set_titles(right, f"Squared error over covariance; mean / 6 = {mean:.3f}", "NEES")
        draw_limit_line(right, 6.0, "mean if consistent", vertical=True)
        right.set_yticks([])


STUDY = Study(
    name="bound",
    title="Error over the Cramer-Rao bound",
    devices=lambda: {"characterised": make_characterised_device()},
    chunks=make_chunks,
    conclude=conclude,
    draw=draw,
    notes={"position_mm": [1e3 * v for v in REFERENCE_POSITION], "quiet_s": 10.0, "half_periods": HALF_PERIODS},
)
