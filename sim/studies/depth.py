"""Depth down to which a pose is found to within 1 mm, against the size of the magnet (Fig. 2E)."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sim.studies.benches import make_characterised_device, make_localizers, make_optimised_device, open_bench
from sim.studies.columns import join_columns, make_columns, select_rows
from sim.studies.scatter import compute_mean_bound, compute_scatter, locate_repeatedly
from sim.studies.study import Chunk, Columns, Options, Outcome, Study, cut_chunks, make_rng
from smolbot.core.arrays import FloatArray
from smolbot.core.sensing import Device

EDGE_MM = (math.pi / 4.0) ** (1.0 / 3.0)
"""Edge of the cube with the volume of the paper's magnet, diameter 1 x 1 mm."""

SIZES_MM = (0.5, 0.7, EDGE_MM, 1.2, 1.5, 2.0)
CASES = {"characterised": (make_characterised_device, 2), "optimised": (make_optimised_device, 6)}
LIMIT_MM = 1.0
"""Largest standard deviation at the depth that is searched."""

FIRST_GUESS_MM = {"characterised": 130.0, "optimised": 190.0}
"""Approximate limit for the paper's magnet; heights are chosen around it."""

DEFAULT_POSES, BENCHES = 200, 2
"""Poses of each size, and benches among which they are divided."""

SMALL_EXPONENT = 0.75
"""Depth against edge for magnets smaller than the paper's, whose array is not scaled."""

VOLUME_FACTOR = 1.3
"""Height of a cold start's volume, relative to the greatest height."""

RELATIVE_HEIGHTS = (0.42, 0.55, 0.65, 0.75, 0.82, 0.88, 0.94, 1.0, 1.06, 1.12, 1.2)


def make_device(case: str, size_mm: float) -> Device:
    """Make the device with a cubic magnet of another size; frequency, stop, damping and l0 stay.

    Parameters
    ----------
    case : str
    size_mm : float
        Edge.

    Returns
    -------
    Device
    """
    device = CASES[case][0]()
    return replace(device, moment=device.moment * (size_mm / EDGE_MM) ** 3)


def compute_array_scale(size_mm: float) -> float:
    """Return the scale of the array: it grows with magnets larger than the paper's, and does not shrink.

    Parameters
    ----------
    size_mm : float

    Returns
    -------
    float
    """
    return max(size_mm / EDGE_MM, 1.0)


def list_heights(case: str, size_mm: float) -> FloatArray:
    """Return heights around the expected depth.

    Parameters
    ----------
    case : str
    size_mm : float

    Returns
    -------
    ndarray, shape (n,), in m
    """
    scale = size_mm / EDGE_MM if size_mm > EDGE_MM else (size_mm / EDGE_MM) ** SMALL_EXPONENT
    return 1e-3 * FIRST_GUESS_MM[case] * scale * np.array(RELATIVE_HEIGHTS)


def run_chunk(chunk: Chunk) -> Columns:
    """Locate one size of one device on one bench at all heights.

    Parameters
    ----------
    chunk : Chunk

    Returns
    -------
    Columns
    """
    case, size = chunk["case"], chunk["size_mm"]
    bench = open_bench(chunk, make_device(case, size), chunk["mismatch"], spread=compute_array_scale(size))
    reach = float(list_heights(case, size).max())
    found, rng = make_localizers(bench, chunk["estimators"], reach=VOLUME_FACTOR * reach), make_rng(chunk)
    rows: list[dict[str, Any]] = []
    for height in list_heights(case, size):
        least = compute_mean_bound(bench, float(height), CASES[case][1])
        labels = {"case": case, "size_mm": size, "bound_mm": least}
        rows += locate_repeatedly(bench, found, float(height), CASES[case][1], chunk["poses"], rng, labels)
    return make_columns(rows)


def make_chunks(options: Options) -> list[Chunk]:
    """Make two benches for each size of each device.

    Parameters
    ----------
    options : Options

    Returns
    -------
    list of Chunk
    """
    total, scale = options.poses or DEFAULT_POSES, options.mismatch or 0.0
    pieces = [
        (
            f"{case}-{size:.2f}-{i}",
            {"case": case, "size_mm": size, "mismatch": scale, "poses": max(total // BENCHES, 2)},
        )
        for case in CASES
        for size in SIZES_MM
        for i in range(BENCHES)
    ]
    return cut_chunks(options, run_chunk, pieces)


def find_crossing(places: FloatArray, values: FloatArray, limit: float = LIMIT_MM) -> float:
    """Find where rising `values` first pass `limit`, by linear interpolation of logarithms.

    Parameters
    ----------
    places : ndarray, shape (n,)
    values : ndarray, shape (n,)
    limit : float

    Returns
    -------
    float
        nan if they do not.

    Examples
    --------
    >>> round(find_crossing(np.array([100.0, 120.0]), np.array([0.5, 2.0])), 3)
    110.0
    """
    above = np.flatnonzero(values >= limit)
    if not above.size or above[0] == 0:
        return math.nan  # above or below all heights
    i = int(above[0])
    low, high = math.log(values[i - 1]), math.log(values[i])
    part = (math.log(limit) - low) / (high - low)
    return float(places[i - 1] + part * (places[i] - places[i - 1]))


def conclude(options: Options, parts: list[Columns]) -> Outcome:
    """Compute the depth of each size, and fit a straight line through the characterised device's.

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
    figures: dict[str, Any] = {"mismatch": options.mismatch or 0.0, "cases": [], "depths": []}
    rows: list[tuple[str, str]] = []
    for case in CASES:
        for size in SIZES_MM:
            for name in options.estimators:
                sigmas, bounds, lost = [], [], 0
                for height in list_heights(case, size):
                    part = select_rows(columns, case=case, size_mm=size, estimator=name, height_mm=1e3 * height)
                    one = compute_scatter(part) | {"bound_mm": float(np.sqrt(np.mean(part["bound_mm"] ** 2)))}
                    kind = {"case": case, "size_mm": size, "estimator": name, "height_mm": 1e3 * float(height)}
                    figures["cases"].append({**kind, **one})
                    sigmas.append(one["sigma_xyz_mm"])
                    bounds.append(one["bound_mm"])
                    lost += one["untrusted"]
                places = 1e3 * list_heights(case, size)
                depth, least = find_crossing(places, np.array(sigmas)), find_crossing(places, np.array(bounds))
                figures["depths"].append(
                    {"case": case, "size_mm": size, "estimator": name, "z_max_mm": depth, "z_max_bound_mm": least,
                     "half_periods": CASES[case][1], "untrusted": lost}
                )  # fmt: skip
                mark = " (the paper's magnet)" if size == EDGE_MM else ""
                rows.append(
                    (
                        f"{case}, {name}, a = {size:.2f} mm",
                        f"z_max {depth:.1f} mm, bound {least:.1f} mm, N = {CASES[case][1]}; {lost} untrusted{mark}",
                    )
                )
    return Outcome(rows, figures, columns)


def draw(outcome: Outcome, path: Path) -> None:
    """Draw depth against size, and scatter against height for the paper's magnet.

    Parameters
    ----------
    outcome : Outcome
    path : Path
        PNG to write.
    """
    from sim.batch.slide import BOUND, COLORS, OTHERS, draw_limit_line, label_line, open_slide, set_titles

    depths, cases = outcome.figures["depths"], outcome.figures["cases"]
    name = depths[0]["estimator"]
    of_ours = [d for d in depths if d["size_mm"] == EDGE_MM and d["estimator"] == name]
    mine = {d["case"]: d["z_max_mm"] for d in of_ours}
    headline = f"Under 1 mm to {mine['characterised']:.0f} mm; optimised device to {mine['optimised']:.0f} mm"
    subline = f"{name}; N = 2 and N = 6; above the array's middle; array scaled with magnets larger than the paper's"
    shade = {"characterised": COLORS["whitened"], "optimised": OTHERS[0]}
    with open_slide(path, headline, subline, 1, 2) as (left, right):
        for case in CASES:
            for estimator in dict.fromkeys(d["estimator"] for d in depths):
                line = [d for d in depths if d["case"] == case and d["estimator"] == estimator]
                style = "o-" if estimator == name else "s--"
                color = shade[case] if estimator == name else COLORS["paper"]
                left.plot([d["size_mm"] for d in line], [d["z_max_mm"] for d in line], style, color=color, lw=2, ms=6,
                          alpha=1.0 if case == "characterised" or estimator == name else 0.6)  # fmt: skip
                known = [d for d in line if math.isfinite(d["z_max_mm"])]
                if known:
                    last = known[-1]
                    shift = (6, 12 if (case, estimator) == ("characterised", name) else -8)
                    label_line(left, last["size_mm"], last["z_max_mm"], f"{case},\n{estimator}", color, fontsize=10,
                              xytext=shift)  # fmt: skip
        left.set_xlim(right=2.75)
        left.plot([EDGE_MM] * 2, [112.5, 156], "D", color="#777777", ms=8, mfc="white", mew=2, zorder=5)
        left.plot([], [], "D", color="#777777", ms=8, mfc="white", mew=2, label="the paper: 110 to 115, and 156 mm")
        left.legend(frameon=False, loc="upper left", labelcolor="#777777")
        set_titles(left, "Depth with sigma below 1 mm, in mm", "edge a of the cubic magnet in mm")
        for case in CASES:
            line = [c for c in cases if c["case"] == case and c["size_mm"] == EDGE_MM and c["estimator"] == name]
            x = [c["height_mm"] for c in line]
            right.plot(x, [c["bound_mm"] for c in line], color=BOUND, lw=8, solid_capstyle="round", zorder=1)
            right.plot(x, [c["sigma_xyz_mm"] for c in line], "o-", color=shade[case], lw=2)
            at = 6 if case == "characterised" else 3
            shift_by: dict[str, Any] = {"xytext": (10, -8)}
            if case == "characterised":
                shift_by = {"xytext": (-10, 8), "ha": "right"}
            label_line(right, x[at], line[at]["sigma_xyz_mm"], f"{case}, N = {CASES[case][1]}", shade[case], **shift_by)
        right.set_yscale("log")
        right.set_yticks([0.05, 0.1, 0.2, 0.5, 1, 2, 5], ["0.05", "0.1", "0.2", "0.5", "1", "2", "5"])
        draw_limit_line(right, 1.0, "1 mm")
        set_titles(right, "Sigma for the paper's magnet, in mm (grey: bound)", "height above the sensors in mm")


STUDY = Study(
    name="depth",
    title="Depth with under 1 mm of scatter",
    devices=lambda: {"characterised": make_characterised_device(), "optimised": make_optimised_device()},
    chunks=make_chunks,
    conclude=conclude,
    draw=draw,
    notes={
        "magnet_edge_mm": EDGE_MM,
        "array": "scaled about the origin by a / 0.92 mm for magnets larger than the paper's",
        "half_periods": {case: n for case, (_, n) in CASES.items()},
    },
)
