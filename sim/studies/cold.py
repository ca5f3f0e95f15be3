"""Poses without a prior: anywhere in the volume, in any orientation; none may be confident and wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sim.studies.benches import FLIP_DEG, make_characterised_device, make_localizers, make_pose_row, open_bench
from sim.studies.columns import join_columns, make_columns, select_rows, stack_position_errors
from sim.studies.study import Chunk, Columns, Options, Outcome, Study, cut_chunks, make_rng, split_evenly
from smolbot.core.rotations import compute_rotation_error

HALF_PERIODS = 6
POSES_PER_CHUNK, DEFAULT_POSES = 125, 2000

LOW, HIGH = (-0.04, -0.04, 0.05), (0.04, 0.04, 0.11)
"""Corners of the volume, in m."""

WRONG_MM, WRONG_DEG = 5.0, 20.0
"""Errors above which a pose is wrong."""

NEES_MEDIAN = 5.348
"""Median of chi-square with 6 degrees of freedom."""


def run_chunk(chunk: Chunk) -> Columns:
    """Locate random poses on one bench.

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
    for _ in range(chunk["poses"]):
        position = rng.uniform(LOW, HIGH)
        turn = rng.standard_normal(4)
        orientation = turn / np.linalg.norm(turn)
        recording = bench.record(position, orientation, HALF_PERIODS)
        place = {f"{axis}_mm": 1e3 * float(position[i]) for i, axis in enumerate("xyz")}
        for name, localizer in found.items():
            pose = localizer.locate(recording)
            off = float(np.linalg.norm(compute_rotation_error(np.array(pose.orientation), orientation)))
            rows.append(
                {
                    "mismatch": chunk["mismatch"],
                    "estimator": name,
                    **place,
                    **{f"q{i}": float(v) for i, v in enumerate(orientation)},
                    "off_mm": 1e3 * float(np.linalg.norm(pose.position - position)),
                    "off_deg": float(np.degrees(off)),
                    **make_pose_row(pose, position, orientation),
                }
            )
    return make_columns(rows)


def make_chunks(options: Options) -> list[Chunk]:
    """Make chunks without, then with mismatches, each on a bench of its own.

    Parameters
    ----------
    options : Options

    Returns
    -------
    list of Chunk
    """
    total = options.poses or DEFAULT_POSES
    scales = (0.0, 1.0) if options.mismatch is None else (options.mismatch,)
    pieces = [
        (f"x{scale:g}-{i:03d}", {"mismatch": scale, "poses": size})
        for scale in scales
        for i, size in enumerate(split_evenly(total, POSES_PER_CHUNK))
    ]
    return cut_chunks(options, run_chunk, pieces)


def conclude(options: Options, parts: list[Columns]) -> Outcome:
    """Count poses that are confident and wrong, and trusted ones; compute errors of the trusted ones.

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
    figures: dict[str, Any] = {"cases": []}
    rows: list[tuple[str, str]] = []
    for scale in np.unique(columns["mismatch"]):
        for name in options.estimators:
            part = select_rows(columns, mismatch=scale, estimator=name)
            trusted = part["trusted"] == 1.0
            wrong = (part["off_mm"] > WRONG_MM) | (part["off_deg"] > WRONG_DEG)
            good = trusted & ~wrong
            case = {
                "mismatch": float(scale),
                "estimator": name,
                "poses": len(wrong),
                "confident_wrong": int(np.sum(trusted & wrong)),
                "confident_flips": int(np.sum(trusted & (part["off_deg"] > FLIP_DEG))),
                "untrusted": int(np.sum(~trusted)),
                "untrusted_but_right": int(np.sum(~trusted & ~wrong)),
                "trusted_share": float(np.mean(trusted)),
                "median_off_mm": float(np.median(part["off_mm"][good])),
                "p95_off_mm": float(np.percentile(part["off_mm"][good], 95)),
                "median_off_deg": float(np.median(part["off_deg"][good])),
                "nees_over_6_median": float(np.median(part["nees"][good])) / NEES_MEDIAN,
                "rms_by_axis_mm": np.sqrt(np.mean(stack_position_errors(part)[good] ** 2, axis=0)).tolist(),
            }
            figures["cases"].append(case)
            rows.append(
                (
                    f"mismatch x {scale:g}, {name}",
                    f"{case['confident_wrong']} of {case['poses']} trusted but wrong "
                    f"({case['confident_flips']} of them flips); trusted {case['trusted_share']:.1%}, "
                    f"{case['untrusted_but_right']} of "
                    f"{case['untrusted']} untrusted were right; median {case['median_off_mm']:.2f} mm, "
                    f"{case['median_off_deg']:.2f} deg",
                )
            )
    return Outcome(rows, figures, columns)


def draw(outcome: Outcome, path: Path) -> None:
    """Draw where poses are, trusted or not, and their errors against height.

    Parameters
    ----------
    outcome : Outcome
    path : Path
        PNG to write.
    """
    from sim.batch.slide import COLORS, LIMIT, OTHERS, draw_limit_line, open_slide, set_titles

    cases = outcome.figures["cases"]
    first = cases[0]
    shown = select_rows(outcome.columns, mismatch=first["mismatch"], estimator=first["estimator"])
    headline = (
        f"{first['confident_wrong']} of {first['poses']} cold starts trusted but wrong, "
        f"{first['trusted_share']:.1%} trusted"
    )
    label = "ideal: all mismatches off" if first["mismatch"] == 0 else f"mismatches x {first['mismatch']:g}"
    more = "".join(
        f"; mismatches x {c['mismatch']:g}: {c['confident_wrong']} wrong, {c['trusted_share']:.1%} trusted"
        for c in cases[1:]
        if c["estimator"] == first["estimator"]
    )
    subline = (
        f"{first['estimator']}, N = 6, any orientation, |x|, |y| < 40 mm, 50 to 110 mm high, no prior; {label}{more}"
    )
    trusted = shown["trusted"] == 1.0
    wrong = (shown["off_mm"] > WRONG_MM) | (shown["off_deg"] > WRONG_DEG)
    groups = [
        (trusted & ~wrong, COLORS["whitened"], "trusted and right", 9, "o"),
        (~trusted & ~wrong, OTHERS[1], "not trusted, though right", 26, "o"),
        (~trusted & wrong, LIMIT, "not trusted, and wrong", 26, "o"),
        (trusted & wrong, COLORS["paper"], "trusted, but wrong", 60, "X"),
    ]
    with open_slide(path, headline, subline, 1, 2) as (left, right):
        for mask, color, text, size, marker in groups:
            kind: dict[str, Any] = {"s": size, "color": color, "lw": 0, "alpha": 0.75, "marker": marker}
            left.scatter(
                shown["z_mm"][mask], np.maximum(shown["off_mm"][mask], 1e-3), label=f"{text}: {mask.sum()}", **kind
            )
            right.scatter(shown["off_deg"][mask], np.maximum(shown["off_mm"][mask], 1e-3), **kind)
        for panel in (left, right):
            panel.set_yscale("log")
            panel.set_ylim(2e-3, 500)
            panel.set_yticks([0.01, 0.1, 1, 10, 100], ["0.01", "0.1", "1", "10", "100"])
            draw_limit_line(panel, WRONG_MM, "5 mm")
        right.set_xscale("log")
        right.set_xlim(5e-3, 250)
        right.set_xticks([0.01, 0.1, 1, 10, 100], ["0.01", "0.1", "1", "10", "100"])
        draw_limit_line(right, WRONG_DEG, "20°", vertical=True)
        left.legend(frameon=False, loc="upper left", bbox_to_anchor=(0.0, 1.0), fontsize=10, markerscale=1.2)
        set_titles(left, "Position error in mm, against height", "true height in mm")
        set_titles(right, "Position error in mm, against orientation error", "orientation error in degrees")


STUDY = Study(
    name="cold",
    title="Cold starts",
    devices=lambda: {"characterised": make_characterised_device()},
    chunks=make_chunks,
    conclude=conclude,
    draw=draw,
    estimators=("whitened",),
    notes={"low_m": LOW, "high_m": HIGH, "half_periods": HALF_PERIODS, "wrong": "beyond 5 mm or 20 deg"},
)
