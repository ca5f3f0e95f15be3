"""Precision and localization rate against the number of half-periods (Fig. 2F)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sim.studies.benches import (
    CYCLES,
    REFERENCE_POSITION,
    RING_DOWN,
    make_characterised_device,
    make_localizers,
    open_bench,
)
from sim.studies.columns import join_columns, make_columns, select_rows
from sim.studies.scatter import compute_mean_bound, compute_scatter, locate_repeatedly
from sim.studies.study import Chunk, Columns, Options, Outcome, Study, cut_chunks, make_rng

HALF_PERIODS = tuple(range(1, 21))
BENCHES, DEFAULT_POSES = 4, 200


def compute_rate(half_periods: int) -> float:
    """Compute poses per second from drive, ring-down and listening; computing is left out.

    Parameters
    ----------
    half_periods : int

    Returns
    -------
    float, in Hz
    """
    device = make_characterised_device()
    return 1.0 / (CYCLES / device.frequency + RING_DOWN + half_periods / (2.0 * device.frequency))


def run_chunk(chunk: Chunk) -> Columns:
    """Locate with every N on one bench.

    Parameters
    ----------
    chunk : Chunk

    Returns
    -------
    Columns
    """
    bench = open_bench(chunk, make_characterised_device(), chunk["mismatch"])
    found, rng = make_localizers(bench, chunk["estimators"]), make_rng(chunk)
    rows: list[dict[str, Any]] = []
    for n in HALF_PERIODS:
        least = compute_mean_bound(bench, REFERENCE_POSITION[2], n)
        labels = {"bound_mm": least}
        rows += locate_repeatedly(bench, found, REFERENCE_POSITION[2], n, chunk["poses"], rng, labels)
    return make_columns(rows)


def make_chunks(options: Options) -> list[Chunk]:
    """Make chunks without mismatches: they shift the mean, not the scatter.

    Parameters
    ----------
    options : Options

    Returns
    -------
    list of Chunk
    """
    total, scale = options.poses or DEFAULT_POSES, options.mismatch or 0.0
    sizes = [max(total // BENCHES, 2)] * min(BENCHES, max(total // 2, 1))
    return cut_chunks(
        options, run_chunk, [(f"bench-{i}", {"mismatch": scale, "poses": size}) for i, size in enumerate(sizes)]
    )


def conclude(options: Options, parts: list[Columns]) -> Outcome:
    """Compute the scatter of each N about the mean of all benches.

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
    figures: dict[str, Any] = {"mismatch": options.mismatch or 0.0, "cases": []}
    rows: list[tuple[str, str]] = []
    for n in HALF_PERIODS:
        texts = []
        for name in options.estimators:
            part = select_rows(columns, estimator=name, half_periods=n)
            case = compute_scatter(part) | {"bound_mm": float(np.sqrt(np.mean(part["bound_mm"] ** 2)))}
            figures["cases"].append({"estimator": name, "half_periods": n, "rate_hz": compute_rate(n), **case})
            texts.append(f"{name} {case['sigma_xyz_mm']:.3f}")
            if case["flipped"]:
                texts[-1] += f" (without {case['flipped']} flips {case['sigma_xyz_without_flips_mm']:.3f})"
            texts[-1] += f" ({case['untrusted']} untrusted)" if case["untrusted"] else ""
        least = figures["cases"][-1]["bound_mm"]
        rows.append((f"N = {n}", f"sigma in mm: {', '.join(texts)}; bound {least:.3f}; {compute_rate(n):.2f} poses/s"))
    return Outcome(rows, figures, columns)


def draw(outcome: Outcome, path: Path) -> None:
    """Draw scatter against N, and against the localization rate.

    Parameters
    ----------
    outcome : Outcome
    path : Path
        PNG to write.
    """
    from sim.batch.slide import BOUND, COLORS, LIMIT, label_line, open_slide, set_ticks, set_titles

    cases = outcome.figures["cases"]
    names = list(dict.fromkeys(c["estimator"] for c in cases))
    by_name = {name: [c for c in cases if c["estimator"] == name] for name in names}
    first = by_name[names[0]]
    flips = ", ".join(f"{name} {sum(c['flipped'] for c in by_name[name])}" for name in names)
    headline = f"{1e3 * first[1]['sigma_xyz_without_flips_mm']:.0f} µm at {first[1]['rate_hz']:.1f} poses/s"
    subline = (
        f"{names[0]}, N = 2; device at (0, 0, 80 mm), linear damping 1.1 1/s, "
        f"{first[0]['n']} poses for each N, mismatch x {outcome.figures['mismatch']:g}; flips, left out here: {flips}"
    )
    with open_slide(path, headline, subline, 1, 2) as (left, right):
        ns = [c["half_periods"] for c in first]
        left.plot(ns, [1e3 * c["bound_mm"] for c in first], color=BOUND, lw=9, solid_capstyle="round", zorder=1)
        label_line(left, 13, 1e3 * first[12]["bound_mm"], "bound", "#7d838e", xytext=(0, -18), ha="center")
        paper_n, paper_sigma = [1, 20], [500, 100]
        for panel, x in ((left, paper_n), (right, [compute_rate(n) for n in paper_n])):
            panel.plot(x, paper_sigma, "D", color=LIMIT, ms=8, mfc="white", mew=2, zorder=4)
            panel.set(yscale="log", ylim=(15, 2000))
            panel.set_yticks([20, 50, 100, 200, 500, 1000], ["20", "50", "100", "200", "500", "1000"])
        left.annotate("as printed in the paper", (20, 100), xytext=(-8, 14), textcoords="offset points", ha="right",
                      color="#777777", fontsize=10)  # fmt: skip
        for name, line in by_name.items():
            sigma = [1e3 * c["sigma_xyz_without_flips_mm"] for c in line]
            left.plot(ns, sigma, "o-", color=COLORS[name], lw=2, ms=5)
            right.plot([c["rate_hz"] for c in line], sigma, "o-", color=COLORS[name], lw=2, ms=5)
            label_line(left, 6, sigma[5], name, COLORS[name], xytext=(0, 16), ha="left")
        for n in (1, 2, 6, 20):
            c = first[n - 1]
            right.annotate(f"N = {n}", (c["rate_hz"], 1e3 * c["sigma_xyz_without_flips_mm"]), xytext=(4, -16),
                           color=COLORS[names[0]], textcoords="offset points", fontsize=10)  # fmt: skip
        set_titles(left, "Standard deviation, mean of x, y and z, in µm", "half-periods N")
        set_ticks(left, [1, 2, 4, 6, 10, 15, 20])
        set_titles(right, "The same against the rate", "poses/s (5 cycles of drive, 20 ms ring-down, N half-periods)")


STUDY = Study(
    name="precision",
    title="Precision and rate against half-periods",
    devices=lambda: {"characterised": make_characterised_device()},
    chunks=make_chunks,
    conclude=conclude,
    draw=draw,
    notes={"rate": "1 / (5 cycles + 20 ms + N half-periods); computing not counted", "position_mm": [0, 0, 80]},
)
